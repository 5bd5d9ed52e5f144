"""The report of static fits: ``report.json`` and ``report.html``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.static_force import ForceFit
from pam_antagonist.identification.static_regression import Undetermined
from pam_antagonist.identification.static_rig import StaticResult, reach
from pam_antagonist.identification.static_volume import COEFFICIENTS as VOLUME_COEFFICIENTS
from pam_antagonist.report import html
from pam_antagonist.report.document import Block, Definitions, Document, Finding, Findings, Section, Text, Tile, Tiles
from pam_antagonist.report.static_figures import static_figures
from pam_antagonist.report.table import MISSING, Table, number
from pam_antagonist.software import versions

Forms = Mapping[str, ForceFit | Undetermined]
Floats = NDArray[np.float64]

_UNITS = {
    "linear": ("m", "m²", "N/m", "N"),
    "hildebrandt": ("N",) * 7,
    "sarosi": ("N", "N", "-", "N", "N", "N"),
    "polynomial": ("N",) * 6,
}
_VOLUME_UNITS = ("m", "m²", "m³")
DEFINITIONS = (
    (
        "Left out",
        "The form was fitted to all other lengths and asked for this one, in turn for each length. The error on the "
        "points that a form was fitted to says little about others, and is given for comparison only.",
    ),
    (
        "Between the ends",
        "The same without the shortest and the longest length at which forces were measured: no extrapolation in it.",
    ),
    (
        "Slack points",
        "Where a table says 0 N the muscle was slack or nothing was measured. The fit takes such a point for a force "
        "of at most that (Tobit regression), not for a measured 0 N, which would bend the map.",
    ),
    (
        "Standard deviation",
        "Of a coefficient: not below that of independent errors, nor below that of the fits without each length "
        "(jackknife), since forces at one length err together where the form is not quite right. They go into the rig "
        "file as priors.",
    ),
)


def document(result: StaticResult) -> dict[str, Any]:
    """What goes into ``report.json``; SI units."""
    span = reach(result.rig)
    return {
        "rig": result.rig.name,
        "muscles": list(result.muscles),
        "joint": {"shortest_m": span.shortest, "longest_m": span.longest},
        "files": {table.name: table.sha256 for table in (result.volumes, result.force_map) if table is not None},
        "volume": _volume_entry(result),
        "force": _force_entry(result),
        "warnings": list(result.warnings),
        "rig_written": result.fitted is not None,
        "software": versions(),
    }


def _coefficients(
    names: Sequence[str], units: Sequence[str], values: Floats, std: Floats, width: float
) -> dict[str, Any]:
    return {
        name: {"value": value, "std": own, "unit": unit, "interval95": [value - width * own, value + width * own]}
        for name, unit, value, own in zip(names, units, values, std, strict=True)
    }


def _volume_entry(result: StaticResult) -> dict[str, Any] | None:
    fit, table = result.volume, result.volumes
    if fit is None or table is None:
        return None
    return {
        "samples": len(table),
        "coefficients": _coefficients(VOLUME_COEFFICIENTS, _VOLUME_UNITS, fit.coefficients, fit.std, fit.reach95),
        "covariance": fit.covariance,
        "fitted": {"rmse_m3": fit.fitted_rmse},
        "left_out": {
            "rmse_m3": fit.left_out_rmse,
            "by_length": [
                {"length_m": length, "rmse_m3": error} for length, error in zip(fit.lengths, fit.left_out, strict=True)
            ],
        },
    }


def _force_entry(result: StaticResult) -> dict[str, Any] | None:
    table = result.force_map
    if table is None:
        return None
    return {
        "form": result.form,
        "samples": len(table),
        "slack": int(table.slack.sum()),
        "lengths": table.lengths,
        "forms": {name: form_entry(fit) for name, fit in result.forms.items()},
    }


def form_entry(fit: ForceFit | Undetermined) -> dict[str, Any]:
    """One form's part of a report."""
    if isinstance(fit, Undetermined):
        return {"undetermined": str(fit)}
    units = _UNITS[fit.form]
    return {
        "coefficients": _coefficients(fit.names, units, fit.coefficients, fit.std, fit.reach95),
        "covariance": fit.covariance,
        "contraction_from_m": fit.rest_length,
        "fitted": {"rmse_n": fit.fitted_rmse, "max_n": fit.fitted_largest},
        "left_out": {
            "rmse_n": fit.left_out_rmse,
            "rmse_between_n": fit.inner_rmse,
            "max_n": fit.left_out_largest,
            "slack_max_n": fit.overshoot,
            "by_length": [
                {
                    "length_m": item.length,
                    "measured": item.measured,
                    "slack": item.slack,
                    "rmse_n": item.rmse,
                    "max_n": item.largest,
                    "slack_max_n": item.overshoot,
                }
                for item in fit.left_out
            ],
        },
        "notes": list(fit.notes),
    }


