r"""A pressure sensor that reads wrong.

```math
y_i = (1 + g_i)\,P_i + o_i .
```

The filter takes the inverse of every reading (`sensor.pressure_behind`), the model alone is compared with readings
(`sensor.reading`). Everything else is in true pressures.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import Effect, SealedJoint, inlined, per_muscle


@inlined
def shown(offset, gain, pressure):
    """What the sensor shows [Pa].

    Args:
        offset: o [Pa].
        gain: g [-].
        pressure: P [Pa].
    """
    return (1.0 + gain) * pressure + offset


@inlined
def pressure_behind(offset, gain, reading):
    """The pressure behind a reading [Pa]; the inverse of :func:`shown`.

    Args:
        offset: o [Pa].
        gain: g [-].
        reading: of the sensor [Pa].
    """
    return (reading - offset) / (1.0 + gain)


EFFECT = Effect(
    name="pressure_sensor",
    meaning="A pressure sensor reads with a wrong offset or gain.",
    law="reading_i = (1 + g_i) P_i + o_i",
    source="linear sensor error",
    signature="Torque and steady pressure are wrong together, as if the muscle had another pressure than its "
    "sensor reads.",
    parameters=(
        *per_muscle("offset", "Pa", -60e3, 60e3, 3e3, "offset of the sensor", symbol="o"),
        *per_muscle("gain", "-", -0.3, 0.3, 0.01, "error of the sensor's gain", symbol="g"),
    ),
    hooks={"sensor_reading": shown, "sensor_inverse": pressure_behind},
    sentence="the pressure sensor of {muscle} reads wrong (pressure_sensor)",
    experiment="compare the sensor with a gauge at three pressures",
    sealed=SealedJoint(part=None, reason="an offset or gain looks like another charge or another slope of the volume"),
)
