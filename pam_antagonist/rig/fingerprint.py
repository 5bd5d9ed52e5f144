"""Identity of a rig: a fingerprint of its physics, and the facts that the nodes of one joint must agree on.

Every node reads a rig file of its own. The files need not be *the same*: an estimator may use a rig that ``identify``
or ``close_loop`` has refined, or one with effects that a simulated plant lacks. The nodes must agree on the facts that
a refinement does not change, or changes only a little (:data:`FACTS`): the parts of the joint, and its limits. Equal
fingerprints mean equal physics.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.model import muscle
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig.schema import Rig

_NOT_PHYSICS = (
    "name", "source", "identified", "fitted", "encoder", "calibration", "uncertainty", "directions", "priors", "bounds",
    "tunings",
)  # fmt: skip
"""Fields of a rig file about recordings, the filter, fits, or for people: not physics of the joint."""
_DIGITS = 16
_LONGEST = 20_000  # of a text that is read [characters]
_LARGEST_NAME = 200
_LONGEST_WORD = 40

Value = float | str | bool | None


@dataclass(frozen=True)
class Fact:
    """A value on which the rigs of one joint agree."""

    name: str  # a dotted path of the rig file, or words for a computed value
    unit: str
    tolerance: float  # largest difference relative to the larger of both magnitudes; 0: none
    value: Callable[[Rig], Value]
    absolute: bool = False


def _path(name: str, unit: str = "", tolerance: float = 0.0) -> Fact:
    return Fact(name, unit, tolerance, attrgetter(name))


def _strength(index: int) -> Fact:
    """Force of a muscle at angle 0 and the supply's pressure."""
    return Fact(
        f"force of muscle {index + 1} at angle 0 and supply pressure", "N", _MAP,
        lambda rig: float(muscle.force(index, rig.geometry.length, rig.supply.pressure, rig.parameters())),
    )  # fmt: skip


def _opening(number: int) -> Fact:
    """Open rate of a valve at the middle of its voltages."""

    def value(rig: Rig) -> Value:
        curve = (rig.valve_1, rig.valve_2)[number - 1].curve
        middle = 0.5 * (rig.valves.voltage_min + rig.valves.voltage_max)
        return float(np.interp(middle, curve.voltage, curve.open_rate))

    return Fact(f"open rate of valve {number} at its middle voltage", "-", _OPEN, value, absolute=True)


# A value measured with a ruler or a gauge is known to a per cent; if it differs by five, it is another joint's.
_MEASURED = 0.05
# A force map is identified to some per cent; that of other muscles, or one with a wrong sign, differs by more.
_MAP = 0.25
# In a fit, areas trade off with polytropic indices and the curves, and may change by a third.
_AREA = 0.4
# Absolute, since a valve with a dead zone is nearly closed in the middle: a relative difference says nothing there.
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
"""The facts that must agree, with their tolerances."""


def fingerprint(rig: Rig) -> str:
    """Hash of a rig's physics, sixteen hex digits: model, parameters, valve curves, sensors, effects.

    It does not depend on name, comments, order, tunings, uncertainties and settings of fits. Default values are left
    out, so that a rig keeps its fingerprint when later versions have more parameters.
    """
    content = rig.plain(exclude=set(_NOT_PHYSICS), exclude_defaults=True, exclude_none=True)
    content["effects"] = _effects(rig.effects)
    text = json.dumps({name: value for name, value in content.items() if value != {}}, sort_keys=True, default=float)
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


def _effects(effects: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Effects that are present: an effect whose sizes are all 0 is absent."""
    out = {}
    for name, values in effects.items():
        items = {item.name: item for item in CATALOGUE[name].parameters}
        if any(items[key].is_size and value != 0.0 for key, value in values.items()):
            out[name] = {key: float(value) for key, value in values.items() if value != items[key].neutral}
    return out


@dataclass(frozen=True)
class RigIdentity:
    """Identity of the rig that a node was given.

    Attributes:
        name: of the rig.
        fingerprint: see :func:`fingerprint`.
        facts: value of each of :data:`FACTS`, by name.
        node: ``plant``, ``bridge``, ``estimator`` or ``controller``; empty: none.
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
        """The identity of a rig."""
        return cls(rig.name, fingerprint(rig), {fact.name: fact.value(rig) for fact in FACTS}, node)

    def text(self) -> str:
        """As one line of JSON, for a message."""
        content = {"node": self.node, "name": self.name, "fingerprint": self.fingerprint, "facts": dict(self.facts)}
        return json.dumps(content, ensure_ascii=False)

    @classmethod
    def read(cls, text: str) -> RigIdentity:
        """Read a text that :meth:`text` wrote, of this version or another.

        Raises:
            BadInput: the text is not such an identity.
        """
        try:
            content = json.loads(text) if len(text) <= _LONGEST else None
        except (ValueError, RecursionError):
            content = None
        content = content if isinstance(content, dict) else {}
        facts, words = content.get("facts"), [content.get(key) for key in ("node", "name", "fingerprint")]
        good = all(isinstance(word, str) and len(word) <= _LARGEST_NAME for word in words)
        if not (good and isinstance(facts, dict) and all(map(_usable, facts.values()))):
            raise BadInput(
                f"rig: {text[:60]!r} does not describe a rig: expected JSON with node, name, fingerprint and facts"
            )
        node, name, digits = (_clean(str(word)) for word in words)
        return cls(name, digits, facts, node)


def _usable(value: object) -> bool:
    return value is None or isinstance(value, (bool, float, str)) or (isinstance(value, int) and abs(value) < 2**53)


def differences(ours: RigIdentity, theirs: RigIdentity) -> list[str]:
    """Facts on which two rigs disagree, so that they cannot be of the same joint.

    A fact that only one of them has (from another version of this package) is skipped.

    Args:
        ours: the reference.
        theirs: the other one.

    Returns:
        A sentence for each fact; none if both may be of the same joint.
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
    """A text from another node as one line of printable characters, safe for a terminal."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
