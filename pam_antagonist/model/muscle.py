r"""Geometry, volume and contraction force of a muscle: equations (2), (3), (6) and (7).

With the travel $s(\psi)$ of a muscle's end over r, equation (2) is $l_i = L_0 \mp r\,s(\psi)$, and the torque (9) is
$\tau = r\,s'(\psi)\,(F_1 - F_2)$:

```math
s(\psi) = s_0(\psi) + \tfrac12 c_1 \psi^2 + \tfrac13 c_2 \psi^3,\qquad
s_0 = \begin{cases}\sin\psi & \text{lever}\\ \psi & \text{pulley.}\end{cases}
```

$c_1$ (``geometry.cam_1``) and $c_2$ (``geometry.cam_2``) are 0 for a round pulley. A cam, a belt that leaves it,
or a muscle whose end does not lie on the circle has others. Both muscles have the same arm.

The forms of the force map that the paper compares with (6) are here too, and that of a braided muscle:

```math
F = \tfrac12\left(f + \sqrt{f^2 + w^2}\right),\qquad
f = a\,(1 - k\,\varepsilon)\,\frac{P - P_{out}}{100\,\mathrm{kPa}}
    - b\,\left(1 - e^{-s(\varepsilon - \varepsilon_0)}\right),\qquad \varepsilon = 1 - l/L_n .
```

The first part is the pressure's, on an area that falls with the contraction and is 0 at $1/k$. The second part is the
rubber's and the mesh's: it rises within a few per cent of contraction and then stays. Below $\varepsilon_0$ it goes on
along its tangent, so that a stretched muscle has no exponential force. With $a, k, b, s > 0$ the force rises with the
pressure and falls with the contraction, and the muscle never pushes.

On a measured map of a Festo DMSP-20 (Martens and Boblan 2017: 126 points, six lengths, 0 to 6 bar) five numbers have an
error of 0.3 % of the largest force (RMS), 1.2 % at most. The linear map of equations (6) and (7) has 2.3 % and 6.5 %.
"""

from __future__ import annotations

