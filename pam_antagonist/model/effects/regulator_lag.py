r"""A pressure regulator that follows its command as a lag of second order.

```math
\dot P_i = \max\Big(\dot P_{i,\mathrm{closed}} + s_i,\ \frac{P_\mathrm{out} - P_i}{T_\mathrm{stp}/2}\Big),\qquad
\dot s_i = \omega_i^2\, e_i - 2 \zeta\, \omega_i\, s_i,\qquad
e_i = \mathrm{dz}_\delta\big(P_i^* - P_i\big),\qquad |s_i| \le s_\mathrm{max}.
```

$P_i^*$ is the pressure that the regulator goes by: the command, with what `regulator_limits`, `regulator_threshold` and
`regulator_dead_time` make of it. $\dot P_{i,\mathrm{closed}}$ is what equation (4) has without flow: a joint that moves
compresses the air, and the regulator lets it out again. So a measured pressure that differs from the command tells of
the joint's motion. $\mathrm{dz}_\delta$ is 0 within $\pm\delta$ and moves on from there: an error within the dead zone
is not corrected. At the largest rate $s_\mathrm{max}$ (0: none) the regulator's valve is wholly open. A regulator that
swings about a low command makes no vacuum: near $P_\mathrm{out}$ the pressure falls within the shortest time
$T_\mathrm{stp}/2$ that a step of the integration follows.
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
def with_flow(chamber_rate, regulator_rate, valve_pressure, atmosphere, quickest_lag):
    """dP/dt [Pa/s] of a chamber with a regulator: rate of the closed chamber plus rate of the regulator, no vacuum.

    `valve_pressure`: P [Pa]. `quickest_lag`: shortest time constant that a step of the integration follows [s].
    """
    return max(chamber_rate + regulator_rate, (atmosphere - valve_pressure) / quickest_lag)


@inlined
def correcting(
    frequency, damping, dead_zone, largest_rate, regulator_rate, asked_pressure, valve_pressure, quickest_lag
):
    """ds/dt [Pa/s²]: change of the rate by which a regulator approaches the pressure P*.

    `frequency`: ω [1/s]. `damping`: ζ [-]. `dead_zone`: δ [Pa]. `largest_rate`: s_max [Pa/s]; 0: none.
    `regulator_rate`: s [Pa/s]. `asked_pressure`: P* [Pa]. `valve_pressure`: P [Pa]. `quickest_lag`: shortest time
    constant that a step of the integration follows [s].
    """
    # A search may try frequencies that are too high for the integration step; a rig file may not have them.
    omega = min(frequency, 1.0 / quickest_lag)
    fading = min(2.0 * damping * omega, 1.0 / quickest_lag)
    error = asked_pressure - valve_pressure
    error -= min(max(error, -dead_zone), dead_zone)
    wanted = omega * omega * error - fading * regulator_rate
    if largest_rate > 0.0:
        wanted = min(max(wanted, (-largest_rate - regulator_rate) / quickest_lag),
                     (largest_rate - regulator_rate) / quickest_lag)  # fmt: skip
    return wanted


EFFECT = Effect(
    name="regulator_lag",
    meaning="A pressure regulator follows its command late, with a resonance, and no faster than it can.",
    law="d²P_i/dt² = ω_i² (P_i* − P_i) − 2 ζ ω_i dP_i/dt, beside what the joint's motion compresses; no vacuum",
    source="inner loops of pressure regulators: step responses of their data sheets; 7 Hz with a damping ratio of 0.33 "
    "on a measured arm (docs/evidence/measured.md)",
    signature="The measured pressures are not those of the commands for some tens of milliseconds after each step, and "
    "ring. In the steady state nothing is wrong.",
    parameters=(
        *per_muscle("frequency", "1/s", 0.0, 1500.0, 60.0, "natural frequency of the regulator", symbol=r"\omega"),
        EffectParameter("damping", "-", 0.7, 0.02, 10.0, 0.3, "damping ratio of both regulators", r"\zeta"),
        EffectParameter("dead_zone", "Pa", 0.0, 0.0, 1e5, 500.0, "error that is not corrected", r"\delta"),
        EffectParameter(
            "largest_rate", "Pa/s", 0.0, 0.0, 1e9, 2e6, "largest rate by which a regulator changes a pressure; 0: any",
            r"s_\mathrm{max}",
        ),
    ),
    states=state_per_muscle(
        "regulator_rate", "Pa/s", "frequency", 1e4, 1e5, symbol="s", rate=correcting,
    ),
    hooks={"valve_pressure_rate": with_flow},
    sentence="the regulator of {muscle} follows its command late (regulator_lag)",
    experiment="step each commanded pressure by 1 bar every 0.3 s, and record the measured pressures",
    distinguished_by={
        "regulator_dead_time": "step the command: a dead time shifts the whole answer, a lag begins at once",
        "regulator_threshold": "step the command to and fro by different sizes: a lag has the same form at each, a "
        "threshold leaves the small ones out",
    },
    tested_with=(),
    sealed=SealedJoint(part=None, reason="no regulator works"),
)  # fmt: skip
