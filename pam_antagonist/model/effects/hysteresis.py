r"""Hysteresis of the contraction force.

```math
F_i = F(l_i, P_i) + a_i z_i,\qquad
\dot z_i = \frac{1}{s}\left[\dot l_i - \tfrac12\left(|\dot l_i|\, z_i + \dot l_i\, |z_i|\right)\right].
```

$z_i$ stays within ±1. It goes to +1 while the muscle gets longer, which then pulls harder by $a_i$. It goes to −1 while
the muscle gets shorter. The loop in force is $2 a_i$ wide. The speed does not matter, since only $dz/dl$ enters. For
$a_i > 0$ a cycle takes the work $\oint F\,dl > 0$.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import (
    Effect,
    EffectParameter,
    Form,
    Loop,
    SealedJoint,
    inlined,
    per_muscle,
    state_per_muscle,
)


@inlined
def loop_force(amplitude, hysteresis):
    """Force [N] that the loop adds to the contraction force.

    `amplitude`: a [N], half the width of the loop. `hysteresis`: z [-], state of the loop.
    """
    return amplitude * hysteresis


@inlined
def loop_rate(width, length_rate, hysteresis):
    """dz/dt [1/s] by Bouc and Wen: z depends on the path of the length and not on its speed.

    `width`: s [m]. `length_rate`: dl/dt [m/s]. `hysteresis`: z [-].
    """
    return (length_rate - 0.5 * (abs(length_rate) * hysteresis + length_rate * abs(hysteresis))) / width


@inlined
def turned_round(length_rate):
    """Loop state z [-] of a muscle after a long rest, or after a long motion in one direction."""
    if length_rate == 0.0:
        return 0.0
    return 1.0 if length_rate > 0.0 else -1.0


EFFECT = Effect(
    name="hysteresis",
    meaning="The contraction force depends on the direction in which the length changes: braid and tube rub.",
    law="F_i gains a_i z_i, dz_i/dt = (dl_i/dt − (|dl_i/dt| z_i + dl_i/dt |z_i|)/2)/s",
    source="Bouc (1967), Wen (1976), with A = 1, β = γ = 1/2, n = 1; for muscles: Vo-Minh et al. (2011)",
    signature="Torque and rest angle differ between shortening and lengthening, at any speed.",
    parameters=(
        *per_muscle("amplitude", "N", -2000.0, 2000.0, 4.0, "half the width of the force loop", symbol="a"),
        EffectParameter("width", "m", 2e-3, 2e-4, 2e-2, 2e-3, "length over which the force reverses", "s"),
    ),
    states=state_per_muscle(
        "hysteresis", "-", "amplitude", 0.5, 1e-4, symbol="z", rate=loop_rate, steady_value=turned_round
    ),
    hooks={"contraction_force": loop_force},
    sentence="the force of the muscles depends on the direction in which their length changes (hysteresis)",
    experiment="turn the joint slowly to and fro at constant pressures and plot torque over angle",
    distinguished_by={
        "friction": "turn the joint by hand with both muscles vented: friction of the shaft stays, hysteresis of the "
        "muscles depends on the pressure",
        "creep": "turn the joint by the same way slowly and fast: hysteresis gives the same loop, creep does not",
    },
    # Both lengths change together, and so do both loops: the share of each muscle is not observable.
    form=Form(tied=True),
    sealed=SealedJoint(
        part="balance",
        forms=(Form(tied=True, shapes=tuple({"width": width} for width in (2e-4, 5e-4, 2e-3, 8e-3))),),
        instead="hysteresis that reverses within a step of the encoder explains the data as well as friction",
        experiment="drive the joint with half the torque, and again with another charge: friction of the drive keeps "
        "its torque, hysteresis makes a smaller loop and grows with the pressure; or uncouple the drive and turn by "
        "hand",
        # A loop by Bouc and Wen reverses to 95 % in four widths: one until z is 0, and three more from there.
        loop=Loop(
            sizes=("amplitude_1", "amplitude_2"),
            torque=0.1,
            width="width",
            widths_a_turn=4.0,
            widths=(2e-4,),
            about="A hysteresis loop as narrow as a step of the encoder ({step}) was tried as well.",
        ),
    ),
    needs_motion=True,
    needs_angle=True,
    tested_with=("valve", "regulator", "command"),
)
