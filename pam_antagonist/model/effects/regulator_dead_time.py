r"""A pressure regulator that hears its command late.

```math
\ddot P_i^* = \frac{2}{T_i^2}\left(u_i - P_i^* - T_i\, \dot P_i^*\right).
```

This is $e^{-sT} \approx 1/(1 + sT + \tfrac12 s^2T^2)$, Padé's form without zeros: it agrees with a dead time $T_i$ up
to the second order, overshoots a step by 4 %, and never answers in the wrong direction. Commands that change within a
fraction of $T_i$ are smoothed.
"""

from __future__ import annotations

import math

from pam_antagonist.model.effects.base import Effect, SealedJoint, inlined, per_muscle, state_per_muscle


@inlined
def delayed(late_command):
    """Pressure [Pa] that the regulator follows: the state itself."""
    return late_command


@inlined
def passing(late_command_rate):
    """Rate [Pa/s] of the pressure that the regulator follows: a state as well."""
    return late_command_rate


@inlined
def approaching(time, late_command, late_command_rate, asked_pressure, quickest_lag):
    """Second derivative [Pa/s²] of the pressure that the regulator follows.

    `time`: T [s]. `late_command`: P* [Pa]. `late_command_rate`: dP*/dt [Pa/s]. `asked_pressure`: u [Pa].
    `quickest_lag`: shortest time constant that a step of the integration follows [s].
    """
    # A search may try times that are too short for the integration step; a rig file may not have them.
    late = max(time, 2.0 * quickest_lag)
    return 2.0 / (late * late) * (asked_pressure - late_command - late * late_command_rate)


@inlined
def as_asked(asked_pressure):
    """P* [Pa] after a long time with a constant command."""
    return asked_pressure


@inlined
def small_signal_lag(time):
    """Time constant [s] for small changes of the command."""
    return time / math.sqrt(2.0)


EFFECT = Effect(
    name="regulator_dead_time",
    meaning="A pressure regulator hears its command late.",
    law="P_i* + T_i dP_i*/dt + T_i²/2 d²P_i*/dt² = u_i",
    source="dead time of buses, filters and switching valves; Padé approximation of order (0, 2)",
    signature="The measured pressures follow their commands as they should, but later.",
    parameters=per_muscle("time", "s", 0.0, 0.2, 5e-3, "dead time of the regulator", symbol="T"),
    states=(
        *state_per_muscle(
            "late_command", "Pa", "time", 500.0, 10.0, symbol="P_#^*", rate=passing, steady_value=as_asked,
            lag=small_signal_lag,
        ),
        *state_per_muscle("late_command_rate", "Pa/s", "time", 1e4, 1e3, symbol=r"\dot P_#^*", rate=approaching),
    ),
    hooks={"asked_pressure": delayed},
    sentence="the regulator of {muscle} hears its command late (regulator_dead_time)",
    experiment="step each commanded pressure by 1 bar every 0.3 s, and record the measured pressures",
    tested_with=("command",),
    sealed=SealedJoint(part=None, reason="no regulator works"),
)  # fmt: skip
