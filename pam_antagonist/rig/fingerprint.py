"""Which joint a rig file is about: a fingerprint of its physics, and what has to agree between the nodes of one joint.

Every node reads a rig file of its own. That all of them have *the same file* would be too much to ask: an estimator may
run a rig that ``identify`` or ``close_loop`` has refined, or one with effects that a simulated plant lacks. What has to
agree is what no refinement changes, or changes by little only (:data:`FACTS`): what the joint is built of, and within
what limits it is kept. The fingerprint tells the rest: equal ones stand for equal physics.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.model import muscle
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig.schema import Rig

_WORDS = (
    "name",
    "source",
    "identified",
    "encoder",
    "calibration",
    "uncertainty",
    "directions",
    "priors",
    "bounds",
    "tunings",
)
"""What a rig file says about recordings, the filter, fits, or to people: no part of the joint."""
_DIGITS = 16
_LONGEST = 20_000  # of a text that is read [characters]
_LARGEST_NAME = 200
_LONGEST_WORD = 40

Value = float | str | bool | None


@dataclass(frozen=True)
class Fact:
    """Something that the rigs of one joint agree about.

    Attributes:
        name: a dotted path of the rig file, or what is computed of it.
        unit: of the value; empty where it is no number.
        tolerance: largest difference relative to the larger of both magnitudes; 0: none.
        value: what a rig says.
        absolute: whether the tolerance is in the value's unit instead.
    """

    name: str
    unit: str
    tolerance: float
    value: Callable[[Rig], Value]
    absolute: bool = False


def _path(name: str, unit: str = "", tolerance: float = 0.0) -> Fact:
    def value(rig: Rig) -> Value:
        node: Any = rig
        for part in name.split("."):
            node = getattr(node, part)
        return node  # type: ignore[no-any-return]

    return Fact(name, unit, tolerance, value)


def _strength(index: int) -> Fact:
    """What a muscle of the joint in its middle position pulls with at the supply's pressure."""

    def value(rig: Rig) -> Value:
        return float(muscle.force(index, rig.geometry.length, rig.supply.pressure, rig.parameters()))

    return Fact(f"force of muscle {index + 1} at angle 0 and supply pressure", "N", _MAP, value)


def _opening(number: int) -> Fact:
    """How far a valve is open to the supply at the middle of its voltages."""

    def value(rig: Rig) -> Value:
        curve = (rig.valve_1, rig.valve_2)[number - 1].curve
        middle = 0.5 * (rig.valves.voltage_min + rig.valves.voltage_max)
        return float(np.interp(middle, curve.voltage, curve.open_rate))

    return Fact(f"open rate of valve {number} at its middle voltage", "-", _OPEN, value, absolute=True)


# What is measured with a ruler or a gauge is known to a per cent; a fit that moves it by five has found another joint.
_MEASURED = 0.05
# A force map is identified to some per cent; that of other muscles, or one with a sign turned, is further off.
_MAP = 0.25
# Areas trade off with polytropic indices and the curves in a fit, which may move them by a third.
_AREA = 0.4
# A valve with a dead zone is all but closed in the middle, so that no share of that says anything.
_OPEN = 0.15

FACTS: tuple[Fact, ...] = (
    _path("sample_period", "s"),
    _path("geometry.kind"),
    _path("geometry.radius", "m", _MEASURED),
    _path("geometry.length", "m", _MEASURED),
    _path("joint.stop", "rad", _MEASURED),
    _path("valves.voltage_min", "V"),
    _path("valves.voltage_max", "V"),
    _path("valves.sealed"),
    _path("supply.pressure", "Pa", _MEASURED),
    _path("atmosphere.pressure", "Pa", _MEASURED),
    _strength(0),
    _strength(1),
    *(_path(f"valve_{i}.{name}", "m²", _AREA) for i in (1, 2) for name in ("inflow_area", "outflow_area")),
    _opening(1),
    _opening(2),
)
"""What has to agree, and how closely."""


def fingerprint(rig: Rig) -> str:
    """Sixteen hex digits that stand for the physics of a rig: model, parameters, valve curves, sensors, effects.

    Name, comments, order, tunings, and what is said about uncertainties and for fits have no part in it. Values at
    their default are left out, so that a rig keeps its fingerprint when later versions know more parameters.
    """
    content = {name: value for name, value in _content(rig).items() if name not in _WORDS}
    content["effects"] = _effects(rig.effects)
    text = json.dumps({name: value for name, value in content.items() if value != {}}, sort_keys=True, default=float)
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


