"""Documents as self-contained HTML pages, which need no network and stay readable in ten years.

The templates contain all HTML. The style sheet, the script and, for figures, plotly's library are written into the
file. A content security policy keeps a browser from loading anything else. Library and data of the figures are
compressed; as plain text they would be three times as large.

Curves are decimated so that outliers stay visible. Sixty seconds at 1 kHz are 60,000 samples for a plot that is 1,000
pixels wide. Taking every k-th sample would lose spikes, and a mean would flatten them. Here each bucket of samples
keeps its least and its largest value at their times, so that the drawn curve fills the same pixels as the full one.
"""

from __future__ import annotations

import base64
import gzip
import itertools
import json
import math
import re
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from jinja2.filters import do_mark_safe
from numpy.typing import NDArray

from pam_antagonist import strict_json
from pam_antagonist.optional import needs
from pam_antagonist.report.document import Document, Section, figures_of, with_unit
from pam_antagonist.report.figure import (
    DARK,
    DEEP,
    GRID,
    INK,
    PALE,
    QUIET,
    VEIL,
    ZERO,
    Axis,
    Band,
    Bars,
    Figure,
    FloatArray,
    Heatmap,
    Line,
    Panel,
    Points,
    Reference,
    Region,
)

Values = dict[str, Any]
IndexArray = NDArray[np.int64]

LIMIT = 2000
"""Most points of one curve: least and largest value for each pixel of a figure that is 1,000 pixels wide."""
_PAUSE = 5.0
"""A time step of more than this many median steps is a pause."""
_OPTION = re.compile(r"(?<!\S)--[a-z][a-z-]*")
_CHECKSUM = re.compile(r"\b[0-9a-f]{64}\b")
_FONT = 'system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans","DejaVu Sans",sans-serif'
_DECADES = [10.0**power for power in range(-6, 10)]
_CLEAR = "rgba(0,0,0,0)"
_DENSE = 26.0
"""Rows with a smaller height [px] have small letters."""


def render(document: Document) -> str:
    """The whole page."""
    plotly = _library() if any(figures_of(document.blocks)) else ""
    sections = [block for block in document.blocks if isinstance(block, Section) and block.anchor]
    page = _environment().get_template("page.html.j2")
    return page.render(document=document, sections=sections, library=plotly, dark=DARK, serial=itertools.count(1))


