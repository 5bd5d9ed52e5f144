"""A muscle's static tables evaluated for a rig: fits, comparison of the forms, doubts, and the resulting rig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static_force import COEFFICIENTS as FORCE_COEFFICIENTS
from pam_antagonist.identification.static_force import ForceFit, compare_forms
from pam_antagonist.identification.static_regression import Undetermined
from pam_antagonist.identification.static_table import ForceMap, VolumeTable
from pam_antagonist.identification.static_volume import COEFFICIENTS as VOLUME_COEFFICIENTS
from pam_antagonist.identification.static_volume import VolumeFit, fit_volume
from pam_antagonist.model import lever_arm, muscle
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import RANGE_WITHOUT_STOP, unphysical

Floats = NDArray[np.float64]

_OFFSET = {"linear": "w2", "hildebrandt": "c4", "sarosi": "c6", "polynomial": "c1", "braided": "c3"}
"""The coefficient of each form that is a force offset, which is uncertain in a rig by default; the rubber's is one at
all contractions but the least."""
_FEW_LENGTHS, _FEW_PRESSURES = 4, 4


@dataclass(frozen=True)
class Reach:
    """Range of lengths and pressures of a rig's muscles.

    Attributes:
        shortest: length [m] of a muscle at one end of the joint's range.
        longest: at the other [m].
        lowest: least absolute pressure [Pa].
        highest: largest [Pa].
    """

    shortest: float
    longest: float
    lowest: float
    highest: float

    def lengths(self, count: int = 41) -> Floats:
        """Lengths (count,) [m] over the range."""
        return np.linspace(self.shortest, self.longest, count)

    @override
    def __str__(self) -> str:
        return f"{self.shortest * 1e3:.1f} to {self.longest * 1e3:.1f} mm"


def with_length(rig: Rig, length: float) -> Rig:
    """The rig with another muscle length at ψ = 0.

    Raises:
        BadInput: a length that no rig has.
    """
    if not 0.02 < length < 2.0:
        raise BadInput(f"--length {length:g} m: expected the muscle's length at angle 0, 0.02 to 2 m")
    return rig.replaced(geometry=rig.geometry.replaced(length=length))


def reach(rig: Rig) -> Reach:
    """Lengths and pressures that a rig's muscles get to, by the model's geometry."""
    p = rig.parameters()
    bound = rig.joint.stop if rig.joint.stop is not None else RANGE_WITHOUT_STOP
    lengths = [muscle.length(0, lever_arm.leverage(angle, p)[0], p) for angle in (-bound, bound)]
    return Reach(min(lengths), max(lengths), rig.atmosphere.pressure, rig.supply.pressure)


def refuse_other_muscle(table: ForceMap | VolumeTable, rig: Rig, own_length: bool) -> None:
    """Refuse a table of a muscle that cannot be the rig's.

    Args:
        table: what was measured.
        rig: whose joint the muscle is to drive.
        own_length: whether the length at ψ = 0 was given with the table.

    Raises:
        BadInput: no measured length lies within the joint's range.
    """
    span = reach(rig)
    low, high = float(table.length.min()), float(table.length.max())
    if low <= span.longest and high >= span.shortest:
        return
    given = (
        f"--length {rig.geometry.length:g}" if own_length else f"rig {rig.name} with L_0 = {rig.geometry.length:g} m"
    )
    raise BadInput(
        f"{table.name}: measured at {low * 1e3:.0f} to {high * 1e3:.0f} mm, but {given} uses {span}: another muscle; "
        "expected lengths within the joint's range, or --length L_0 [m] for a joint with this muscle (it becomes "
        "geometry.length), or --report-only to fit the table without a rig file"
    )


def coverage(table: ForceMap | VolumeTable, rig: Rig) -> list[str]:
    """Sentences on where the joint goes and the table does not, and on how little is in it."""
    span, out = reach(rig), []
    low, high = float(table.length.min()), float(table.length.max())
    slack = 0.02 * (span.longest - span.shortest)
    uncovered = []
    if low > span.shortest + slack:
        uncovered.append(f"below {low * 1e3:.1f} mm")
    if high < span.longest - slack:
        uncovered.append(f"above {high * 1e3:.1f} mm")
    if uncovered:
        out.append(
            f"{table.name}: in the joint the muscles are {span} long; {' and '.join(uncovered)} the fit is "
            "extrapolated: measure there"
        )
    if table.lengths < _FEW_LENGTHS:
        out.append(
            f"{table.name}: {table.lengths} lengths; with fewer than {_FEW_LENGTHS} the form's error between them is "
            "unknown"
        )
    if isinstance(table, VolumeTable):
        return out
    measured = table.pressure[~table.slack]
    if len(np.unique(np.round(table.pressure, -2))) < _FEW_PRESSURES:
        out.append(
            f"{table.name}: fewer than {_FEW_PRESSURES} pressures; it is unknown whether the force is linear in the "
            "pressure"
        )
    if not rig.valves.sealed and measured.max() < 0.95 * span.highest:
        out.append(
            f"{table.name}: forces up to {measured.max() / 1e3:.0f} kPa absolute, but the supply of rig {rig.name} has "
            f"{span.highest / 1e3:.0f} kPa: above, the fit is extrapolated"
        )
    return out


def doubts_about_volume(fit: VolumeFit, rig: Rig) -> list[str]:
    """Sentences on a volume that is odd within the joint's range."""
    span = reach(rig)
    volume, slope = fit.volume(span.lengths())
    out = []
    if np.any(slope >= 0.0):
        out.append(
            f"the volume grows with length at {np.sum(slope >= 0.0) / len(slope):.0%} of the joint's lengths, where a "
            "pressurised muscle would push, not pull: is the length column right?"
        )
    relative = float(np.max(fit.volume_std(span.lengths()) / volume))
    if relative > 0.1:
        out.append(f"within the joint's range the volume is known to {relative:.0%} only: more lengths, or repeat them")
    return out


