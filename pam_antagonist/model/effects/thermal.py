r"""Warmth of the gas.

```math
\dot P_i = \dot P_i^{(4)} - q_i/T,\qquad \dot q_i = \chi_i\,\dot P_i^{(4)} - q_i/T .
```

$q_i$ is the part of the pressure that is due to the gas being warmer than its surroundings. The pressure of a closed
muscle ends lower by $q_i$. At rest $q_i = 0$, and nothing is changed.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import (
    Effect,
    EffectParameter,
    Form,
    SealedJoint,
    inlined,
    per_muscle,
    state_per_muscle,
)


@inlined
def cooling(time, warmth):
    """Rate [Pa/s] by which cooling reduces dP/dt.

    `time`: T [s]. `warmth`: q [Pa], the part of the pressure that is due to the gas being warmer than its surroundings.
    """
    return warmth / time


@inlined
def warmth_rate(share, time, warmth, polytropic_rate):
    """dq/dt [Pa/s].

    `share`: χ [-]. `time`: T [s]. `warmth`: q [Pa]. `polytropic_rate`: dP/dt of equation (4) [Pa/s].
    """
    return share * polytropic_rate - cooling(time, warmth)


EFFECT = Effect(
    name="thermal",
    meaning="Compression warms the gas. It cools with time, and its pressure falls.",
    law="dP_i/dt loses q_i/T, dq_i/dt = χ_i dP_i/dt|(4) − q_i/T",
    source="first-order heat exchange with the wall about the polytropic law (4)",
    signature="For seconds after each filling or emptying, the pressure goes back by a part of its change.",
    parameters=(
        *per_muscle("share", "-", -0.5, 0.9, 0.05, "thermal share of a change of pressure", symbol=r"\chi"),
        EffectParameter("time", "s", 1.0, 0.05, 30.0, 1.0, "time constant of the heat exchange", "T"),
    ),
    states=state_per_muscle("warmth", "Pa", "share", 500.0, 20.0, symbol="q", rate=warmth_rate),
    hooks={"cooling": cooling},
    sentence="the gas warms and cools (thermal)",
    experiment="lock the joint, step the pressure and hold for 30 s",
    sealed=SealedJoint(
        part="air",
        forms=(Form(tied=True), Form()),
        instead="gas that still cools from being charged explains the data as well as a leak",
        experiment="leave the joint closed for ten minutes and record again: what is due to charging has died out "
        "then, a leak goes on",
        loss="fading",
        loss_about="Gas that cools after the charging, or tubes that stretch, lose pressure at a rate that dies out.",
    ),
)
