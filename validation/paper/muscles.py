"""Static tests of a virtual rig's muscles, (6) and (7), and force maps compared by their torque (Table IV)."""

from __future__ import annotations

import hashlib
import math

import numpy as np

from pam_antagonist.identification.static_fit import StaticFit, fit
from pam_antagonist.identification.static_table import StaticTable
from pam_antagonist.identification.tobit import Undetermined
from pam_antagonist.model import dynamics, equilibrium, muscle
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig
from validation.paper.estimates import COMPARED_S
from validation.paper.virtual import TUNINGS, VirtualRig, filtered, judged

LENGTHS, PRESSURES, FORCE_STD = 6, 11, 0.5
_LOWEST, _HIGHEST = 200e3, 700e3
_REACH_RAD = np.radians(20.0)
"""The lengths span the joint's range of the paper."""
_STREAM = 3
_AT = ((0.165, 450e3), (0.155, 600e3), (0.175, 300e3))
"""Lengths [m] and pressures [Pa] at which maps are compared: coefficients nearly cancel, forces do not."""
FORMS = {
    "linear": "Equation (6)",
    "hildebrandt": "Polynomial model 1 (Hildebrandt 2005)",
    "sarosi": "Polynomial model 2 (Sárosi 2010)",
    "polynomial": "Polynomial model 3 (2012)",
}


def static_test(rig: VirtualRig, which: int, noise: float = FORCE_STD) -> StaticTable:
    """Forces of a muscle as a test bench would measure them: each length from both sides, noise of the sensor [N].

    No point counts as slack: the model's muscle is not cut off at zero, and pulls with a newton less than nothing at
    the shortest length and the lowest pressure.
    """
    p = rig.plant("locked").parameters
    # Muscle 1 gets shorter as the angle grows, muscle 2 longer.
    angles = (-1.0 if which == 1 else 1.0) * np.linspace(-_REACH_RAD, _REACH_RAD, LENGTHS)
    grids = np.meshgrid(np.arange(LENGTHS), np.linspace(_LOWEST, _HIGHEST, PRESSURES), [-1.0, 1.0], indexing="ij")
    group, pressure, way = (grid.ravel() for grid in grids)
    angle = angles[group.astype(np.int64)]
    loop = int(p[par.SLOT_OF[f"hysteresis_{which}"]])
    force = np.empty(len(angle))
    for k in range(len(angle)):
        x = equilibrium.initial_state(angle[k], pressure[k], pressure[k], np.zeros(3), p)
        if loop:
            x[loop] = way[k]
        force[k] = dynamics.forces(x, p)[which - 1]
    force += noise * np.random.default_rng([rig.seed, _STREAM, which]).standard_normal(len(force))
    return StaticTable(
        name=f"virtual rig, seed {rig.seed}, muscle {which}",
        sha256=hashlib.sha256(force.tobytes()).hexdigest(),
        length=np.array([muscle.length(which - 1, np.sin(at), p) for at in angle]),
        group=group.astype(np.int64),
        spread=np.ones(len(force)),
        declared=False,
        pressure=np.asarray(pressure, dtype=np.float64),
        atmosphere=float(p[par.ATMOSPHERE]),
        value=force,
        limit=-np.inf,
        slack=np.zeros(len(force), dtype=bool),
    )


def static_fits(rig: VirtualRig, form: str, noise: float = FORCE_STD) -> tuple[StaticFit, StaticFit]:
    """A form of the force map fitted to the static test of either muscle; ``Undetermined`` where a test cannot."""
    rest = rig.declared.geometry.length
    # The search for an exponent meets ones that the test cannot tell apart, whose cost is infinite.
    with np.errstate(invalid="ignore"):
        first, second = (fit(static_test(rig, which, noise), form, rest) for which in (1, 2))
    return first, second


def true_map(rig: VirtualRig, which: int) -> dict[str, float]:
    """Coefficients v1, v2, w1, w2 that the virtual rig's muscle really has."""
    p = rig.plant("locked").parameters
    return {name: float(p[par.INDEX[f"muscle_{which}.force.{name}"]]) for name in ("v1", "v2", "w1", "w2")}


def _force(names: dict[str, float], length: float, pressure: float) -> float:
    return (names["v1"] * length + names["v2"]) * pressure + names["w1"] * length + names["w2"]


def static(rig: VirtualRig) -> dict[str, float]:
    """How far fitted and declared map are from the muscle's own: the largest force error at ``_AT`` of both muscles."""
    errors: dict[str, list[float]] = {"fitted map": [], "declared map": []}
    for which, found in zip((1, 2), static_fits(rig, "linear"), strict=True):
        true, declared = true_map(rig, which), getattr(rig.declared, f"muscle_{which}").force
        maps = {
            "fitted map": dict(zip(found.names, found.coefficients.tolist(), strict=True)),
            "declared map": {name: getattr(declared, name) for name in true},
        }
        for name, one in maps.items():
            errors[name].append(max(abs(_force(one, *at) - _force(true, *at)) for at in _AT))
    return {name: max(values) for name, values in errors.items()}


def _with_fits(rig: Rig, form: str, fits: tuple[StaticFit, StaticFit]) -> Rig:
    """A rig whose muscles have the fitted maps in place of the declared ones."""
    changes = {}
    for which, found in zip((1, 2), fits, strict=True):
        part = getattr(rig, f"muscle_{which}")
        values = dict(zip(found.names, found.coefficients.tolist(), strict=True))
        changes[f"muscle_{which}"] = part.replaced(force=part.force.replaced(**values))
    return rig.replaced(name=f"{rig.name}, {form} fitted", model=rig.model.replaced(force=form), **changes)


def compare_torque(rig: VirtualRig) -> dict[str, float]:
    """Errors of each force map, fitted to the rig's static test, with both tunings; NaN where it is undetermined."""
    samples = round(COMPARED_S / rig.declared.sample_period)
    out: dict[str, float] = {}
    for form, label in FORMS.items():
        try:
            fits = static_fits(rig, form)
        except Undetermined:  # a straight map leaves the exponent of a curved form free
            out[f"{label}, tuning published, ℚ"] = math.nan
            continue
        model = _with_fits(rig.declared, form, fits)
        out[f"{label}, static test, a length left out"] = 0.5 * sum(one.left_out_rmse for one in fits)
        for tuning in TUNINGS:
            track = filtered(model, rig.locked, tuning, "locked", samples)
            found = judged(track, rig.locked, rig.declared, "torque")
            out |= {f"{label}, tuning {tuning}, {key}": value for key, value in found.items()}
    return out
