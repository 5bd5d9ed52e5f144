"""A static test of a virtual rig's muscles: force at lengths and pressures, and rigs with a map fitted to it."""

from __future__ import annotations

import hashlib

import numpy as np

from pam_antagonist.identification.static_force import ForceFit, fit_force
from pam_antagonist.identification.static_table import ForceMap
from pam_antagonist.model import dynamics, equilibrium, muscle
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig
from validation.paper.seed_work import SeedWork

_REACH_RAD = np.radians(20.0)
"""The lengths span the joint's range of the paper."""
_STREAM = 3


def static_test(work: SeedWork, which: int) -> ForceMap:
    """Forces of a muscle of the virtual rig as a test bench would measure them.

    Each length is approached twice, by getting shorter and by getting longer, so the muscle's hysteresis is in the
    data; and the force sensor has noise. No point counts as slack: the model's muscle is not cut off at zero, and pulls
    with a newton less than nothing at the shortest length and the lowest pressure.

    Args:
        work: the virtual rig.
        which: muscle 1 or 2.

    Returns:
        2 × lengths × pressures rows.
    """
    test, rig = work.scenario.static, work.rig
    p = rig.plant("locked").parameters
    # Muscle 1 gets shorter as the angle grows, muscle 2 longer.
    sign = -1.0 if which == 1 else 1.0
    angles = np.linspace(-_REACH_RAD, _REACH_RAD, test.lengths)
    pressures = np.linspace(test.lowest, test.highest, test.pressures)
    grids = np.meshgrid(np.arange(test.lengths), pressures, [-1.0, 1.0], indexing="ij")
    group, pressure, way = (grid.ravel() for grid in grids)
    angle = sign * angles[group.astype(np.int64)]
    length = np.array([muscle.length(which - 1, np.sin(at), p) for at in angle])
    loop = int(p[par.SLOT_OF[f"hysteresis_{which}"]])
    force = np.empty(len(length))
    for k in range(len(length)):
        x = equilibrium.initial_state(angle[k], pressure[k], pressure[k], np.zeros(3), p)
        if loop:
            x[loop] = way[k]
        force[k] = dynamics.forces(x, p)[which - 1]
    rng = np.random.default_rng([work.seed, _STREAM, which])
    force += test.force_std * rng.standard_normal(len(force))
    return ForceMap(
        name=f"virtual rig, seed {work.seed}, muscle {which}",
        sha256=hashlib.sha256(force.tobytes()).hexdigest(),
        issues=(),
        length=length,
        group=group.astype(np.int64),
        spread=np.ones(len(force)),
        declared=False,
        pressure=np.asarray(pressure, dtype=np.float64),
        atmosphere=float(p[par.ATMOSPHERE]),
        force=force,
        limit=-np.inf,
        slack=np.zeros(len(force), dtype=bool),
    )


def static_fits(work: SeedWork, form: str) -> tuple[ForceFit, ForceFit]:
    """A form of the force map fitted to the static test of either muscle.

    Raises:
        Undetermined: the test of a muscle does not determine the form's coefficients.
    """
    rest = work.rig.declared.geometry.length
    # The search for an exponent meets ones that the test cannot tell apart, whose cost is infinite.
    with np.errstate(invalid="ignore"):
        first, second = (fit_force(static_test(work, which), form, rest) for which in (1, 2))
    return first, second


def with_fits(rig: Rig, form: str, fits: tuple[ForceFit, ForceFit]) -> Rig:
    """A rig whose muscles have the fitted maps in place of the declared ones.

    Args:
        rig: with the declared maps.
        form: of the force map.
        fits: of muscle 1 and 2.
    """
    changes = {}
    for which, fit in zip((1, 2), fits, strict=True):
        part = getattr(rig, f"muscle_{which}")
        found = {name: float(value) for name, value in zip(fit.names, fit.coefficients, strict=True)}
        changes[f"muscle_{which}"] = part.replaced(force=part.force.replaced(**found))
    return rig.replaced(name=f"{rig.name}, {form} fitted", model=rig.model.replaced(force=form), **changes)


def true_map(work: SeedWork, which: int) -> dict[str, float]:
    """Coefficients v1, v2, w1, w2 that the virtual rig's muscle really has."""
    p = work.rig.plant("locked").parameters
    return {name: float(p[par.INDEX[f"muscle_{which}.force.{name}"]]) for name in ("v1", "v2", "w1", "w2")}
