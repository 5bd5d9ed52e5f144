"""Geometry, volume and contraction force of a muscle: equations (2), (3), (6) and (7)."""

from __future__ import annotations

from pam_antagonist._jit import inlined
from pam_antagonist.model.parameters import (
    D1,
    D2,
    D3,
    LENGTH,
    MUSCLE,
    MUSCLE_SIZE,
    RADIUS,
    V1,
    V2,
    W1,
    W2,
)

_LEAST_VOLUME = 1e-8
"""[m³] Bound for lengths far outside the joint's range, where the parabola (3) falls through zero."""


@inlined
def length(muscle, sine, p):
    """Muscle length, equation (2).

    Args:
        muscle: 0 or 1.
        sine: sin ψ of the joint angle.
        p: parameter vector.

    Returns:
        l_i [m]: L_0 − r sin ψ for the first muscle, L_0 + r sin ψ for the second.
    """
    shift = p[RADIUS] * sine
    return p[LENGTH] - shift if muscle == 0 else p[LENGTH] + shift


@inlined
def length_rate(muscle, cosine, velocity, p):
    """Time derivative of equation (2) [m/s], from cos ψ and ψ̇ [rad/s]."""
    rate = p[RADIUS] * cosine * velocity
    return -rate if muscle == 0 else rate


@inlined
def volume(muscle, muscle_length, p):
    """Muscle volume and its derivative with respect to length, equation (3).

    Returns:
        V_i [m³] and dV_i/dl_i [m²].
    """
    base = MUSCLE + muscle * MUSCLE_SIZE
    d1 = p[base + D1]
    d2 = p[base + D2]
    value = (d1 * muscle_length + d2) * muscle_length + p[base + D3]
    return max(value, _LEAST_VOLUME), 2.0 * d1 * muscle_length + d2


@inlined
def force(muscle, muscle_length, pressure, p):
    """Contraction force [N], equations (6) and (7): F = v(l) P + w(l).

    The map is the paper's straight line. It is not cut off at zero: inside the joint's range and above
    200 kPa it stays positive within a newton, and a cut would hide a wrong calibration.
    """
    base = MUSCLE + muscle * MUSCLE_SIZE
    slope = p[base + V1] * muscle_length + p[base + V2]
    intercept = p[base + W1] * muscle_length + p[base + W2]
    return slope * pressure + intercept


@inlined
def force_length_slope(muscle, pressure, p):
    """∂F/∂l [N/m] of equations (6) and (7)."""
    base = MUSCLE + muscle * MUSCLE_SIZE
    return p[base + V1] * pressure + p[base + W1]
