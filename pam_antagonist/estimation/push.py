r"""Pushes that set in at once, or are let go at once.

A random walk is a poor model of a push: to follow a jump, it has to be so quick that it shakes a joint at rest out of
its friction, and what the joint then does without a cause is taken for a push. Here the torque from outside d hardly
changes for as long as a push lasts, and now and then it jumps. A jump shows within milliseconds: the innovations are
then more improbable than the declared ``onset``, in standard deviations.

From then on d may be anything: what it has changed by has the variance s² of its prior. The change has been there for a
time t, somewhere within the last ``_NOTICED``, and has moved the joint meanwhile by (8), stiffness and friction aside:

    Δψ̇ = Δd t/J,   Δψ = Δd t²/(2 J).

So the covariance gains s² E[g gᵀ], g = (t²/(2 J), t/J, 1) of angle, velocity and d, over t between 0 and ``_NOTICED``.
The updates that follow find the push within some 10 ms.
"""

from __future__ import annotations

from pam_antagonist._jit import in_place
from pam_antagonist.model.dynamics import ANGLE, VELOCITY
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE
from pam_antagonist.model.parameters import INDEX, INERTIA, LOCKED, SLOT_OF

EXTERNAL_TORQUE = CATALOGUE[DISTURBANCE].states[0].name
"""Name of the state that is the torque from outside."""
_AT = SLOT_OF[EXTERNAL_TORQUE]
_ONSET, _PRIOR = INDEX["effects.external_torque.onset"], INDEX["effects.external_torque.prior"]
_NOTICED = 0.005
"""[s] A push of 0.3 N m moves the pressures of the paper's joint by five times their noise in 6 ms, 1 N m in 3 ms."""
_COUNTED = 0.5
"""Part of the velocity's new variance from which on a jump has been counted: it is not counted twice."""


@in_place
def jumped(distance, p):
    """Whether an innovation is so improbable that a push must have set in or been let go.

    Args:
        distance: squared Mahalanobis distance of the innovation.
        p: parameter vector.
    """
    return p[_AT] > 0.0 and p[LOCKED] == 0.0 and distance > p[_ONSET] * p[_ONSET]


@in_place
def widen(covariance, p):
    """Add what a push that has just set in may be, in place.

    Args:
        covariance: P (n, n).
        p: parameter vector.
    """
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
