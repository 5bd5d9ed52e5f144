"""What makes a rig impossible although each of its values may stand alone."""

from __future__ import annotations

import difflib
import math

import numpy as np

from pam_antagonist.model import parameters as par
from pam_antagonist.rig.schema import Rig

_LEAST_VOLUME, _LARGEST_VOLUME = 1e-7, 1e-2
_REACH = 5.0
"""Sigma points go so many standard deviations away from the value."""


def is_positive(name: str) -> bool:
    """Whether a parameter is positive in any rig: all but the coefficients of volume and force map are."""
    return ".force." not in name and ".volume." not in name


def unphysical(rig: Rig) -> str:
    """What fields alone cannot tell, in one line; empty where nothing is wrong."""
    if rig.supply.pressure <= rig.atmosphere.pressure * 1.2:
        return (
            f"supply.pressure {rig.supply.pressure:g} Pa: expected an absolute pressure well above "
            f"atmosphere.pressure, {rig.atmosphere.pressure:g} Pa"
        )
    if rig.valves.voltage_min >= rig.valves.voltage_max:
        return (
            f"valves.voltage_min {rig.valves.voltage_min:g} V: expected below voltage_max, {rig.valves.voltage_max:g} V"
        )
    for name, valve in (("valve_1", rig.valve_1), ("valve_2", rig.valve_2)):
        complaint = _bad_curve(f"{name}.curve", np.array(valve.curve.voltage), np.array(valve.curve.open_rate))
        if complaint:
            return complaint
    reach = rig.geometry.radius * math.sin(rig.joint.stop if rig.joint.stop is not None else math.radians(25.0))
    for name, muscle in (("muscle_1", rig.muscle_1), ("muscle_2", rig.muscle_2)):
        for length in (rig.geometry.length - reach, rig.geometry.length, rig.geometry.length + reach):
            volume = (muscle.volume.d1 * length + muscle.volume.d2) * length + muscle.volume.d3
            if not _LEAST_VOLUME < volume < _LARGEST_VOLUME:
                return (
                    f"{name}.volume gives {volume:.3g} m³ at a length of {length:g} m: expected {_LEAST_VOLUME:g} "
                    f"to {_LARGEST_VOLUME:g} m³ within the joint's range"
                )
        slope = muscle.force.v1 * rig.geometry.length + muscle.force.v2
        if not 1e-7 < slope < 0.1:
            return (
                f"{name}.force gives dF/dP = {slope:.3g} m² at geometry.length: expected 1e-7 to 0.1 m² "
                "(force in N over absolute pressure in Pa)"
            )
    for section, spreads in (("uncertainty", rig.uncertainty), ("priors", rig.priors)):
        for name, std in spreads.items():
            if name not in par.INDEX or name == "friction.time_step":
                close = difflib.get_close_matches(name, par.INDEX, 1)
                return f"{section}: unknown parameter {name!r}" + (f" (did you mean {close[0]!r}?)" if close else "")
            if not (math.isfinite(std) and std > 0.0):
                return f"{section} of {name}: {std:g}, expected a standard deviation above 0"
            if section == "uncertainty" and is_positive(name) and std * _REACH >= rig.value(name):
                return (
                    f"uncertainty of {name}: {std:g}, expected less than a {_REACH:g}th of its value, "
                    f"{rig.value(name):g}, since it cannot be negative"
                )
    for name, tuning in rig.tunings.items():
        numbers = np.array([*tuning.initial, *tuning.process, *tuning.measurement])
        if not (np.all(np.isfinite(numbers)) and np.all(numbers >= 0.0) and min(tuning.measurement) > 0.0):
            return f"tunings.{name}: expected variances, finite and not negative, those of the measurement above 0"
    if "default" not in rig.tunings:
        return "tunings: expected one that is called 'default'"
    return "" if np.all(np.isfinite(rig.parameters()[par.LOCKED :])) else "gas: these constants give no finite flow"


def _bad_curve(where: str, voltage: np.ndarray, rate: np.ndarray) -> str:
    if not 2 <= len(voltage) <= par.MAX_KNOTS:
        return f"{where}: {len(voltage)} points, expected 2 to {par.MAX_KNOTS}"
    if len(voltage) != len(rate):
        return f"{where}: {len(voltage)} voltages but {len(rate)} open rates"
    if not (np.all(np.isfinite(voltage)) and np.all(np.diff(voltage) > 0.0)):
        return f"{where}.voltage: expected increasing values [V]"
    if not (np.all(np.diff(rate) >= 0.0) and rate[0] >= 0.0 and rate[-1] <= 1.0):
        return f"{where}.open_rate: expected values from 0 to 1 that do not decrease"
    return ""
