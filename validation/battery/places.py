"""Where each effect of the battery sits in the equations, and what it depends on: the truth for a search.

Places and arguments have the names of learned laws; there is no law for ``line``. An effect has several places where
they are one function: a leak by a pressure is a valve that this pressure opens.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from pam_antagonist.rig.learned import Law

LEARNED = "learned"
"""Name of an effect whose law was measured."""


class Place(NamedTuple):
    """A place of an effect, and the arguments of its law."""

    places: frozenset[str]  # names of the place, any of which is right
    arguments: frozenset[str]  # any of which are right; a constant has none


def _place(places: str, arguments: str) -> Place:
    return Place(frozenset(places.split()), frozenset(arguments.split()))


_AIR, _PULL, _MOTION = "flow leak valve", "force strength torque", "length angle length_rate velocity speed"
PLACES: Mapping[str, Place] = {
    "hysteresis": _place(_PULL, _MOTION),
    "leak": _place(_AIR, "pressure"),
    "supply_droop": _place("supply", "draw valve_flow time"),
    "valve_lag": _place("valve command", "open_rate voltage"),
    "valve_offset": _place("valve flow command", "open_rate voltage time"),
    "line_resistance": _place("line sensor flow valve passage", "valve_flow pressure open_rate"),
    "pressure_sensor": _place("sensor", "pressure time"),
    "load_torque": _place(_PULL, "angle length"),
    "friction": _place("friction torque", "velocity speed"),
    "gear_friction": _place("friction torque", "angle velocity speed"),
    "creep": _place(_PULL, "pressure length angle time"),
    "thermal": _place(_AIR, "pressure valve_flow length_rate"),
    "external_torque": _place("torque", "time"),
    "valve_play": _place("valve command", "open_rate voltage"),
    "warm_up": _place(_PULL, "time"),
    "play": _place("encoder", "angle length"),
    "cogging": _place("torque", "angle length"),
    "bend": _place(_PULL, "pressure"),
    "crack": _place(_AIR, "length angle pressure"),
    "compressor": _place("supply", "draw time"),
    "ripple": _place("supply", "time"),
    "exchange": _place("exchange", "pressure_difference"),
    "swell": _place("volume flow", "pressure length_rate"),
    "crosstalk": _place("valve flow", "other_open_rate open_rate"),
    # Outside of every law.
    "check": _place("exchange", "pressure_difference"),
    "relief": _place(_AIR, "pressure"),
    "kink": _place("valve flow line passage", "length angle valve_flow"),
    "fold": _place("volume flow", "length angle length_rate"),
    "jet": _place(_AIR, "pressure"),
    "coil": _place("valve flow command", "open_rate voltage"),
    "damping": _place(f"{_PULL} friction", "length_rate velocity speed pressure"),
    "engage": _place(_PULL, "angle length"),
    "gauge_tube": _place("sensor line", "pressure"),
    "multiplexer": _place("sensor", "other_pressure pressure_difference"),
    "eccentric": _place("encoder", "angle length"),
}
"""Place of each effect of the battery, by its name."""
_OWN, _OF_JOINT = "pressure", "pressure_1 pressure_2"
LITERATURE: Mapping[str, Place] = {
    # Dry friction against the motion; a torque by the velocity is the same function.
    "rope": _place("friction torque", f"{_OF_JOINT} velocity speed"),
    "stick": _place("friction", "angle"),
    "press": _place("friction", f"pressure_sum {_OF_JOINT}"),
    "lean": _place("friction torque", "velocity"),
    "dwell": _place("friction", "speed velocity"),
    "pressure_loop": _place(_PULL, f"{_OWN} {_OF_JOINT} pressure_difference"),
    "pressure_play": _place(_PULL, f"{_OWN} {_OF_JOINT} pressure_difference"),
    "relaxation": _place(_PULL, f"{_OWN} {_OF_JOINT} pressure_difference"),
    "meter_loop": _place("meter", "torque"),
    # An opening counts by what passes the valve; behind a chamber, a line is a passage.
    "ball": _place("passage valve flow line", "pressure valve_flow open_rate"),
    "meter_out": _place("passage valve flow line", "valve_flow open_rate"),
    "silencer": _place("passage valve flow line", "valve_flow open_rate time"),
    "quick_exhaust": _place("passage valve flow line", "valve_flow open_rate"),
    "narrow_line": _place("sensor line", "pressure"),
    "stuck_bit": _place("valve command", "open_rate voltage"),
    "jitter": _place("valve command", "open_rate voltage"),
    "valve_creep": _place("valve command", "open_rate voltage"),
    "uneven_slew": _place("valve command", "open_rate voltage"),
    "crossover": _place("valve command", "open_rate voltage"),
    "arm": _place(_PULL, "angle length pressure_difference"),
    "loose": _place(_PULL, "length angle"),
    "bulge": _place("volume flow", "length angle length_rate"),
    "heat": _place(_PULL, "time pressure"),
    "give": _place(_PULL, "pressure length"),
    # The supply at one valve: a flow through that valve is the same function.
    "shared_line": _place("supply passage flow valve", "draw valve_flow other_pressure"),
    "lift": _place(_AIR, "pressure"),
    "exponent": _place("flow passage valve", "valve_flow open_rate pressure length_rate"),
    "seat": _place("flow valve", "pressure"),
}
"""Place of each effect of :mod:`forms_literature`, by its name."""
_EVERY = {**PLACES, **LITERATURE}


class Found(NamedTuple):
    """Where a diagnosis says that an effect sits."""

    place: tuple[str, ...]  # names of it, any of which may be meant; empty for an effect that only a package knows
    muscle: int | None  # None for both or none
    arguments: tuple[str, ...]  # of its law


def found(effect: Any) -> Found:
    """The place of an effect of a diagnosis: as it says, or that of the catalogue's law."""
    name = str(effect.name)
    if name != LEARNED:
        known = PLACES.get(name, Place(frozenset(), frozenset()))
        return Found(tuple(sorted(known.places)), effect.muscle, tuple(sorted(known.arguments)))
    law: Law = effect.law
    muscle = law.muscle if isinstance(law.muscle, int) else None
    return Found((law.place,), muscle, () if law.argument == "none" else (law.argument,))


def is_place(one: Found, effect: tuple[str, int | None]) -> bool:
    """Whether something was found where an effect sits: in its equation, and of its muscle where it has one."""
    name, muscle = effect
    return bool(_EVERY[name].places.intersection(one.place)) and (muscle is None or one.muscle in (None, muscle))


def are_arguments(one: Found, effect: tuple[str, int | None]) -> bool:
    """Whether a law in the right place depends on what the effect depends on, and on nothing else."""
    return is_place(one, effect) and bool(one.arguments) and _EVERY[effect[0]].arguments.issuperset(one.arguments)