import math

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.model.lane_values import shared
from pam_antagonist.model.numeric import exp, sine_and_cosine
from pam_antagonist.model.parameters import (
    ATMOSPHERE,
    C1,
    CAM_1,
    CAM_2,
    D1,
    D2,
    D3,
    FORCE_FORM,
    FORCE_FORMS,
    LENGTH,
    MUSCLE,
    MUSCLE_SIZE,
    PULLEY,
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
_AREA, _CLOSING, _RUBBER, _STEEPNESS, _REST, _NOMINAL, _BEND = range(C1, C1 + 7)
"""Places of a, k, b, s, ε_0, L_n and w of a braided muscle among the numbers of a muscle."""


@inlined
def leverage(angle, p):
    """Travel of the muscles' ends over r, with its first derivative (the lever arm over r) and its second.

    Returns s, s', s''. Without a cam: sin ψ, cos ψ, −sin ψ for a lever; ψ, 1, 0 for a pulley.
    """
    if shared(p[PULLEY]) != 0.0:
        travel, arm, bend = angle, 1.0, 0.0
    else:
        sine, cosine = sine_and_cosine(angle)
        travel, arm, bend = sine, cosine, -sine
    first, second = p[CAM_1], p[CAM_2]
    if first != 0.0 or second != 0.0:
        travel += angle * angle * (0.5 * first + angle * second * (1.0 / 3.0))
        arm += angle * (first + angle * second)
        bend += first + 2.0 * angle * second
    return travel, arm, bend


@inlined
def length(muscle, sine, p):
    """Muscle length, equation (2).

    Returns l_i [m]: L_0 − r sin ψ for the first muscle, L_0 + r sin ψ for the second.
    """
    shift = p[RADIUS] * sine
    return p[LENGTH] - shift if muscle == 0 else p[LENGTH] + shift


@inlined
def length_rate(muscle, cosine, velocity, p):
    """Time derivative of equation (2) [m/s]."""
    rate = p[RADIUS] * cosine * velocity
    return -rate if muscle == 0 else rate


@inlined
def volume(muscle, muscle_length, p):
    """Muscle volume and its derivative with respect to length, equation (3).

    Returns V_i [m³] and dV_i/dl_i [m²].
    """
    base = MUSCLE + muscle * MUSCLE_SIZE
    d1 = p[base + D1]
    d2 = p[base + D2]
    value = (d1 * muscle_length + d2) * muscle_length + p[base + D3]
    return max(value, _LEAST_VOLUME), 2.0 * d1 * muscle_length + d2


@inlined
def linear_force(muscle, muscle_length, pressure, p):
    """Contraction force [N], equations (6) and (7): F = v(l) P + w(l)."""
    base = MUSCLE + muscle * MUSCLE_SIZE
    slope = p[base + V1] * muscle_length + p[base + V2]
    intercept = p[base + W1] * muscle_length + p[base + W2]
    return slope * pressure + intercept


@inlined
def force(muscle, muscle_length, pressure, p):
    """Contraction force [N] of a form of the static force map.

    ``linear`` is equations (6) and (7): F = v(l) P + w(l). It is not cut off at zero: inside the joint's range and
    above 200 kPa it stays positive within a newton, and a cut would hide a wrong calibration. ``braided`` is the form
    for muscles of a data sheet. The other forms are those of the paper's
    comparison (Table IV), in the contraction k = 1 − l/L_0 and q = P/100 kPa:

    * ``hildebrandt`` (Hildebrandt et al. 2005): area and elastic force as polynomials,
      (c1 + c2 k + c3 k²) q + c4 + c5 k + c6 k² + c7 k³;
    * ``sarosi`` (Sárosi et al. 2010): (c1 q + c2) exp(c3 k) + c4 k q + c5 q + c6;
    * ``polynomial`` (of second degree in both): c1 + c2 k + c3 q + c4 k² + c5 k q + c6 q².
    """
    base = MUSCLE + muscle * MUSCLE_SIZE
    if shared(p[FORCE_FORM]) != 0.0:
        return _compared_force(base, muscle_length, pressure, p)
    return linear_force(muscle, muscle_length, pressure, p)


@inlined
def _braided_force(base, muscle_length, pressure, p):
    """Contraction force [N] of a braided muscle, and its derivative by the length [N/m]."""
    contraction = 1.0 - muscle_length / p[base + _NOMINAL]
    driving = p[base + _AREA] * ((pressure - p[ATMOSPHERE]) / _UNIT_PRESSURE)
    beyond, steepness, rubber = contraction - p[base + _REST], p[base + _STEEPNESS], p[base + _RUBBER]
    fading = exp(-steepness * max(beyond, 0.0))
    # The tangent of the exponential below its rest contraction.
    held = rubber * (1.0 - fading) + rubber * steepness * min(beyond, 0.0)
    pull = driving * (1.0 - p[base + _CLOSING] * contraction) - held
    slope = driving * p[base + _CLOSING] + rubber * steepness * fading
    root = math.sqrt(pull * pull + p[base + _BEND] * p[base + _BEND])
    return 0.5 * (pull + root), 0.5 * (1.0 + pull / root) * slope / p[base + _NOMINAL]


@in_place
def _compared_force(base, muscle_length, pressure, p):
    """The other forms. They are a separate function to keep the code of the linear form small and fast."""
    form = shared(p[FORCE_FORM])
    if form == _BRAIDED:
        braided, _ = _braided_force(base, muscle_length, pressure, p)
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
    """∂F/∂l [N/m] of :func:`force`."""
    base = MUSCLE + muscle * MUSCLE_SIZE
    form = shared(p[FORCE_FORM])
    if form == 0.0:
        return p[base + V1] * pressure + p[base + W1]
    if form == _BRAIDED:
        _, steepness = _braided_force(base, muscle_length, pressure, p)
        return steepness
    k, q, c = 1.0 - muscle_length / p[LENGTH], pressure / _UNIT_PRESSURE, base + C1
    if form == _HILDEBRANDT:
        slope = (2.0 * p[c + 2] * k + p[c + 1]) * q + (3.0 * p[c + 6] * k + 2.0 * p[c + 5]) * k + p[c + 4]
    elif form == _SAROSI:
        slope = p[c + 2] * (p[c] * q + p[c + 1]) * exp(p[c + 2] * k) + p[c + 3] * q
    else:
        slope = 2.0 * p[c + 3] * k + p[c + 1] + p[c + 4] * q
    return -slope / p[LENGTH]
