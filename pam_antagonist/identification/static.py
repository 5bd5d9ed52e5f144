"""A muscle's static tables for a rig: fits, comparison of the forms, doubts, and the resulting rig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static_fit import UNITS, VOLUME, StaticFit, compare_forms, fit, rms
from pam_antagonist.identification.static_table import StaticTable
from pam_antagonist.identification.tobit import Undetermined
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.model import muscle
from pam_antagonist.model.force_forms import FORMS
from pam_antagonist.program import versions
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import RANGE_WITHOUT_STOP, unphysical

_FEW_LENGTHS, _FEW_PRESSURES = 4, 4
_FAINT = 1e-3
"""[N] An error below which no form is worth changing."""
_NEAR = 1e-6
"""[m] Half a step for a slope."""
Forms = dict[str, StaticFit | Undetermined]


class Reach(NamedTuple):
    """Range of lengths [m] and absolute pressures [Pa] of a rig's muscles."""

    shortest: float
    longest: float
    lowest: float
    highest: float

    @override
    def __str__(self) -> str:
        return f"{self.shortest * 1e3:.1f} to {self.longest * 1e3:.1f} mm"


def reach(rig: Rig) -> Reach:
    """Lengths and pressures that a rig's muscles get to, by the model's geometry."""
    p = rig.parameters()
    bound = rig.joint.stop if rig.joint.stop is not None else RANGE_WITHOUT_STOP
    lengths = [muscle.length(0, muscle.leverage(angle, p)[0], p) for angle in (-bound, bound)]
    pressures = rig.command_limits if rig.drive == "regulator" else (rig.atmosphere.pressure, rig.supply.pressure)
    return Reach(min(lengths), max(lengths), *pressures)


@dataclass(frozen=True, eq=False)
class StaticFits:
    """The results of static tables."""

    rig: Rig | None
    fitted: Rig | None  # that rig with the fits, None where only a report was requested
    muscles: tuple[int, ...]
    volumes: StaticTable | None
    volume: StaticFit | None
    force_map: StaticTable | None
    forms: Forms
    form: str  # the one for the rig, without a rig that with the least error at lengths left out; empty without a map
    warnings: tuple[str, ...]

    @property
    def force(self) -> StaticFit | None:
        """Fit of the form for the rig."""
        chosen = self.forms.get(self.form)
        return chosen if isinstance(chosen, StaticFit) else None

    @property
    def tables(self) -> tuple[StaticTable, ...]:
        """Those that were given."""
        return tuple(table for table in (self.volumes, self.force_map) if table is not None)

    def to_json(self) -> dict[str, Any]:
        """Content of ``report.json``, in SI units."""
        span, volumes, forces = self.rig and reach(self.rig), self.volumes, self.force_map
        return {
            "rig": self.rig and self.rig.name,
            "muscles": self.muscles,
            "joint": span and {"shortest_m": span.shortest, "longest_m": span.longest},
            "files": {table.name: table.sha256 for table in self.tables},
            "volume": None if volumes is None or self.volume is None else {
                "samples": len(volumes), **self.volume.to_json()
            },
            "force": None if forces is None else {
                "form": self.form,
                "samples": len(forces),
                "slack": int(forces.slack.sum()),
                "lengths": forces.lengths,
                "forms": {
                    name: found.to_json() if isinstance(found, StaticFit) else {"undetermined": str(found)}
                    for name, found in self.forms.items()
                },
            },
            "warnings": self.warnings,
            "rig_written": self.fitted is not None,
            "software": versions(),
        }  # fmt: skip


