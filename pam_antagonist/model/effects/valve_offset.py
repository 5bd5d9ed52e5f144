r"""A valve whose curve is shifted.

```math
\alpha_i = \min\big(\max(\kappa(u_i - \delta_i) + \rho_i,\, 0),\, 1\big).
```

With $\delta_i > 0$ the curve of the rig file moves to the right: the valve needs a voltage that is higher by
$\delta_i$. With $\rho_i > 0$ the curve moves up, within 0 and 1: the zero of spool or seat is displaced, and the valve
is further open by $\rho_i$ at every voltage. On a straight part of the curve the two look the same:
$\rho = -\kappa'\,\delta$. They differ where the slope of the curve changes. A valve with a lag (`valve_lag`) follows
the shifted curve.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, SealedJoint, inlined, per_muscle


@inlined
def voltage_shift(voltage):
    """δ [V], by which the curve is shifted along the voltage: the parameter itself."""
    return voltage


@inlined
def open_rate_shift(open_rate):
    """ρ [-], by which the valve is further open: the parameter itself."""
    return open_rate


EFFECT = Effect(
    name="valve_offset",
    meaning="The valve's curve is shifted: along the voltage, along the open rate, or both.",
    law="α_i = κ(u_i − δ_i) + ρ_i, within 0 and 1",
    source="null shift of a proportional valve: of its electronics δ, of its spool or seat ρ",
    signature="The steady pressure of one muscle belongs to another voltage. δ shows most where the curve is "
    "steep, ρ shows everywhere.",
    parameters=(
        *per_muscle("voltage", "V", -2.0, 2.0, 0.1, "voltage shift of the curve of the valve", symbol=r"\delta"),
        *per_muscle("open_rate", "-", -0.1, 0.1, 0.01, "open-rate shift of the curve of the valve", symbol=r"\rho"),
    ),
    hooks={"voltage_shift": voltage_shift, "open_rate_shift": open_rate_shift},
    sentence="the curve of {valve} is shifted (valve_offset)",
    experiment="hold each of six voltages for 10 s, and compare the steady pressures with the model's",
    distinguished_by={
        "pressure_sensor": "vent the muscle and read the sensor at the atmosphere's pressure",
    },
    sealed=SealedJoint(part=None, reason="no valve moves"),
)
