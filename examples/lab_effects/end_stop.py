r"""Rubber that takes the joint up.

```math
J\ddot\psi = \dots - k\,\max(|\psi| - \gamma, 0)\,\mathrm{sgn}\,\psi .
```

The rubber is on both sides alike, and it does not rub.
"""

from pam_antagonist.model.effects.base import Effect, EffectParameter, SealedJoint, inlined


@inlined
def push(stiffness, gap, joint_angle):
    """Torque of the rubber on the joint [N m]."""
    pressed = max(abs(joint_angle) - gap, 0.0)
    return -stiffness * (pressed if joint_angle > 0.0 else -pressed)


EFFECT = Effect(
    name="end_stop",
    meaning="Rubber on either side takes the joint up before the mechanical stop does.",
    law="τ loses k max(|ψ| − γ, 0) sgn ψ on the joint's side",
    source="linear spring behind a gap",
    signature="Joint motion off beyond an angle on either side; torque of a locked joint as it should be.",
    parameters=(
        EffectParameter("stiffness", "N m/rad", 0.0, 0.0, 500.0, 5.0, "stiffness of the rubber", "k"),
        EffectParameter("gap", "rad", 0.1, 0.01, 1.5, 0.1, "angle at which the joint meets it", r"\gamma"),
    ),
    hooks={"joint_torque": push},
    sentence="rubber with {stiffness} N m/rad takes the joint up (end_stop)",
    experiment="turn the joint slowly from stop to stop with both muscles vented",
    distinguished_by={"load_torque": "turn the joint by small angles: a load is there, the rubber is not"},
    sealed=SealedJoint(part=None, reason="a spring looks like another force map"),
    needs_motion=True,
    needs_angle=True,
)
