"""The chambers alone: equation (4) with pressure regulators, driven by commands and by the measured angle.

The Runge-Kutta step of the whole model integrates it. The joint is locked, and the angle is set from outside. So the
muscles have their measured volumes, and the result tests the model of the regulators only.
"""

from __future__ import annotations

import numpy as np

from pam_antagonist._jit import inlined, kernel
from pam_antagonist.model import equilibrium, integration
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2, VELOCITY
from pam_antagonist.model.integration import STAGES
from pam_antagonist.model.parameters import FRICTION_STEP

_rk4_step, _initial_state = integration.rk4_step_within, equilibrium.initial_state
_substeps_of = inlined(integration.substeps_of)


@kernel
def pressures(first, start, time, command, angle, p, longest, anew):
    """Pressures of episodes, each with its own start.

    Args:
        first: index of the first row of each episode, then the number of rows (E + 1,).
        start: pressures with which each episode begins (E, 2) [Pa].
        time: of the rows [s] (N,), increasing within an episode.
        command: pressures commanded over the step that ends at each row (N, 2) [Pa].
        angle: measured (N,) [rad], linear between rows.
        p: parameter vector (m,) of a locked joint.
        longest: longest step of the integration [s].
        anew: whether each episode starts after a long rest (E,). If not, it goes on from the episode before: only the
            pressures start from the given ones, and the states of supply and regulators go on.

    Returns:
        P_1, P_2 of each row (N, 2) [Pa].
    """
    p = p.copy()
    u = np.zeros(2)
    out = np.empty((time.shape[0], 2))
    x = _initial_state(angle[0], start[0, 0], start[0, 1], u, p)
    scratch = np.empty((STAGES + 1, x.shape[0]))
    for e in range(first.shape[0] - 1):
        begin = first[e]
        u[:] = command[begin]
        if anew[e]:
            x = _initial_state(angle[begin], start[e, 0], start[e, 1], u, p)
        else:
            x[PRESSURE_1], x[PRESSURE_2] = start[e, 0], start[e, 1]
        out[begin] = start[e]
        for k in range(begin + 1, first[e + 1]):
            u[:] = command[k]
            dt = time[k] - time[k - 1]
            steps = _substeps_of(dt, longest)
            p[FRICTION_STEP] = dt / steps
            moved = angle[k] - angle[k - 1]
            x[VELOCITY] = moved / dt
            for s in range(steps):
                x[ANGLE] = angle[k - 1] + (s + 0.5) / steps * moved
                _rk4_step(x, u, p, dt / steps, x, scratch)
            out[k, 0], out[k, 1] = x[PRESSURE_1], x[PRESSURE_2]
    return out
