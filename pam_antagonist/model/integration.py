"""Integration of the model: Runge-Kutta steps with the mechanical stop.

Names and arguments are those of :mod:`pam_antagonist.model.dynamics`.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import in_place, inlined, kernel
from pam_antagonist.model import dynamics, flow
from pam_antagonist.model.dynamics import ANGLE, FIRST, PRESSURE_1, PRESSURE_2, SECOND, VELOCITY, WITH_EFFECTS
from pam_antagonist.model.lane_values import shared
from pam_antagonist.model.parameters import BASE_STATES, LAWS_PRESENT, LONGEST_STEP, PLAIN, STOP

STAGES = 4
"""Stages of a Runge-Kutta step. A step with added states or learned laws needs scratch of STAGES + 1 rows."""

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_open_rate, _external_torque = flow.open_rate, dynamics.external_torque
_slopes, _rows, _reading, _torque = dynamics.slopes, dynamics.rows, dynamics.reading, dynamics.torque


@inlined
def apply_stop(x, p):
    """The mechanical stop, an inelastic impact: the angle is held at ±``joint.stop``, the velocity into it is lost.

    `x`: state (n,), changed in place.
    """
    stop = p[STOP]
    if x[ANGLE] >= stop:
        x[ANGLE] = stop
        x[VELOCITY] = min(x[VELOCITY], 0.0)
    elif x[ANGLE] <= -stop:
        x[ANGLE] = -stop
        x[VELOCITY] = max(x[VELOCITY], 0.0)


@in_place
def _extended_step(x, u, p, dt, result, scratch):
    """:func:`rk4_step_within` with any number of states, and with learned laws."""
    n = x.shape[0]
    slopes, point = scratch[:STAGES], scratch[STAGES]
    wanted_1, wanted_2 = _open_rate(FIRST, u[0], p), _open_rate(SECOND, u[1], p)
    _rows(x, u, wanted_1, wanted_2, p, slopes[0])
    for stage in range(1, STAGES):
        reach = dt if stage == STAGES - 1 else 0.5 * dt
        for i in range(n):
            point[i] = x[i] + reach * slopes[stage - 1, i]
        _rows(point, u, wanted_1, wanted_2, p, slopes[stage])
    sixth = dt / 6.0
    for i in range(n):
        result[i] = x[i] + sixth * (slopes[0, i] + 2.0 * (slopes[1, i] + slopes[2, i]) + slopes[3, i])
    apply_stop(result, p)


@inlined
def _scalar_step(x, u, p, dt, result, effects):
    """:func:`rk4_step_within` without added states."""
    alpha_1 = _open_rate(FIRST, u[0], p)
    alpha_2 = _open_rate(SECOND, u[1], p)
    e = _external_torque(u)
    half = 0.5 * dt
    a, b, c, d = x[ANGLE], x[VELOCITY], x[PRESSURE_1], x[PRESSURE_2]
    a1, b1, c1, d1 = _slopes(a, b, c, d, alpha_1, alpha_2, e, p, effects)
    a2, b2, c2, d2 = _slopes(
        a + half * a1, b + half * b1, c + half * c1, d + half * d1, alpha_1, alpha_2, e, p, effects
    )
    a3, b3, c3, d3 = _slopes(
        a + half * a2, b + half * b2, c + half * c2, d + half * d2, alpha_1, alpha_2, e, p, effects
    )
    a4, b4, c4, d4 = _slopes(a + dt * a3, b + dt * b3, c + dt * c3, d + dt * d3, alpha_1, alpha_2, e, p, effects)
    sixth = dt / 6.0
    result[ANGLE] = a + sixth * (a1 + 2.0 * (a2 + a3) + a4)
    result[VELOCITY] = b + sixth * (b1 + 2.0 * (b2 + b3) + b4)
    result[PRESSURE_1] = c + sixth * (c1 + 2.0 * (c2 + c3) + c4)
    result[PRESSURE_2] = d + sixth * (d1 + 2.0 * (d2 + d3) + d4)
    apply_stop(result, p)


@in_place
def _optional_step(x, u, p, dt, result):
    """:func:`rk4_step_within` with options or effects, but without added states."""
    _scalar_step(x, u, p, dt, result, WITH_EFFECTS)


@in_place
def plain_step(x, u, p, dt, result, scratch):
    """:func:`rk4_step_within` of a rig that is known to be plain.

    `x`: state (4,), not changed unless it is also ``result``. `result`: state after the step (4,).
    """
    _scalar_step(x, u, p, dt, result, None)


@in_place
def rk4_step_within(x, u, p, dt, result, scratch):
    """One step of the fourth-order Runge-Kutta method with the input held, then the mechanical stop.

    `x`: state (n,), not changed unless it is also ``result``. `u`: valve voltages [V] over the step, and where it is
    known the torque from outside [N m]; (2,) or (3,). `scratch`: (STAGES + 1, n), used where there are added states or
    learned laws.
    """
    if shared(p[PLAIN]) != 0.0:
        _scalar_step(x, u, p, dt, result, None)
    elif x.shape[0] == BASE_STATES and shared(p[LAWS_PRESENT]) == 0.0:
        _optional_step(x, u, p, dt, result)
    else:
        _extended_step(x, u, p, dt, result, scratch)


@kernel
def rk4_step(x, u, p, dt, result, effects=True):
    """:func:`rk4_step_within` that allocates its scratch, which takes as long as the step: not for loops.

    `x`: state (n,), not changed unless it is also ``result``. `u`: valve voltages [V] over the step, and where it is
    known the torque from outside [N m]; (2,) or (3,). `effects`: None where the rig is known to be plain: less is
    compiled then.
    """
    if effects is None:
        _scalar_step(x, u, p, dt, result, None)
    else:
        rk4_step_within(x, u, p, dt, result, np.empty((STAGES + 1, x.shape[0])))


@in_place
def sample(x, u, p, dt, steps, scratch, shown):
    """Advance a simulated joint by several steps, and read what its sensors show of it without their noise.

    `x`: state (n,), changed in place. `u`: as of :func:`rk4_step`. `scratch`: (STAGES + 1, n). `shown`: both pressures
    [Pa] and the torque [N m] (3,), written.
    """
    for _ in range(steps):
        rk4_step_within(x, u, p, dt, x, scratch)
    shown[0], shown[1] = _reading(FIRST, x[PRESSURE_1], p), _reading(SECOND, x[PRESSURE_2], p)
    shown[2] = _torque(x, p)


def substeps_of(period: float, longest: float = LONGEST_STEP) -> int:
    """Number of Runge-Kutta steps in a sample.

    `period`: sample period [s]. `longest`: longest step [s]; a tenth more is allowed.
    """
    return max(1, math.ceil(period / longest - 0.1))
