r"""The weight of a limb that the joint carries in a vertical plane.

```math
J\ddot\psi = \tau - G\,\sin(\psi - \psi_h) - T_f - k_s\psi ,\qquad G = m\,g\,l .
```

$\psi_h$ is the angle at which the limb hangs straight down. $\tau$, which is measured and estimated, is still the
torque (9) of the muscles.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, EffectParameter, SealedJoint, inlined
from pam_antagonist.model.numeric import sine_and_cosine


@inlined
def weight(torque, hanging, joint_angle):
    """Torque [N m] of the limb's weight on the joint.

    `torque`: G = m g l [N m]. `hanging`: ψ_h [rad]. `joint_angle`: ψ [rad].
    """
    sine, _ = sine_and_cosine(joint_angle - hanging)
    return -torque * sine


EFFECT = Effect(
    name="limb_weight",
    meaning="The joint carries a limb in a vertical plane, and its weight pulls the limb down.",
    law="J d²ψ/dt² gains −G sin(ψ − ψ_h), G = m g l",
    source="rigid body under gravity",
    signature="The rest angle is wrong by an amount that depends on the angle, in a free joint only.",
    parameters=(
        EffectParameter("torque", "N m", 0.0, 0.0, 200.0, 0.1, "weight times distance of the limb's centre", "G"),
        EffectParameter("hanging", "rad", 0.5, -3.2, 3.2, 1.0, "angle at which the limb hangs down", r"\psi_h"),
    ),
    hooks={"joint_torque": weight},
    sentence="the weight of a limb pulls at the joint (limb_weight)",
    experiment="move the joint slowly through its range, once with the axis upright",
    needs_motion=True,
    needs_angle=True,
    # A search tries load_torque, which is the same to first order of the angle.
    tested_with=(),
    sealed=SealedJoint(part=None, reason="over a small range it looks like another force map or another stiffness"),
)
