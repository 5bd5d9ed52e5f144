"""The parameter vector: every number that the physics needs, in one flat array.

The compiled physics reads parameters by the indices defined here; people read and write them by name.
A name is the dotted path of the value in a rig file (``muscle_1.force.v1``), so that a rig, an
uncertainty and an identified value all speak of the same thing. Values that depend on others (the flow
constants of equation (5)) stand behind the named ones and are filled in by :func:`refresh`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

MAX_KNOTS = 24
"""The most points that a valve curve may have."""

_MUSCLE = ("volume.d1", "volume.d2", "volume.d3", "force.v1", "force.v2", "force.w1", "force.w2")
_VALVE = ("inflow_area", "outflow_area")
_NAMES = (
    *(f"muscle_1.{name}" for name in _MUSCLE),
    *(f"muscle_2.{name}" for name in _MUSCLE),
    *(f"valve_1.{name}" for name in _VALVE),
    *(f"valve_2.{name}" for name in _VALVE),
    "geometry.radius",
    "geometry.length",
    "gas.heat_ratio",
    "gas.constant",
    "gas.temperature",
    "gas.polytropic_flow",
    "gas.polytropic_volume",
    "supply.pressure",
    "atmosphere.pressure",
    "joint.inertia",
    "joint.stiffness",
    "joint.viscous_friction",
    "joint.shaft_radius",
    "joint.mass",
    "joint.gravity",
    "joint.stop",
    "friction.shaft",
    "friction.muscle",
    "friction.pressure_floor",
    "friction.time_step",
)
INDEX: Mapping[str, int] = {name: index for index, name in enumerate(_NAMES)}
"""Index of each named parameter in the vector."""

MUSCLE, MUSCLE_SIZE = INDEX["muscle_1.volume.d1"], len(_MUSCLE)
D1, D2, D3, V1, V2, W1, W2 = range(len(_MUSCLE))
VALVE, VALVE_SIZE = INDEX["valve_1.inflow_area"], len(_VALVE)
INFLOW_AREA, OUTFLOW_AREA = range(len(_VALVE))
RADIUS = INDEX["geometry.radius"]
LENGTH = INDEX["geometry.length"]
HEAT_RATIO = INDEX["gas.heat_ratio"]
GAS_CONSTANT = INDEX["gas.constant"]
TEMPERATURE = INDEX["gas.temperature"]
POLYTROPIC_FLOW = INDEX["gas.polytropic_flow"]
POLYTROPIC_VOLUME = INDEX["gas.polytropic_volume"]
SUPPLY = INDEX["supply.pressure"]
ATMOSPHERE = INDEX["atmosphere.pressure"]
INERTIA = INDEX["joint.inertia"]
STIFFNESS = INDEX["joint.stiffness"]
VISCOUS = INDEX["joint.viscous_friction"]
SHAFT_RADIUS = INDEX["joint.shaft_radius"]
MASS = INDEX["joint.mass"]
GRAVITY = INDEX["joint.gravity"]
STOP = INDEX["joint.stop"]
SHAFT_FRICTION = INDEX["friction.shaft"]
MUSCLE_FRICTION = INDEX["friction.muscle"]
PRESSURE_FLOOR = INDEX["friction.pressure_floor"]
FRICTION_STEP = INDEX["friction.time_step"]

# Behind the named values: the joint's condition, what is derived, the two valve curves.
LOCKED = len(_NAMES)
CRITICAL_RATIO = LOCKED + 1
CHOKED_FLOW = LOCKED + 2
SUBSONIC_FLOW = LOCKED + 3
FLOW_EXPONENT = LOCKED + 4
CURVE = LOCKED + 5
CURVE_SIZE = 1 + 2 * MAX_KNOTS
SIZE = CURVE + 2 * CURVE_SIZE


def refresh(p: np.ndarray) -> np.ndarray:
    """Fill in what follows from the named values: the constants of equation (5) that hold no pressure.

    Args:
        p: parameter vector (SIZE,), changed in place.

    Returns:
        The same vector.
    """
    k, gas, root_t = p[HEAT_RATIO], p[GAS_CONSTANT], np.sqrt(p[TEMPERATURE])
    p[CRITICAL_RATIO] = (2.0 / (k + 1.0)) ** (k / (k - 1.0))
    p[CHOKED_FLOW] = np.sqrt(k / gas * (2.0 / (k + 1.0)) ** ((k + 1.0) / (k - 1.0))) / root_t
    p[SUBSONIC_FLOW] = np.sqrt(2.0 * k / (gas * (k - 1.0))) / root_t
    p[FLOW_EXPONENT] = (k - 1.0) / k
    return p


def set_curve(p: np.ndarray, valve: int, voltage: np.ndarray, open_rate: np.ndarray) -> None:
    """Write the curve α = κ(u) of one valve into the vector.

    Args:
        p: parameter vector (SIZE,), changed in place.
        valve: 0 or 1.
        voltage: knots (K,) [V], increasing, at most ``MAX_KNOTS``.
        open_rate: open rates (K,) [-] at the knots.
    """
    start = CURVE + valve * CURVE_SIZE
    knots = len(voltage)
    p[start] = knots
    p[start + 1 : start + 1 + knots] = voltage
    p[start + 1 + MAX_KNOTS : start + 1 + MAX_KNOTS + knots] = open_rate


def changed(p: np.ndarray, changes: Mapping[str, float]) -> np.ndarray:
    """A copy of the vector with some named values set.

    Args:
        p: parameter vector (SIZE,).
        changes: new values by name.

    Returns:
        The new vector (SIZE,), refreshed.

    Raises:
        KeyError: a name that is no parameter.
    """
    result = p.copy()
    for name, value in changes.items():
        result[INDEX[name]] = value
    return refresh(result)
