"""The report of static fits: ``report.json`` and ``report.html``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.static_force import ForceFit
from pam_antagonist.identification.static_regression import Undetermined
from pam_antagonist.identification.static_rig import StaticResult, reach
from pam_antagonist.identification.static_volume import COEFFICIENTS as VOLUME_COEFFICIENTS
from pam_antagonist.report import html
from pam_antagonist.report.document import Block, Document, Finding, Findings, Text, Tile, Tiles, background
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


@dataclass(frozen=True)
class Coefficient:
    """A fitted coefficient.

    Attributes:
        value: in `unit`.
        std: its standard deviation, in `unit`.
        unit: of all of them.
        interval95: lower and upper end, in `unit`.
    """

    value: float
    std: float
    unit: str
    interval95: tuple[float, float]


@dataclass(frozen=True)
class LeftOutVolume:
    """RMS error of the volume at a length that was left out.

    Attributes:
        length_m: the length [m].
        rmse_m3: the error [m³].
    """

    length_m: float
    rmse_m3: float


@dataclass(frozen=True)
class LeftOutForce:
    """Errors of the force at a length that was left out.

    Attributes:
        length_m: the length [m].
        measured: points with a force.
        slack: points without one.
        rmse_n: at the measured points [N].
        max_n: largest error there [N].
        slack_max_n: largest force that the fit gives at the slack points [N].
    """

    length_m: float
    measured: int
    slack: int
    rmse_n: float
    max_n: float
    slack_max_n: float


@dataclass(frozen=True)
class VolumeEntry:
    """The fitted volume.

    Attributes:
        samples: rows of the table.
        coefficients: by name.
        covariance: of the coefficients (3, 3), in squared SI units.
        fitted_rmse_m3: on the fitted points [m³].
        left_out_rmse_m3: at lengths that were left out [m³].
        by_length: the same for each length.
    """

    samples: int
    coefficients: Mapping[str, Coefficient]
    covariance: Floats
    fitted_rmse_m3: float
    left_out_rmse_m3: float
    by_length: tuple[LeftOutVolume, ...]

    @classmethod
    def of(cls, result: StaticResult) -> VolumeEntry | None:
        """The entry of a result; None without a table of volumes."""
        fit, table = result.volume, result.volumes
        if fit is None or table is None:
            return None
        return cls(
            len(table),
            _coefficients(VOLUME_COEFFICIENTS, _VOLUME_UNITS, fit.coefficients, fit.std, fit.reach95),
            fit.covariance,
            fit.fitted_rmse,
            fit.left_out_rmse,
            tuple(LeftOutVolume(*item) for item in zip(fit.lengths, fit.left_out, strict=True)),
        )

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        return {
            "samples": self.samples,
            "coefficients": self.coefficients,
            "covariance": self.covariance,
            "fitted": {"rmse_m3": self.fitted_rmse_m3},
            "left_out": {"rmse_m3": self.left_out_rmse_m3, "by_length": self.by_length},
        }


@dataclass(frozen=True)
class FormEntry:
    """A form of the force map that was fitted, or why it is not determined."""

    fit: ForceFit | Undetermined

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        fit = self.fit
        if isinstance(fit, Undetermined):
            return {"undetermined": str(fit)}
        return {
            "coefficients": _coefficients(fit.names, _UNITS[fit.form], fit.coefficients, fit.std, fit.reach95),
            "covariance": fit.covariance,
            "contraction_from_m": fit.rest_length,
            "fitted": {"rmse_n": fit.fitted_rmse, "max_n": fit.fitted_largest},
            "left_out": {
                "rmse_n": fit.left_out_rmse,
                "rmse_between_n": fit.inner_rmse,
                "max_n": fit.left_out_largest,
                "slack_max_n": fit.overshoot,
                "by_length": [
                    LeftOutForce(item.length, item.measured, item.slack, item.rmse, item.largest, item.overshoot)
                    for item in fit.left_out
                ],
            },
            "notes": fit.notes,
        }


@dataclass(frozen=True)
class ForceEntry:
    """All forms of the force map.

    Attributes:
        form: the one for the rig.
        samples: rows of the table.
        slack: rows without a force.
        lengths: different ones in the table.
        forms: by name.
    """

    form: str
    samples: int
    slack: int
    lengths: int
    forms: Mapping[str, FormEntry]


@dataclass(frozen=True)
class Span:
    """Lengths that the muscles of a joint have.

    Attributes:
        shortest_m: [m].
        longest_m: [m].
    """

    shortest_m: float
    longest_m: float


@dataclass(frozen=True)
class StaticReport:
    """What goes into ``report.json``; SI units.

    Attributes:
        rig: its name.
        muscles: numbers of those that the tables hold for.
        joint: lengths of its muscles.
        files: SHA-256 of each table, by name.
        volume: None without a table of volumes.
        force: None without a table of forces.
        warnings: what the user should know.
        rig_written: whether the fit became a rig file.
        software: versions.
    """

    rig: str
    muscles: tuple[int, ...]
    joint: Span
    files: Mapping[str, str]
    volume: VolumeEntry | None
    force: ForceEntry | None
    warnings: tuple[str, ...]
    rig_written: bool
    software: Mapping[str, str]

    @classmethod
    def of(cls, result: StaticResult) -> StaticReport:
        """The numbers of a result."""
        span, table = reach(result.rig), result.force_map
        forms = {name: FormEntry(fit) for name, fit in result.forms.items()}
        return cls(
            result.rig.name,
            result.muscles,
            Span(span.shortest, span.longest),
            {item.name: item.sha256 for item in (result.volumes, table) if item is not None},
            VolumeEntry.of(result),
            None if table is None else ForceEntry(
                result.form, len(table), int(table.slack.sum()), table.lengths, forms
            ),
            result.warnings,
            result.fitted is not None,
            versions(),
        )  # fmt: skip


def _coefficients(
    names: Sequence[str], units: Sequence[str], values: Floats, std: Floats, width: float
) -> dict[str, Coefficient]:
    return {
        name: Coefficient(value, own, unit, (value - width * own, value + width * own))
        for name, unit, value, own in zip(names, units, values, std, strict=True)
    }


def write_report(folder: Path, result: StaticResult, with_figures: bool = True) -> None:
    """Write ``report.json`` and ``report.html`` into a folder that exists.

    Args:
        folder: that exists.
        result: of ``static``.
        with_figures: whether the page shows figures.
    """
    html.write(folder, document(result, with_figures), StaticReport.of(result))


def summary(result: StaticResult) -> tuple[Block, ...]:
    """What the terminal shows."""
    forms = () if result.force_map is None else (forms_table(result.forms, result.form),)
    warnings = Findings(tuple(Finding("warn", f"{text}.") for text in result.warnings))
    return coefficients_table(result), *forms, Text(verdict(result)), warnings


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
    """The errors at lengths that the fits have not seen."""
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
    """A sentence's beginning in upper case."""
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
