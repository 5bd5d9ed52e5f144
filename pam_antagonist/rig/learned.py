"""Learned laws of a rig: as a file has them, as numbers of the parameter vector, and as an entry of a report.

A file names place, argument and operator of a law (:mod:`pam_antagonist.model.effects.learned`). A rig in memory holds
numbers only, as of every effect: ``effects.learned.law1_value3`` is the third value of its first law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import learned, parameter_path, places
from pam_antagonist.strict_yaml import unknown

if TYPE_CHECKING:
    from pam_antagonist.rig.schema import Rig

LAWS = tuple(f"law{number}" for number in range(1, learned.LAWS + 1))
"""Names of the laws of a rig."""
_KEYS = ("place", "muscle", "argument", "operator", "time", "width", "nodes", "values")
OPERATORS = ("none", "lag", "high_pass", "play", "stop")
OWN = ("pressure", "other_pressure", "length", "length_rate")
EVERYWHERE = (
    "none", "pressure_1", "pressure_2", "pressure_difference", "pressure_sum", "angle", "velocity", "speed", "time"
)  # fmt: skip
_MOST_DIRECTIONS = 3
"""Most directions in which the filter carries the uncertainty of a law: each costs two sigma points."""
_PRIOR = 0.3
"""Prior standard deviation of a value without a given one, as a share of the law's largest value."""
_OF_READINGS = {"torque": "N m"}
"""What an error of readings may depend on beside what a law of a rig may."""
_SHOWN = {"Pa": ("kPa", 1e-3), "rad": ("°", math.degrees(1.0)), "rad/s": ("°/s", math.degrees(1.0)), "m": ("mm", 1e3)}
_ON = {
    "none": "nothing that was measured", "pressure_difference": "P1 - P2", "pressure_sum": "P1 + P2",
    "pressure_1": "P1", "pressure_2": "P2", "pressure": "its own pressure", "other_pressure": "the other pressure",
    "length": "its length", "length_rate": "the rate of its length", "open_rate": "the valve's open rate",
    "valve_flow": "the valve's flow", "draw": "the air that is drawn", "voltage": "its voltage",
    "time": "the time since the start", "torque": "its torque",
}  # fmt: skip


