"""What a pressure sensor shows: the effect ``pressure_sensor``. At its neutral values the pressure itself."""

from __future__ import annotations

from pam_antagonist._jit import inlined
from pam_antagonist.model.parameters import SENSOR_GAIN, SENSOR_OFFSET


@inlined
def reading(muscle, pressure, p):
    """What sensor ``muscle`` (0 or 1) shows [Pa] at a pressure [Pa]."""
    return (1.0 + p[SENSOR_GAIN + muscle]) * pressure + p[SENSOR_OFFSET + muscle]


@inlined
def pressure_behind(muscle, shown, p):
    """The pressure [Pa] behind a reading [Pa]; the inverse of :func:`reading`."""
    return (shown - p[SENSOR_OFFSET + muscle]) / (1.0 + p[SENSOR_GAIN + muscle])
