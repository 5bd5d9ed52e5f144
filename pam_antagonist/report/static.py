"""The report of static fits: ``report.json`` and ``report.html``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pam_antagonist.identification.static import Forms, StaticResult
from pam_antagonist.identification.static_fit import UNITS, StaticFit, largest, rms
from pam_antagonist.identification.tobit import Undetermined
from pam_antagonist.report import html
from pam_antagonist.report.document import Block, Document, Finding, Findings, Text, Tile, Tiles, background
from pam_antagonist.report.static_figures import static_figures
from pam_antagonist.report.table import MISSING, Table, number
from pam_antagonist.report.units import readable

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
        result: of ``static``.
    """
    html.write(folder, document(result, with_figures), result)


def summary(result: StaticResult) -> tuple[Block, ...]:
    """Blocks for the terminal."""
    forms = () if result.force_map is None else (forms_table(result),)
    warnings = Findings(tuple(Finding("warn", f"{text}.") for text in result.warnings))
    return coefficients_table(result), *forms, Text(verdict(result)), warnings


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
    names = " and ".join(table.name for table in result.tables)
    whose = "both muscles" if len(result.muscles) == 2 else f"muscle {result.muscles[0]}"
    rig = f"for {whose} of rig {result.fitted.name}" if result.fitted else "without a rig to put them into"
    lede = f"Static measurements of a muscle, fitted {rig}."
    starts = tuple(table.name for table in result.tables)
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
        parts += [forms_table(result), lengths_table(result.forms)]
        parts += [Text(f"Form {name} is not determined by this map: {fit}.") for name, fit in result.forms.items()
                  if isinstance(fit, Undetermined)]  # fmt: skip
        for name, fit in result.forms.items():
            if isinstance(fit, StaticFit) and name != result.form:
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
    rig, force = result.rig, result.force
    rows = [("Rig", rig.name if rig else "none: gauge pressures count from 101.325 kPa")]
    if rig is not None:
        rows.append(("Muscle length at angle 0", f"{rig.geometry.length:g} m"))
    elif force is not None:
        rows.append(("Length that contractions count from", f"{force.form.rest_length:g} m"))
    rows += [(f"File {table.name}", f"SHA-256 {table.sha256}") for table in result.tables]
    return rows
