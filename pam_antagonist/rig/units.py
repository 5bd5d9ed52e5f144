"""A rig in words: readable units, such as mm² for orifices, where files use SI; and what its file claims unproven."""

from __future__ import annotations

import math
import re
from operator import attrgetter
from typing import NamedTuple

from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.rig.schema import Rig
from pam_antagonist.shown import listed, number
from pam_antagonist.strict_yaml import described, fields_of


class Unit(NamedTuple):
    """A readable unit."""

    name: str
    scale: float


_READABLE = {
    "m": Unit("mm", 1e3),
    "m²": Unit("mm²", 1e6),
    "m³": Unit("cm³", 1e6),
    "kg m²": Unit("kg cm²", 1e4),
    "kg/s": Unit("mg/s", 1e6),
    "Pa": Unit("kPa", 1e-3),
    "Pa/s": Unit("kPa/s", 1e-3),
    "Pa/kg": Unit("kPa/g", 1e-6),
    "Pa s/kg": Unit("kPa s/g", 1e-6),
    "N m Pa²": Unit("N m kPa²", 1e-6),
    "rad": Unit("°", math.degrees(1.0)),
    "rad/s": Unit("°/s", math.degrees(1.0)),
}
_SMALL = 1e-9
"""[m²] Smaller areas are shown in µm² instead of mm²."""
_LOW = 10.0
"""[Pa] Smaller pressures are shown in Pa instead of kPa."""
_EFFECTS = {parameter_path(effect.name, item.name): item.unit for effect in CATALOGUE.values()
            for item in effect.parameters}  # fmt: skip


def readable(unit: str, value: float = math.inf) -> Unit:
    """The readable unit of a quantity.

    `unit`: SI unit of the quantity, as in the description of a rig file or an effect. `value`: of the quantity in this
    unit, or the smallest of several; selects µm² or Pa for very small values.
    """
    written = re.sub(r"(?<=m)[23]\b", lambda found: "²³"[int(found[0]) - 2], unit)
    if written == "m²" and abs(value) < _SMALL:
        return Unit("µm²", 1e12)
    if written == "Pa" and 0.0 < abs(value) < _LOW:
        return Unit("Pa", 1.0)
    return _READABLE.get(written, Unit(written, 1.0))


def unit_of(rig: Rig, name: str) -> str:
    """The SI unit of a parameter of a rig file by its dotted path, ``-`` for a pure number."""
    if name in _EFFECTS:
        return _EFFECTS[name]
    part, _, last = name.rpartition(".")
    kind = type(attrgetter(part)(rig) if part else rig)
    first, *others = described(fields_of(kind)[last]).split("; ")
    # Coefficients of a force map have another unit in some forms.
    text = next((one for one in others if one.startswith(f"{rig.model.force}:")), first)
    found = re.search(r"\[([^\]]*)\]", text)
    return found[1] if found else "-"


def unread(rig: Rig) -> str:
    """What of a rig plant, controller and simulate do not read, in words; empty if nothing."""
    names = listed(tuple(rig.signals))
    parts = [f"do not read {names} (they take the value in the rig file throughout)"] if names else []
    parts += ["leave out weak laws"] if rig.weak_laws is not None else []
    if not parts:
        return ""
    lack = " and ".join(parts)
    return f"plant, controller and simulate {lack}; estimator, replay and the Python Estimator take all of it"


def assumption(rig: Rig, tuning: str = "default", identified: bool = False) -> str | None:
    """The uncertainty that a rig file claims without proof, in a sentence; None for an identified rig."""
    if rig.identified:
        return None
    considered = rig.tuning(tuning).consider
    claimed = [f"{name} ± {_size(rig.value(name), std)}" for name, std in rig.uncertainty.items() if considered]
    if considered and rig.directions:
        claimed.append(f"its {len(rig.directions)} directions")
    known = f"as well as its file claims ({', '.join(claimed)})" if claimed else "exactly, as its file claims,"
    its = "As configured, its" if identified else "Its"
    also = " The intervals of the identified rig follow from the recordings." if identified else ""
    return (
        f"Assumption: rig {rig.name} was not identified. {its} 95 % intervals are right if its parameters are known "
        f"{known} and if nothing else is wrong.{also}"
    )


def _size(value: float, std: float) -> str:
    """An uncertainty in per cent of the value; absolute where the value is 0."""
    return f"{number(100.0 * std / abs(value), 2)} %" if value else number(std, 2)