def doubts_about_force(fit: ForceFit, rig: Rig) -> list[str]:
    """Sentences on a force map that is odd within the joint's range."""
    span = reach(rig)
    lengths = span.lengths(9)
    middle = np.full(len(lengths), 0.5 * (span.lowest + span.highest))
    std = float(np.max(fit.force_std(lengths, middle)))
    largest = float(np.max(np.abs(fit.force(lengths, middle))))
    out = []
    if std > 0.05 * largest:
        out.append(
            f"at {middle[0] / 1e3:.0f} kPa the map is known to {std:.2g} N only within the joint's range "
            f"({std / largest:.0%} of its largest force there): more lengths there, or a form that fits better"
        )
    offsets = [name for name in rig.uncertainty if name.endswith(f".force.{_OFFSET[rig.model.force]}")]
    carried = min((rig.uncertainty[name] for name in offsets), default=math.inf)
    # Means over a length: the sensor's noise is no error of the map.
    shared = [float(np.mean(item.errors)) for item in fit.left_out if item.measured and np.isfinite(item.rmse)]
    missed = float(np.sqrt(np.mean(np.square(shared)))) if shared else math.nan
    if missed > 2.0 * carried:
        out.append(
            f"at lengths left out the map's mean error is {missed:.2g} N, but the filter's covariance allows for "
            f"{carried:.2g} N only (uncertainty of {offsets[0]} in the rig file): identify the rig, or enter a larger "
            "value there"
        )
    return out


