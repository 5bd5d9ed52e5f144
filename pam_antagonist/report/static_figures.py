"""Figures of static fits: measured points, fitted lines, and errors at lengths that were left out."""

from __future__ import annotations

import numpy as np

from pam_antagonist.identification.static import Forms, StaticResult, reach
from pam_antagonist.identification.static_fit import StaticFit, rms
from pam_antagonist.identification.static_table import StaticTable
from pam_antagonist.report.figure import Axis, Band, Figure, Line, Panel, Points, Reference, Series
from pam_antagonist.report.style import BAND, ESTIMATE, MEASURED, MODEL, PALETTE, SECOND

COLORS = {"linear": MEASURED, "hildebrandt": MODEL, "sarosi": ESTIMATE, "polynomial": SECOND, "braided": PALETTE[3]}
"""Colours of the forms of the force map."""
_LENGTH_COLORS = ("#6a3aa0", "#4a62b8", "#2a7f9e", "#22a884", "#7ad151", "#c9a400")
"""Colours from the shortest to the longest length; lighter is longer, also without colour vision."""
_POINTS = 60


def static_figures(result: StaticResult) -> list[Figure]:
    """All figures for the available tables."""
    out = []
    if result.force_map is not None and result.force is not None:
        out += [force_figure(result.force_map, result.force), form_figure(result.forms)]
    if result.volumes is not None and result.volume is not None:
        out.append(volume_figure(result.volumes, result.volume, result))
    return out


def force_figure(table: StaticTable, fit: StaticFit) -> Figure:
    """Force over pressure, a line for each length."""
    parts: list[Series] = []
    grid = np.linspace(table.pressure.min(), table.pressure.max(), _POINTS)
    for group in range(table.lengths):
        inside = table.group == group
        length = float(table.length[inside].mean())
        color = _color(group, table.lengths)
        name = f"{length * 1e3:.4g} mm"
        line = fit.value(np.full(_POINTS, length), grid)
        shown = np.where(line >= table.limit, line, np.nan)
        parts.append(Line(name, grid / 1e3, shown, color, width=1.8, quiet=True))
        filled = bool(np.any(inside & ~table.slack))
        for slack in (False, True):
            rows = inside & (table.slack == slack)
            if rows.any():
                size = 6.0 if slack else 7.0
                pressure, force = table.pressure[rows] / 1e3, table.value[rows]
                parts.append(Points(name, pressure, force, color, size, hollow=slack, quiet=slack and filled))
    panel = Panel(Axis("Absolute pressure [kPa]"), Axis("Contraction force [N]"), tuple(parts), 342)
    about = (
        f"Filled: measured; open: slack or not measured, of which the fit knows only that the force is not above "
        f"{table.limit:g} N. Lines: form {fit.form.name}, cut off where it falls below that."
    )
    return Figure("Force over pressure at each length", about, (panel,), "force")


def form_figure(forms: Forms) -> Figure:
    """Error at each length of a fit without this length, a line for each form."""
    parts: list[Series] = []
    for name, fit in forms.items():
        if isinstance(fit, StaticFit):
            known = [item for item in fit.left_out if item.measured]
            lengths = np.array([item.length for item in known]) * 1e3
            errors = np.array([rms(item.errors) for item in known])
            parts.append(Line(name, lengths, errors, COLORS[name], width=1.8))
            parts.append(Points(name, lengths, errors, COLORS[name], 7.0, quiet=True))
    panel = Panel(Axis("Length left out [mm]"), Axis("RMS error there [N]", from_zero=True), tuple(parts), 222)
    about = (
        "Each form was fitted without one length and then predicted the forces measured at it. At the two ends this "
        "is extrapolation. A length at which every point was slack has no value here."
    )
    return Figure("Error of each form at a length that was left out", about, (panel,), "forms")


def volume_figure(table: StaticTable, fit: StaticFit, result: StaticResult) -> Figure:
    """Volume over length with the fitted parabola and its 95 % interval.

    Args:
        result: with the rig; the range of its muscle lengths is marked if a rig was fitted.
    """
    low, high = float(table.length.min()), float(table.length.max())
    edges: list[Reference] = []
    if result.fitted is not None:
        span = reach(result.fitted)
        low, high = min(low, span.shortest), max(high, span.longest)
        edges = [Reference(edge * 1e3, vertical=True) for edge in (span.shortest, span.longest)]
    grid = np.linspace(low, high, _POINTS)
    volume, half = fit.value(grid), fit.value_std(grid) * fit.reach95
    parts: list[Series] = [*edges]
    if np.all(np.isfinite(half)):
        parts.append(Band("95 % interval", grid * 1e3, (volume - half) * 1e6, (volume + half) * 1e6, BAND))
    parts.append(Line("fitted parabola", grid * 1e3, volume * 1e6, ESTIMATE, width=1.8))
    parts.append(Points("measured", table.length * 1e3, table.value * 1e6, MEASURED, 7.0))
    panel = Panel(Axis("Length [mm]"), Axis("Volume [cm³]"), tuple(parts), 262)
    about = "Equation (3)." + (" Dashed: the lengths between which the rig's joint takes its muscles." if edges else "")
    return Figure("Volume over length", about, (panel,), "volume")


def _color(number: int, count: int) -> str:
    place = 0.0 if count == 1 else number / (count - 1) * (len(_LENGTH_COLORS) - 1)
    stops = np.array([[int(color[k : k + 2], 16) for k in (1, 3, 5)] for color in _LENGTH_COLORS])
    red, green, blue = (round(float(np.interp(place, np.arange(len(stops)), part))) for part in stops.T)
    return f"#{red:02x}{green:02x}{blue:02x}"
