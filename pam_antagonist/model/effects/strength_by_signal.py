r"""Muscles whose strength goes with a signal, such as a temperature.

```math
F_i \to F_i \left(1 + \sum_k g_k (s_k - \bar s_k)\right)
```

for both muscles. $s_k$ and $\bar s_k$ are those of `friction_by_signal`. A warm rubber tube is softer.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, SealedJoint, along_signals, inlined, per_signal


@inlined
def stronger(muscle_force, slope1, slope2, slope3, slope4, signal1, signal2, signal3, signal4):
    """Contraction force of a muscle [N].

    `muscle_force`: F [N]. `slope1`: g_1 [1 by the unit of the signal]. `slope2`: g_2, likewise. `slope3`: g_3,
    likewise. `slope4`: g_4, likewise. `signal1`: s_1 − s̄_1 [SI]. `signal2`: s_2 − s̄_2 [SI]. `signal3`: s_3 − s̄_3
    [SI]. `signal4`: s_4 − s̄_4 [SI].
    """
    return muscle_force * (1.0 + along_signals(slope1, slope2, slope3, slope4, signal1, signal2, signal3, signal4))


EFFECT = Effect(
    name="strength_by_signal",
    meaning="The muscles' strength depends on something that was measured beside the joint, such as a temperature.",
    law="F_i becomes F_i (1 + the sum of g_k (s_k − s̄_k)) over the further signals s_k",
    source="first order of any dependence of the contraction force on a temperature or a supply pressure",
    signature="Forces are wrong by a share, and the share depends on a signal.",
    parameters=per_signal("slope", "1/SI", -1.0, 1.0, 1e-6, "growth of the muscles' strength with the signal", "g"),
    hooks={"muscle_force": stronger},
    sentence="the muscles' strength depends on a signal (strength_by_signal)",
    experiment="repeat the same motion while the signal has another value",
    distinguished_by={
        "load_by_signal": "raise both pressures: a load turns the joint less, a strength that changes turns it as "
        "before",
    },
    sealed=SealedJoint(part=None, reason="further signals are not offered to sealed joints"),
    needs_angle=True,
    tested_with=("regulator",),
)
