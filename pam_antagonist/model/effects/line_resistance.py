r"""A line between valve and muscle that resists the flow.

```math
\dot P_{s,i} = \frac{P_{c,i} + R_i\, m_i\,(|m_i|/m_0)^{n-1} - P_{s,i}}{T},\qquad
\dot P_{c,i} = (4)\ \text{with}\ P_{c,i},\qquad
m_i = m^{(5)}(\alpha_i, P_{s,i}).
```

Valve and sensor see $P_s$, the state `pressure`; volume, force and friction see the chamber's $P_c$, the added state.
All air that passes the valve arrives in the chamber. With $n = 1$ the line is laminar; turbulent flow, bends and
fittings resist with the flow's square, $n = 2$. At $m_0 = 0.05$ g/s, which a muscle draws when it fills, lines of any
$n$ have the resistance $R_i$.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, EffectParameter, SealedJoint, per_muscle, state_per_muscle

EFFECT = Effect(
    name="line_resistance",
    meaning="Tube or fitting between valve and muscle: the sensor at the valve shows more than the chamber while it "
    "fills.",
    law="P_s,i = P_c,i + R_i m_i (|m_i|/0.05 g/s)^(n − 1) behind a lag T; valve and sensor see P_s, the muscle P_c",
    source="laminar flow for n = 1, turbulent flow and fittings up to n = 2; line volume neglected",
    signature="Both flow and torque wrong with the flow while air moves, nothing in the steady state.",
    parameters=(
        *per_muscle("resistance", "Pa s/kg", 0.0, 5e9, 1e8, "resistance of the line", symbol="R"),
        EffectParameter("time", "s", 2e-3, 1e-3, 0.05, 2e-3, "lag of the line", "T"),
        EffectParameter("exponent", "-", 1.0, 1.0, 2.0, 1.5, "power of the flow in the fall of pressure", "n"),
    ),
    states=state_per_muscle("chamber", "Pa", "resistance", 1e3, 50.0, symbol="P_c"),
    sentence="the line to {muscle} throttles the flow (line_resistance)",
    experiment="record the pressure at the muscle's far end as well",
    sealed=SealedJoint(part=None, reason="no air passes the line"),
)