def with_fits(rig: Rig, muscles: Sequence[int], volume: VolumeFit | None, force: ForceFit | None, source: str) -> Rig:
    """The rig with fitted coefficients, and their standard deviations as priors for an identification.

    Args:
        rig: what everything else is taken from.
        muscles: 1, 2 or both.
        volume: fitted volume, None to leave it.
        force: fitted force map, None to leave it; its form becomes the rig's.
        source: what the rig's ``source`` says about it.

    Raises:
        BadInput: the other muscle has no coefficients of the form, or the resulting rig is physically impossible.
    """
    found: dict[str, tuple[float, float]] = {}
    for number in muscles:
        if volume is not None:
            found |= _named(f"muscle_{number}.volume", VOLUME_COEFFICIENTS, volume.coefficients, volume.std)
        if force is not None:
            found |= _named(f"muscle_{number}.force", force.names, force.coefficients, force.std)
    changes: dict[str, object] = {}
    for number in muscles:
        own = getattr(rig, f"muscle_{number}")
        parts = {"volume": volume, "force": force}
        changes[f"muscle_{number}"] = own.replaced(
            **{
                part: getattr(own, part).replaced(**_under(found, f"muscle_{number}.{part}."))
                for part, fit in parts.items()
                if fit is not None
            }
        )
    if force is not None and force.form != rig.model.force:
        _refuse_half(rig, muscles, force.form)
        changes["model"] = rig.model.replaced(force=force.form)
        changes["uncertainty"] = _moved_offsets(rig, force.form)
    spread = {name: std for name, (_, std) in found.items() if math.isfinite(std) and std > 0.0}
    changes["priors"] = {**{name: std for name, std in rig.priors.items() if name not in found}, **spread}
    changes["bounds"] = {name: pair for name, pair in rig.bounds.items() if name not in found}
    out = rig.replaced(**changes, source=f"{rig.source.strip()} {source}")
    complaint = unphysical(out)
    if complaint:
        missing = (
            "; give this muscle's --volume as well, or --report-only"
            if ".volume" in complaint and volume is None
            else ""
        )
        raise BadInput(f"the rig with these fits: {complaint}{missing}")
    return out


def _named(path: str, names: Sequence[str], values: Floats, std: Floats) -> dict[str, tuple[float, float]]:
    return {f"{path}.{name}": (float(value), float(own)) for name, value, own in zip(names, values, std, strict=True)}


def _under(found: dict[str, tuple[float, float]], start: str) -> dict[str, float]:
    return {name.removeprefix(start): value for name, (value, _) in found.items() if name.startswith(start)}


def _refuse_half(rig: Rig, muscles: Sequence[int], form: str) -> None:
    for number in {1, 2} - set(muscles):
        if not any(rig.value(f"muscle_{number}.force.{name}") for name in FORCE_COEFFICIENTS[form]):
            raise BadInput(
                f"form {form} for muscle {muscles[0]}: rig {rig.name} has no coefficients of it for muscle {number}, "
                f"and both share one form; expected --muscle both, or --form {rig.model.force}"
            )


def _moved_offsets(rig: Rig, form: str) -> dict[str, float]:
    """Uncertain force offsets under the name that they have in another form."""
    before, after = f".force.{_OFFSET[rig.model.force]}", f".force.{_OFFSET[form]}"
    out = {}
    for name, std in rig.uncertainty.items():
        if ".force." in name and not name.endswith(before):
            continue
        out[name.replace(before, after)] = std
    return out


_FAINT = 1e-3
"""[N] An error below which no form is worth changing."""


@dataclass(frozen=True, eq=False)
class StaticResult:
    """The results of static tables.

    Attributes:
        rig: the start rig, with the length that was given.
        fitted: that rig with the fits, None where only a report was requested.
        muscles: numbers of the muscles that the tables hold for.
        volumes: table of volumes, or None.
        volume: its fit, or None.
        force_map: table of forces, or None.
        forms: every form of the force map fitted to it, or why not.
        form: the one for the rig, empty without a map.
        warnings: sentences on what to look at.
    """

    rig: Rig
    fitted: Rig | None
    muscles: tuple[int, ...]
    volumes: VolumeTable | None
    volume: VolumeFit | None
    force_map: ForceMap | None
    forms: dict[str, ForceFit | Undetermined]
    form: str
    warnings: tuple[str, ...]

    @property
    def force(self) -> ForceFit | None:
        """Fit of the form for the rig."""
        chosen = self.forms.get(self.form)
        return chosen if isinstance(chosen, ForceFit) else None