def forms_table(forms: Forms, chosen: str = "") -> Table:
    """Errors of each form at lengths left out, and on what it was fitted to."""
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
        "Force maps, each fitted without one length in turn and asked for it",
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
        rows += _rows("volume", VOLUME_COEFFICIENTS, _VOLUME_UNITS, fit.coefficients, fit.std, fit.reach95)
    if result.force is not None:
        force = result.force
        rows += _rows("force", force.names, _UNITS[force.form], force.coefficients, force.std, force.reach95)
    whose = " and ".join(str(item) for item in result.muscles)
    head = ("Coefficient", "Value", "Standard deviation", "95 % interval ±", "Unit")
    return Table(head, tuple(rows), f"Of muscle {whose}; pressures absolute")


def _rows(
    part: str, names: Sequence[str], units: Sequence[str], values: Floats, std: Floats, width: float
) -> list[tuple[str, ...]]:
    return [
        (f"{part}.{name}", number(value, 5), number(own), number(width * own), unit)
        for name, value, own, unit in zip(names, values, std, units, strict=True)
    ]


def verdict(result: StaticResult) -> str:
    """One sentence on how far the fits can be trusted."""
    parts = []
    if result.volume is not None:
        error = result.volume.left_out_rmse
        known = (
            f"to {number(error * 1e6)} cm³" if np.isfinite(error) else "with an error that so few lengths do not tell"
        )
        parts.append(f"the parabola tells the volume at a length it has not seen {known}")
    if result.force is not None:
        error = result.force.left_out_rmse
        known = f"to {number(error)} N" if np.isfinite(error) else "with an error that so few lengths do not tell"
        parts.append(f"form {result.form} tells the force at a length it has not seen {known}")
    return f"{_begun(' and '.join(parts))} (root mean square)."


def _begun(text: str) -> str:
    """A sentence's beginning in upper case."""
    return f"{text[:1].upper()}{text[1:]}"


def page(result: StaticResult, with_figures: bool = True) -> Document:
    """The report as a page."""
    tables = [table for table in (result.volumes, result.force_map) if table is not None]
    names = " and ".join(table.name for table in tables)
    whose = "both muscles" if len(result.muscles) == 2 else f"muscle {result.muscles[0]}"
    goal = f"fitted for {whose} of rig {result.rig.name}" if result.fitted else "fitted without a rig to put them into"
    lede = f"Static measurements of a muscle, {goal}."
    starts = tuple(table.name for table in tables)
    findings = [Finding("warn", f"{text if text.startswith(starts) else _begun(text)}.") for text in result.warnings]
    if len(result.muscles) == 2 and result.fitted is not None:
        once = "with a table of each, run once with --muscle 1, then with --muscle 2 on the rig that came out"
        findings.append(Finding("note", f"Both muscles are given the same coefficients; {once}."))
    parts: list[Block] = [
        Text(lede, "lede"), Text(verdict(result), "verdict"), Tiles(_tiles(result)), Findings(tuple(findings)),
        coefficients_table(result),
    ]  # fmt: skip
    if result.force_map is not None:
        parts += [forms_table(result.forms, result.form), lengths_table(result.forms)]
        parts += [Text(f"Form {name} is not determined by this map: {fit}.") for name, fit in result.forms.items()
                  if isinstance(fit, Undetermined)]  # fmt: skip
        for name, fit in result.forms.items():
            if isinstance(fit, ForceFit) and name != result.form:
                parts += [Text(f"Form {name}: {note}.") for note in fit.notes]
    if with_figures:
        parts += static_figures(result)
    parts += [
        Section("What the words mean", (Definitions(DEFINITIONS),), folded=True),
        Section("How this report was made", _provenance(result), folded=True),
    ]
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


def _provenance(result: StaticResult) -> tuple[Block, ...]:
    rows = [("Rig", result.rig.name), ("Muscle length at angle 0", f"{result.rig.geometry.length:g} m")]
    rows += [(f"File {table.name}", f"SHA-256 {table.sha256}") for table in (result.volumes, result.force_map) if table]
    return (Table(("What", "Which"), tuple(rows), prose=True),)


def write_report(folder: Path, result: StaticResult, with_figures: bool = True) -> None:
    """Write ``report.json`` and ``report.html`` into a folder that exists."""
    html.write(folder, page(result, with_figures), document(result))
