r"""A pressure regulator that leaves out small reversals of its command.

```math
P_i^* \in \left[u_i - \tfrac12 b_i,\; u_i + \tfrac12 b_i\right],\qquad
\dot P_i^* = \frac{1}{T}\left(\min\big(\max(P_i^*,\, u_i - \tfrac12 b_i),\, u_i + \tfrac12 b_i\big) - P_i^*\right).
```

$P_i^*$ is the pressure that the regulator goes by. It stays while the command $u_i$ turns round by less than the
threshold $b_i$. Beyond that it follows the command at a distance of $b_i/2$. $T$ is the shortest lag that a step of the
integration can follow, so the speed does not matter. After a long rest $P_i^* = u_i$. Data sheets call the threshold
hysteresis, or, of a digital input, sensitivity.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, SealedJoint, inlined, per_muscle, played, state_per_muscle


@inlined
def held(regulator_goal):
    """Pressure [Pa] that the regulator follows: the state itself."""
    return regulator_goal


@inlined
def following(threshold, regulator_goal, asked_pressure, quickest_lag):
    """Rate [Pa/s] of the pressure P*, which the command moves at either end of the threshold.

    `threshold`: b [Pa]. `regulator_goal`: P* [Pa]. `asked_pressure`: u [Pa]. `quickest_lag`: shortest time constant
    that a step of the integration follows [s].
    """
    return played(threshold, regulator_goal, asked_pressure, quickest_lag)


@inlined
def in_the_middle(asked_pressure):
    """P* [Pa] after a long time with a constant command."""
    return asked_pressure


EFFECT = Effect(
    name="regulator_threshold",
    meaning="A pressure regulator leaves out reversals of its command that are smaller than a threshold.",
    law="the regulator goes by P_i*, which is held within u_i ± b_i/2 and stays otherwise",
    source="play operator: Krasnosel'skii and Pokrovskii (1989); hysteresis and sensitivity in data sheets of "
    "regulators",
    signature="The measured pressure stays where it is after the command has turned round, and follows at a distance "
    "from then on.",
    parameters=per_muscle(
        "threshold", "Pa", 0.0, 1e5, 2e3, "reversal of the command that the regulator leaves out", symbol="b"
    ),
    states=state_per_muscle(
        "regulator_goal", "Pa", "threshold", 500.0, 10.0, symbol="P_#^*", rate=following, steady_value=in_the_middle
    ),
    hooks={"asked_pressure": held},
    sentence="the regulator of {muscle} leaves out small reversals of its command (regulator_threshold)",
    experiment="raise one commanded pressure in steps of 0.01 bar, hold each for 1 s, and lower it again by the same "
    "steps",
    tested_with=("command",),
    sealed=SealedJoint(part=None, reason="no regulator works"),
)
