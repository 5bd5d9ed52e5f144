"""What a pressure sensor shows: the pressure itself, unless an effect says otherwise."""

from __future__ import annotations

from pam_antagonist._jit import inlined
from pam_antagonist.model.composition import sensor_inverse, sensor_reading


@inlined
def reading(muscle, pressure, p):
    """What sensor ``muscle`` (0 or 1) shows [Pa] at a pressure [Pa]."""
    return sensor_reading(pressure, muscle, p)


@inlined
def pressure_behind(muscle, shown, p):
    """The pressure [Pa] behind a reading [Pa]; the inverse of :func:`reading`."""
    return sensor_inverse(shown, muscle, p)
