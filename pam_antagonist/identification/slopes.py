"""In which directions and how far parameters are moved to see what they do.

The coefficients of a force map nearly cancel each other: moved one by one, each throws a joint out of stiction, and the
differences of such slopes claim to know what the data do not tell. So the map's coefficients are moved along
combinations that change the force in independent ways, and each by a thousandth of the force.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.free_parameters import FreeParameter
from pam_antagonist.model import dynamics
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

STEP = 0.02
"""Step of the central differences in standard deviations of the prior."""
_FORCE_STEP = 1e-3
"""Change of the force that a step of a map's coefficients makes, relative."""
_RANGE = 0.35
"""[rad] Angles at which the maps are looked at, either way."""


def step_directions(rig: Rig, free: Sequence[FreeParameter]) -> Floats:
    """Steps as columns (F, F), in units of the priors.

    Args:
        rig: start values.
        free: parameters of the fit.
    """
    steps = STEP * np.eye(len(free))
    for number in (1, 2):
        own = [k for k, item in enumerate(free) if item.name.startswith(f"muscle_{number}.force.")]
        if len(own) > 1:
            steps[np.ix_(own, own)] = _force_steps(rig, [free[k] for k in own], number - 1)
    return steps


def _force_steps(rig: Rig, free: Sequence[FreeParameter], muscle: int) -> Floats:
    p = rig.parameters()
    stop = min(p[par.STOP], _RANGE)
    low = 0.5 * (rig.supply.pressure + rig.atmosphere.pressure) - 0.4 * (rig.supply.pressure - rig.atmosphere.pressure)
    states = [
        np.array([angle, 0.0, pressure, pressure])
        for angle in np.linspace(-stop, stop, 5)
        for pressure in np.linspace(low, rig.supply.pressure, 5)
    ]

    def forces(q: Floats) -> Floats:
        return np.array([dynamics.forces(state, q)[muscle] for state in states])

    base = forces(p)
    design = np.column_stack(
        [forces(par.changed(p, {item.name: item.start + 0.01 * item.prior_std})) - base for item in free]
    ) / (0.01 * np.sqrt(len(states)))
    _, strength, turned = np.linalg.svd(design, full_matrices=False)
    wanted = _FORCE_STEP * float(np.sqrt(np.mean(base**2)))
    # A combination that hardly moves the force is moved by a standard deviation at most.
    return np.asarray(turned.T * np.minimum(wanted / np.maximum(strength, 1e-300), 1.0))