def work_out(
    rig: Rig,
    volumes: VolumeTable | None,
    force_map: ForceMap | None,
    muscles: Sequence[int] = (1, 2),
    form: str = "",
    own_length: bool = False,
    report_only: bool = False,
) -> StaticResult:
    """Fit static tables and put them into a rig.

    Args:
        rig: start; what is not fitted stays as it is.
        volumes: table of length and volume.
        force_map: table of length, pressure and force.
        muscles: which the tables hold for, 1, 2 or both.
        form: of the force map, one of ``parameters.FORCE_FORMS``; default: the rig's.
        own_length: whether the rig's length was given with the tables.
        report_only: make no rig; then the muscle need not fit the joint.

    Raises:
        BadInput: another muscle, a table that does not determine its coefficients, or an impossible rig.
    """
    warnings: list[str] = []
    for table in (volumes, force_map):
        if table is None:
            continue
        warnings += [f"{table.name}: {issue}" for issue in table.issues]
        if not report_only:
            refuse_other_muscle(table, rig, own_length)
            warnings += coverage(table, rig)
    volume, forms, chosen = None, {}, ""
    if volumes is not None:
        volume = fit_volume(volumes)
        warnings += _about_volume(volumes, volume, rig, report_only)
    if force_map is not None:
        chosen = form or rig.model.force
        nominal = rig.value(f"muscle_{muscles[0]}.force.c6") if rig.model.force == "braided" else 0.0
        forms = compare_forms(force_map, rig.geometry.length, nominal=nominal)
        fit = forms[chosen]
        if not isinstance(fit, ForceFit):
            raise BadInput(f"{force_map.name}: does not determine a force map of form {chosen}: {fit}")
        warnings += [f"form {chosen}: {note}" for note in fit.notes]
        if not report_only:
            warnings += doubts_about_force(fit, rig)
        warnings += _better_form(forms, chosen)
    fitted = None
    if not report_only:
        force = forms.get(chosen)
        fitted = with_fits(
            rig, muscles, volume, force if isinstance(force, ForceFit) else None, _source(volumes, force_map, muscles)
        )
    return StaticResult(
        rig, fitted, tuple(muscles), volumes, volume, force_map, forms, chosen, tuple(dict.fromkeys(warnings))
    )


def _about_volume(table: VolumeTable, fit: VolumeFit, rig: Rig, report_only: bool) -> list[str]:
    out = [] if report_only else doubts_about_volume(fit, rig)
    if fit.freedom == 0 and not table.declared:
        out.append(
            f"{table.name}: 3 volumes for 3 coefficients give no error estimate, so there are no priors: measure more "
            "lengths"
        )
    return out


def _better_form(forms: dict[str, ForceFit | Undetermined], chosen: str) -> list[str]:
    """A note on a form whose error at lengths left out is less than two thirds of the chosen form's."""
    own = forms[chosen]
    assert isinstance(own, ForceFit)
    known = {
        name: fit.left_out_rmse
        for name, fit in forms.items()
        if isinstance(fit, ForceFit) and fit.left_out_rmse == fit.left_out_rmse
    }
    if chosen not in known:
        return [f"form {chosen}: some lengths cannot be left out, so its error on new lengths is not known"]
    best = min(known, key=lambda name: known[name])
    if known[best] < own.left_out_rmse / 1.5 and own.left_out_rmse > _FAINT:
        return [
            f"at lengths left out, form {best} errs by {known[best]:.3g} N (RMS), {chosen} by {known[chosen]:.3g} N: "
            f"consider --form {best}"
        ]
    return []


def _source(volumes: VolumeTable | None, force_map: ForceMap | None, muscles: Sequence[int]) -> str:
    whose = " and ".join(str(number) for number in muscles)
    parts = [("volume", volumes), ("force map", force_map)]
    sources = [f"{what} from {table.name} (SHA-256 {table.sha256[:12]})" for what, table in parts if table is not None]
    return f"Muscle {whose}: {', '.join(sources)}."
