"""A muscle's static tables worked out for a rig: fits, comparison of the forms, doubts, and the rig with them in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static_force import ForceFit, compare_forms
from pam_antagonist.identification.static_regression import Undetermined
from pam_antagonist.identification.static_rig import (
    coverage,
    doubts_about_force,
    doubts_about_volume,
    refuse_other_muscle,
    with_fits,
)
from pam_antagonist.identification.static_table import ForceMap, VolumeTable
from pam_antagonist.identification.static_volume import VolumeFit, fit_volume
from pam_antagonist.rig import Rig

_FAINT = 1e-3
"""[N] An error below which no form is worth changing."""


@dataclass(frozen=True, eq=False)
class StaticResult:
    """What became of the tables.

    Attributes:
        rig: the rig that was started from, with the length that was given.
        fitted: it with the fits, None where only a report was asked for.
        muscles: numbers of the muscles that the tables were said to hold for.
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
        report_only: make no rig; then the muscle need not fit its joint.

    Raises:
        BadInput: another muscle, a table that does not determine what it is for, or a rig that cannot be.
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
        forms = compare_forms(force_map, rig.geometry.length)
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
            f"{table.name}: 3 volumes for 3 coefficients tell no error, so there are no priors: measure more lengths"
        )
    return out


def _better_form(forms: dict[str, ForceFit | Undetermined], chosen: str) -> list[str]:
    """A form that errs less than two thirds as much on lengths left out deserves a word."""
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
    said = [f"{what} from {table.name} (SHA-256 {table.sha256[:12]})" for what, table in parts if table is not None]
    return f"Muscle {whose}: {', '.join(said)}."
