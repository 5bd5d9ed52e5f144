"""Traces of a plotly figure on matplotlib's axes: lines, points, bands, bars and a heatmap (see :mod:`.pictures`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.report.picture_values import FloatArray, Reach, color, dashes, numbers, one_of, only

_PLACE = ("type", "name", "showlegend", "xaxis", "yaxis", "x", "y")
_IDLE = ("legendgroup", "hoverinfo", "hovertemplate")
_BOTTOM = 3.0
"""Traces lie above grid and zero line, in the order in which they are given."""


@dataclass(frozen=True)
class Drawn:
    """A trace that was drawn.

    Attributes:
        x: what it needs of the horizontal axis.
        y: what it needs of the vertical axis.
        key: its sign in a legend, None for a trace that has none.
    """

    x: Reach
    y: Reach
    key: Any = None


def draw(
    axes: Any, traces: Sequence[Mapping[str, Any]], numbered: Sequence[int], layout: Mapping[str, Any]
) -> list[Drawn]:
    """Draw all traces of one pair of axes.

    Args:
        axes: matplotlib's.
        traces: plotly's, from back to front.
        numbered: their numbers in the figure.
        layout: plotly's; bars need their mode and gap.

    Raises:
        BadInput: a trace has something that pictures do not draw.
    """
    bars = [trace for trace in traces if trace.get("type") == "bar"]
    out = []
    for number, trace in zip(numbered, traces, strict=True):
        kind = one_of(f"trace {number}: type", trace.get("type"), ("scatter", "bar", "heatmap"))
        where, depth = f"{kind} trace {number}", _BOTTOM + 1e-3 * number
        if kind == "scatter":
            out.append(_scatter(axes, trace, where, depth))
        elif kind == "bar":
            out.append(_bars(axes, trace, bars, layout, where, depth))
        else:
            out.append(_heatmap(axes, trace, where, depth))
    return out


def _scatter(axes: Any, trace: Mapping[str, Any], where: str, depth: float) -> Drawn:
    only(where, trace, (*_PLACE, "mode", "line", "marker", "opacity", "fill", "fillcolor"), _IDLE)
    mode = one_of(f"{where}: mode", trace["mode"], ("lines", "markers", "lines+markers"))
    x, y = numbers(trace["x"]), numbers(trace["y"])
    if "fill" in trace:
        one_of(f"{where}: fill", trace["fill"], ("toself",))
        return _band(axes, trace, x, y, where, depth)
    style: dict[str, Any] = {"linestyle": "none"}
    if "lines" in mode:
        line = trace["line"]
        only(f"{where}: line", line, ("color", "width", "dash"))
        width = float(line["width"])
        style = {
            "color": color(where, line["color"]),
            "linewidth": width,
            "linestyle": dashes(f"{where}: dash", line.get("dash") or "solid", width),
            "solid_joinstyle": "round",
        }
    if "markers" in mode:
        style |= _marker(trace["marker"], where)
    if "opacity" in trace:
        style["alpha"] = float(trace["opacity"])
    from matplotlib.lines import Line2D

    axes.add_line(Line2D(x, y, zorder=depth, **style))
    return Drawn(Reach(x, "markers" in mode), Reach(y, True), Line2D([], [], **style))


def _marker(marker: Mapping[str, Any], where: str) -> dict[str, Any]:
    only(f"{where}: marker", marker, ("color", "size", "opacity"))
    *solid, alpha = color(where, marker["color"])
    shade = (*solid, alpha * float(marker.get("opacity", 1.0)))
    return {"marker": "o", "markersize": float(marker["size"]), "markerfacecolor": shade, "markeredgecolor": "none"}


def _band(axes: Any, trace: Mapping[str, Any], x: FloatArray, y: FloatArray, where: str, depth: float) -> Drawn:
    """Closed outlines with gaps between them, filled."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    only(f"{where}: line", trace["line"], ("width",))
    one_of(f"{where}: width of a band's line", trace["line"]["width"], (0,))
    one_of(f"{where}: mode of a band", trace["mode"], ("lines",))
    there = np.isfinite(x) & np.isfinite(y)
    runs = np.split(np.arange(len(x)), np.flatnonzero(np.diff(there)) + 1)
    outlines = [np.column_stack([x[run], y[run]]) for run in runs if len(run) and there[run[0]]]
    style: dict[str, Any] = {
        "facecolor": color(where, trace["fillcolor"]),
        "edgecolor": "none",
        **({"alpha": float(trace["opacity"])} if "opacity" in trace else {}),
    }
    axes.add_collection(PolyCollection(outlines, zorder=depth, **style), autolim=False)
    return Drawn(Reach(x, False), Reach(y, True), Patch(**style))


def _bars(
    axes: Any,
    trace: Mapping[str, Any],
    bars: Sequence[Mapping[str, Any]],
    layout: Mapping[str, Any],
    where: str,
    depth: float,
) -> Drawn:
    """Bars from 0, those of several traces beside each other."""
    from matplotlib.patches import Patch

    only(where, trace, (*_PLACE, "marker"), _IDLE)
    only(f"{where}: marker", trace["marker"], ("color",))
    one_of("layout: barmode", layout.get("barmode"), ("group",))
    places = np.unique(np.concatenate([numbers(other["x"]) for other in bars]))
    step = float(np.min(np.diff(places))) if len(places) > 1 else 1.0
    width = step * (1.0 - float(layout["bargap"])) / len(bars)
    turn = next(k for k, other in enumerate(bars) if other is trace) - (len(bars) - 1) / 2
    x, y = numbers(trace["x"]), numbers(trace["y"])
    shade = color(where, trace["marker"]["color"])
    axes.bar(x + turn * width, y, width, color=shade, zorder=depth)
    edges = np.concatenate([places - step / 2, places + step / 2])
    return Drawn(Reach(edges, False), Reach(np.append(y, 0.0), True), Patch(facecolor=shade, edgecolor="none"))


def _heatmap(axes: Any, trace: Mapping[str, Any], where: str, depth: float) -> Drawn:
    """Cells between the middles of their neighbours, rows at 0, 1, ...; a cell without a value is empty."""
    from matplotlib.colors import LinearSegmentedColormap

    only(where, trace, ("type", "xaxis", "yaxis", "x", "y", "z", "colorscale", "zmin", "zmax", "showscale"),
         (*_IDLE, "text"))  # fmt: skip
    one_of(f"{where}: showscale", trace.get("showscale", True), (False,))
    if not all(isinstance(name, str) for name in trace["y"]):
        raise BadInput(f"{where}: pictures draw rows by name; expected strings for y")
    x, z = numbers(trace["x"]), numbers(trace["z"])
    rows = numbers(np.arange(len(trace["y"]) + 1) - 0.5)
    half = np.diff(x) / 2 if len(x) > 1 else np.array([0.5])
    between = x[:-1] + half if len(x) > 1 else x[:0]
    edges = np.concatenate([x[:1] - half[:1], between, x[-1:] + half[-1:]])
    stops = [(place, color(where, shade)) for place, shade in trace["colorscale"]]
    shades = LinearSegmentedColormap.from_list("scale", stops)
    cells = np.ma.masked_invalid(z)
    axes.pcolormesh(edges, rows, cells, cmap=shades, vmin=trace["zmin"], vmax=trace["zmax"], zorder=depth)
    return Drawn(Reach(edges, False), Reach(rows, False))
