"""The joint's mechanics alone, equations (6) to (10), driven by the measured pressures.

The Runge-Kutta step of the whole model integrates it. The valves are shut and the chambers keep the measured pressures.
So only the equations of force, friction and motion act, with all their effects.
"""

from __future__ import annotations

import numpy as np

from pam_antagonist._jit import inlined, kernel
from pam_antagonist.model import equilibrium, integration
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2, VELOCITY
from pam_antagonist.model.integration import STAGES
from pam_antagonist.model.parameters import FRICTION_STEP, POLYTROPIC_VOLUME, SIGNAL, VALVE, VALVE_SIZE

_rk4_step, _initial_state = integration.rk4_step_within, equilibrium.initial_state
_substeps_of = inlined(integration.substeps_of)


@kernel
def angles(first, start, time, pressure, signals, p, longest):
    """Angles of episodes, each started anew.

    Args:
        first: index of the first row of each episode, then the number of rows (E + 1,).
        start: angle [rad] and velocity [rad/s] with which each episode begins (E, 2).
        time: of the rows [s] (N,), increasing within an episode.
        pressure: P_1, P_2 (N, 2) [Pa], linear between rows.
        signals: further signals less their values in the rig file (N, S) [SI], linear between rows; S = 0 for none.
        p: parameter vector (m,).
        longest: longest step of the integration [s].

    Returns:
        ψ of each row (N,) [rad].
    """
    p = p.copy()
    # With these zeros, equation (4) keeps the pressures: no flow, and no effect of the volume.
    p[VALVE : VALVE + 2 * VALVE_SIZE] = 0.0
    p[POLYTROPIC_VOLUME] = 0.0
    u = np.zeros(2)
    out = np.empty(time.shape[0])
    for e in range(first.shape[0] - 1):
        begin = first[e]
        for j in range(signals.shape[1]):
            p[SIGNAL + j] = signals[begin, j]
        x = _initial_state(start[e, 0], pressure[begin, 0], pressure[begin, 1], u, p)
        x[VELOCITY] = start[e, 1]
        scratch = np.empty((STAGES + 1, x.shape[0]))
        out[begin] = x[ANGLE]
        for k in range(begin + 1, first[e + 1]):
            dt = time[k] - time[k - 1]
            steps = _substeps_of(dt, longest)
            h = dt / steps
            p[FRICTION_STEP] = h
            for s in range(steps):
                # The inputs are held over a step, at their values in its middle.
                share = (s + 0.5) / steps
                x[PRESSURE_1] = pressure[k - 1, 0] + share * (pressure[k, 0] - pressure[k - 1, 0])
                x[PRESSURE_2] = pressure[k - 1, 1] + share * (pressure[k, 1] - pressure[k - 1, 1])
                for j in range(signals.shape[1]):
                    p[SIGNAL + j] = signals[k - 1, j] + share * (signals[k, j] - signals[k - 1, j])
                _rk4_step(x, u, p, h, x, scratch)
            out[k] = x[ANGLE]
    return out
