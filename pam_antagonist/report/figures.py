"""Time series as plotly figures, built as plain values: plotly itself is not imported here.

A figure is one or more panels above each other over the same time axis. Everything is thinned by
:mod:`pam_antagonist.report.decimate`, and a pause in the recording is a gap in the line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.report import decimate
from pam_antagonist.report.style import QUIET

FloatArray = NDArray[np.float64]

_FONT = 'system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans","DejaVu Sans",sans-serif'
_GAP = 5
"""A pause of more than this many sample periods breaks a line."""


@dataclass(frozen=True, eq=False)
class Clock:
    """The time axis of a recording.

    Attributes:
        seconds: time since the recording's first sample, (N,) [s].
        group: number of the uninterrupted stretch that each sample belongs to, (N,).
    """

    seconds: FloatArray
    group: NDArray[np.int64]

    @classmethod
    def from_stamps(cls, stamp_ns: NDArray[np.int64], origin_ns: int, period: float) -> Clock:
        """The axis of these stamps.

        Args:
            stamp_ns: stamps of the samples, (N,) [ns], increasing.
            origin_ns: where time 0 is [ns].
            period: sample period [s].
        """
        seconds = np.asarray((stamp_ns - origin_ns) * 1e-9, dtype=np.float64)
        return cls(seconds, decimate.gap_groups(stamp_ns, int(_GAP * period * 1e9)))


@dataclass(frozen=True, eq=False)
class Line:
    """A curve.

    Attributes:
        name: what the legend calls it; lines of one name are switched together.
        values: (N,), NaN where there is nothing.
        color: CSS colour.
        dash: plotly's dash, empty for a full line.
        width: in pixels.
        quiet: not in the legend.
        opacity: 0 to 1.
    """

    name: str
    values: FloatArray
    color: str
    dash: str = ""
    width: float = 1.3
    quiet: bool = False
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Band:
    """An interval around a curve.

    Attributes:
        name: what the legend calls it.
        lower: (N,) lower edge.
        upper: (N,) upper edge.
        color: CSS colour, translucent.
        quiet: not in the legend.
    """

    name: str
    lower: FloatArray
    upper: FloatArray
    color: str
    quiet: bool = False


@dataclass(frozen=True, eq=False)
class Level:
    """A horizontal line at a value, with a label at its right end."""

    value: float
    label: str
    color: str = QUIET


Part = Line | Band | Level
"""What a panel shows."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One set of axes: `title` carries the unit in brackets, `height` is in pixels."""

    title: str
    parts: Sequence[Part]
    height: int = 230
    log: bool = False
    bounds: tuple[float, float] | None = None


