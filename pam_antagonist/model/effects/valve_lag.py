r"""A valve that follows its voltage late.

```math
\dot\alpha_i = \frac{\mathrm{sat}_w\big(\alpha_i^* - \alpha_i\big)}{w\,T_i},\qquad
\mathrm{sat}_w(e) = \min(\max(e, -w), w).
```

$\alpha_i^*$ is the open rate that the voltage asks for: $\kappa(u_i)$, or what `valve_offset` makes of it. With $w =
1$ the speed has no limit, and $T_i$ is the time constant. With $w < 1$ the full speed of the valve is $1/T_i$: a full
stroke takes $T_i$. The last part $w$ of a stroke is a lag with the time constant $w\,T_i$, or half a step of the
integration if that is longer.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import (
    Effect,
    EffectParameter,
    SealedJoint,
    inlined,
    per_muscle,
    state_per_muscle,
)


@inlined
def position(open_rate):
    """Open rate at which the valve stands [-]: the state itself."""
    return open_rate


@inlined
def position_rate(time, reach, open_rate, wanted_open_rate, quickest_lag):
    """dα/dt [1/s] of a valve that follows the wanted open rate, at its full speed at most.

    `time`: T [s]. `reach`: w [-]. `open_rate`: α [-]. `wanted_open_rate`: α* [-]. `quickest_lag`: shortest time
    constant that a step of the integration follows [s].
    """
    # A search may try times that are too short for the integration step; a rig file may not have them.
    stroke = max(time, quickest_lag)
    behind = wanted_open_rate - open_rate
    if reach >= 1.0:
        return behind / stroke
    followed = min(max(reach, quickest_lag / stroke), 1.0)
    return min(max(behind, -followed), followed) / (followed * stroke)


@inlined
def asked_for(wanted_open_rate):
    """Open rate α [-] after a long time with a constant voltage."""
    return wanted_open_rate


@inlined
def small_signal_lag(time, reach):
    """Time constant [s] with which the valve follows small changes of its voltage; 0 for none."""
    return time * min(reach, 1.0)


EFFECT = Effect(
    name="valve_lag",
    meaning="The valve follows its voltage with a first-order lag, and no faster than its full speed.",
    law="dα_i/dt = (κ(u_i) − α_i)/(w T_i), at most 1/T_i either way",
    source="first-order spool whose drive saturates: the small-signal and the full-stroke time of data sheets",
    signature="The mass flow is wrong for milliseconds after each change of voltage. In the steady state "
    "nothing is wrong.",
    parameters=(
        *per_muscle("time", "s", 0.0, 2.0, 0.01, "time constant, or time of a full stroke, of the valve", symbol="T"),
        EffectParameter("reach", "-", 1.0, 1e-2, 1.0, 0.05, "remaining stroke above which the speed is full", "w"),
    ),
    states=state_per_muscle(
        "open_rate",
        "-",
        "time",
        0.02,
        1e-4,
        symbol=r"\alpha",
        rate=position_rate,
        steady_value=asked_for,
        lag=small_signal_lag,
    ),
    hooks={"open_rate": position},
    sentence="{valve} follow{s} the voltage late (valve_lag)",
    experiment="step one valve by 1 V every 0.2 s",
    distinguished_by={
        "line_resistance": "step the valve at different pressures: a lag is the same, what a line adds grows with the "
        "flow",
    },
    sealed=SealedJoint(part=None, reason="no valve moves"),
)
