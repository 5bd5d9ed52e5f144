"""The report of static fits: ``report.json`` and ``report.html``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.static_force import ForceFit
from pam_antagonist.identification.static_regression import Undetermined
from pam_antagonist.identification.static_rig import StaticResult
from pam_antagonist.identification.static_volume import COEFFICIENTS as VOLUME_COEFFICIENTS
from pam_antagonist.report import html
from pam_antagonist.report.document import Block, Document, Finding, Findings, Text, Tile, Tiles, background
from pam_antagonist.report.static_entries import FORCE_UNITS, VOLUME_UNITS, StaticReport
from pam_antagonist.report.static_figures import static_figures
from pam_antagonist.report.table import MISSING, Table, number
from pam_antagonist.report.units import readable

Forms = Mapping[str, ForceFit | Undetermined]
Floats = NDArray[np.float64]

DEFINITIONS = (
    (
        "Left out",
        "Each length is left out in turn. The form is fitted to all other lengths and predicts the forces at this one. "
        "The error on the fitted points says little about other lengths; it is given for comparison.",
    ),
    (
        "Between the ends",
        "The same without the shortest and the longest measured length, so that nothing is extrapolated.",
    ),
    (
        "Slack points",
        "A force of 0 N means that the muscle was slack or that nothing was measured. The fit takes such a point as a "
        "force of at most 0 N (Tobit regression). A measured 0 N would bend the map.",
    ),
    (
        "Standard deviation",
        "Of a coefficient. It is the larger of two values: for independent errors, and from the fits without each "
        "length (jackknife). Errors at one length are correlated where the form is not quite right. The rig file "
        "takes them as priors.",
    ),
)


def write_report(folder: Path, result: StaticResult, with_figures: bool = True) -> None:
    """Write ``report.json`` and ``report.html`` into an existing folder.

    Args:
        folder: existing folder.
        result: of ``static``.
        with_figures: whether the page shows figures.
    """
    html.write(folder, document(result, with_figures), StaticReport.of(result))


def summary(result: StaticResult) -> tuple[Block, ...]:
    """Blocks for the terminal."""
    forms = () if result.force_map is None else (forms_table(result.forms, result.form),)
    warnings = Findings(tuple(Finding("warn", f"{text}.") for text in result.warnings))
    return coefficients_table(result), *forms, Text(verdict(result)), warnings


def forms_table(forms: Forms, chosen: str = "") -> Table:
    """Errors of each form at lengths left out, and on the fitted points."""
    rows = []
    for name, fit in forms.items():
        mark = " (for the rig)" if name == chosen else ""
        if isinstance(fit, Undetermined):
            rows.append((name + mark, *[MISSING] * 5))
            continue
        values = (fit.left_out_rmse, fit.inner_rmse, fit.left_out_largest, fit.overshoot, fit.fitted_rmse)
        rows.append((name + mark, *(number(value) for value in values)))
    return Table(
        (
            "Form",
            "Left out: RMS [N]",
            "between the ends [N]",
            "largest [N]",
            "above 0 where slack [N]",
            "fitted points: RMS [N]",
        ),
        tuple(rows),
        "Force maps. Each is fitted without one length in turn and predicts the forces there.",
    )


def lengths_table(forms: Forms) -> Table:
    """Error of each form at each length that was left out."""
    fits = [fit for fit in forms.values() if isinstance(fit, ForceFit)]
    rows = []
    for place, item in enumerate(fits[0].left_out):
        cells = [number(fit.left_out[place].rmse) for fit in fits]
        rows.append((f"{item.length * 1e3:.4g} mm", str(item.measured), str(item.slack), *cells))
    header = ("Length left out", "measured", "slack", *(f"{fit.form} [N]" for fit in fits))
    return Table(header, tuple(rows), "RMS error of the measured forces at each length")


def coefficients_table(result: StaticResult) -> Table:
    """Fitted coefficients with their 95 % intervals."""
    rows = []
    if result.volume is not None:
        fit = result.volume
        rows += _rows("volume", VOLUME_COEFFICIENTS, VOLUME_UNITS, fit.coefficients, fit.std, fit.reach95)
    if result.force is not None:
        force = result.force
        rows += _rows("force", force.names, FORCE_UNITS[force.form], force.coefficients, force.std, force.reach95)
    whose = " and ".join(str(item) for item in result.muscles)
    head = ("Coefficient", "Value", "Standard deviation", "95 % interval ±", "Unit")
    return Table(head, tuple(rows), f"Of muscle {whose}; pressures absolute")


def _rows(
    part: str, names: Sequence[str], units: Sequence[str], values: Floats, std: Floats, width: float
) -> list[tuple[str, ...]]:
    return [
        (f"{part}.{name}", number(value, 5), number(own), number(width * own), shown.name)
        for name, si, deviation, unit in zip(names, values, std, units, strict=True)
        for shown in [readable(unit)]
        for value, own in [(si * shown.scale, deviation * shown.scale)]
    ]


def verdict(result: StaticResult) -> str:
    """The errors at lengths that were left out, in a sentence."""
    unknown = "an error that so few lengths do not determine"
    parts = []
    if result.volume is not None:
        error = result.volume.left_out_rmse
        parts.append(f"the parabola gives the volume with {_known(error * 1e6, 'cm³') or unknown}")
    if result.force is not None:
        error = result.force.left_out_rmse
        parts.append(f"form {result.form} gives the force with {_known(error, 'N') or unknown}")
    return f"At a length that was left out, {' and '.join(parts)}."


def _known(error: float, unit: str) -> str:
    return f"a root mean square error of {number(error)} {unit}" if np.isfinite(error) else ""


def _begun(text: str) -> str:
    """A text with its first letter in upper case."""
    return f"{text[:1].upper()}{text[1:]}"


def document(result: StaticResult, with_figures: bool = True) -> Document:
    """The report as a document."""
    tables = [table for table in (result.volumes, result.force_map) if table is not None]
    names = " and ".join(table.name for table in tables)
    whose = "both muscles" if len(result.muscles) == 2 else f"muscle {result.muscles[0]}"
    goal = f"fitted for {whose} of rig {result.rig.name}" if result.fitted else "fitted without a rig to put them into"
    lede = f"Static measurements of a muscle, {goal}."
    starts = tuple(table.name for table in tables)
    findings = [Finding("warn", f"{text if text.startswith(starts) else _begun(text)}.") for text in result.warnings]
    if len(result.muscles) == 2 and result.fitted is not None:
        text = (
            "Both muscles get the same coefficients. If you have a table of each, run once with --muscle 1, then with "
            "--muscle 2 on the rig that came out."
        )
        findings.append(Finding("note", text))
    figures = static_figures(result) if with_figures else ()
    parts: list[Block] = [
        Text(lede, "lede"), Text(verdict(result), "verdict"), *figures[:1], Tiles(_tiles(result)),
        Findings(tuple(findings)), coefficients_table(result),
    ]  # fmt: skip
    if result.force_map is not None:
        parts += [forms_table(result.forms, result.form), lengths_table(result.forms)]
        parts += [Text(f"Form {name} is not determined by this map: {fit}.") for name, fit in result.forms.items()
                  if isinstance(fit, Undetermined)]  # fmt: skip
        for name, fit in result.forms.items():
            if isinstance(fit, ForceFit) and name != result.form:
                parts += [Text(f"Form {name}: {note}.") for note in fit.notes]
    parts += figures[1:]
    parts += background(DEFINITIONS, _provenance(result))
    return Document("Static data of a pneumatic muscle", names, tuple(parts))


def _tiles(result: StaticResult) -> tuple[Tile, ...]:
    out = []
    if result.volume is not None and result.volumes is not None:
        note = f"{len(result.volumes)} volumes at {result.volumes.lengths} lengths"
        out.append(Tile("Volume, lengths left out", f"{number(result.volume.left_out_rmse * 1e6)} cm³", note))
    if result.force is not None and result.force_map is not None:
        table = result.force_map
        seen = len(table) - int(table.slack.sum())
        out += [
            Tile("Force, lengths left out", f"{number(result.force.left_out_rmse)} N", f"form {result.form}"),
            Tile("of them between the ends", f"{number(result.force.inner_rmse)} N", "no extrapolation"),
            Tile("Forces measured", str(seen), f"and {int(table.slack.sum())} slack, at {table.lengths} lengths"),
        ]
    return tuple(out)


def _provenance(result: StaticResult) -> list[tuple[str, str]]:
    rows = [("Rig", result.rig.name), ("Muscle length at angle 0", f"{result.rig.geometry.length:g} m")]
    rows += [(f"File {table.name}", f"SHA-256 {table.sha256}") for table in (result.volumes, result.force_map) if table]
    return rows
