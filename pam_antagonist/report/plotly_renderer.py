"""Interactive figures for the page, drawn by plotly's JavaScript library, which is included in the page.

Library and data are compressed; as plain text they would be three times as large.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
import re
import textwrap
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.optional import needs
from pam_antagonist.report import decimate
from pam_antagonist.report.figure import (
    GRID,
    INK,
    QUIET,
    VEIL,
    ZERO,
    Axis,
    Band,
    Bars,
    Figure,
    Heatmap,
    Line,
    Panel,
    Points,
    Reference,
    Region,
)

Values = dict[str, Any]
FloatArray = NDArray[np.float64]

_FONT = 'system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans","DejaVu Sans",sans-serif'
_DECADES = [10.0**power for power in range(-6, 10)]
_CLEAR = "rgba(0,0,0,0)"
_LONGEST = 10
"""Largest number of letters in one line of a name below a column."""
_DENSE = 26.0
"""Rows with a smaller height [px] have small letters."""


def library() -> str:
    """Plotly's library, read from the installed package."""
    with needs("reports", "figures of report.html (leave them out by --no-figures)"):
        from plotly.offline import get_plotlyjs
    return str(get_plotlyjs())


def packed(text: str) -> str:
    """A text compressed for the page: gzip in base64, reproducible."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


def text(figure: Figure) -> str:
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
        whole = {"fixedrange": True} if any(isinstance(part, Heatmap) and part.cell for part in panel.series) else {}
        layout["xaxis" + suffix] = {
            **_horizontal(panel, lowest), **follows, **whole, "domain": area[:2], "anchor": "y" + suffix
        }  # fmt: skip
        layout["yaxis" + suffix] = {**_vertical(panel), **whole, "domain": area[2:], "anchor": "x" + suffix}
        if panel.title:
            layout["annotations"].append(_label(panel.title, f"x{suffix} domain", f"y{suffix} domain", 0, 1, INK))
        for part in panel.series:
            if isinstance(part, Region):
                look = {"fillcolor": part.color, "line": {"width": 0}, "layer": "below"}
                layout["shapes"].append(_shape("rect", "x", part.first, part.last, suffix, **look))
            elif isinstance(part, Reference):
                dashed = {"color": part.color, "width": 1.4, "dash": "dash"}
                axis = "x" if part.vertical else "y"
                layout["shapes"].append(_shape("line", axis, part.value, part.value, suffix, line=dashed))
                if part.label:
                    height = math.log10(part.value) if panel.y.log else part.value
                    label = _label(part.label, f"x{suffix} domain", "y" + suffix, 1, height, part.color)
                    layout["annotations"].append({**label, "bgcolor": VEIL})
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
    out = {**_axis(axis, 6), "zeroline": bool(panel.y.labels) and not axis.is_time and not axis.labels}
    if axis.is_time:
        out |= {"meta": "time", "hoverformat": ".3f"}
    if axis.labels:
        # Wrap long names: plotly leaves out names that do not fit, as on a phone.
        names = ["<br>".join(_text(line) for line in textwrap.wrap(name, _LONGEST)) for name in axis.labels]
        out |= {"showgrid": False, "ticktext": names}
    if not lowest:
        del out["title"]
        out |= {"showticklabels": False, "ticks": ""}
    return out


def _vertical(panel: Panel) -> Values:
    axis = panel.y
    out = _axis(axis, 4)
    if axis.labels:
        count = len(axis.labels)
        out |= {"zeroline": False, "showgrid": not panel.x.labels, "range": axis.bounds or (count - 0.5, -0.5)}
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
    x, y = decimate.curve(part.x, part.y, panel.x.is_time) if isinstance(part, Line) else (part.x, part.y)
    digits = 4 if isinstance(part, Line) and part.opacity < 1.0 else 5  # without a hover text, only pixels count
    out: Values = {"type": "scatter", **common, "x": _rounded(x, panel.x, 6), "y": _rounded(y, panel.y, digits)}
    if isinstance(part, Bars):
        return {**out, "type": "bar", "marker": {"color": part.color}}
    if isinstance(part, Line):
        out |= {"mode": "lines", "line": {"color": part.color, "width": part.width, "dash": part.dash or "solid"}}
        if part.opacity < 1.0:
            out |= {"opacity": part.opacity, "hoverinfo": "skip"}
    else:
        marker = {"color": part.color, "size": part.size, "opacity": part.opacity}
        out |= {"mode": "markers", "marker": {**marker, "symbol": "circle-open" if part.hollow else "circle"}}
        if part.half_width is not None:
            half = {"array": _rounded(part.half_width, panel.x), "thickness": part.bar_width, "width": 0}
            return {**out, "error_x": {"type": "data", "color": part.color, **half}}
    # The row is named at the axis already.
    return {**out, "hovertemplate": f"%{{x}}<extra>{_text(part.name)}</extra>"} if panel.y.labels else out


def _outline(part: Band, panel: Panel) -> Values:
    """A closed outline for each uninterrupted stretch of a band, with a gap between them."""
    gap = np.array([np.nan])
    x, y = [gap[:0]], [gap[:0]]
    for place, low, high in decimate.band(part.x, part.lower, part.upper, panel.x.is_time):
        x += [place, place[::-1], place[:1], gap]
        y += [high, low[::-1], high[:1], gap]
    points = {
        "x": _rounded(np.concatenate(x), panel.x, 6), "y": _rounded(np.concatenate(y), panel.y, 4)
    }  # fmt: skip
    area = {"fill": "toself", "fillcolor": part.color, "line": {"width": 0}, "hoverinfo": "skip"}
    return {"type": "scatter", "mode": "lines", **points, **area}


def _heatmap(part: Heatmap, panel: Panel) -> Values:
    steps = len(part.colors) - 1
    out: Values = {
        "type": "heatmap", "x": _rounded(part.x, panel.x, 6), "y": list(range(len(part.rows))),
        "z": [_rounded(row, Axis(), 4) for row in part.values], "hovertemplate": _template(part) + "<extra></extra>",
        "colorscale": [[k / steps, color] for k, color in enumerate(part.colors)],
        "zmin": part.bounds[0], "zmax": part.bounds[1], "showscale": False,
    }  # fmt: skip
    if not part.cell:
        return {**out, "text": [[_text(name)] * len(part.x) for name in part.rows]}
    cells = [[part.cell.format(value=value) if math.isfinite(value) else "" for value in row] for row in part.values]
    return {**out, "text": cells, "texttemplate": "%{text}", "xgap": 1, "ygap": 1}


def _template(part: Heatmap) -> str:
    """The hover text as a plotly template; if cells have a text, the axis gives the name of the row."""
    out = part.hover.replace("\n", "<br>")
    for name, place in (("row", "y" if part.cell else "text"), ("column", "x"), ("value", "z")):
        out = re.sub(rf"\{{{name}\b", f"%{{{place}", out)
    return out


def _shape(kind: str, along: str, first: float, last: float, suffix: str, **look: Any) -> Values:
    """A line or an area from one value of an axis to another one, over the whole panel in the other direction."""
    across = "y" if along == "x" else "x"
    ends = {f"{along}ref": along + suffix, f"{along}0": first, f"{along}1": last}
    whole = {f"{across}ref": f"{across}{suffix} domain", f"{across}0": 0, f"{across}1": 1}
    return {"type": kind, **ends, **whole, **look}


def _label(text: str, xref: str, yref: str, x: float, y: float, color: str) -> Values:
    """A text above a position, towards the middle of the panel."""
    place = {"xref": xref, "yref": yref, "x": x, "y": y, "xanchor": "right" if x else "left", "yanchor": "bottom"}
    return {**place, "text": _text(text), "showarrow": False, "font": {"size": 11, "color": color}}


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
