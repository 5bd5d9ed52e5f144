"""How far a joint may go and where it rests, by its rig file: the defaults of nodes and commands."""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist.model import dynamics, equilibrium, flow
from pam_antagonist.model import parameters as par
from pam_antagonist.rig.physical import RANGE_WITHOUT_STOP
from pam_antagonist.rig.schema import Rig

_BEYOND = math.radians(1.0)
"""[rad] A correct estimate does not get so far beyond the mechanical stop."""
_REST_SHARE = (450.0 - 101.3) / (710.0 - 101.3)
"""[-] Pressure at rest as a share of the supply's gauge pressure: 450 of 710 kPa absolute, as in the paper."""


def angle_range(rig: Rig) -> float:
    """Largest angle to either side [rad]: the mechanical stop; without one, the range that is checked."""
    return RANGE_WITHOUT_STOP if rig.joint.stop is None else rig.joint.stop


def stop_angle(rig: Rig) -> float:
    """Estimated angle to either side beyond which a controller stops the joint [rad]."""
    return angle_range(rig) + _BEYOND


def largest_torque(rig: Rig) -> float:
    """Torque at angle 0 with the supply's pressure in one muscle and none in the other, the larger of both [N m]."""
    p, (low, high) = rig.parameters("locked", 0.0), _pressures(rig)
    at_rest = np.array([*(flow.voltage_for(i, 0.5, p) for i in (0, 1)), 0.0])
    ways = [equilibrium.initial_state(0.0, *pair, at_rest, p) for pair in ((high, low), (low, high))]
    return max(abs(float(dynamics.torque(x, p))) for x in ways)


def rest_pressure(rig: Rig) -> float:
    """Absolute pressure of both muscles at rest [Pa]."""
    low, high = _pressures(rig)
    return float(round(low + _REST_SHARE * (high - low))) if rig.drive == "valve" else 0.5 * (low + high)


def vented(rig: Rig) -> tuple[float, tuple[float, float]]:
    """Least pressure that the muscles can have [Pa], and the commands (2,) that let the air out."""
    low = rig.command_limits[0]
    return _pressures(rig)[0], (low, low)


def rest_voltage(rig: Rig) -> tuple[float, float]:
    """Voltages (2,) at which the valves keep the pressure at rest [V], to a hundredth of a volt."""
    low, high = rig.valves.voltage_min, rig.valves.voltage_max
    first, second = (round(min(max(u, low), high), 2) for u in steady_voltage(rig, rest_pressure(rig)))
    return first, second


def steady_voltage(rig: Rig, pressure: float) -> tuple[float, float]:
    """Voltages (2,) [V] under which both muscles keep a pressure [Pa], by the valves' law (5).

    In the steady state as much flows in as out: the orifice areas play no part. A valve that is closed in the middle
    keeps any pressure there.
    """
    p = rig.parameters()
    supply = p[par.SUPPLY]
    first, second = (float(flow.voltage_for(i, flow.open_rate_for(i, 0.0, pressure, supply, p), p)) for i in (0, 1))
    return first, second


def _pressures(rig: Rig) -> tuple[float, float]:
    """Least and largest pressure that the muscles can have [Pa]."""
    return (rig.atmosphere.pressure, rig.supply.pressure) if rig.drive == "valve" else rig.command_limits