def moving_mean(values: FloatArray, window: int) -> FloatArray:
    """Centred mean over the finite ones of `window` samples, (N,); NaN where there is none."""
    known = np.isfinite(values)
    total = np.concatenate(([0.0], np.cumsum(np.where(known, values, 0.0))))
    count = np.concatenate(([0], np.cumsum(known)))
    low = np.maximum(np.arange(len(values)) - window // 2, 0)
    high = np.minimum(low + window, len(values))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((total[high] - total[low]) / (count[high] - count[low]))


def with_mean(name: str, values: FloatArray, color: str, window: int) -> list[Line]:
    """Every sample, faint, and the mean over a window of samples in front: the error behind the sensor's noise."""
    faint = Line(name, values, color, width=0.8, quiet=True, opacity=0.3)
    return [faint, Line(name, moving_mean(values, window), color, width=1.8, quiet=True)]


def _rounded(values: FloatArray, digits: int = 5) -> list[float]:
    """Values with as many decimals as their range needs: a smaller file that looks the same."""
    finite = values[np.isfinite(values)]
    span = float(np.max(np.abs(finite))) if finite.size else 1.0
    decimals = digits - 1 - math.floor(math.log10(span)) if span > 0.0 else digits
    return [float(value) for value in np.round(values, min(max(decimals, 0), 12))]


def _with_gaps(index: NDArray[np.int64], clock: Clock) -> NDArray[np.int64]:
    """Positions in `index` before which a gap has to be drawn."""
    return np.flatnonzero(np.diff(clock.group[index]) != 0) + 1


def _curve(line: Line, clock: Clock) -> tuple[list[float], list[float]]:
    index = decimate.min_max_indices(line.values)
    breaks = _with_gaps(index, clock)
    x = np.insert(clock.seconds[index], breaks, np.nan)
    y = np.insert(line.values[index], breaks, np.nan)
    return _rounded(x, 6), _rounded(y)


def _outline(band: Band, clock: Clock) -> tuple[list[float], list[float]]:
    """A closed outline for each uninterrupted stretch of a band, with a gap between them."""
    index, low, high = decimate.envelope(band.lower, band.upper)
    present = np.isfinite(low)
    key = np.where(present, clock.group[index] * 2 + 1, -1)
    x: list[FloatArray] = []
    y: list[FloatArray] = []
    for run in np.split(np.arange(len(index)), np.flatnonzero(np.diff(key) != 0) + 1):
        if len(run) < 2 or not present[run[0]]:
            continue
        t = clock.seconds[index[run]]
        x += [t, t[::-1], t[:1], np.array([np.nan])]
        y += [high[run], low[run][::-1], high[run[:1]], np.array([np.nan])]
    if not x:
        return [], []
    return _rounded(np.concatenate(x), 6), _rounded(np.concatenate(y))


def _trace(part: Line | Band, clock: Clock, suffix: str) -> dict[str, Any]:
    common = {
        "type": "scatter",
        "mode": "lines",
        "name": part.name,
        "legendgroup": part.name,
        "showlegend": not part.quiet,
        "xaxis": "x" + suffix,
        "yaxis": "y" + suffix,
    }
    if isinstance(part, Band):
        x, y = _outline(part, clock)
        return {
            **common,
            "x": x,
            "y": y,
            "fill": "toself",
            "fillcolor": part.color,
            "line": {"width": 0},
            "hoverinfo": "skip",
        }
    x, y = _curve(part, clock)
    line = {"color": part.color, "width": part.width, **({"dash": part.dash} if part.dash else {})}
    faint = {"opacity": part.opacity, "hoverinfo": "skip"} if part.opacity < 1.0 else {}
    return {**common, **faint, "x": x, "y": y, "line": line}


def base_layout(height: int) -> dict[str, Any]:
    """Layout that every figure shares."""
    return {
        "height": height,
        "margin": {"l": 66, "r": 14, "t": 34, "b": 44},
        "font": {"family": _FONT, "size": 12, "color": "#1a1d21"},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "hovermode": "x",
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": QUIET, "activecolor": "#0b5c8a"},
        "legend": {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom", "itemsizing": "constant"},
    }


def axis(**changes: Any) -> dict[str, Any]:
    """An axis with a light grid and a line on its lower side."""
    return {
        "gridcolor": "#e8ebee",
        "zerolinecolor": "#b9bfc6",
        "linecolor": "#8a8f98",
        "showline": True,
        "ticks": "outside",
        "ticklen": 4,
        "automargin": False,
        **changes,
    }


def time_axis(last: bool, **changes: Any) -> dict[str, Any]:
    """An axis of seconds; only the lowest panel's carries numbers and title."""
    text = {"title": {"text": "Time [s]", "standoff": 6}} if last else {"showticklabels": False, "ticks": ""}
    return axis(meta="time", zeroline=False, hoverformat=".3f", **text, **changes)


def stack(panels: Sequence[Panel], clock: Clock) -> dict[str, Any]:
    """Panels above each other over one time axis.

    Args:
        panels: from top to bottom.
        clock: time of the samples.

    Returns:
        plotly's ``data`` and ``layout`` as plain values.
    """
    gap, top, bottom = 22, 34, 44
    inner = sum(panel.height for panel in panels) + gap * (len(panels) - 1)
    layout = base_layout(inner + top + bottom)
    data: list[dict[str, Any]] = []
    shapes: list[dict[str, Any]] = []
    labels: list[dict[str, Any]] = []
    upper = float(inner)
    for number, panel in enumerate(panels):
        suffix = str(number + 1) if number else ""
        last = number == len(panels) - 1
        domain = [max((upper - panel.height) / inner, 0.0), upper / inner]
        upper -= panel.height + gap
        matches = {} if number == 0 else {"matches": "x"}
        layout["xaxis" + suffix] = time_axis(last, anchor="y" + suffix, **matches)
        scale: dict[str, Any] = {"nticks": 6}
        if panel.log:
            decades = [10.0**power for power in range(-6, 10)]
            scale = {"type": "log", "tickvals": decades, "ticktext": [f"{value:g}" for value in decades]}
        if panel.bounds:
            ends = [math.log10(bound) for bound in panel.bounds] if panel.log else list(panel.bounds)
            scale["range"] = ends
        layout["yaxis" + suffix] = axis(
            title={"text": panel.title, "standoff": 4}, domain=domain, anchor="x" + suffix, **scale
        )
        for part in panel.parts:
            if isinstance(part, Level):
                shapes.append(_level_line(part, suffix))
                labels.append(_level_label(part, suffix, panel.log))
            else:
                data.append(_trace(part, clock, suffix))
    layout["shapes"] = shapes
    layout["annotations"] = labels
    return {"data": data, "layout": layout}


def _level_line(level: Level, suffix: str) -> dict[str, Any]:
    return {
        "type": "line",
        "xref": f"x{suffix} domain",
        "yref": "y" + suffix,
        "x0": 0,
        "x1": 1,
        "y0": level.value,
        "y1": level.value,
        "line": {"color": level.color, "width": 1.4, "dash": "dash"},
    }


def _level_label(level: Level, suffix: str, log: bool) -> dict[str, Any]:
    return {
        "xref": f"x{suffix} domain",
        "yref": "y" + suffix,
        "x": 1,
        "y": math.log10(level.value) if log else level.value,
        "xanchor": "right",
        "yanchor": "bottom",
        "text": level.label,
        "showarrow": False,
        "font": {"size": 11, "color": level.color},
        "bgcolor": "rgba(255,255,255,0.75)",
    }


def strip(names: Sequence[str], category: NDArray[np.int64], clock: Clock, columns: int = 400) -> dict[str, Any]:
    """Which category is active when: one row a category, darker where more of the time is spent in it.

    Args:
        names: of the categories.
        category: (N,) indices into `names`.
        clock: time of the samples.
        columns: most stretches of time.

    Returns:
        plotly's ``data`` and ``layout`` as plain values. Categories that never occur have no row.
    """
    middle, share = decimate.shares(category, len(names), columns)
    seen = [int(number) for number in np.flatnonzero(share.sum(axis=1) > 0.0)]
    cells = np.where(share[seen] > 0.0, share[seen], np.nan)
    layout = base_layout(max(120, 26 * len(seen) + 90))
    layout["margin"] = {"l": 66, "r": 14, "t": 10, "b": 44}
    layout["xaxis"] = time_axis(True)
    layout["yaxis"] = axis(
        title={"text": "Subsystem σ [-]", "standoff": 4},
        type="category",
        tickmode="array",
        tickvals=list(range(len(seen))),
        ticktext=[names[number].split(":")[0] for number in seen],
    )
    trace = {
        "type": "heatmap",
        "x": _rounded(clock.seconds[middle], 6),
        "y": [names[number].split(":")[0] for number in seen],
        "z": [_rounded(row, 3) for row in cells],
        "text": [[names[number]] * cells.shape[1] for number in seen],
        "hovertemplate": "%{text}<br>%{x} s: %{z:.0%} of the time<extra></extra>",
        "colorscale": [[0.0, "#cfe3f1"], [1.0, "#0b5c8a"]],
        "zmin": 0.0,
        "zmax": 1.0,
        "showscale": False,
    }
    return {"data": [trace], "layout": layout}


def bars(
    lag: FloatArray, groups: Sequence[tuple[str, FloatArray, str]], bound: float, x_title: str, y_title: str
) -> dict[str, Any]:
    """Correlation over lag, with the bounds between which 95 % of a white series' values lie.

    Args:
        lag: (K,) positions.
        groups: name, values (K,) and colour of each series.
        bound: half width of the bounds.
        x_title: with the unit in brackets.
        y_title: with the unit in brackets.

    Returns:
        plotly's ``data`` and ``layout`` as plain values.
    """
    layout = base_layout(260)
    layout["xaxis"] = axis(title={"text": x_title, "standoff": 6}, zeroline=False)
    layout["yaxis"] = axis(title={"text": y_title, "standoff": 4})
    layout["barmode"] = "group"
    layout["bargap"] = 0.35
    layout["shapes"] = [_level_line(Level(sign * bound, ""), "") for sign in (-1.0, 1.0)]
    data = [
        {"type": "bar", "name": name, "x": _rounded(lag), "y": _rounded(values), "marker": {"color": color}}
        for name, values, color in groups
    ]
    return {"data": data, "layout": layout}