def _content(model: BaseModel) -> dict[str, Any]:
    kind: Any = type(model)
    fields: Mapping[str, Any] = getattr(kind, "model_fields", None) or kind.__fields__
    out = {}
    for name, field in fields.items():
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            out[name] = _content(value)
        elif value is not None and value != field.default:
            out[name] = value
    return out


def _effects(effects: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Those that are there: an effect without a size is none."""
    out = {}
    for name, values in effects.items():
        items = {item.name: item for item in CATALOGUE[name].parameters}
        if any(items[key].is_size and value != 0.0 for key, value in values.items()):
            out[name] = {key: float(value) for key, value in values.items() if value != items[key].neutral}
    return out


@dataclass(frozen=True)
class RigIdentity:
    """What a node tells about the rig that it was given.

    Attributes:
        name: of the rig.
        fingerprint: see :func:`fingerprint`.
        facts: name of each of :data:`FACTS` -> value.
        node: who tells it: ``plant``, ``bridge``, ``estimator``, ``controller``; empty: nobody.
    """

    name: str
    fingerprint: str
    facts: Mapping[str, Value]
    node: str = ""

    @override
    def __str__(self) -> str:
        return f"{self.name} ({self.fingerprint})"

    @classmethod
    def of(cls, rig: Rig, node: str = "") -> RigIdentity:
        """That of a rig."""
        return cls(rig.name, fingerprint(rig), {fact.name: fact.value(rig) for fact in FACTS}, node)

    def text(self) -> str:
        """As one line of JSON, for a message."""
        content = {"node": self.node, "name": self.name, "fingerprint": self.fingerprint, "facts": dict(self.facts)}
        return json.dumps(content, ensure_ascii=False)

    @classmethod
    def read(cls, text: str) -> RigIdentity:
        """What :meth:`text` wrote, here or in another version.

        Raises:
            BadInput: it is something else.
        """
        try:
            content = json.loads(text) if len(text) <= _LONGEST else None
        except (ValueError, RecursionError):
            content = None
        content = content if isinstance(content, dict) else {}
        facts, words = content.get("facts"), [content.get(key) for key in ("node", "name", "fingerprint")]
        good = all(isinstance(word, str) and len(word) <= _LARGEST_NAME for word in words)
        if not (good and isinstance(facts, dict) and all(map(_usable, facts.values()))):
            raise BadInput(f"rig: {text[:60]!r} tells of no rig: expected JSON with node, name, fingerprint and facts")
        node, name, digits = (_clean(str(word)) for word in words)
        return cls(name, digits, facts, node)


def _usable(value: object) -> bool:
    return value is None or isinstance(value, (bool, float, str)) or (isinstance(value, int) and abs(value) < 2**53)


def differences(ours: RigIdentity, theirs: RigIdentity) -> list[str]:
    """What two rigs do not agree about although they would if they were the same joint's.

    Facts that only one of them tells (another version of this package) are passed over.

    Args:
        ours: the one that is taken for granted.
        theirs: the other one.

    Returns:
        A sentence a fact; none where both may be the same joint's.
    """
    if ours.fingerprint == theirs.fingerprint:
        return []
    out = []
    for fact in FACTS:
        if fact.name not in ours.facts or fact.name not in theirs.facts:
            continue
        here, there = ours.facts[fact.name], theirs.facts[fact.name]
        if not _agree(here, there, fact):
            out.append(f"{fact.name} {_written(there, fact.unit)} rather than {_written(here, fact.unit)}")
    return out


def _agree(here: Value, there: Value, fact: Fact) -> bool:
    numbers = [value for value in (here, there) if isinstance(value, (int, float)) and not isinstance(value, bool)]
    if len(numbers) < 2:
        return here == there and type(here) is type(there)
    largest = max(abs(numbers[0]), abs(numbers[1]))
    if not math.isfinite(largest):
        return False
    return abs(numbers[0] - numbers[1]) <= max(fact.tolerance, 1e-9) * (1.0 if fact.absolute else largest)


def _written(value: Value, unit: str) -> str:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return f"{value:.6g} {unit}".rstrip(" -")
    return "none" if value is None else _clean(str(value))[:_LONGEST_WORD]


def _clean(text: str) -> str:
    """A text from elsewhere, as one line that does nothing to a terminal."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
