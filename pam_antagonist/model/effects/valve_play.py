r"""Play between a valve's command and its spool.

```math
v_i \in \left[u_i - \tfrac12 b_i,\; u_i + \tfrac12 b_i\right],\qquad
\dot v_i = \frac{1}{T}\left(\min\big(\max(v_i,\, u_i - \tfrac12 b_i),\, u_i + \tfrac12 b_i\big) - v_i\right),\qquad
\alpha_i = \kappa(v_i).
```

$v_i$ is the voltage that the position of the spool stands for. It stays while the command $u_i$ moves within the play.
Beyond the play it follows the command at a distance of $b_i/2$. $T$ is the shortest lag that a step of the integration
can follow, so the speed does not matter. After a long rest the spool is in the middle of its play, $v_i = u_i$. Shift
and lag of the valve (`valve_offset`, `valve_lag`) come after the play.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, SealedJoint, inlined, per_muscle, played, state_per_muscle


@inlined
def position(spool_voltage):
    """Voltage for which the spool stands [V]: the state itself."""
    return spool_voltage


@inlined
def following(play, spool_voltage, valve_voltage, quickest_lag):
    """dv/dt [V/s] of a spool, which the command moves at either end of the play.

    `play`: b [V]. `spool_voltage`: v [V]. `valve_voltage`: u [V]. `quickest_lag`: shortest time constant that a step of
    the integration follows [s].
    """
    return played(play, spool_voltage, valve_voltage, quickest_lag)


@inlined
def in_the_middle(valve_voltage):
    """Voltage v [V] after a long time with a constant command: the middle of the play."""
    return valve_voltage


EFFECT = Effect(
    name="valve_play",
    meaning="There is play between a valve's command and its spool: the spool stays while the command reverses.",
    law="α_i = κ(v_i), where v_i is held within u_i ± b_i/2 and stays otherwise",
    source="play operator: Krasnosel'skii and Pokrovskii (1989); backlash and hysteresis of valves: Tao and Kokotović "
    "(1996), the hysteresis of data sheets of proportional valves",
    signature="The mass flow of one muscle is wrong after its voltage has reversed, and right while the "
    "voltage goes on in one direction. Steady pressures depend on the direction from which the "
    "voltage came.",
    parameters=per_muscle("play", "V", 0.0, 1.0, 0.05, "play of the valve", symbol="b"),
    states=state_per_muscle(
        "spool_voltage", "V", "play", 0.02, 1e-4, symbol="v", rate=following, steady_value=in_the_middle
    ),
    hooks={"spool_voltage": position},
    sentence="the spool of {valve} has play (valve_play)",
    experiment="raise one voltage in steps of 0.2 V, hold each for 10 s, and lower it again by the same steps",
    distinguished_by={
        "valve_offset": "approach the same voltage from below and from above: a shifted curve gives one pressure, play "
        "two",
        "valve_lag": "hold the voltage after a step: a lag dies out, play stays",
    },
    sealed=SealedJoint(part=None, reason="no valve moves"),
)
