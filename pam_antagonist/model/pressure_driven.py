"""The joint's mechanics alone, equations (6) to (10), driven by pressures that were measured.

The same Runge-Kutta step as everywhere runs it. The valves are shut and the chambers keep what they are given, so that
only the equations of forces, friction and motion act, with every effect on them.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import kernel
from pam_antagonist.model import equilibrium, integration
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2, VELOCITY
from pam_antagonist.model.integration import STAGES
from pam_antagonist.model.parameters import FRICTION_STEP, POLYTROPIC_VOLUME, SIGNAL, VALVE, VALVE_SIZE

_rk4_step, _initial_state = integration.rk4_step_within, equilibrium.initial_state


@kernel
def angles(first, start, time, pressure, signals, p, longest):
    """Angles of episodes, each started anew.

    Args:
        first: index of the first row of each episode, and behind the last one (E + 1,).
        start: angle [rad] and velocity [rad/s] with which each begins (E, 2).
        time: of the rows [s] (N,), increasing within an episode.
        pressure: P_1, P_2 (N, 2) [Pa], linear between rows.
        signals: further signals less their values in the rig file (N, S) [SI], linear between rows; S = 0 for none.
        p: parameter vector (m,).
        longest: step of the integration [s].

    Returns:
        ψ of each row (N,) [rad].
    """
    p = p.copy()
    # No air passes, and a muscle that changes its volume does not change its pressure.
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
            steps = max(1, math.ceil(dt / longest - 0.1))
            h = dt / steps
            p[FRICTION_STEP] = h
            for s in range(steps):
                # Held over a step at its middle.
                late = (s + 0.5) / steps
                x[PRESSURE_1] = pressure[k - 1, 0] + late * (pressure[k, 0] - pressure[k - 1, 0])
                x[PRESSURE_2] = pressure[k - 1, 1] + late * (pressure[k, 1] - pressure[k - 1, 1])
                for j in range(signals.shape[1]):
                    p[SIGNAL + j] = signals[k - 1, j] + late * (signals[k, j] - signals[k - 1, j])
                _rk4_step(x, u, p, h, x, scratch)
            out[k] = x[ANGLE]
    return out