def work_out(
    rig: Rig | None,
    volumes: StaticTable | None,
    force_map: StaticTable | None,
    muscles: Sequence[int] = (1, 2),
    form: str = "",
    length: float = 0.0,
    report_only: bool = False,
) -> StaticFits:
    """Fit static tables and put them into a rig.

    `muscles`: which the tables hold for, 1, 2 or both. `form`: of the force map, one of ``parameters.FORCE_FORMS``;
    default: the rig's, and for muscles of a data sheet ``braided``, as in an identification. `length`: muscle length at
    ψ = 0 [m] in place of the rig's; without a rig the nominal one. 0: not given.
    """
    if length and rig is not None:
        rig = rig.replaced(geometry=rig.geometry.replaced(length=length))
    target = None if report_only else rig
    tables = {what: table for what, table in ((VOLUME, volumes), ("force map", force_map)) if table is not None}
    warnings = [f"{table.name}: {issue}" for table in tables.values() for issue in table.issues]
    if target is not None:
        _refuse_unknown_units(target)
        for table in tables.values():
            warnings += _coverage(table, target, length)
    volume, force, forms = None, None, {}
    if volumes is not None:
        try:
            volume = fit(volumes, VOLUME)
        except Undetermined as reason:
            raise BadInput(f"{volumes.name}: {reason}; expected at least 3 lengths that are well apart") from None
        warnings += _doubts_about_volume(volume, target) if target else []
        if volume.freedom == 0 and not volumes.declared:
            warnings.append(
                f"{volumes.name}: 3 volumes for 3 coefficients give no error estimate, so there are no priors: measure "
                "more lengths"
            )
    if force_map is not None:
        nominal, rest = length, length or float(force_map.length.max())
        if rig is not None:
            rest = rig.geometry.length
            form = form or rig.model.force
            length_of = FORMS[rig.model.force].nominal
            nominal = rig.value(f"muscle_{muscles[0]}.force.{length_of}") if length_of else 0.0
        forms = compare_forms(force_map, rest, nominal=nominal)
        form = form or _least_error(forms)
        force = _chosen(force_map, forms, form)
        warnings += [f"form {form}: {note}" for note in force.notes]
        warnings += _doubts_about_force(force, target) if target else []
        warnings += _better_form(forms, form, force)
    fitted = None
    if target is not None:
        files = ", ".join(f"{what} from {table.name} (SHA-256 {table.sha256[:12]})" for what, table in tables.items())
        fitted = _with_fits(target, muscles, volume, force)
        fitted = fitted.replaced(source=f"{target.source.strip()} Muscle {' and '.join(map(str, muscles))}: {files}.")
    return StaticFits(
        rig, fitted, tuple(muscles), volumes, volume, force_map, forms, form if force else "",
        tuple(dict.fromkeys(warnings)),
    )  # fmt: skip


def _chosen(force_map: StaticTable, forms: Forms, name: str) -> StaticFit:
    found = forms[name]
    if isinstance(found, StaticFit):
        return found
    others = [other for other, fitted in forms.items() if isinstance(fitted, StaticFit)]
    hint = f"; it determines {', '.join(others)}: choose by --form" if others else ""
    raise BadInput(f"{force_map.name}: does not determine a force map of form {name}: {found}{hint}")


def _refuse_unknown_units(rig: Rig) -> None:
    """Refuse a rig whose pressures or forces are in units of its own: measured ones do not fit in."""
    for field, known in (("pressure", "pascal"), ("force", "newton")):
        if (unit := getattr(rig.units, field)) != known:
            raise BadInput(
                f"rig {rig.name}: its {field}s are not in a known unit (units.{field}: {unit}), so a measured table "
                "does not fit in; expected a rig in Pa and N, or --report-only to fit the table without a rig file"
            )


def _coverage(table: StaticTable, rig: Rig, own_length: float) -> list[str]:
    """Sentences on where the joint goes and the table does not, and on how little is in it.

    A table of which no length lies within the joint's range is refused.
    """
    span, out = reach(rig), []
    low, high = float(table.length.min()), float(table.length.max())
    if low > span.longest or high < span.shortest:
        given = f"--length {own_length:g}" if own_length else f"rig {rig.name} with L_0 = {rig.geometry.length:g} m"
        raise BadInput(
            f"{table.name}: measured at {low * 1e3:.0f} to {high * 1e3:.0f} mm, but {given} uses {span}: another "
            "muscle; expected lengths within the joint's range, or --length L_0 [m] for a joint with this muscle (it "
            "becomes geometry.length), or --report-only to fit the table without a rig file"
        )
    slack = 0.02 * (span.longest - span.shortest)
    uncovered = [f"below {low * 1e3:.1f} mm"] if low > span.shortest + slack else []
    uncovered += [f"above {high * 1e3:.1f} mm"] if high < span.longest - slack else []
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
    if not table.pressure.any():
        return out
    if len(np.unique(np.round(table.pressure, -2))) < _FEW_PRESSURES:
        out.append(
            f"{table.name}: fewer than {_FEW_PRESSURES} pressures; it is unknown whether the force is linear in the "
            "pressure"
        )
    highest = table.pressure[~table.slack].max()
    if not rig.valves.sealed and highest < 0.95 * span.highest:
        regulated = rig.drive == "regulator"
        source = f"the regulators of rig {rig.name} hold up to" if regulated else f"the supply of rig {rig.name} has"
        out.append(
            f"{table.name}: forces up to {highest / 1e3:.0f} kPa absolute, but {source} "
            f"{span.highest / 1e3:.0f} kPa: above, the fit is extrapolated"
        )
    return out


