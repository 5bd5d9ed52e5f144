"""What a pressure sensor shows: the pressure itself, unless an effect says otherwise."""

from __future__ import annotations

from pam_antagonist._jit import inlined
from pam_antagonist.model.composition import sensor_inverse, sensor_reading


@inlined
def reading(muscle, pressure, p):
    """What a pressure sensor shows [Pa].

    Args:
        muscle: 0 or 1.
        pressure: P_i [Pa].
        p: parameter vector (m,).
    """
    return sensor_reading(pressure, muscle, p)


@inlined
def pressure_behind(muscle, shown, p):
    """The pressure behind a reading [Pa]; the inverse of :func:`reading`.

    Args:
        muscle: 0 or 1.
        shown: reading of the sensor [Pa].
        p: parameter vector (m,).
    """
    return sensor_inverse(shown, muscle, p)
