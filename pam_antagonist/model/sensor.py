"""Readings of a pressure sensor: the pressure itself, unless an effect changes it."""

from __future__ import annotations

import numpy as np

from pam_antagonist._jit import inlined, kernel
from pam_antagonist.model.composition import sensor_inverse, sensor_reading


@inlined
def reading(muscle, pressure, p):
    """Reading of a pressure sensor [Pa].

    `pressure`: P_i [Pa].
    """
    return sensor_reading(pressure, muscle, p)


@inlined
def pressure_behind(muscle, shown, p):
    """The pressure behind a reading [Pa]; the inverse of :func:`reading`.

    `shown`: reading of the sensor [Pa].
    """
    return sensor_inverse(shown, muscle, p)


@kernel
def readings(pressure, p):
    """Readings of both sensors (N, 2) [Pa] at pressures (N, 2) [Pa]."""
    shown = np.empty(pressure.shape)
    for k in range(len(pressure)):
        for i in range(2):
            shown[k, i] = reading(i, pressure[k, i], p)
    return shown


@kernel
def pressures_behind(shown, p):
    """The pressures (N, 2) [Pa] behind readings of both sensors (N, 2) [Pa]; the inverse of :func:`readings`."""
    pressure = np.empty(shown.shape)
    for k in range(len(shown)):
        for i in range(2):
            pressure[k, i] = pressure_behind(i, shown[k, i], p)
    return pressure
