r"""Friction that grows with a signal from outside of the joint, such as the pressures of another joint's muscles.

```math
T_c = T_s + T_p + \sum_k b_k (s_k - \bar s_k)\ \ge 0
```

in the place of $T_s + T_p$ in (10). $s_k$ are the further signals that the rig file names (`signals`), in SI units, and
$\bar s_k$ their values there. Where a signal is not measured, that value is taken. Tendons of a neighbouring joint may
press on the guides of this one.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, SealedJoint, along_signals, per_signal

EFFECT = Effect(
    name="friction_by_signal",
    meaning="Friction grows with something outside of the joint that was measured: another joint's pressures.",
    law="T_s + T_p gains the sum of b_k (s_k − s̄_k) over the further signals s_k",
    source="Coulomb: friction is proportional to the force that presses the surfaces together",
    signature="The joint sticks longer when a signal of another joint is higher or lower.",
    parameters=per_signal("slope", "N m/SI", -10.0, 10.0, 1e-7, "growth of the Coulomb torque with the signal", "b"),
    hooks={"coulomb_torque": along_signals},
    sentence="the joint's friction depends on a signal from outside of the joint (friction_by_signal)",
    experiment="hold the other joint at a low and at a high pressure, and repeat the same motion",
    sealed=SealedJoint(part=None, reason="further signals are not offered to sealed joints"),
    needs_motion=True,
    needs_angle=True,
    tested_with=("regulator",),
)
