"""The result of ``static``: fits of static tables, the rig with them, and their page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from typing_extensions import override

from pam_antagonist.identification.static import Forms, StaticFits, reach
from pam_antagonist.identification.static_fit import UNITS, StaticFit, largest, rms
from pam_antagonist.identification.static_table import StaticTable
from pam_antagonist.identification.tobit import Undetermined
from pam_antagonist.report.document import Block, Document, Findings, Table, Text, note, page, sentence, warn
from pam_antagonist.report.figure import BAND, ESTIMATE, MEASURED, Axis, Band, Figure, Line, Panel, Points, Reference
from pam_antagonist.report.result import DataFrame, Result, frame_of
from pam_antagonist.rig.file import write_rig
from pam_antagonist.rig.units import readable
from pam_antagonist.shown import MISSING, number

_LENGTH_COLORS = ("#6a3aa0", "#4a62b8", "#2a7f9e", "#22a884", "#7ad151", "#c9a400")
"""Colours from the shortest to the longest length; lighter is longer, also without colour vision."""
_POINTS = 60


@dataclass(frozen=True, eq=False)
class StaticResult(StaticFits, Result):
    """Fits of a muscle's static tables.

    Attributes:
        rig: that the fits are for; None for a muscle without a rig.
        fitted: that rig with the fits, None where only a report was requested.
        muscles: that get the coefficients.
        volumes: the table of volumes.
        volume: the parabola that was fitted to it.
        force_map: the table of forces.
        forms: the fits of each form to it.
        form: the one for the rig, without a rig that with the least error at lengths left out; empty without a map.
        warnings: for the user.
    """

    @override
    def _brief(self) -> str:
        return f"{verdict(self)} {len(self.warnings)} warnings"

    @override
    def document(self, figures: bool = True) -> Document:
        names = " and ".join(table.name for table in self.tables)
        whose = "both muscles" if len(self.muscles) == 2 else f"muscle {self.muscles[0]}"
        rig = f"for {whose} of rig {self.fitted.name}" if self.fitted else "without a rig to put them into"
        lede = f"Static measurements of a muscle, fitted {rig}."
        findings = [warn(sentence(text)) for text in self.warnings]
        if len(self.muscles) == 2 and self.fitted is not None:
            text = (
                "Both muscles get the same coefficients. If you have a table of each, run once with --muscle 1, then "
                "with --muscle 2 on the rig that came out."
            )
            findings.append(note(text))
        drawn = static_figures(self) if figures else ()
        parts: list[Block] = [*drawn[:1], Findings(tuple(findings)), coefficients_table(self)]
        if self.force_map is not None:
            parts += [forms_table(self), lengths_table(self.forms)]
            parts += [Text(f"Form {name} is not determined by this map: {fit}.") for name, fit in self.forms.items()
                      if isinstance(fit, Undetermined)]  # fmt: skip
            for name, fit in self.forms.items():
                if isinstance(fit, StaticFit) and name != self.form:
                    parts += [Text(f"Form {name}: {note}.") for note in fit.notes]
        parts += drawn[1:]
        kicker = "Static data of a pneumatic muscle"
        return page(kicker, names, parts, "static", _provenance(self), lede, verdict(self))

    def to_dataframe(self) -> DataFrame:
        """A row for each coefficient: value, standard deviation and unit (needs pandas)."""
        rows = [
            (f"{part}.{name}", value, std, unit)
            for part, fit in (("volume", self.volume), ("force", self.force))
            if fit is not None
            for (name, unit), value, std in zip(UNITS[fit.form.name].items(), fit.coefficients, fit.std, strict=True)
        ]
        return frame_of(rows, ("coefficient", "value", "std", "unit"), "coefficient")

    @override
    def write_rigs(self, folder: Path) -> None:
        if self.fitted is None:
            return
        tables, whose = (" and ".join(map(str, names)) for names in ([t.name for t in self.tables], self.muscles))
        about = f"Rig {self.fitted.name} with static fits of muscle {whose} from {tables}; their errors: priors."
        write_rig(self.fitted, folder / "rig.yaml", [about, *(f"! {text}" for text in self.warnings)])


def forms_table(result: StaticResult) -> Table:
    """Errors of each form at lengths left out, and on the fitted points."""
    rows = []
    for name, fit in result.forms.items():
        mark = "" if name != result.form else " (for the rig)" if result.rig else " (shown)"
        if isinstance(fit, Undetermined):
            rows.append((name + mark, *[MISSING] * 5))
            continue
        values = (fit.left_out_rmse, fit.inner_rmse, largest(fit.left_out_errors), fit.overshoot, fit.fitted_rmse)
        rows.append((name + mark, *(number(value) for value in values)))
    header = (
        "Form", "Left out: RMS [N]", "between the ends [N]", "largest [N]", "above 0 where slack [N]",
        "fitted points: RMS [N]",
    )  # fmt: skip
    about = "Force maps. Each is fitted without one length in turn and predicts the forces there."
    return Table(header, tuple(rows), about)


def lengths_table(forms: Forms) -> Table:
    """Error of each form at each length that was left out."""
    fits = [fit for fit in forms.values() if isinstance(fit, StaticFit)]
    rows = []
    for place, item in enumerate(fits[0].left_out):
        cells = [number(rms(fit.left_out[place].errors)) for fit in fits]
        rows.append((f"{item.length * 1e3:.4g} mm", str(item.measured), str(item.slack), *cells))
    header = ("Length left out", "measured", "slack", *(f"{fit.form.name} [N]" for fit in fits))
    return Table(header, tuple(rows), "RMS error of the measured forces at each length")


def coefficients_table(result: StaticResult) -> Table:
    """Fitted coefficients with their 95 % intervals."""
    rows = []
    for part, fit in (("volume", result.volume), ("force", result.force)):
        if fit is None:
            continue
        for (name, si), value, std in zip(UNITS[fit.form.name].items(), fit.coefficients, fit.std, strict=True):
            unit = readable(si)
            cells = (number(value * unit.scale, 5), *(number(std * unit.scale * width) for width in (1.0, fit.reach95)))
            rows.append((f"{part}.{name}", *cells, unit.name))
    whose = f"Of muscle {' and '.join(map(str, result.muscles))}; p" if result.rig else "P"
    head = ("Coefficient", "Value", "Standard deviation", "95 % interval ±", "Unit")
    return Table(head, tuple(rows), f"{whose}ressures absolute")


def verdict(result: StaticResult) -> str:
    """The errors at lengths that were left out, in a sentence."""

    def known(error: float, unit: str) -> str:
        shown = f"a root mean square error of {number(error)} {unit}"
        return shown if np.isfinite(error) else "an error that so few lengths do not determine"

    parts = []
    if result.volume is not None:
        parts.append(f"the parabola gives the volume with {known(result.volume.left_out_rmse * 1e6, 'cm³')}")
    if result.force is not None:
        parts.append(f"form {result.form} gives the force with {known(result.force.left_out_rmse, 'N')}")
    return f"At a length that was left out, {' and '.join(parts)}."


def _provenance(result: StaticResult) -> list[tuple[str, str]]:
    rig, force = result.rig, result.force
    rows = [("Rig", rig.name if rig else "none: gauge pressures count from 101.325 kPa")]
    if rig is not None:
        rows.append(("Muscle length at angle 0", f"{rig.geometry.length:g} m"))
    elif force is not None:
        rows.append(("Length that contractions count from", f"{force.form.rest_length:g} m"))
    for table in result.tables:
        slack = f", {int(table.slack.sum())} of them slack," if table.slack.any() else ""
        measured = f"{len(table)} values{slack} at {table.lengths} lengths"
        rows.append((f"File {table.name}", f"{measured}; SHA-256 {table.sha256}"))
    return rows


def static_figures(result: StaticResult) -> list[Figure]:
    """All figures for the available tables."""
    out = []
    if result.force_map is not None and result.force is not None:
        out.append(force_figure(result.force_map, result.force))
    if result.volumes is not None and result.volume is not None:
        out.append(volume_figure(result.volumes, result.volume, result))
    return out


def force_figure(table: StaticTable, fit: StaticFit) -> Figure:
    """Force over pressure, a line for each length."""
    parts: list[Line | Points] = []
    grid = np.linspace(table.pressure.min(), table.pressure.max(), _POINTS)
    for group in range(table.lengths):
        inside, color = table.group == group, _color(group, table.lengths)
        length = float(table.length[inside].mean())
        name = f"{length * 1e3:.4g} mm"
        line = fit.value(np.full(_POINTS, length), grid)
        parts.append(Line(name, grid / 1e3, np.where(line >= table.limit, line, np.nan), color, width=1.8, quiet=True))
        filled = bool(np.any(inside & ~table.slack))
        for slack in (False, True):
            rows = inside & (table.slack == slack)
            if rows.any():
                at, force, size = table.pressure[rows] / 1e3, table.value[rows], 6.0 if slack else 7.0
                parts.append(Points(name, at, force, color, size, hollow=slack, quiet=slack and filled))
    panel = Panel(Axis("Absolute pressure [kPa]"), Axis("Contraction force [N]"), tuple(parts), 342)
    about = (
        f"Filled: measured; open: slack or not measured, of which the fit knows only that the force is not above "
        f"{table.limit:g} N. Lines: form {fit.form.name}, cut off where it falls below that."
    )
    return Figure("Force over pressure at each length", about, (panel,), "force")


def volume_figure(table: StaticTable, fit: StaticFit, result: StaticResult) -> Figure:
    """Volume over length with the fitted parabola and its 95 % interval; marks the range of a fitted rig's lengths."""
    low, high = float(table.length.min()), float(table.length.max())
    edges: tuple[Reference, ...] = ()
    if result.fitted is not None:
        span = reach(result.fitted)
        low, high = min(low, span.shortest), max(high, span.longest)
        edges = Reference(span.shortest * 1e3, vertical=True), Reference(span.longest * 1e3, vertical=True)
    grid = np.linspace(low, high, _POINTS)
    volume, half = fit.value(grid), fit.value_std(grid) * fit.reach95
    band = Band("95 % interval", grid * 1e3, (volume - half) * 1e6, (volume + half) * 1e6, BAND)
    fitted = Line("fitted parabola", grid * 1e3, volume * 1e6, ESTIMATE, width=1.8)
    measured = Points("measured", table.length * 1e3, table.value * 1e6, MEASURED, 7.0)
    series = (*edges, *((band,) if np.all(np.isfinite(half)) else ()), fitted, measured)
    panel = Panel(Axis("Length [mm]"), Axis("Volume [cm³]"), series, 262)
    about = "Equation (3)." + (" Dashed: the lengths between which the rig's joint takes its muscles." if edges else "")
    return Figure("Volume over length", about, (panel,), "volume")


def _color(number: int, count: int) -> str:
    place = 0.0 if count == 1 else number / (count - 1) * (len(_LENGTH_COLORS) - 1)
    stops = np.array([[int(color[k : k + 2], 16) for k in (1, 3, 5)] for color in _LENGTH_COLORS])
    red, green, blue = (round(float(np.interp(place, np.arange(len(stops)), part))) for part in stops.T)
    return f"#{red:02x}{green:02x}{blue:02x}"
