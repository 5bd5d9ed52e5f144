"""Numbers of static fits: the fields of :class:`StaticReport` are the keys of its ``report.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.static_force import ForceFit
from pam_antagonist.identification.static_regression import Undetermined
from pam_antagonist.identification.static_rig import StaticResult, reach
from pam_antagonist.identification.static_volume import COEFFICIENTS as VOLUME_COEFFICIENTS
from pam_antagonist.software import versions

Floats = NDArray[np.float64]

FORCE_UNITS = {
    "linear": ("m", "m²", "N/m", "N"),
    "hildebrandt": ("N",) * 7,
    "sarosi": ("N", "N", "-", "N", "N", "N"),
    "polynomial": ("N",) * 6,
    "braided": ("N", "-", "N", "-", "-", "m", "N"),
}
"""Units of the coefficients of each form of the force map."""
VOLUME_UNITS = ("m", "m²", "m³")
"""Units of the volume's coefficients."""


@dataclass(frozen=True)
class Coefficient:
    """A fitted coefficient.

    Attributes:
        value: in `unit`.
        std: standard deviation, in `unit`.
        unit: of all numbers.
        interval95: lower and upper end of the 95 % interval, in `unit`.
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
        rmse_n: RMS error at the measured points [N].
        max_n: largest error at the measured points [N].
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
        coefficients: name -> coefficient.
        covariance: of the coefficients (3, 3), in squared SI units.
        fitted_rmse_m3: RMS error on the fitted points [m³].
        left_out_rmse_m3: RMS error at lengths that were left out [m³].
        by_length: errors at each length that was left out.
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
            _coefficients(VOLUME_COEFFICIENTS, VOLUME_UNITS, fit.coefficients, fit.std, fit.reach95),
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
    """A fitted form of the force map, or why it is not determined."""

    fit: ForceFit | Undetermined

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        fit = self.fit
        if isinstance(fit, Undetermined):
            return {"undetermined": str(fit)}
        return {
            "coefficients": _coefficients(fit.names, FORCE_UNITS[fit.form], fit.coefficients, fit.std, fit.reach95),
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
        form: the form for the rig.
        samples: rows of the table.
        slack: rows without a force.
        lengths: number of different lengths in the table.
        forms: name -> entry.
    """

    form: str
    samples: int
    slack: int
    lengths: int
    forms: Mapping[str, FormEntry]


@dataclass(frozen=True)
class Span:
    """Range of the muscle lengths of a joint.

    Attributes:
        shortest_m: [m].
        longest_m: [m].
    """

    shortest_m: float
    longest_m: float


@dataclass(frozen=True)
class StaticReport:
    """Content of ``report.json``, in SI units.

    Attributes:
        rig: name of the rig.
        muscles: numbers of the muscles that the tables are for.
        joint: range of the muscle lengths.
        files: name of each table -> SHA-256.
        volume: None without a table of volumes.
        force: None without a table of forces.
        warnings: for the user.
        rig_written: whether the fit was written to a rig file.
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
