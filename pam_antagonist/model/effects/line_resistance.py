r"""A line between valve and muscle that resists the flow.

```math
\dot P_{s,i} = \frac{P_{c,i} + R_i\, m_i\,(|m_i|/m_0)^{n-1} - P_{s,i}}{T},\qquad
\dot P_{c,i} = (4)\ \text{with}\ P_{c,i},\qquad
m_i = m^{(5)}(\alpha_i, P_{s,i}).
```

Valve and sensor see $P_s$, the state `pressure`; volume, force and friction see the chamber's $P_c$, the added state.
All air that passes the valve arrives in the chamber. With $n = 1$ the flow is laminar. In turbulent flow, bends and
fittings the pressure drop grows with the square of the flow, $n = 2$. At $m_0 = 0.05$ g/s, which a muscle draws when it
fills, lines of any $n$ have the resistance $R_i$.
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
from pam_antagonist.model.numeric import power

_FLOW = 5e-5
"""[kg/s] Flow at which the resistance is R for any exponent; typical while a muscle fills."""


@inlined
def pressure_fall(resistance, exponent, valve_flow):
    """Pressure drop [Pa] along a line.

    `resistance`: R [Pa s/kg]. `exponent`: n [-]. `valve_flow`: m [kg/s].
    """
    fall = resistance * valve_flow
    if exponent != 1.0:
        fall *= power(abs(valve_flow) / _FLOW, exponent - 1.0)
    return fall


@inlined
def behind(chamber):
    """Pressure behind the line [Pa]: the state itself."""
    return chamber


@inlined
def behind_rate(chamber_rate):
    """dP_c/dt [Pa/s]: the muscle's own rate."""
    return chamber_rate


@inlined
def before_rate(resistance, exponent, time, valve_pressure, chamber_pressure, valve_flow):
    """dP_s/dt [Pa/s] at the valve: the pressure follows chamber pressure plus pressure drop with a lag.

    `resistance`: R [Pa s/kg]. `exponent`: n [-]. `time`: lag T [s]. `valve_pressure`: P_s [Pa]. `chamber_pressure`: P_c
    [Pa]. `valve_flow`: m through the valve [kg/s].
    """
    return (chamber_pressure + pressure_fall(resistance, exponent, valve_flow) - valve_pressure) / time


@inlined
def steady_chamber(resistance, exponent, valve_pressure, valve_flow, atmosphere, supply_pressure):
    """Pressure behind the line [Pa] while it carries the flow of the valve.

    A line settles within milliseconds. If a recording begins while a muscle fills, the pressures before and behind the
    line differ from the start.

    `resistance`: R [Pa s/kg]. `exponent`: n [-]. `valve_pressure`: P_s [Pa]. `valve_flow`: m through the valve [kg/s].
    `atmosphere`: P_out [Pa]. `supply_pressure`: P_tank [Pa].
    """
    chamber = valve_pressure - pressure_fall(resistance, exponent, valve_flow)
    return min(max(chamber, min(atmosphere, valve_pressure)), max(supply_pressure, valve_pressure))


EFFECT = Effect(
    name="line_resistance",
    meaning="Tube or fitting between valve and muscle: the sensor at the valve shows more than the chamber while it "
    "fills.",
    law="P_s,i = P_c,i + R_i m_i (|m_i|/0.05 g/s)^(n − 1) behind a lag T; valve and sensor see P_s, the muscle P_c",
    source="laminar flow for n = 1, turbulent flow and fittings up to n = 2; line volume neglected",
    signature="Flow and torque are wrong while air moves, by more at larger flow. In the steady state nothing "
    "is wrong.",
    parameters=(
        *per_muscle("resistance", "Pa s/kg", 0.0, 5e9, 1e8, "resistance of the line", symbol="R"),
        EffectParameter("time", "s", 2e-3, 1e-3, 0.05, 2e-3, "lag of the line", "T"),
        EffectParameter("exponent", "-", 1.0, 1.0, 2.0, 1.5, "exponent of the flow in the pressure drop", "n"),
    ),
    states=state_per_muscle(
        "chamber", "Pa", "resistance", 1e3, 50.0, symbol="P_{c,#}", rate=behind_rate, steady_value=steady_chamber
    ),
    hooks={"chamber_pressure": behind, "valve_pressure_rate": before_rate},
    sentence="the line to {muscle} throttles the flow (line_resistance)",
    experiment="record the pressure at the muscle's far end as well",
    sealed=SealedJoint(part=None, reason="no air passes the line"),
)
