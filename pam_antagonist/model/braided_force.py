r"""The force of a braided muscle in few numbers that are physical by their signs.

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

from pam_antagonist._jit import inlined
from pam_antagonist.model.numeric import exp
from pam_antagonist.model.parameters import ATMOSPHERE, C1

AREA, CLOSING, RUBBER, STEEPNESS, REST, NOMINAL, BEND = range(C1, C1 + 7)
"""Places of a, k, b, s, ε_0, L_n and w among the numbers of a muscle."""
_UNIT_PRESSURE = 1e5
"""[Pa] Unit of the pressure, so that a is a force."""


@inlined
def braided_force(base, muscle_length, pressure, p):
    """Contraction force [N], and its derivative by the length [N/m]. `muscle_length`: l_i [m]. `pressure`: P_i [Pa]."""
    contraction = 1.0 - muscle_length / p[base + NOMINAL]
    driving = p[base + AREA] * ((pressure - p[ATMOSPHERE]) / _UNIT_PRESSURE)
    beyond, steepness, rubber = contraction - p[base + REST], p[base + STEEPNESS], p[base + RUBBER]
    fading = exp(-steepness * max(beyond, 0.0))
    # The tangent of the exponential below its rest contraction.
    held = rubber * (1.0 - fading) + rubber * steepness * min(beyond, 0.0)
    pull = driving * (1.0 - p[base + CLOSING] * contraction) - held
    slope = driving * p[base + CLOSING] + rubber * steepness * fading
    root = math.sqrt(pull * pull + p[base + BEND] * p[base + BEND])
    return 0.5 * (pull + root), 0.5 * (1.0 + pull / root) * slope / p[base + NOMINAL]
