r"""The lever arm of the muscles, and how it changes with the angle.

With the travel $s(\psi)$ of a muscle's end over $r$, equation (2) is $l_i = L_0 \mp r\,s(\psi)$, and the torque (9) is
$\tau = r\,s'(\psi)\,(F_1 - F_2)$:

```math
s(\psi) = s_0(\psi) + \tfrac12 c_1 \psi^2 + \tfrac13 c_2 \psi^3,\qquad
s_0 = \begin{cases}\sin\psi & \text{lever}\\ \psi & \text{pulley.}\end{cases}
```

$c_1$ (``geometry.cam_1``) and $c_2$ (``geometry.cam_2``) are 0 for a round pulley. A cam, a belt that leaves it,
or a muscle whose end does not lie on the circle has others. Both muscles have the same arm.
"""

from __future__ import annotations

from pam_antagonist._jit import inlined
from pam_antagonist.model.numeric import sine_and_cosine
from pam_antagonist.model.parameters import CAM_1, CAM_2, PULLEY


@inlined
def leverage(angle, p):
    """Travel of the muscles' ends over r, with its first derivative (the lever arm over r) and its second.

    `angle`: ψ [rad]. Returns s, s', s''. Without a cam: sin ψ, cos ψ, −sin ψ for a lever; ψ, 1, 0 for a pulley.
    """
    if p[PULLEY] != 0.0:
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
