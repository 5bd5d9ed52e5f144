"""Geometry, volume and contraction force of a muscle: equations (2), (3), (6) and (7).

The forms of the force map that the paper compares with (6) are here too.
"""

from __future__ import annotations

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.model.braided_force import braided_force
from pam_antagonist.model.numeric import exp
from pam_antagonist.model.parameters import (
    C1,
    D1,
    D2,
    D3,
    FORCE_FORM,
    FORCE_FORMS,
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
_HILDEBRANDT, _SAROSI, _BRAIDED = (float(FORCE_FORMS.index(name)) for name in ("hildebrandt", "sarosi", "braided"))
_UNIT_PRESSURE = 1e5
"""[Pa] Unit of the pressure in the compared force maps, so that their coefficients are forces."""


@inlined
def length(muscle, sine, p):
    """Muscle length, equation (2).

    `sine`: travel over r, sin ψ for a lever (:func:`~pam_antagonist.model.lever_arm.leverage`). Returns l_i [m]: L_0 −
    r sin ψ for the first muscle, L_0 + r sin ψ for the second.
    """
    shift = p[RADIUS] * sine
    return p[LENGTH] - shift if muscle == 0 else p[LENGTH] + shift


@inlined
def length_rate(muscle, cosine, velocity, p):
    """Time derivative of equation (2) [m/s].

    `cosine`: lever arm over r, cos ψ for a lever [-]. `velocity`: ψ̇ [rad/s].
    """
    rate = p[RADIUS] * cosine * velocity
    return -rate if muscle == 0 else rate


@inlined
def volume(muscle, muscle_length, p):
    """Muscle volume and its derivative with respect to length, equation (3).

    `muscle_length`: l_i [m]. Returns V_i [m³] and dV_i/dl_i [m²].
    """
    base = MUSCLE + muscle * MUSCLE_SIZE
    d1 = p[base + D1]
    d2 = p[base + D2]
    value = (d1 * muscle_length + d2) * muscle_length + p[base + D3]
    return max(value, _LEAST_VOLUME), 2.0 * d1 * muscle_length + d2


@inlined
def linear_force(muscle, muscle_length, pressure, p):
    """Contraction force [N], equations (6) and (7): F = v(l) P + w(l).

    `muscle_length`: l_i [m]. `pressure`: P_i [Pa].
    """
    base = MUSCLE + muscle * MUSCLE_SIZE
    slope = p[base + V1] * muscle_length + p[base + V2]
    intercept = p[base + W1] * muscle_length + p[base + W2]
    return slope * pressure + intercept


@inlined
def force(muscle, muscle_length, pressure, p):
    """Contraction force [N] of a form of the static force map.

    ``linear`` is equations (6) and (7): F = v(l) P + w(l). It is not cut off at zero: inside the joint's range and
    above 200 kPa it stays positive within a newton, and a cut would hide a wrong calibration. ``braided`` is the form
    for muscles of a data sheet (:mod:`~pam_antagonist.model.braided_force`). The other forms are those of the paper's
    comparison (Table IV), in the contraction k = 1 − l/L_0 and q = P/100 kPa:

    * ``hildebrandt`` (Hildebrandt et al. 2005): area and elastic force as polynomials,
      (c1 + c2 k + c3 k²) q + c4 + c5 k + c6 k² + c7 k³;
    * ``sarosi`` (Sárosi et al. 2010): (c1 q + c2) exp(c3 k) + c4 k q + c5 q + c6;
    * ``polynomial`` (of second degree in both): c1 + c2 k + c3 q + c4 k² + c5 k q + c6 q².

    `muscle_length`: l_i [m]. `pressure`: P_i [Pa].
    """
    base = MUSCLE + muscle * MUSCLE_SIZE
    if p[FORCE_FORM] != 0.0:
        return _compared_force(base, muscle_length, pressure, p)
    return linear_force(muscle, muscle_length, pressure, p)


@in_place
def _compared_force(base, muscle_length, pressure, p):
    """The other forms. They are a separate function to keep the code of the linear form small and fast."""
    form = p[FORCE_FORM]
    if form == _BRAIDED:
        braided, _ = braided_force(base, muscle_length, pressure, p)
        return braided
    k, q, c = 1.0 - muscle_length / p[LENGTH], pressure / _UNIT_PRESSURE, base + C1
    if form == _HILDEBRANDT:
        area = (p[c + 2] * k + p[c + 1]) * k + p[c]
        return area * q + ((p[c + 6] * k + p[c + 5]) * k + p[c + 4]) * k + p[c + 3]
    if form == _SAROSI:
        return (p[c] * q + p[c + 1]) * exp(p[c + 2] * k) + (p[c + 3] * k + p[c + 4]) * q + p[c + 5]
    return p[c] + (p[c + 3] * k + p[c + 1]) * k + (p[c + 2] + p[c + 4] * k + p[c + 5] * q) * q


@inlined
def force_length_slope(muscle, muscle_length, pressure, p):
    """∂F/∂l [N/m] of :func:`force`.

    `muscle_length`: l_i [m]. `pressure`: P_i [Pa].
    """
    base = MUSCLE + muscle * MUSCLE_SIZE
    form = p[FORCE_FORM]
    if form == 0.0:
        return p[base + V1] * pressure + p[base + W1]
    if form == _BRAIDED:
        _, steepness = braided_force(base, muscle_length, pressure, p)
        return steepness
    k, q, c = 1.0 - muscle_length / p[LENGTH], pressure / _UNIT_PRESSURE, base + C1
    if form == _HILDEBRANDT:
        slope = (2.0 * p[c + 2] * k + p[c + 1]) * q + (3.0 * p[c + 6] * k + 2.0 * p[c + 5]) * k + p[c + 4]
    elif form == _SAROSI:
        slope = p[c + 2] * (p[c] * q + p[c + 1]) * exp(p[c + 2] * k) + p[c + 3] * q
    else:
        slope = 2.0 * p[c + 3] * k + p[c + 1] + p[c + 4] * q
    return -slope / p[LENGTH]