@dataclass(frozen=True)
class Law:
    """A learned law."""

    place: str  # where it acts, one of :data:`~pam_antagonist.model.effects.learned.PLACES`
    nodes: tuple[float, ...]  # of what it depends on [SI], increasing; 1 to 15
    values: tuple[float, ...]  # at the nodes, in the unit of the place
    muscle: int | str | None = None  # 1, 2 or ``both``; None at a place of the joint
    argument: str = "none"  # what it depends on, or the name of a signal of the rig
    operator: str = "none"  # ``none``, ``lag``, ``high_pass``, ``play`` or ``stop``
    time: float = 0.0  # of ``lag`` and ``high_pass`` [s]
    width: float = 0.0  # of ``play`` and ``stop``, in the unit of the argument
    std: tuple[float, ...] = ()  # standard deviations of the values; empty: not known
    # of the values (N, N); None where only the standard deviations are known: all are then taken to be wrong together.
    covariance: Any = field(default=None, compare=False, repr=False)

    def measured(self, values: np.ndarray, covariance: np.ndarray) -> Law:
        """The law with other values (N,) and their covariance (N, N)."""
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return replace(self, values=tuple(map(float, values)), std=tuple(map(float, std)), covariance=covariance)

    @property
    def at(self) -> str:
        """Place with its muscle: ``flow_2``; ``flow`` for both, ``friction`` for the joint."""
        return f"{self.place}_{self.muscle}" if self.muscle in (1, 2) else self.place

    @property
    def is_of_readings(self) -> bool:
        """Whether it is an error of sensors that no rig can hold; one can where a pressure is misread by itself."""
        return not places.TABLE[self.place].hooks or (
            self.place == "sensor" and (self.argument, self.operator) != ("pressure", "none")
        )

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return places.TABLE[self.place].unit

    @property
    def argument_unit(self) -> str:
        """Unit of the nodes."""
        return {**learned.ARGUMENTS, **_OF_READINGS}.get(self.argument, "SI")

    def value(self, argument: float) -> float:
        """The table: linear between the nodes, constant outside."""
        return float(np.interp(argument, self.nodes, self.values))

    @property
    def where(self) -> str:
        """Its place in words."""
        which = "both muscles" if self.muscle == "both" else f"muscle {self.muscle}"
        return places.TABLE[self.place].words.format(m=which, v=which.replace("muscle", "valve"))

    @property
    def on(self) -> str:
        """What it depends on, in words."""
        memory = {"lag": f" with a lag of {self.time:.2g} s", "high_pass": f", which fades within {self.time:.2g} s"}
        memory |= {"play": f" with a play of {self.shown(self.width)}", "stop": f", within {self.shown(self.width)}"}
        return _ON.get(self.argument, f"the {self.argument}") + memory.get(self.operator, "")

    @property
    def range_in_words(self) -> str:
        """The range that was seen, in words; empty for a constant."""
        if len(self.nodes) < 2:
            return ""
        return f", seen from {self.shown(self.nodes[0])} to {self.shown(self.nodes[-1])}"

    def shown(self, value: float, digits: int = 3) -> str:
        """A value of what it depends on, in the unit of reports."""
        name, scale = _SHOWN.get(self.argument_unit, (self.argument_unit, 1.0))
        return f"{value * scale:.{digits}g} {name}".removesuffix(" -")

    def in_words(self) -> str:
        """Place, argument and range, as a report says them."""
        return f"{self.where} depends on {self.on}{self.range_in_words}"

    def to_json(self) -> dict[str, Any]:
        """As an effect of report.json."""
        numbers = {"nodes": list(self.nodes), "values": list(self.values), "std": list(self.std), "unit": self.unit}
        seen = {"range": [self.nodes[0], self.nodes[-1]], "argument_unit": self.argument_unit}
        memory = {name: getattr(self, name) for name in ("operator", "time", "width")}
        return {
            "name": "learned",
            "place": self.at,
            "arguments": [] if self.argument == "none" else [self.argument],
            "law": {**numbers, **seen, **memory},
            "like": [],
        }

    def content(self) -> dict[str, Any]:
        """As a rig file has it, with what is not neutral."""
        entries = {key: getattr(self, key) for key in _KEYS}
        neutral = {"muscle": None, "operator": "none", "time": 0.0, "width": 0.0}
        return {key: entries[key] for key in _KEYS if key not in neutral or entries[key] != neutral[key]}

    def complaint(self, signals: Sequence[str] = ()) -> str:
        """What is wrong with it, in one line; empty if nothing is."""
        if self.place not in learned.PLACES:
            return f"place: {unknown(str(self.place), learned.PLACES)}; expected one of {', '.join(learned.PLACES)}"
        of_joint = self.place in learned.OF_JOINT
        if of_joint and self.muscle is not None:
            return f"muscle: {self.muscle}, expected none, since {self.place} is a place of the joint"
        if not of_joint and self.muscle not in (1, 2, "both"):
            return f"muscle: found {self.muscle!r}, expected 1, 2 or both, since {self.place} is a place of a muscle"
        known = self._arguments(signals)
        if self.argument not in known:
            return f"argument: {unknown(str(self.argument), known)}; expected, at {self.place}, {', '.join(known)}"
        return self._wrong_operator() or self._wrong_table()

    def _arguments(self, signals: Sequence[str]) -> list[str]:
        """What a law at this place may depend on."""
        place = places.TABLE[self.place]
        if place.only:
            return list(place.only)
        own = [*OWN, *place.also] if place.sides else ["draw"]
        return [*EVERYWHERE, *own, *(name for name in signals if name not in learned.ARGUMENTS)]

    @property
    def _is_bound(self) -> bool:
        """Whether its place allows few arguments, and no operator."""
        return bool(places.TABLE[self.place].only)

    def _wrong_operator(self) -> str:
        if self.operator not in OPERATORS:
            return f"operator: {unknown(str(self.operator), OPERATORS)}; expected one of {', '.join(OPERATORS)}"
        if self.operator != "none" and (self._is_bound or self.argument in ("none", "time")):
            what = f"the place {self.place}" if self._is_bound else f"the argument {self.argument}"
            return f"operator: {self.operator}, expected none with {what}"
        if self.argument == "draw" and self.operator != "lag":
            return f"operator: {self.operator}, expected lag with the argument draw"
        for name, operators in (("time", ("lag", "high_pass")), ("width", ("play", "stop"))):
            value = getattr(self, name)
            if not (math.isfinite(value) and (value > 0.0) == (self.operator in operators) and value >= 0.0):
                wanted = "above 0" if self.operator in operators else "none"
                return f"{name}: {value:g}, expected {wanted} with the operator {self.operator}"
        return ""

    def _wrong_table(self) -> str:
        count = len(self.nodes)
        if not 1 <= count <= learned.NODES:
            return f"nodes: {count} of them, expected 1 to {learned.NODES}"
        for name in ("values", "std"):
            if len(getattr(self, name)) != count and (name == "values" or self.std):
                return f"{name}: {len(getattr(self, name))} of them, expected {count}, one for each node"
        if not all(map(math.isfinite, (*self.nodes, *self.values, *self.std))):
            return "nodes and values: expected finite numbers"
        if not any(self.values):
            return "values: all are 0, expected one at least that is not; a law that adds nothing is left out"
        if (count == 1) != (self.argument == "none"):
            return f"nodes: {count} of them; expected one with the argument none, and two or more with others"
        for before, after in zip(self.nodes[:-1], self.nodes[1:], strict=True):
            if not after > before:
                return f"nodes: {after:g} follows {before:g}, expected increasing values [{self.argument_unit}]"
        if self.place == "sensor" and not np.all(np.diff(self.values) < np.diff(self.nodes)):
            return "values: they grow as fast as the nodes, expected readings that tell the pressures apart"
        return ""


