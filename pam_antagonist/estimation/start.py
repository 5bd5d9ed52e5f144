"""Start of the filter: state and covariance from a first sample.

A joint with valves starts at rest under its first pressures, with the variances of the tuning. If the external torque d
has a declared prior, d may hold the joint away from its angle of rest: ψ = ψ_0 + d/K, with the joint's stiffness K.
This correlates ψ and d from the start.

If the charge of sealed chambers is known, their pressures show the angle, also during a motion. The pressures are

    P_i = P_i,closed(ψ) + s_i + e_i.

s_i is the difference between reading and chamber that an effect may add (the drift of a sensor), and e_i the error of
the charge. The tuning has the variances of ψ, s_i and e_i *before* the sample. The sample then gets the same update as
every other one, equations (23) and (24), which correlates angle and drift. The joint may slide in either direction or
stick. So an estimated external torque starts in the middle of the band of friction, with the band's width as its
uncertainty.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import in_place
from pam_antagonist.estimation import ukf
from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.model.dynamics import ANGLE, FIRST, PRESSURE_1, SECOND
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE
from pam_antagonist.model.effects.external_torque import UNBOUNDED
from pam_antagonist.model.parameters import BASE_STATES, CHARGE, INDEX, LOCKED, SLOT_OF, STIFFNESS

_AT = SLOT_OF[CATALOGUE[DISTURBANCE].states[0].name]
_PRIOR = INDEX["effects.external_torque.prior"]
_NEAR = 1e-5
"""[rad] Step to either side for the slope of a closed chamber's pressure."""
_start_angle, _make_steady, _closed = equilibrium.start_angle, equilibrium.make_steady, equilibrium.closed_pressure
_pressure_behind, _chamber, _update = dynamics.pressure_behind, dynamics.chamber_pressure, ukf.update
_torque_slope, _torque_needed, _sliding_friction = (
    dynamics.torque_slope,
    dynamics.torque_needed,
    dynamics.sliding_friction,
)


@in_place
def start(y, effects, memory, settings, work):
    """Set state and covariance from a first sample.

    `y`: pressures (2,) [Pa]. `memory`: :class:`~pam_antagonist.estimation.memory.Memory` of the filter, changed in
    place. `settings`: its :class:`~pam_antagonist.estimation.memory.FilterSettings`.
    """
    x, covariance, cross, innovation = memory.x, memory.covariance, memory.cross, memory.innovation
    p = settings.parameter_sets[0]
    pressure_1, pressure_2 = _pressure_behind(FIRST, y[0], p), _pressure_behind(SECOND, y[1], p)
    angle = settings.lock_angle if p[LOCKED] != 0.0 else _start_angle(pressure_1, pressure_2, p, effects)
    _make_steady(x, angle, pressure_1, pressure_2, memory.held, p, 0.0, effects)
    covariance[:] = 0.0
    cross[:] = 0.0
    for i in range(x.shape[0]):
        covariance[i, i] = settings.initial[i]
    if p[LOCKED] == 0.0 and p[CHARGE] > 0.0 and p[CHARGE + 1] > 0.0:
        _closed_covariance(x, covariance, work.scratch, p)
        innovation[:] = 0.0
        # Both pressures are finite. numba would compile the update once more for the literal True.
        known = math.isfinite(y[0])
        _update(x, covariance, cross, innovation, settings.measurement_noise, settings.gain_noise, known, known, work)
        innovation[:] = np.nan  # the sample was not predicted
        if effects is not None:
            _start_external_torque(x, covariance, p)
    elif effects is not None and p[LOCKED] == 0.0 and p[_PRIOR] < UNBOUNDED:
        _correlate_torque(x, covariance, p)


@in_place
def _correlate_torque(x, covariance, p):
    """Correlate angle and external torque of a joint at rest, from the diagonal of the covariance, in place."""
    at = int(p[_AT])
    stiffness = p[STIFFNESS] - _torque_slope(x, p)
    if at > 0 and stiffness > 0.0:
        covariance[ANGLE, at] = covariance[at, at] / stiffness
        covariance[at, ANGLE] = covariance[ANGLE, at]
        covariance[ANGLE, ANGLE] += covariance[ANGLE, at] / stiffness


@in_place
def _closed_covariance(x, covariance, slopes, p):
    """Covariance of closed chambers before the first sample, from its diagonal, in place; slopes (2 or more, n)."""
    n = x.shape[0]
    for i in range(2):
        for k in range(n):
            slopes[i, k] = 0.0
        slopes[i, ANGLE] = (_closed(i, x[ANGLE] + _NEAR, p) - _closed(i, x[ANGLE] - _NEAR, p)) / (2.0 * _NEAR)
        here = _chamber(i, x, p)
        for k in range(BASE_STATES, n):
            # The chamber's pressure is linear in the added states, so that a step of 1 gives the slope.
            x[k] += 1.0
            slopes[i, k] = here - _chamber(i, x, p)
            x[k] -= 1.0
    for i in range(2):
        for j in range(2):
            for k in range(n):
                covariance[PRESSURE_1 + i, PRESSURE_1 + j] += slopes[i, k] * slopes[j, k] * covariance[k, k]
    for i in range(2):
        for k in range(n):
            if not PRESSURE_1 <= k < BASE_STATES:
                covariance[PRESSURE_1 + i, k] = slopes[i, k] * covariance[k, k]
                covariance[k, PRESSURE_1 + i] = covariance[PRESSURE_1 + i, k]


@in_place
def _start_external_torque(x, covariance, p):
    """Set the external torque to the one that holds the joint where it is, uncertain by the band of friction."""
    at = int(p[_AT])
    if at > 0:
        x[at] = _torque_needed(x, 0.0, 0.0, p)
        band = _sliding_friction(x, 1.0, p) - _sliding_friction(x, 0.0, p)
        covariance[at, at] = max(covariance[at, at], band * band / 3.0)