def _doubts_about_volume(fit: StaticFit, rig: Rig) -> list[str]:
    """A sentence on a volume that grows with the length somewhere in the joint's range."""
    lengths = np.linspace(reach(rig).shortest, reach(rig).longest, 41)
    grows = fit.value(lengths + _NEAR) >= fit.value(lengths - _NEAR)
    if not np.any(grows):
        return []
    return [
        f"the volume grows with length at {np.mean(grows):.0%} of the joint's lengths, where a pressurised muscle "
        "would push, not pull: is the length column right?"
    ]


def _doubts_about_force(fit: StaticFit, rig: Rig) -> list[str]:
    """A sentence on a force map that errs by more than the filter of a rig allows for."""
    # Means over a length: the sensor's noise is no error of the map.
    means = [float(np.mean(item.errors)) for item in fit.left_out if item.measured]
    missed = rms([mean for mean in means if math.isfinite(mean)])
    offset = f".force.{FORMS[rig.model.force].offset}"
    carried, name = min(((std, name) for name, std in rig.uncertainty.items() if name.endswith(offset)),
                        default=(math.inf, ""))  # fmt: skip
    if missed <= 2.0 * carried:
        return []
    return [
        f"at lengths left out the map's mean error is {missed:.2g} N, but the filter's covariance allows for "
        f"{carried:.2g} N only (uncertainty of {name} in the rig file): identify the rig, or enter a larger value there"
    ]


def _least_error(forms: Forms) -> str:
    """The form with the least error at lengths left out, among those for which it is known; else the first."""
    known = {name: error for name, found in forms.items()
             if isinstance(found, StaticFit) and math.isfinite(error := found.left_out_rmse)}  # fmt: skip
    return min(known or forms, key=lambda name: known.get(name, math.inf))


def _better_form(forms: Forms, chosen: str, own: StaticFit) -> list[str]:
    """A note on a form whose error at lengths left out is less than two thirds of the chosen form's."""
    if not math.isfinite(own.left_out_rmse):
        return [f"form {chosen}: some lengths cannot be left out, so its error on new lengths is not known"]
    best = forms[_least_error(forms)]
    if isinstance(best, StaticFit) and best.left_out_rmse < own.left_out_rmse / 1.5 and own.left_out_rmse > _FAINT:
        name = best.form.name
        return [
            f"at lengths left out, form {name} errs by {best.left_out_rmse:.3g} N (RMS), {chosen} by "
            f"{own.left_out_rmse:.3g} N: consider --form {name}"
        ]
    return []


def _with_fits(rig: Rig, muscles: Sequence[int], volume: StaticFit | None, force: StaticFit | None) -> Rig:
    """The rig with fitted coefficients, and their standard deviations as priors for an identification."""
    values: dict[str, float] = {}
    stds: dict[str, float] = {}
    for part, number in product((VOLUME, "force"), muscles):
        found = volume if part == VOLUME else force
        if found is not None:
            names = [f"muscle_{number}.{part}.{name}" for name in found.names]
            values |= dict(zip(names, found.coefficients.tolist(), strict=True))
            stds |= dict(zip(names, found.std.tolist(), strict=True))
    changes: dict[str, Any] = {}
    if force is not None and (form := force.form.name) != rig.model.force:
        _check_other_muscle(rig, muscles, form)
        changes["model"] = rig.model.replaced(force=form)
        # Uncertain offsets have another name in another form.
        before, after = f".force.{FORMS[rig.model.force].offset}", f".force.{FORMS[form].offset}"
        changes["uncertainty"] = {
            name.replace(before, after): std for name, std in rig.uncertainty.items()
            if ".force." not in name or name.endswith(before)
        }  # fmt: skip
    changes["priors"] = {
        **{name: std for name, std in rig.priors.items() if name not in stds},
        **{name: std for name, std in stds.items() if math.isfinite(std) and std > 0.0},
    }
    changes["bounds"] = {name: pair for name, pair in rig.bounds.items() if name not in stds}
    out = moved(rig, values).replaced(**changes)
    complaint = unphysical(out)
    if complaint:
        missing = (
            "; give this muscle's --volume as well, or --report-only"
            if ".volume" in complaint and volume is None
            else ""
        )
        raise BadInput(f"the rig with these fits: {complaint}{missing}")
    return out


def _check_other_muscle(rig: Rig, muscles: Sequence[int], form: str) -> None:
    """Refuse a table of one muscle whose form the other one does not have."""
    for number in {1, 2} - set(muscles):
        name = f"muscle_{number}"
        if not any(rig.value(f"{name}.force.{key}") for key in UNITS[form]):
            raise BadInput(
                f"form {form} for muscle {muscles[0]}: rig {rig.name} has no coefficients of it for muscle {number}, "
                f"and both share one form; expected --muscle both, or --form {rig.model.force}"
            )
