r"""A load torque that goes with a signal from outside of the joint, such as another joint's angle.

```math
\tau_l = \sum_k c_k (s_k - \bar s_k)
```

is added to the torque on the joint. $s_k$ and $\bar s_k$ are those of `friction_by_signal`. An arm whose next joint
bends has its weight elsewhere; a tendon that runs through this joint pulls on it.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, SealedJoint, along_signals, per_signal

EFFECT = Effect(
    name="load_by_signal",
    meaning="A torque on the joint depends on something that was measured outside of it.",
    law="the torque on the joint gains the sum of c_k (s_k − s̄_k) over the further signals s_k",
    source="statics: the moment of a weight, or of a tendon, that something else moves",
    signature="The joint rests elsewhere when a signal of another joint is higher or lower.",
    parameters=per_signal("slope", "N m/SI", -10.0, 10.0, 1e-7, "torque for each unit of the signal", "c"),
    hooks={"joint_torque": along_signals},
    sentence="a torque on the joint depends on a signal from outside of the joint (load_by_signal)",
    experiment="hold the joint's own pressures, and move the other joint slowly",
    distinguished_by={
        "friction_by_signal": "approach the same angle from both sides: friction holds on either side, a load pulls to "
        "one",
    },
    sealed=SealedJoint(part=None, reason="further signals are not offered to sealed joints"),
    needs_angle=True,
    tested_with=("regulator",),
)
