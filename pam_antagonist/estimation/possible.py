"""Which readings and commands are possible at all on a rig.

A sensor that fails, or a driver that sends bar or kPa, gives values that no chamber of the rig can have. The filter
takes them for missing, and flags them as ``OUTLIER`` as well. The bounds are wide: the gate judges what lies within.

* A pressure lies between half the atmosphere's and the highest one that the supply gives. Valves never give more than
  the supply; ``_VALVE`` leaves room for its error and for a push from outside. An underdamped regulator overshoots
  (``_REGULATOR``). In a sealed joint the charge is pressed together over the joint's range.
* A voltage lies within the limits and the curve of its valve, widened by ``_VOLTAGE``; a regulator's command is an
  absolute pressure in Pa.
* A measured angle lies within a quarter of a turn: no joint of this model turns further.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.model import dynamics, muscle
from pam_antagonist.rig import Rig

FURTHEST = 0.5 * math.pi
"""[rad] Largest possible angle."""
_LOW = 0.5
"""Lowest possible pressure, by the atmosphere's: a vented muscle of a rig at 5,000 m."""
_VALVE, _REGULATOR = 1.2, 1.5
"""Highest possible pressure, by the supply's: its file may be 8 % off, and a quick push adds some 10 %."""
_SPREAD = 5.0
"""The supply's own uncertainty counts with so many standard deviations, where that is more."""
_HIGHEST = 2e6
"""[Pa] Highest pressure that a rig file can hold."""
_VOLTAGE = 0.05
"""Part of a valve's range by which a reading may lie beyond it."""
MOST_VOLTS = 24.0
"""[V] Numbers up to the usual supply of a valve may be volts, and no other unit."""
_ANY = (-1e300, 1e300)
_RANGE = math.radians(25.0)
"""[rad] Range of a sealed joint without a stop."""
_UNITS = {"kPa": 1e3, "hPa": 1e2, "bar": 1e5, "MPa": 1e6, "psi": 6894.757}


def bounds(rig: Rig) -> NDArray[np.float64]:
    """Least and largest possible value of both pressure readings and both commands (4, 2) [Pa, Pa, V, V]."""
    p = rig.parameters()
    pressures = [_pressures(rig, i, p) for i in (0, 1)]
    if rig.drive == "regulator":
        return np.array([*pressures, *[_ANY if _no_unit(rig) else (_LOW * rig.atmosphere.pressure, _HIGHEST)] * 2])
    commands = []
    for valve in (rig.valve_1, rig.valve_2):
        low = min(rig.valves.voltage_min, *valve.curve.voltage)
        high = max(rig.valves.voltage_max, *valve.curve.voltage)
        commands.append((low - _VOLTAGE * (high - low), high + _VOLTAGE * (high - low)))
    return np.array([*pressures, *commands])


def _no_unit(rig: Rig) -> bool:
    return rig.units.pressure == "unknown"


def _pressures(rig: Rig, i: int, p: NDArray[np.float64]) -> tuple[float, float]:
    """Least and largest possible reading of a pressure [Pa]."""
    if _no_unit(rig):
        return _ANY
    supply, charge = rig.supply.pressure, (rig.valves.charge_1, rig.valves.charge_2)[i]
    spread = max(section.get("supply.pressure", 0.0) for section in (rig.uncertainty, rig.priors))
    if rig.drive == "regulator":
        high = _REGULATOR * max(supply, rig.command_limits[1])
    elif rig.valves.sealed:
        high = _VALVE * max(supply, charge * _compression(rig, i, p)) if charge > 0.0 else _HIGHEST
    else:
        high = max(_VALVE * supply, supply + _SPREAD * spread)
    low = _LOW * rig.atmosphere.pressure
    return float(dynamics.reading(i, low, p)), float(dynamics.reading(i, high, p))


def _compression(rig: Rig, i: int, p: NDArray[np.float64]) -> float:
    """Pressure of a closed chamber at its least volume, by that at angle 0."""
    stop = _RANGE if rig.joint.stop is None else rig.joint.stop
    volumes = [muscle.volume(i, muscle.length(i, muscle.leverage(a, p)[0], p), p)[0] for a in (-stop, 0.0, stop)]
    return float(max(1.0, volumes[1] / min(volumes)) ** rig.gas.polytropic_volume)


def impossible(limits: NDArray[np.float64], pressure: np.ndarray, command: np.ndarray) -> NDArray[np.bool_]:
    """Which values of some samples are there, but not possible (N, 4).

    `limits`: (4, 2), see :func:`bounds`. `pressure`: (N, 2) [Pa]. `command`: (N, 2) [V] or [Pa].
    """
    values = np.concatenate([pressure, command], axis=1)
    return np.isfinite(values) & ((values < limits[:, 0]) | (values > limits[:, 1]))


def complaint(limits: NDArray[np.float64], drive: str, pressure: np.ndarray, command: np.ndarray) -> str:
    """What is impossible of some samples, in a sentence; empty if nothing is.

    `limits`: (4, 2), see :func:`bounds`. `drive`: of the rig, ``valve`` or ``regulator``. `pressure`: (N, 2) [Pa].
    `command`: (N, 2) [V] or [Pa].
    """
    odd = impossible(limits, pressure, command)
    if not odd.any():
        return ""
    values = np.concatenate([pressure, command], axis=1)
    column = int(np.argmax(odd.sum(axis=0)))
    value = float(values[int(np.argmax(odd[:, column])), column])
    low, high = (float(limit) for limit in limits[column])
    valve = column > 1 and drive == "valve"
    what = f"{'pressure' if column < 2 else 'voltage' if valve else 'pressure command'} {column % 2 + 1}"
    unit = "V" if valve else "Pa, absolute"
    count = f" in {int(odd[:, column].sum())} of {len(values)} samples" if len(values) > 1 else ""
    return f"{what} is {value:g}{count}, expected {low:.4g} to {high:.4g} {unit}{_hint(value, low, high, valve)}"


def _hint(value: float, low: float, high: float, valve: bool) -> str:
    """The unit that a value may be in."""
    if valve and value <= MOST_VOLTS:
        return ""
    factors = {"mV": 1e-3, "percent": 0.01 * high} if valve else _UNITS
    units = [unit for unit, factor in factors.items() if low <= value * factor <= high]
    return f"; it looks like {' or '.join(units)}" if units and value > 0.0 else ""
