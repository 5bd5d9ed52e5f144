r"""Friction beside that of equation (10).

```math
T_c = T_s + T_p + c + d\,e^{-|\dot\psi|/v}\ \ge 0
```

in the place of $T_s + T_p$ in (10). At rest the joint sticks within $\pm(T_s + T_p + c + d)$.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, EffectParameter, Form, Loop, SealedJoint, inlined
from pam_antagonist.model.numeric import exp

# A negative Coulomb torque would remove the sticking of the joint.
_LEAST = {"coulomb": 0.0, "stribeck": 0.0}


@inlined
def extra_coulomb(coulomb, stribeck, velocity, joint_velocity):
    """Torque [N m] added to T_s + T_p: a constant, and a part that fades with the velocity.

    `coulomb`: c [N m]. `stribeck`: d [N m]. `velocity`: v [rad/s]. `joint_velocity`: ψ̇ [rad/s].
    """
    if stribeck == 0.0:
        return coulomb
    return coulomb + stribeck * exp(-abs(joint_velocity) / velocity)


EFFECT = Effect(
    name="friction",
    meaning="Friction that (10) does not have: constant, or larger at rest than in motion.",
    law="T_s + T_p gains c + d exp(−|ψ̇|/v)",
    source="Coulomb and Stribeck; Tondu and Lopez (2000)",
    signature="The joint sticks longer or shorter than it should. Flow and the torque of a locked joint are right.",
    parameters=(
        EffectParameter("coulomb", "N m", 0.0, -0.5, 200.0, 0.02, "constant Coulomb torque", "c"),
        EffectParameter("stribeck", "N m", 0.0, -0.5, 200.0, 0.02, "further torque at rest", "d"),
        EffectParameter("velocity", "rad/s", 0.3, 0.01, 10.0, 0.3, "velocity over which the torque at rest fades", "v"),
    ),
    hooks={"coulomb_torque": extra_coulomb},
    sentence="the joint has friction that the model lacks (friction)",
    experiment="move the joint slowly and fast through the same angles at constant pressures",
    sealed=SealedJoint(
        part="balance",
        forms=(Form(without=("stribeck", "velocity"), low=_LEAST), Form(low=_LEAST)),
        sentence="something holds the joint back with the same torque at any speed ({coulomb} N m, Coulomb friction)",
        instead="Coulomb friction of drive or joint explains the data as well as hysteresis",
        experiment="drive the joint with half the torque, and again with another charge: friction of the drive keeps "
        "its torque, hysteresis makes a smaller loop and grows with the pressure; or uncouple the drive and turn by "
        "hand",
        loop=Loop(sizes=("coulomb",), torque=0.2),
    ),
    needs_motion=True,
    needs_angle=True,
    tested_with=("valve", "regulator", "command"),
)
