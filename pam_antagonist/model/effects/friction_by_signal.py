r"""Friction that grows with a signal from outside of the joint, such as the pressures of another joint's muscles.

```math
T_c = T_s + T_p + \sum_k b_k (s_k - \bar s_k)\ \ge 0
```

in the place of $T_s + T_p$ in (10). $s_k$ are the further signals that the rig file names (`signals`), in SI units, and
$\bar s_k$ their values there. Where a signal is not measured, that value is taken. Tendons of a neighbouring joint that
run through this one press on its guides when that joint's muscles pull.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, SealedJoint, inlined, per_signal


@inlined
def extra_coulomb(slope1, slope2, slope3, slope4, signal1, signal2, signal3, signal4):
    """What is added to T_s + T_p [N m].

    Args:
        slope1: b_1 [N m by the unit of the signal].
        slope2: b_2, likewise.
        slope3: b_3, likewise.
        slope4: b_4, likewise.
        signal1: s_1 − s̄_1 [SI].
        signal2: s_2 − s̄_2 [SI].
        signal3: s_3 − s̄_3 [SI].
        signal4: s_4 − s̄_4 [SI].
    """
    return slope1 * signal1 + slope2 * signal2 + slope3 * signal3 + slope4 * signal4


EFFECT = Effect(
    name="friction_by_signal",
    meaning="Friction grows with something outside of the joint that was measured: another joint's pressures.",
    law="T_s + T_p gains the sum of b_k (s_k − s̄_k) over the further signals s_k",
    source="Coulomb: friction is proportional to the force that presses the surfaces together",
    signature="The joint sticks longer at some times, and those go with a signal of another joint.",
    parameters=per_signal("slope", "N m/SI", -10.0, 10.0, 1e-7, "growth of the Coulomb torque with the signal", "b"),
    hooks={"coulomb_torque": extra_coulomb},
    sentence="the joint's friction grows with a signal from outside of it (friction_by_signal)",
    experiment="hold the other joint at a low and at a high pressure, and repeat the same motion",
    sealed=SealedJoint(part=None, reason="further signals are not offered to sealed joints"),
    needs_motion=True,
    needs_angle=True,
    tested_with=("regulator",),
)
