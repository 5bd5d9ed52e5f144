r"""A pressure sensor that reads wrong.

```math
y_i = (1 + g_i)\,P_i + o_i + s_i,\qquad
\ddot s_i = -\frac{2}{T}\,\dot s_i - \frac{1}{T^2}\,s_i + w_i .
```

The filter removes offset and gain from every reading (`dynamics.pressure_behind`). The model alone is compared with
readings (`dynamics.reading`).

The drift $s$ is a slow error of the reading. No law gives it: the model alone has $s = 0$, and a filter estimates it.
It is a smooth random process (second-order Gauss–Markov). White noise $w$ of the density $n^2$ gives it the standard
deviation $\sigma = n\,T^{3/2}/2$. With it the state `pressure` is the reading with its drift; the chamber's pressure is
$P - s$. The valve's flow is taken at the reading.
"""

from __future__ import annotations

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
def shown(offset, gain, pressure):
    """Reading of the sensor [Pa].

    `offset`: o [Pa]. `gain`: g [-]. `pressure`: P [Pa].
    """
    return (1.0 + gain) * pressure + offset


@inlined
def pressure_behind(offset, gain, reading):
    """The pressure behind a reading [Pa]; the inverse of :func:`shown`.

    `offset`: o [Pa]. `gain`: g [-]. `reading`: of the sensor [Pa].
    """
    return (reading - offset) / (1.0 + gain)


@inlined
def without_drift(reading_drift, valve_pressure):
    """Pressure in the muscle [Pa]: the reading without its drift."""
    return valve_pressure - reading_drift


@inlined
def with_drift_rate(reading_drift_rate, chamber_rate):
    """dP/dt [Pa/s] of the reading: rate of the chamber plus rate of the drift."""
    return chamber_rate + reading_drift_rate


@inlined
def drift_change(reading_drift_rate):
    """ds/dt [Pa/s]: a state by itself."""
    return reading_drift_rate


@inlined
def drift_acceleration(drift_time, reading_drift, reading_drift_rate):
    """d²s/dt² [Pa/s²] without the noise: the drift goes back to 0 within a few T.

    `drift_time`: T [s]. `reading_drift`: s [Pa]. `reading_drift_rate`: ds/dt [Pa/s].
    """
    return -(2.0 * reading_drift_rate + reading_drift / drift_time) / drift_time


EFFECT = Effect(
    name="pressure_sensor",
    meaning="A pressure sensor reads with a wrong offset or gain, or its reading drifts.",
    law="reading_i = (1 + g_i) P_i + o_i + s_i; s_i a second-order Gauss–Markov process with the time constant T",
    source="linear sensor error; drift: Matérn process of the order 3/2",
    signature="Torque and steady pressure are wrong together, as if the pressure in the muscle were not what the "
    "sensor reads.",
    parameters=(
        *per_muscle("offset", "Pa", -60e3, 60e3, 3e3, "offset of the sensor", symbol="o"),
        *per_muscle("gain", "-", -0.3, 0.3, 0.01, "gain error of the sensor", symbol="g"),
        *per_muscle("drift", "Pa/s^1.5", 0.0, 1e8, 1e4, "noise that drives the drift of the sensor", symbol="n"),
        EffectParameter("drift_time", "s", 0.1, 0.01, 100.0, 0.1, "time constant of the drift", "T"),
    ),
    states=(
        *state_per_muscle("reading_drift", "Pa", "drift", 250.0, 0.0, symbol="s", rate=drift_change),
        *state_per_muscle(
            "reading_drift_rate", "Pa/s", "drift", 2500.0, "drift", symbol=r"\dot s", rate=drift_acceleration
        ),
    ),
    hooks={
        "sensor_reading": shown,
        "sensor_inverse": pressure_behind,
        "chamber_pressure": without_drift,
        "valve_pressure_rate": with_drift_rate,
    },
    form=Form(without=("drift_1", "drift_2", "drift_time")),
    sentence="the pressure sensor of {muscle} reads wrong (pressure_sensor)",
    experiment="compare the sensor with a gauge at three pressures",
    sealed=SealedJoint(part=None, reason="an offset or gain looks like another charge or another slope of the volume"),
    tested_with=("valve", "command"),
)