def numbers_of(law: Law, number: int, signals: Sequence[str] = ()) -> dict[str, float]:
    """The numbers of a law, by their names in the catalogue. `law`: that has no complaint."""
    of_joint = law.muscle is None
    argument = law.argument
    if argument not in learned.ARGUMENTS:
        argument = f"signal{list(signals).index(argument) + 1}"
    operator = "clock" if argument == "time" else law.operator
    keeps = operator != "none"
    codes = {
        "place": 1 + list(learned.PLACES).index(law.place),
        "muscle": learned.MUSCLES.index("joint" if of_joint else str(law.muscle)),
        "argument": 1 + list(learned.ARGUMENTS).index(argument),
        "operator": 1 + learned.OPERATORS.index(operator),
        "count": len(law.nodes),
        "keeps_1": keeps and law.muscle in (1, "both"),
        "keeps_2": keeps and law.muscle in (2, "both"),
        "keeps": keeps and of_joint,
        "time": law.time,
        "width": law.width,
        **{f"node{k}": node for k, node in enumerate(law.nodes, 1)},
        **{f"value{k}": value for k, value in enumerate(law.values, 1)},
    }
    return {f"law{number}_{name}": float(value) for name, value in codes.items()}


def law_of(numbers: Mapping[str, float], number: int, signals: Sequence[str] = ()) -> Law | None:
    """A law from the numbers of the effect, by their names in the catalogue; None if there is no such law."""

    def of(name: str) -> float:
        return numbers.get(f"law{number}_{name}", 0.0)

    own = {key: value for key, value in numbers.items() if key.startswith(f"law{number}_") and value}
    if not own:
        return None
    try:
        argument = list(learned.ARGUMENTS)[int(of("argument")) - 1]
        if argument.startswith("signal"):
            argument = list(signals)[int(argument[-1]) - 1]
        operator = learned.OPERATORS[int(of("operator")) - 1]
        muscle = learned.MUSCLES[int(of("muscle"))]
        count = int(of("count"))
        law = Law(
            place=list(learned.PLACES)[int(of("place")) - 1],
            nodes=tuple(of(f"node{k}") for k in range(1, count + 1)),
            values=tuple(of(f"value{k}") for k in range(1, count + 1)),
            muscle={"1": 1, "2": 2, "joint": None}.get(muscle, muscle),
            argument=argument,
            operator="none" if operator == "clock" else operator,
            time=of("time"),
            width=of("width"),
        )
    except IndexError:
        raise BadInput(f"effects.learned.law{number}: its codes name no place, argument or operator") from None
    if not law.complaint(signals) and {k: v for k, v in numbers_of(law, number, signals).items() if v} != own:
        raise BadInput(f"effects.learned.law{number}: its numbers do not belong together; expected those of one law")
    return law


def complaint_about(numbers: Mapping[str, float], signals: Sequence[str] = ()) -> str:
    """What is wrong with the learned laws of a rig, by their numbers, in one line; empty if nothing is."""
    sensors: list[int | str | None] = []
    for number, name in enumerate(LAWS, 1):
        try:
            law = law_of(numbers, number, signals)
        except BadInput as error:
            return str(error)
        if law is None:
            continue
        if complaint := law.complaint(signals):
            return f"effects.learned.{name}.{complaint}"
        if law.place == "sensor":
            if sensors and (law.muscle in sensors or "both" in (law.muscle, *sensors)):
                return f"effects.learned.{name}.place: a second law of this sensor, expected one for each"
            sensors.append(law.muscle)
    return ""


def as_numbers(content: Mapping[str, Any], signals: Sequence[str] = ()) -> dict[str, Any]:
    """The content of ``effects.learned`` in a file as numbers; what is a number already stays."""
    out: dict[str, Any] = {}
    for name, given in content.items():
        if isinstance(given, (int, float)) and not isinstance(given, bool):
            out[name] = given
            continue
        where = f"effects.learned.{name}"
        if name not in LAWS:
            raise BadInput(f"effects.learned: {unknown(str(name), LAWS)}; expected one of {', '.join(LAWS)}")
        if not isinstance(given, Mapping):
            raise BadInput(f"{where}: expected entries {', '.join(_KEYS)}")
        law = _read(given, where)
        if complaint := law.complaint(signals):
            raise BadInput(f"{where}.{complaint}")
        out |= numbers_of(law, int(name.removeprefix("law")), signals)
    return out


