"""Where a learned law may stand: one row for each place, with all that is known of it.

A law of a rig acts in a hook of the equations (:mod:`~pam_antagonist.model.effects.learned`). Three places are errors
of what was measured, which no rig can hold. What one unit at a place does to a recording is in
:mod:`~pam_antagonist.diagnosis.residual_equations`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

_AIR, _PULL, _TURN = ("air",), ("torque", "angle"), ("angle",)
_EVERYTHING = ("air", "torque", "angle")
_FLOWS = ("mass_loss", "open_rate", "open_rate_shift", "voltage_shift", "spool_voltage")
_FORCES = ("contraction_force", "muscle_force")
_EACH, _AND_BOTH = ("1", "2"), ("1", "2", "both")


@dataclass(frozen=True)
class Place:
    """A place of the equations."""

    words: str  # {m} is the muscle, {v} its valve
    unit: str  # of a law's values
    hooks: tuple[str, ...] = ()  # in which a law of a rig acts; none: no rig can hold one
    # muscles at which a law is looked for, ``both``: by their own argument each; none: the place is the joint's.
    sides: tuple[str, ...] = ()
    shown_in: tuple[str, ...] = _EVERYTHING  # parts of the model that it changes
    alike: tuple[str, ...] = ()  # hooks of the catalogue's effects that act as a law here does
    arguments: tuple[str, ...] = ()  # by which a law is looked for
    with_memory: tuple[str, ...] = ()  # of them, or beside them, those that are tried with a memory
    step: float = 0.0  # of a value, at which derivatives of the model are taken; 0: none are
    also: tuple[str, ...] = ()  # what a law of a rig may depend on beside what it may everywhere
    only: tuple[str, ...] = ()  # all that it may depend on, and without a memory


TABLE: Mapping[str, Place] = {
    "flow": Place(
        "the flow into {m}", "kg/s", ("mass_loss",), _AND_BOTH, _AIR, _FLOWS,
        ("none", "pressure", "other_pressure", "pressure_difference", "pressure_sum", "length", "length_rate",
         "valve_flow", "open_rate", "time"),
        ("pressure",), 1e-9, ("open_rate", "valve_flow"),
    ),
    "leak": Place(
        "a leak of {m}", "m2", ("mass_loss",), _EACH, _AIR, _FLOWS, also=("open_rate", "valve_flow"),
    ),
    "exchange": Place(
        "the flow from muscle 1 to muscle 2", "kg/s", ("mass_loss",), (), _AIR, ("mass_loss",),
        ("none", "pressure_difference", "pressure_sum", "angle", "velocity", "time"), ("pressure_difference",), 1e-9,
    ),
    "force": Place(
        "the force of {m}", "N", ("contraction_force",), _EACH, _PULL, _FORCES,
        ("none", "pressure", "other_pressure", "length", "length_rate", "velocity", "time"),
        ("pressure", "length"), 0.1,
    ),
    "strength": Place(
        "the strength of {m}", "-", ("contraction_force",), _AND_BOTH, _PULL, _FORCES,
        ("none", "pressure", "other_pressure", "length", "length_rate", "time"), ("pressure", "length"), 1e-3,
    ),
    "valve": Place(
        "the opening of {v}", "-", ("open_rate",), _AND_BOTH, _AIR, _FLOWS,
        ("none", "pressure", "other_pressure", "pressure_difference", "open_rate", "length", "time"), ("open_rate",),
        also=("open_rate",),
    ),
    "sensor": Place(
        "the sensor of {m}", "Pa", ("sensor_reading", "sensor_inverse"), _AND_BOTH, _EVERYTHING, ("sensor_reading",),
        ("pressure", "other_pressure", "pressure_difference"), ("pressure",), only=("pressure",),
    ),
    "torque": Place(
        "the torque on the joint", "N m", ("joint_torque",), (), _TURN, ("joint_torque",),
        ("none", "angle", "velocity", "pressure_1", "pressure_2", "pressure_difference", "pressure_sum", "time"),
        ("angle", "pressure_difference"), 1e-3,
    ),
    "damping": Place("the joint's viscous friction", "N m s/rad", ("joint_torque",)),
    "friction": Place(
        "the joint's friction", "N m", ("coulomb_torque",), (), _TURN, ("coulomb_torque",),
        ("none", "speed", "angle", "pressure_1", "pressure_2", "pressure_sum", "time"), (), 1e-3,
    ),
    "supply": Place(
        "the supply", "-", ("supply_change",), (), _AIR, ("supply_change",),
        ("none", "pressure_1", "pressure_2", "pressure_sum", "time"), ("draw",),
    ),
    "passage": Place(
        "the passage between {v} and its muscle", "-", ("mass_loss",), _AND_BOTH, _AIR, _FLOWS,
        ("pressure", "length", "valve_flow", "open_rate", "time"), also=("open_rate", "valve_flow"),
    ),
    "volume": Place(
        "the volume of {m}", "-", ("swelling",), _EACH, _AIR, (), ("pressure", "length"), (), 1e-3,
        only=("pressure", "length"),
    ),
    "encoder": Place("the encoder", "rad", arguments=("angle",), with_memory=("angle",)),
    "line": Place("the line of {m}", "rad", sides=_AND_BOTH),
    "meter": Place("the torque meter", "rad"),
}  # fmt: skip
"""All places. Those of a rig are in the order of their codes in the parameter vector: a new one goes behind them."""


def sided(name: str) -> tuple[str, ...]:
    """A place with each muscle at which a law is looked for: ``flow_1``, ``flow_2``, ``flow_both``; or ``friction``."""
    return tuple(f"{name}_{side}" for side in TABLE[name].sides) or (name,)


def by_derivatives(part: str) -> tuple[str, ...]:
    """Places, with muscles, of which the model's derivatives tell. `part`: which they change, ``air`` or ``angle``."""
    return tuple(at for name, place in TABLE.items() if place.step and part in place.shown_in for at in sided(name))
