"""Where a learned law may stand: one row for each place, with all that is known of it.

A law of a rig acts in a hook of the equations (:mod:`~pam_antagonist.model.effects.learned`). No rig can hold an error
of the encoder.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

AIR, JOINT, VALVES, SENSORS = "air", "joint", "valves", "sensors"
"""Parts of a rig."""
_FLOWS = ("mass_loss", "open_rate", "open_rate_shift", "voltage_shift", "spool_voltage")
_FORCES = ("contraction_force", "muscle_force")
_EACH, _AND_BOTH = ("1", "2"), ("1", "2", "both")
_TIMES, _WIDTHS = (0.3, 1.0, 3.0, 10.0, 30.0), (0.1, 0.3, 0.6)


@dataclass(frozen=True)
class Place:
    """A place of the equations."""

    words: str  # {m} is the muscle, {v} its valve
    unit: str  # of a law's values
    hooks: tuple[str, ...] = ()  # in which a law of a rig acts; none: no rig can hold one
    # muscles at which a law is looked for, ``both``: by their own argument each; none: the place is the joint's.
    sides: tuple[str, ...] = ()
    part: str = JOINT  # part of the rig that errs
    alike: tuple[str, ...] = ()  # hooks of the catalogue's effects that act as a law here does
    arguments: tuple[str, ...] = ()  # by which a law is looked for
    with_memory: tuple[str, ...] = ()  # of them, or beside them, those that are tried with a memory
    step: float = 0.0  # of a value, at which derivatives of the model are taken
    also: tuple[str, ...] = ()  # what a law of a rig may depend on beside what it may everywhere
    only: tuple[str, ...] = ()  # all that it may depend on, and without a memory
    reads: str = ""  # of a sensor, what it reads: pressure, angle or torque
    times: tuple[float, ...] = _TIMES  # [s] of the lags that are tried
    fading: tuple[str, ...] = ("lag", "high_pass")  # operators that are tried with these times
    widths: tuple[float, ...] = _WIDTHS  # of the plays that are tried, as shares of the argument's range


TABLE: Mapping[str, Place] = {
    "flow": Place(
        "the flow into {m}", "kg/s", ("mass_loss",), _AND_BOTH, AIR, _FLOWS,
        ("none", "pressure", "other_pressure", "pressure_difference", "pressure_sum", "length", "length_rate",
         "valve_flow", "open_rate", "time"),
        ("pressure",), 1e-9, ("open_rate", "valve_flow"),
    ),
    "leak": Place(
        "a leak of {m}", "m2", ("mass_loss",), _EACH, AIR, _FLOWS, also=("open_rate", "valve_flow"),
    ),
    "exchange": Place(
        "the flow from muscle 1 to muscle 2", "kg/s", ("mass_loss",), (), AIR, ("mass_loss",),
        ("none", "pressure_difference", "pressure_sum", "angle", "velocity", "time"), ("pressure_difference",), 1e-9,
    ),
    "force": Place(
        "the force of {m}", "N", ("contraction_force",), _EACH, JOINT, _FORCES,
        ("none", "pressure", "other_pressure", "length", "length_rate", "velocity", "time"),
        ("pressure", "length"), 0.1,
    ),
    "strength": Place(
        "the strength of {m}", "-", ("contraction_force",), _AND_BOTH, JOINT, _FORCES,
        ("none", "pressure", "other_pressure", "length", "length_rate", "time"), ("pressure", "length"), 1e-3,
    ),
    "valve": Place(
        "the opening of {v}", "-", ("open_rate",), _AND_BOTH, VALVES, _FLOWS,
        ("none", "pressure", "other_pressure", "pressure_difference", "open_rate", "length", "time"), ("open_rate",),
        1e-3, ("open_rate",),
    ),
    "sensor": Place(
        "the sensor of {m}", "Pa", ("sensor_reading", "sensor_inverse"), _AND_BOTH, SENSORS, ("sensor_reading",),
        ("pressure", "other_pressure", "pressure_difference"), ("pressure",), 10.0, only=("pressure",),
        reads="pressure", times=(0.03, 0.1, 0.3), fading=("high_pass",),
    ),
    "torque": Place(
        "the torque on the joint", "N m", ("joint_torque",), (), JOINT, ("joint_torque",),
        ("none", "angle", "velocity", "pressure_1", "pressure_2", "pressure_difference", "pressure_sum", "time"),
        ("angle", "pressure_difference"), 1e-3,
    ),
    "damping": Place("the joint's viscous friction", "N m s/rad", ("joint_torque",)),
    "friction": Place(
        "the joint's friction", "N m", ("coulomb_torque",), (), JOINT, ("coulomb_torque",),
        ("none", "speed", "velocity", "angle", "pressure_1", "pressure_2", "pressure_sum", "time"), ("speed",), 1e-3,
        fading=("lag",), widths=(),
    ),
    "supply": Place(
        "the supply", "-", ("supply_change",), (), VALVES, ("supply_change",),
        ("none", "pressure_1", "pressure_2", "pressure_sum", "time"), ("draw",), 1e-3,
    ),
    "passage": Place(
        "the passage between {v} and its muscle", "-", ("mass_loss",), _AND_BOTH, VALVES, _FLOWS,
        ("pressure", "length", "valve_flow", "open_rate", "time"), (), 1e-3, ("open_rate", "valve_flow"),
    ),
    "volume": Place(
        "the volume of {m}", "-", ("swelling",), _EACH, AIR, (), ("pressure", "length"), (), 1e-3,
        only=("pressure", "length"),
    ),
    "command": Place(
        "the voltage at {v}", "V", ("spool_voltage",), _AND_BOTH, VALVES, _FLOWS, ("voltage",), ("voltage",), 1e-2,
        ("voltage",),
    ),
    "encoder": Place(
        "the encoder", "rad", (), (), SENSORS, (), ("angle",), ("angle",), 1e-4, reads="angle",
        fading=(), widths=(0.01, 0.03, 0.1),
    ),
    # By another argument, what the muscles lack would be an error of the meter.
    "meter": Place(
        "the torque meter", "N m", (), (), SENSORS, (), ("torque",), ("torque",), 1e-3, reads="torque",
        widths=(0.03, 0.1, 0.3, 0.6),
    ),
}  # fmt: skip
"""All places. Those of a rig are in the order of their codes in the parameter vector: a new one goes behind them."""


def sided(name: str) -> tuple[str, ...]:
    """A place with each muscle at which a law is looked for: ``flow_1``, ``flow_2``, ``flow_both``; or ``friction``."""
    return tuple(f"{name}_{side}" for side in TABLE[name].sides) or (name,)


def of_parts(parts: Collection[str]) -> tuple[str, ...]:
    """Places, with muscles, at which a law is looked for in some parts of a rig."""
    return tuple(at for name, place in TABLE.items() if place.part in parts for at in sided(name))