def _read(given: Mapping[str, Any], where: str) -> Law:
    """A law of a file, whose entries are of the right kinds."""
    for key in given:
        if key not in _KEYS:
            raise BadInput(f"{where}: {unknown(str(key), _KEYS)}; expected one of {', '.join(_KEYS)}")
    for key in ("place", "nodes", "values"):
        if key not in given:
            raise BadInput(f"{where}.{key} is missing")

    def number(key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise BadInput(f"{where}.{key}: found {str(value)[:40]!r}, expected a number; decimals stand after a point")
        return float(value)

    entries: dict[str, Any] = {}
    for key in ("nodes", "values"):
        if not isinstance(given[key], (list, tuple)):
            raise BadInput(f"{where}.{key}: expected a list of numbers, as [0.0, 1.0]")
        entries[key] = tuple(number(key, value) for value in given[key])
    entries |= {key: number(key, given[key]) for key in ("time", "width") if key in given}
    entries |= {key: given[key] for key in ("place", "muscle", "argument", "operator") if key in given}
    return Law(**entries)


def value_path(number: int, node: int) -> str:
    """Dotted path of a value of a law, by the numbers of law and node, from 1 on."""
    return parameter_path("learned", f"law{number}_value{node}")


def laws_of(rig: Rig) -> dict[int, Law]:
    """The learned laws of a rig by their numbers, with the standard deviations that its filter carries."""
    numbers, signals = rig.effects.get("learned", {}), list(rig.signals)
    found = {number: law_of(numbers, number, signals) for number in range(1, learned.LAWS + 1)}
    out = {}
    for number, law in found.items():
        if law is not None:
            paths = [value_path(number, k) for k in range(1, len(law.values) + 1)]
            parts = [rig.uncertainty, *rig.directions.values()]
            std = tuple(math.hypot(*(part.get(path, 0.0) for part in parts)) for path in paths)
            out[number] = replace(law, std=std if any(std) else ())
    return out


def with_law(rig: Rig, law: Law, number: int | None = None) -> Rig:
    """The rig with a learned law, as the first free one or in place of that with this number, and its uncertainty.

    The filter carries the covariance of the values in three directions at most: the two largest, and one for what is
    left of each value's variance, as if these parts were wrong together. So each value keeps its standard deviation.
    """
    from pam_antagonist.rig.file import checked  # which imports this module

    taken = laws_of(rig)
    number = number or next((k for k in range(1, learned.LAWS + 1) if k not in taken), 0)
    if not 1 <= number <= learned.LAWS:
        raise BadInput(f"rig {rig.name}: it has {len(taken)} learned laws, expected at most {learned.LAWS}")
    if complaint := law.complaint(list(rig.signals)):
        raise BadInput(f"effects.learned.law{number}.{complaint}")
    path = parameter_path("learned", f"law{number}_")
    content = rig.plain()

    def without(part: Mapping[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in part.items() if not name.startswith(path)}

    others = rig.effects.get("learned", {}).items()
    old = {name: value for name, value in others if not name.startswith(f"law{number}_")}
    content["effects"] = {**rig.effects, "learned": {**old, **numbers_of(law, number, list(rig.signals))}}
    for name in ("uncertainty", "priors", "bounds"):
        content[name] = without(content[name])
    directions = {name: without(changes) for name, changes in rig.directions.items()}
    directions = {name: changes for name, changes in directions.items() if changes}
    std = np.array(law.std)
    paths = [value_path(number, k) for k in range(1, len(law.values) + 1)]
    for k, column in enumerate(_columns(std, law.covariance), 1):
        directions[f"law{number}_{k}"] = {name: float(step) for name, step in zip(paths, column, strict=True) if step}
    content["directions"] = directions
    usual = _PRIOR * max(map(abs, law.values))
    spread = [s if s > 0.0 else usual for s in std] or [usual] * len(paths)
    content["priors"].update(dict(zip(paths, map(float, spread), strict=True)))
    return checked(content, f"rig {rig.name}")


def _columns(std: np.ndarray, covariance: Any) -> list[np.ndarray]:
    """Changes of the values (N,) in independent directions, one standard deviation each."""
    if not np.any(std > 0.0):
        return []
    if covariance is None:
        return [std]
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=float))
    columns = list((vectors * np.sqrt(np.maximum(values, 0.0))).T[::-1])
    if len(columns) > _MOST_DIRECTIONS:
        columns = columns[: _MOST_DIRECTIONS - 1]
        columns.append(np.sqrt(np.maximum(std**2 - np.sum(np.square(columns), axis=0), 0.0)))
    return columns
