r"""A supply whose pressure falls while air is drawn.

```math
P_{tank} \to P_{tank} + s,\qquad
\dot s = -c\,(m_{in,1} + m_{in,2}) - s/T,\qquad
m_{in,i} = A_{1i}\,\alpha_i\, q(P_{tank}+s, P_i).
```

Air is drawn through the inflow orifice, also where $A_0$ of (5) is the outflow area.

A valve of this kind draws $m_{in}$ in the steady state as well, since as much flows out. So the supply does not recover
completely: it stays low by $cT$ times this flow.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import AddedState, Effect, EffectParameter, SealedJoint, inlined


@inlined
def deviation(supply):
    """Deviation [Pa] of the supply's pressure: the state itself."""
    return supply


@inlined
def deviation_rate(stiffness, time, supply, drawn_flow):
    """ds/dt [Pa/s].

    `stiffness`: c [Pa/kg]. `time`: T [s]. `supply`: s [Pa]. `drawn_flow`: that both valves draw [kg/s].
    """
    return -stiffness * drawn_flow - supply / time


EFFECT = Effect(
    name="supply_droop",
    meaning="The tank's pressure falls while air is drawn from it and recovers with time.",
    law="P_tank gains s, ds/dt = −c (m_in,1 + m_in,2) − s/T",
    source="isothermal tank behind a regulator, first order",
    signature="The inflow of both muscles is too low while one of them fills. Steady pressures are too low, "
    "since the valves go on drawing air.",
    parameters=(
        EffectParameter("stiffness", "Pa/kg", 0.0, 0.0, 5e10, 2e8, "fall of the supply pressure per mass drawn", "c"),
        EffectParameter("time", "s", 0.5, 0.02, 20.0, 0.5, "time constant of its recovery", "T"),
    ),
    states=(AddedState("supply", "Pa", "stiffness", 1e3, 10.0, symbol="s", rate=deviation_rate),),
    hooks={"supply_change": deviation},
    sentence="the supply's pressure droops while air is drawn (supply_droop)",
    experiment="record the pressure of the tank as well",
    distinguished_by={
        "line_resistance": "fill one muscle while the other is held: a drooping supply shows in both pressures, a line "
        "in one",
    },
    sealed=SealedJoint(part=None, reason="no air is drawn"),
)
