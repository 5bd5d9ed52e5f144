r"""Pushes that begin or end suddenly.

A random walk is a poor model of a push. To follow a jump, its noise must be so large that the filter's joint at rest
leaves its friction, and the filter then takes this motion for a push. Here the external torque d hardly changes during
a push, and jumps now and then. A jump shows within milliseconds: the normalised innovation then exceeds the declared
``onset``, in standard deviations.

The change Δd then has the variance s² of the prior. It began at a time t ago, between 0 and ``_NOTICED``, and has moved
the joint since then by (8), without stiffness and friction:

    Δψ̇ = Δd t/J,   Δψ = Δd t²/(2 J).

So the covariance gains s² E[g gᵀ] with g = (t²/(2 J), t/J, 1) for angle, velocity and d, and t even over this interval.
The next updates find the push within some 10 ms.
"""

from __future__ import annotations

from pam_antagonist._jit import in_place
from pam_antagonist.model.dynamics import ANGLE, VELOCITY
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE
from pam_antagonist.model.parameters import INDEX, INERTIA, LOCKED, SLOT_OF

EXTERNAL_TORQUE = CATALOGUE[DISTURBANCE].states[0].name
"""Name of the state that is the external torque."""
_AT = SLOT_OF[EXTERNAL_TORQUE]
_ONSET, _PRIOR = INDEX["effects.external_torque.onset"], INDEX["effects.external_torque.prior"]
_NOTICED = 0.005
"""[s] A push of 0.3 N m moves the pressures of the paper's joint by five times their noise in 6 ms, 1 N m in 3 ms."""
_COUNTED = 0.5
"""Part of the velocity's new variance above which this jump has been added already: it is not added twice."""


@in_place
def jumped(distance, p):
    """Whether an innovation is so improbable that a push must have begun or ended."""
    return p[_AT] > 0.0 and p[LOCKED] == 0.0 and distance > p[_ONSET] * p[_ONSET]


@in_place
def widen(covariance, p):
    """Add the variance of a push that has just begun or ended, in place. `covariance`: P (n, n)."""
    at, variance = int(p[_AT]), p[_PRIOR] * p[_PRIOR]
    unit = _NOTICED / p[INERTIA]
    of_velocity = variance * unit * unit / 3.0
    if covariance[VELOCITY, VELOCITY] > _COUNTED * of_velocity:
        return
    with_angle, with_velocity = variance * unit * _NOTICED / 6.0, variance * unit / 2.0
    both = variance * unit * unit * _NOTICED / 8.0
    covariance[ANGLE, ANGLE] += variance * unit * unit * _NOTICED * _NOTICED / 20.0
    covariance[VELOCITY, VELOCITY] += of_velocity
    covariance[at, at] += variance
    covariance[ANGLE, VELOCITY] += both
    covariance[VELOCITY, ANGLE] += both
    covariance[ANGLE, at] += with_angle
    covariance[at, ANGLE] += with_angle
    covariance[VELOCITY, at] += with_velocity
    covariance[at, VELOCITY] += with_velocity
