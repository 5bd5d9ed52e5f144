r"""A torque on the joint beside the muscles'.

```math
J\ddot\psi = \tau + b + a\,\sin\psi - T_f - k_s\psi .
```

For a pulley $\psi$ takes the place of $\sin\psi$, as in (2). A spring about the joint has $a < 0$, as has a limb that
hangs down. A limb that stands up has $a > 0$. $\tau$, which is measured and estimated, is still the torque (9) of the
muscles.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, EffectParameter, SealedJoint, inlined


@inlined
def load(constant, sine, travel):
    """Torque [N m] of the load on the joint.

    `constant`: b [N m]. `sine`: a [N m]. `travel`: sin ψ of a lever, ψ of a pulley [-].
    """
    return constant + sine * travel


EFFECT = Effect(
    name="load_torque",
    meaning="A constant load beside the muscles acts on the joint: a limb's weight, a spring.",
    law="τ gains b + a sin ψ on the joint's side; a torque meter on the muscles does not see it",
    source="rigid body under gravity",
    signature="Motion and rest angle of the joint are wrong. Pressures and the torque of a locked joint are right.",
    parameters=(
        EffectParameter("constant", "N m", 0.0, -200.0, 200.0, 0.05, "torque at angle 0", "b"),
        EffectParameter("sine", "N m", 0.0, -200.0, 200.0, 0.1, "torque that grows with the sine of the angle", "a"),
    ),
    hooks={"joint_torque": load},
    sentence="something beside the muscles pulls at the joint (load_torque)",
    experiment="move the joint slowly through its range with the load taken off",
    distinguished_by={
        "friction": "approach the same pressures from both sides: a load shifts both rest angles the same way, "
        "friction moves them apart",
    },
    sealed=SealedJoint(
        part=None, reason="a constant torque or a spring looks like another force map or another stiffness"
    ),
    needs_motion=True,
    needs_angle=True,
    tested_with=("valve", "command"),
)
