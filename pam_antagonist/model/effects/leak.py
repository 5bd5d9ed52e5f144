r"""A leak from a muscle to the atmosphere.

```math
m_i = m_i^{(5)} - A_i \left(\frac{P_i - P_{out}}{350\,\mathrm{kPa}}\right)^{n-1} q(P_i, P_{out}),
```

with the orifice flow $q$ of (5). With $n = 1$ the leak is an orifice. The flow of a fine crack or capillary is viscous
and grows with nearly the square of the pressure: $n$ is up to 2. The leak is in the muscle: this air does not pass the
line of `line_resistance`.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, EffectParameter, Form, SealedJoint, inlined, per_muscle
from pam_antagonist.model.numeric import power

_SLOW = 1e-11
"""[m²] Scale for sealed muscles: such a leak takes a hundredth of the air in a minute."""

_GAUGE = 350e3
"""[Pa] Gauge pressure at which a leak of any exponent is an orifice of its area."""


@inlined
def outflow(area, exponent, chamber_pressure, atmosphere, orifice_flow):
    """Mass flow out of a leaking muscle [kg/s], through an orifice or through a crack with viscous flow.

    `area`: A [m²]. `exponent`: n [-]. `chamber_pressure`: P [Pa]. `atmosphere`: P_out [Pa]. `orifice_flow`: of an ideal
    orifice from P to P_out, by its area [kg/(s m²)].
    """
    flow = area * orifice_flow
    if exponent != 1.0:
        flow *= power(max(chamber_pressure - atmosphere, 1.0) / _GAUGE, exponent - 1.0)
    return flow


EFFECT = Effect(
    name="leak",
    meaning="Air escapes from a muscle to the atmosphere past the valve.",
    law="m_i loses A_i ((P_i − P_out)/350 kPa)^(n − 1) times the orifice flow (5) from P_i to P_out",
    source="ideal orifice, as equation (5), for n = 1; a fine crack or capillary, whose flow is viscous, up to n = 2",
    signature="The mass flow of one muscle is too low, by more at higher pressure. Its steady pressures are too low.",
    parameters=(
        *per_muscle("area", "m2", 0.0, 5e-8, 1e-9, "area of the leak", symbol="A"),
        EffectParameter("exponent", "-", 1.0, 0.6, 3.0, 1.0, "exponent of the gauge pressure; 1: an orifice", "n"),
    ),
    hooks={"mass_loss": outflow},
    sentence="air leaks from {muscle}",
    experiment="close the valves under pressure and watch the pressures for a minute",
    distinguished_by={
        "valve_offset": "close the valves (or plug the muscle) under pressure: only a leak goes on",
        "pressure_sensor": "close the valves under pressure: a leak falls to the atmosphere, a wrong sensor stands "
        "still",
    },
    sealed=SealedJoint(
        part="air",
        # A sealed muscle's pressure hardly falls, so the exponent is not observable.
        forms=(
            Form(tied=True, without=("exponent",), scale={"area": _SLOW}),
            Form(without=("exponent",), scale={"area": _SLOW}),
        ),
        sentence="{muscle} slowly lose{s} air (leak)",
        instead="a leak explains the data as well",
        experiment="leave the joint closed for ten minutes and record again: what is due to charging has died out "
        "then, a leak goes on",
        loss="steady",
    ),
)
