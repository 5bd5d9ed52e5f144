"""Figures of static fits: measured points, fitted lines, and errors at lengths that were left out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.static_force import ForceFit
from pam_antagonist.identification.static_result import StaticResult
from pam_antagonist.identification.static_rig import reach
from pam_antagonist.identification.static_table import ForceMap, VolumeTable
from pam_antagonist.identification.static_volume import VolumeFit
from pam_antagonist.report.figures import axis, base_layout
from pam_antagonist.report.html import Figure
from pam_antagonist.report.style import BAND, ESTIMATE, MEASURED, MODEL, QUIET, SECOND

Floats = NDArray[np.float64]

COLORS = {"linear": MEASURED, "hildebrandt": MODEL, "sarosi": ESTIMATE, "polynomial": SECOND}
"""Of the forms of the force map, wherever they are compared."""
_LENGTH_COLORS = ("#440154", "#414487", "#2a788e", "#22a884", "#7ad151", "#c9a400")
"""From the shortest length to the longest: lighter is longer, also without colour vision."""
_POINTS = 60


def static_figures(result: StaticResult) -> list[Figure]:
    """Every figure that the tables give."""
    out = []
    if result.force_map is not None and result.force is not None:
        out += [force_figure(result.force_map, result.force), form_figure(result.forms)]
    if result.volumes is not None and result.volume is not None:
        out.append(volume_figure(result.volumes, result.volume, result))
    return out


def force_figure(table: ForceMap, fit: ForceFit) -> Figure:
    """Force over pressure, a line a length."""
    data: list[dict[str, Any]] = []
    grid = np.linspace(table.pressure.min(), table.pressure.max(), _POINTS)
    for group in range(table.lengths):
        inside = table.group == group
        length = float(table.length[inside].mean())
        color = _color(group, table.lengths)
        name = f"{length * 1e3:.4g} mm"
        line = fit.force(np.full(_POINTS, length), grid)
        shown = np.where(line >= table.limit, line, np.nan)
        data.append(_trace(name, grid / 1e3, shown, color, mode="lines", legendgroup=name, showlegend=False))
        for slack, symbol in ((False, "circle"), (True, "circle-open")):
            rows = inside & (table.slack == slack)
            if rows.any():
                points = {"size": 7 if not slack else 6, "color": color, "symbol": symbol}
                data.append(
                    _trace(name, table.pressure[rows] / 1e3, table.force[rows], color, mode="markers", marker=points,
                           legendgroup=name, showlegend=not slack or not np.any(inside & ~table.slack))
                )  # fmt: skip
    layout = _layout("Absolute pressure [kPa]", "Contraction force [N]", 420)
    about = (
        f"Filled: measured; open: slack or not measured, of which the fit knows only that the force is not above "
        f"{table.limit:g} N. Lines: form {fit.form}, cut off where it falls below that."
    )
    return Figure("Force over pressure at each length", about, {"data": data, "layout": layout}, "force")


def form_figure(forms: dict[str, Any]) -> Figure:
    """Error at each length of a fit without it, a line a form."""
    data = []
    for name, fit in forms.items():
        if isinstance(fit, ForceFit):
            known = [item for item in fit.left_out if item.measured]
            lengths = np.array([item.length for item in known]) * 1e3
            errors = np.array([item.rmse for item in known])
            data.append(
                _trace(
                    name, lengths, errors, COLORS[name], mode="lines+markers", marker={"size": 7, "color": COLORS[name]}
                )
            )
    layout = _layout("Length left out [mm]", "RMS error there [N]", 300)
    layout["yaxis"]["rangemode"] = "tozero"
    about = (
        "Each form was fitted without one length and then asked for the forces measured at it. At the ends that is "
        "extrapolation. A length at which every point was slack has no value here."
    )
    return Figure(
        "How wrong each form is at a length it has not seen", about, {"data": data, "layout": layout}, "forms"
    )


def volume_figure(table: VolumeTable, fit: VolumeFit, result: StaticResult) -> Figure:
    """Volume over length with the fitted parabola and its 95 % interval."""
    low, high = float(table.length.min()), float(table.length.max())
    shapes = []
    if result.fitted is not None:
        span = reach(result.rig)
        low, high = min(low, span.shortest), max(high, span.longest)
        for edge in (span.shortest, span.longest):
            shapes.append({"type": "line", "xref": "x", "yref": "y domain", "x0": edge * 1e3, "x1": edge * 1e3,
                           "y0": 0, "y1": 1, "line": {"color": QUIET, "width": 1.4, "dash": "dash"}})  # fmt: skip
    grid = np.linspace(low, high, _POINTS)
    volume, _ = fit.volume(grid)
    half = fit.interval(grid)
    data = []
    if np.all(np.isfinite(half)):
        outline = np.concatenate([volume - half, (volume + half)[::-1]]) * 1e6
        data.append(
            _trace("95 % interval", np.concatenate([grid, grid[::-1]]) * 1e3, outline, BAND, mode="lines",
                   fill="toself", fillcolor=BAND, line={"width": 0}, hoverinfo="skip")
        )  # fmt: skip
    data.append(_trace("fitted parabola", grid * 1e3, volume * 1e6, ESTIMATE, mode="lines"))
    data.append(
        _trace(
            "measured",
            table.length * 1e3,
            table.volume * 1e6,
            MEASURED,
            mode="markers",
            marker={"size": 7, "color": MEASURED},
        )
    )
    layout = _layout("Length [mm]", "Volume [cm³]", 340)
    layout["shapes"] = shapes
    about = "Equation (3)." + (
        " Dashed: the lengths between which the rig's joint takes its muscles." if shapes else ""
    )
    return Figure("Volume over length", about, {"data": data, "layout": layout}, "volume")


def _trace(name: str, x: Floats, y: Floats, color: str, **more: Any) -> dict[str, Any]:
    values = [None if not np.isfinite(value) else float(f"{value:.6g}") for value in y]
    places = [float(f"{value:.6g}") for value in x]
    line = {"color": color, "width": 1.8}
    return {"type": "scatter", "name": name, "x": places, "y": values, "line": line, **more}


def _layout(x_title: str, y_title: str, height: int) -> dict[str, Any]:
    layout = base_layout(height)
    layout["hovermode"] = "closest"
    layout["xaxis"] = axis(title={"text": x_title, "standoff": 6}, zeroline=False)
    layout["yaxis"] = axis(title={"text": y_title, "standoff": 4})
    return layout


def _color(number: int, count: int) -> str:
    place = 0.0 if count == 1 else number / (count - 1) * (len(_LENGTH_COLORS) - 1)
    stops = np.array([[int(color[k : k + 2], 16) for k in (1, 3, 5)] for color in _LENGTH_COLORS])
    red, green, blue = (round(float(np.interp(place, np.arange(len(stops)), part))) for part in stops.T)
    return f"#{red:02x}{green:02x}{blue:02x}"
