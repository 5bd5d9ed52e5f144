"""Figures of one quantity against another, as plain plotly values: curves with points, and spreads over repetitions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.report.figures import axis, base_layout
from pam_antagonist.report.style import ESTIMATE, MEASURED, MODEL, QUIET, SECOND

FloatArray = NDArray[np.float64]
PALETTE = (MODEL, ESTIMATE, SECOND, "#cc79a7", "#e69f00", "#56b4e9", MEASURED, QUIET)
"""Okabe and Ito's colours, for curves that have no meaning of their own."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve or a set of points.

    Attributes:
        name: in the legend.
        x: (N,).
        y: (N,).
        color: CSS colour.
        points: draw points in place of a line.
        dash: plotly's dash, empty for a full line.
        quiet: not in the legend.
    """

    name: str
    x: FloatArray
    y: FloatArray
    color: str
    points: bool = False
    dash: str = ""
    quiet: bool = False


def _values(values: FloatArray) -> list[float]:
    return [float(f"{value:.6g}") for value in np.asarray(values, dtype=np.float64)]


def chart(panels: Sequence[tuple[str, str, Sequence[Curve]]], height: int = 330) -> dict[str, Any]:
    """Charts beside each other.

    Args:
        panels: title of x, title of y (both with the unit in brackets) and curves of each.
        height: in pixels.

    Returns:
        plotly's ``data`` and ``layout`` as plain values.
    """
    layout = base_layout(height)
    gap = 0.1
    width = (1.0 - gap * (len(panels) - 1)) / len(panels)
    data = []
    for number, (x_title, y_title, curves) in enumerate(panels):
        suffix = str(number + 1) if number else ""
        left = number * (width + gap)
        layout["xaxis" + suffix] = axis(
            title={"text": x_title, "standoff": 6}, zeroline=False, domain=[left, left + width], anchor="y" + suffix
        )
        layout["yaxis" + suffix] = axis(title={"text": y_title, "standoff": 4}, anchor="x" + suffix, nticks=7)
        for curve in curves:
            style: dict[str, Any] = (
                {"mode": "markers", "marker": {"color": curve.color, "size": 6}}
                if curve.points
                else {"mode": "lines", "line": {"color": curve.color, "width": 1.7, "dash": curve.dash or "solid"}}
            )
            data.append(
                {
                    "type": "scatter",
                    "name": curve.name,
                    "legendgroup": curve.name,
                    "showlegend": not curve.quiet,
                    "x": _values(curve.x),
                    "y": _values(curve.y),
                    "xaxis": "x" + suffix,
                    "yaxis": "y" + suffix,
                    **style,
                }
            )
    layout["hovermode"] = "closest"
    return {"data": data, "layout": layout}


def spreads(rows: Sequence[tuple[str, FloatArray, str]], title: str, log: bool = False) -> dict[str, Any]:
    """One row of points a name, each point a repetition, with a bar at their median.

    Args:
        rows: name, values (K,) and colour, from top to bottom.
        title: of the axis, with the unit in brackets.
        log: a logarithmic axis.

    Returns:
        plotly's ``data`` and ``layout`` as plain values.
    """
    layout = base_layout(80 + 34 * len(rows))
    layout["margin"] = {"l": 66, "r": 14, "t": 10, "b": 44}
    layout["xaxis"] = axis(title={"text": title, "standoff": 6}, zeroline=False, **({"type": "log"} if log else {}))
    names = [name for name, _, _ in rows]
    layout["yaxis"] = axis(
        tickvals=list(range(len(rows))),
        ticktext=names,
        range=[len(rows) - 0.5, -0.5],
        zeroline=False,
        automargin=True,
    )
    layout["hovermode"] = "closest"
    layout["showlegend"] = False
    data = []
    for number, (name, values, color) in enumerate(rows):
        known = np.asarray(values, dtype=np.float64)
        known = known[np.isfinite(known)]
        # A fixed jitter, so that points of equal value do not hide each other.
        place = number + 0.24 * (np.arange(len(known)) % 5 - 2) / 2
        hover = {"hovertemplate": "%{x}<extra>" + name + "</extra>"}
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": _values(known),
                "y": _values(place),
                "marker": {"color": color, "size": 6, "opacity": 0.45},
                **hover,
            }
        )
        if len(known):
            middle = float(np.median(known))
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "x": [middle, middle],
                    "y": [number - 0.36, number + 0.36],
                    "line": {"color": color, "width": 4},
                    **hover,
                }
            )
    return {"data": data, "layout": layout}
