r"""The range of a pressure regulator.

```math
P_i^* = \min\big(\max(u_i,\, P_\mathrm{min}),\, P_\mathrm{max}\big).
```

A command beyond the range is taken for the nearer end. Nodes clamp their commands to these limits. A bound of 0 is
none.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, EffectParameter, SealedJoint, inlined


@inlined
def within(lowest, highest, asked_pressure):
    """Pressure [Pa] that the regulator follows.

    `lowest`: P_min [Pa]; 0: none. `highest`: P_max [Pa]; 0: none. `asked_pressure`: u [Pa].
    """
    raised = max(asked_pressure, lowest) if lowest > 0.0 else asked_pressure
    return min(raised, highest) if highest > 0.0 else raised


EFFECT = Effect(
    name="regulator_limits",
    meaning="A pressure regulator holds no pressure beyond its range.",
    law="the regulator goes by min(max(u_i, P_min), P_max)",
    source="range of data sheets",
    signature="The measured pressures stay at the ends of the range while commands go beyond.",
    parameters=(
        EffectParameter("lowest", "Pa", 0.0, 0.0, 2e6, 1e5, "least pressure that a regulator holds", r"P_\mathrm{min}"),
        EffectParameter(
            "highest", "Pa", 0.0, 0.0, 2e6, 7e5, "largest pressure that a regulator holds", r"P_\mathrm{max}"
        ),
    ),
    hooks={"asked_pressure": within},
    sentence="the regulators hold no pressure beyond their range (regulator_limits)",
    experiment="command pressures up to both ends of the range",
    tested_with=(),
    sealed=SealedJoint(part=None, reason="no regulator works"),
)
