r"""Torque and friction that go a little with everything: many weak laws at once.

```math
\tau \mathrel{+}= a\,\bigl(c_1 + c_2 s + c_3 s^2 + c_4 s^3 - (c_5 + c_6 s + c_7 s^2 + c_8 |\dot\psi|)\,\dot\psi\bigr),
```

```math
T_c \mathrel{+}= a\,\bigl(c_9 + c_{10} s + c_{11} s^2 + (c_{12} + c_{13} s)\,e^{-|\dot\psi|/v}
  + (c_{14} + c_{15} s)\,|\dot\psi|/v\bigr)\ \ge 0
```

with $s = \psi/\psi_0$, within ± 2.4. The coefficients $c_k$ are sums of what was measured: pressures, further signals,
their products, and what of them fades within fractions of a second. A rig file has the numbers of these sums
(`weak_laws`). They are learned from many episodes, all at once, each with a prior: no single one is certain, but all
together are.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, EffectParameter, SealedJoint, inlined
from pam_antagonist.model.numeric import exp

FARTHEST = 2.4
"""Largest |s|: beyond the angles that were seen, nothing grows."""


@inlined
def _torque(
    amount, angle, joint_angle, joint_velocity, coefficient1, coefficient2, coefficient3, coefficient4, coefficient5,
    coefficient6, coefficient7, coefficient8,
):  # fmt: skip
    """Further torque on the joint [N m]."""
    s = min(max(joint_angle / angle, -FARTHEST), FARTHEST)
    bend = coefficient1 + s * (coefficient2 + s * (coefficient3 + s * coefficient4))
    drag = coefficient5 + s * (coefficient6 + s * coefficient7) + coefficient8 * abs(joint_velocity)
    return amount * (bend - drag * joint_velocity)


@inlined
def _friction(
    amount, angle, velocity, joint_angle, joint_velocity, coefficient9, coefficient10, coefficient11, coefficient12,
    coefficient13, coefficient14, coefficient15,
):  # fmt: skip
    """Further Coulomb torque [N m]."""
    s, speed = min(max(joint_angle / angle, -FARTHEST), FARTHEST), abs(joint_velocity) / velocity
    level = coefficient9 + s * (coefficient10 + s * coefficient11)
    slow, quick = coefficient12 + s * coefficient13, coefficient14 + s * coefficient15
    return amount * (level + slow * exp(-speed) + quick * speed)


EFFECT = Effect(
    name="weak_laws",
    meaning="Torque and friction of the joint go a little with all that was measured.",
    law="torque and Coulomb torque gain sums of angle and velocity whose coefficients go with pressures and signals",
    source="first orders of any smooth dependence",
    signature="What is left of the angle goes a little with much, and with nothing alone.",
    parameters=(
        EffectParameter("amount", "-", 0.0, 0.0, 1.0, 0.5, "share of the laws that acts", "a", fixed=True),
        EffectParameter("angle", "rad", 0.5, 1e-3, 10.0, 0.5, "unit of the angle", "\\psi_0", fixed=True),
        EffectParameter("velocity", "rad/s", 0.5, 1e-3, 100.0, 0.5, "unit of the velocity", "v", fixed=True),
    ),
    hooks={"joint_torque": _torque, "coulomb_torque": _friction},
    sentence="torque and friction of the joint go a little with all that was measured (weak_laws)",
    experiment="record more episodes, of other motions",
    sealed=SealedJoint(part=None, reason="they are learned from many episodes"),
    needs_angle=True,
    tested_with=(),
)