def write(folder: Path, document: Document, numbers: Any) -> None:
    """Write ``report.json``, with these numbers, and ``report.html`` into an existing folder."""
    strict_json.write_json(folder / "report.json", numbers)
    (folder / "report.html").write_text(render(document), encoding="utf-8")


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("pam_antagonist.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters["unbroken"] = _unbroken
    environment.filters["kind"] = lambda block: type(block).__name__
    environment.filters["packed"] = _packed
    environment.filters["plotly"] = _figure
    environment.globals["next"] = next
    return environment


def _unbroken(text: str) -> str:
    """Forbid line breaks between a number and its unit, in units and options; allow them in checksums."""
    shown = _CHECKSUM.sub(lambda found: "<wbr>".join(re.findall(".{8}", found[0])), escape(with_unit(text)))
    return do_mark_safe(_OPTION.sub(r'<span class="option">\g<0></span>', shown))


def _library() -> str:
    """Plotly's library, read from the installed package."""
    with needs("reports", "figures of report.html (leave them out by --no-figures)"):
        from plotly.offline import get_plotlyjs
    return str(get_plotlyjs())


def _packed(text: str) -> str:
    """A text compressed for the page: gzip in base64, reproducible."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


def _figure(figure: Figure) -> str:
    """A figure as JSON for the page's script."""
    return json.dumps(plot(figure), allow_nan=False, ensure_ascii=False, separators=(",", ":"))


def plot(figure: Figure) -> Values:
    """Plotly's ``data`` and ``layout`` as plain values."""
    left, right, top, bottom = figure.margins
    # A pointer over time or lags reads all series at one place; elsewhere the nearest point.
    along = any(panel.x.is_time or any(isinstance(part, Bars) for part in panel.series) for panel in figure.panels)
    layout: Values = {
        "height": figure.height, "margin": {"l": left, "r": right, "t": top, "b": bottom},
        "font": {"family": _FONT, "size": 12, "color": INK}, "paper_bgcolor": _CLEAR, "plot_bgcolor": _CLEAR,
        "hovermode": "x" if along else "closest",
        "modebar": {"bgcolor": _CLEAR, "color": QUIET, "activecolor": "#0b5c8a"},
        "legend": {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom", "itemsizing": "constant"},
        "barmode": "group", "bargap": 0.35, "shapes": [], "annotations": [],
    }  # fmt: skip
    data: list[Values] = []
    for number, (panel, area) in enumerate(zip(figure.panels, figure.areas(), strict=True)):
        suffix = str(number + 1) if number else ""
        lowest = figure.side_by_side or number == len(figure.panels) - 1
        follows = {"matches": "x"} if number and not figure.side_by_side else {}
        layout["xaxis" + suffix] = {
            **_horizontal(panel, lowest), **follows, "domain": area[:2], "anchor": "y" + suffix
        }  # fmt: skip
        layout["yaxis" + suffix] = {**_vertical(panel), "domain": area[2:], "anchor": "x" + suffix}
        for part in panel.series:
            if isinstance(part, Region):
                look = {"fillcolor": part.color, "line": {"width": 0}, "layer": "below"}
                layout["shapes"].append(_shape("rect", "x", part.first, part.last, suffix, **look))
            elif isinstance(part, Reference):
                dashed = {"color": part.color, "width": 1.4, "dash": "dash"}
                axis = "x" if part.vertical else "y"
                layout["shapes"].append(_shape("line", axis, part.value, part.value, suffix, line=dashed))
                if part.label:
                    layout["annotations"].append(_label(part, panel, suffix))
            else:
                place = {"xaxis": "x" + suffix, "yaxis": "y" + suffix}
                data.append({**_trace(part, panel), **place})
    return {"data": data, "layout": layout}


def _axis(axis: Axis, standoff: int) -> Values:
    """Common settings of both axes of a panel."""
    out: Values = {
        "title": {"text": _text(axis.title), "standoff": standoff}, "gridcolor": GRID, "zerolinecolor": ZERO,
        "linecolor": QUIET, "showline": True, "ticks": "outside", "ticklen": 4, "automargin": bool(axis.labels),
        "exponentformat": "power",
    }  # fmt: skip
    if axis.labels:
        out |= {"tickvals": list(range(len(axis.labels))), "ticktext": [_text(name) for name in axis.labels]}
    if axis.log:
        out["type"] = "log"
    if axis.bounds:
        out["range"] = [math.log10(end) for end in axis.bounds] if axis.log else list(axis.bounds)
    if axis.from_zero:
        out["rangemode"] = "tozero"
    return out


def _horizontal(panel: Panel, lowest: bool) -> Values:
    axis = panel.x
    # Named rows get a vertical line at zero.
    out = {**_axis(axis, 6), "zeroline": bool(panel.y.labels) and not axis.is_time}
    if axis.is_time:
        out |= {"meta": "time", "hoverformat": ".3f"}
    if not lowest:
        del out["title"]
        out |= {"showticklabels": False, "ticks": ""}
    return out


def _vertical(panel: Panel) -> Values:
    axis = panel.y
    out = _axis(axis, 4)
    if axis.labels:
        count = len(axis.labels)
        out |= {"zeroline": False, "range": axis.bounds or (count - 0.5, -0.5)}
        if panel.height / count < _DENSE:
            out["tickfont"] = {"size": 10}
    elif axis.log:
        out |= {"tickvals": _DECADES, "ticktext": [f"{value:g}" for value in _DECADES]}
    else:
        out["nticks"] = 6
    return out


def _trace(part: Line | Band | Points | Bars | Heatmap, panel: Panel) -> Values:
    if isinstance(part, Heatmap):
        return _heatmap(part, panel)
    common = {"name": _text(part.name), "legendgroup": _text(part.name), "showlegend": not part.quiet}
    if isinstance(part, Band):
        return {**common, **_outline(part, panel)}
    x, y = decimated(part.x, part.y, panel.x.is_time) if isinstance(part, Line) else (part.x, part.y)
    digits = 4 if isinstance(part, Line) and part.opacity < 1.0 else 5  # without a hover text, only pixels count
    out: Values = {"type": "scatter", **common, "x": _rounded(x, panel.x, 6), "y": _rounded(y, panel.y, digits)}
    if isinstance(part, Bars):
        return {**out, "type": "bar", "marker": {"color": part.color}}
    if isinstance(part, Line):
        out |= {"mode": "lines", "line": {"color": part.color, "width": part.width, "dash": part.dash or "solid"}}
        if part.opacity < 1.0:
            out |= {"opacity": part.opacity, "hoverinfo": "skip"}
    else:
        symbol = "circle-open" if part.hollow else "circle"
        out |= {"mode": "markers", "marker": {"color": part.color, "size": part.size, "symbol": symbol}}
        if part.half_width is not None:
            half = {"array": _rounded(part.half_width, panel.x), "thickness": part.bar_width, "width": 0}
            return {**out, "error_x": {"type": "data", "color": part.color, **half}}
    # The row is named at the axis already.
    return {**out, "hovertemplate": f"%{{x}}<extra>{_text(part.name)}</extra>"} if panel.y.labels else out


def _outline(part: Band, panel: Panel) -> Values:
    """A closed outline for each uninterrupted stretch of a band, with a gap between them."""
    gap = np.array([np.nan])
    x, y = [gap[:0]], [gap[:0]]
    for place, low, high in decimated_band(part.x, part.lower, part.upper, panel.x.is_time):
        x += [place, place[::-1], place[:1], gap]
        y += [high, low[::-1], high[:1], gap]
    points = {
        "x": _rounded(np.concatenate(x), panel.x, 6), "y": _rounded(np.concatenate(y), panel.y, 4)
    }  # fmt: skip
    area = {"fill": "toself", "fillcolor": part.color, "line": {"width": 0}, "hoverinfo": "skip"}
    return {"type": "scatter", "mode": "lines", **points, **area}


def _heatmap(part: Heatmap, panel: Panel) -> Values:
    return {
        "type": "heatmap", "x": _rounded(part.x, panel.x, 6), "y": list(range(len(part.rows))),
        "z": [_rounded(row, Axis(), 4) for row in part.values],
        "text": [[_text(name)] * len(part.x) for name in part.rows],
        "hovertemplate": "%{text}<br>%{x} s: %{z:.0%} of the time<extra></extra>",
        "colorscale": [[0.0, PALE], [1.0, DEEP]], "zmin": 0.0, "zmax": 1.0, "showscale": False,
    }  # fmt: skip


def _shape(kind: str, along: str, first: float, last: float, suffix: str, **look: Any) -> Values:
    """A line or an area from one value of an axis to another one, over the whole panel in the other direction."""
    across = "y" if along == "x" else "x"
    ends = {f"{along}ref": along + suffix, f"{along}0": first, f"{along}1": last}
    whole = {f"{across}ref": f"{across}{suffix} domain", f"{across}0": 0, f"{across}1": 1}
    return {"type": kind, **ends, **whole, **look}


def _label(part: Reference, panel: Panel, suffix: str) -> Values:
    """The text of a line: at the right end above it, or at the upper end beside it."""
    if part.vertical:
        place: Values = {"xref": "x" + suffix, "x": part.value, "yref": f"y{suffix} domain", "y": 1, "yanchor": "top"}
    else:
        height = math.log10(part.value) if panel.y.log else part.value
        place = {"xref": f"x{suffix} domain", "x": 1, "yref": "y" + suffix, "y": height, "yanchor": "bottom"}
    look = {"font": {"size": 11, "color": part.color}, "bgcolor": VEIL, "xanchor": "right", "showarrow": False}
    return {**place, **look, "text": _text(part.label)}


def _text(text: str) -> str:
    """Plain text for plotly, with HTML escaped."""
    return escape(text, quote=False)


def _rounded(values: FloatArray, axis: Axis, digits: int = 5) -> list[float | None]:
    """Values rounded to visible digits for a smaller page, None for NaN."""
    values = np.asarray(values, dtype=np.float64)
    if axis.log:
        return [float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values]
    finite = values[np.isfinite(values)]
    span = float(np.max(np.abs(finite), initial=0.0))
    decimals = digits - 1 - math.floor(math.log10(span)) if span > 0.0 else digits
    rounded = np.round(values, min(max(decimals, 0), 12))
    return [float(value) if math.isfinite(value) else None for value in rounded]


def bucket_width(samples: int, limit: int = LIMIT) -> int:
    """Samples in each bucket, so that two points from each stay within the limit (1: all samples are kept)."""
    return 1 if samples <= limit else -(-samples // (limit // 2))


def _buckets(values: FloatArray, width: int, fill: float) -> FloatArray:
    """Rows of `width` samples; `fill` replaces NaN and pads the last row."""
    known = np.where(np.isnan(values), fill, values)
    return np.pad(known, (0, -len(values) % width), constant_values=fill).reshape(-1, width)


def min_max_indices(values: FloatArray, limit: int = LIMIT) -> IndexArray:
    """Indices of the least and the largest sample of each bucket."""
    width = bucket_width(len(values), limit)
    if width == 1:
        return np.arange(len(values))
    low, high = _buckets(values, width, np.inf).argmin(axis=1), _buckets(values, width, -np.inf).argmax(axis=1)
    starts = np.arange(len(low)) * width
    return np.unique(np.concatenate((starts + low, starts + high)))


def envelope(lower: FloatArray, upper: FloatArray, limit: int = LIMIT) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Decimate a band so that it still covers the full one."""
    width = bucket_width(len(lower), limit)
    low, high = _buckets(lower, width, np.inf).min(axis=1), _buckets(upper, width, -np.inf).max(axis=1)
    known = np.isfinite(low) & np.isfinite(high)
    middle = np.minimum(np.arange(len(low)) * width + width // 2, len(lower) - 1)
    return middle, np.where(known, low, np.nan), np.where(known, high, np.nan)


def stretches(x: FloatArray) -> IndexArray:
    """Number of the stretch that each sample (N,) belongs to; a pause of over five median steps starts a new one."""
    if len(x) < 3:
        return np.zeros(len(x), np.int64)
    step = np.diff(x)
    return np.concatenate(([0], np.cumsum(step > _PAUSE * np.median(step))))


def decimated(x: FloatArray, y: FloatArray, with_pauses: bool) -> tuple[FloatArray, FloatArray]:
    """A curve with at most about `LIMIT` points; `with_pauses`: those in a recording's time become gaps."""
    index = min_max_indices(y)
    if not with_pauses:
        return x[index], y[index]
    gaps = np.flatnonzero(np.diff(stretches(x)[index]) != 0) + 1
    return np.insert(x[index], gaps, np.nan), np.insert(y[index], gaps, np.nan)


def decimated_band(
    x: FloatArray, lower: FloatArray, upper: FloatArray, with_pauses: bool
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """The uninterrupted stretches of a decimated band: x, lower and upper edge of each; as :func:`decimated`."""
    index, low, high = envelope(lower, upper)
    group = stretches(x)[index] if with_pauses else np.zeros(len(index), np.int64)
    key = np.where(np.isfinite(low), group, -1)
    runs = np.split(np.arange(len(index)), np.flatnonzero(np.diff(key) != 0) + 1)
    return [(x[index[run]], low[run], high[run]) for run in runs if len(run) > 1 and key[run[0]] >= 0]
