r"""Friction that grows with the joint's own pressures.

```math
T_c = T_s + T_p + b_1 (P_1 - P_{out}) + b_2 (P_2 - P_{out})\ \ge 0
```

in the place of $T_s + T_p$ in (10). A muscle that pulls harder presses tendon and shaft harder into their guides. It is
a candidate on joints with pressure regulators only: the thresholds for joints with valves were set without this effect.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, SealedJoint, inlined, per_muscle


@inlined
def extra_coulomb(slope_1, slope_2, first_pressure, second_pressure, atmosphere):
    """Torque [N m] added to T_s + T_p.

    `slope_1`: b_1 [N m/Pa]. `slope_2`: b_2 [N m/Pa]. `first_pressure`: P_1 [Pa]. `second_pressure`: P_2 [Pa].
    `atmosphere`: P_out [Pa].
    """
    return slope_1 * (first_pressure - atmosphere) + slope_2 * (second_pressure - atmosphere)


EFFECT = Effect(
    name="friction_by_pressure",
    meaning="Friction grows with the pressure in the joint's own muscles, with a slope for each.",
    law="T_s + T_p gains b_1 (P_1 − P_out) + b_2 (P_2 − P_out)",
    source="Coulomb: friction is proportional to the force that presses the surfaces together",
    signature="The joint sticks longer the higher its pressures are. Flow and the torque of a locked joint are right.",
    parameters=per_muscle("slope", "N m/Pa", -1e-2, 1e-2, 1e-7, "growth of the Coulomb torque with the pressure", "b"),
    hooks={"coulomb_torque": extra_coulomb},
    sentence="the joint's friction grows with its own pressures (friction_by_pressure)",
    experiment="move the joint slowly to and fro at a low and at a high mean pressure",
    distinguished_by={"friction": "repeat the motion at another mean pressure: Coulomb friction stays"},
    sealed=SealedJoint(part=None, reason="its pressures move little, so that it looks like constant friction"),
    needs_motion=True,
    needs_angle=True,
    tested_with=("regulator", "command"),
)
