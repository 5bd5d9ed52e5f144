r"""Air that the rubber of a muscle takes up.

```math
\dot b_i = \frac{s_i\,(P_i - P_{out}) - b_i}{T},\qquad m_i = m_i^{(5)} - \dot b_i .
```

$b_i$ is the mass of the air in the rubber. It follows the pressure by the time constant $T$.
"""

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
def uptake(capacity, time, bound, chamber_pressure, atmosphere):
    """Mass flow into the rubber [kg/s]."""
    return (steady_value(capacity, chamber_pressure, atmosphere) - bound) / time


@inlined
def steady_value(capacity, chamber_pressure, atmosphere):
    """Mass of the air in the rubber after a long rest [kg]."""
    return capacity * (chamber_pressure - atmosphere)


EFFECT = Effect(
    name="sorption",
    meaning="The rubber of a muscle takes up air under pressure and gives it back.",
    law="m_i loses db_i/dt, db_i/dt = (s_i (P_i − P_out) − b_i)/T",
    source="Henry's law with a first-order uptake",
    signature="Pressure falls for seconds after each filling, and rises after each emptying.",
    parameters=(
        *per_muscle("capacity", "kg/Pa", 0.0, 1e-9, 1e-11, "mass of air by its pressure", symbol="s"),
        EffectParameter("time", "s", 3.0, 0.1, 60.0, 3.0, "time constant of the uptake", "T"),
    ),
    states=state_per_muscle("bound", "kg", "capacity", 1e-7, 1e-9, symbol="b", rate=uptake, steady_value=steady_value),
    hooks={"mass_loss": uptake},
    sentence="the rubber of {muscle} take{s} up air (sorption)",
    experiment="close the valves after a fast filling and watch the pressures for a minute",
    sealed=SealedJoint(part="air", forms=(Form(tied=True),)),
)
