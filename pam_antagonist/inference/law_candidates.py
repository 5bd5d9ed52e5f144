"""Laws that episodes may teach: tables of what strength, friction, damping or a torque depends on, as candidates.

They are offered beside the effects of the catalogue. A table has more numbers than a law of the catalogue, which is
taken where it removes as much.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from typing_extensions import override

from pam_antagonist.inference.free_parameters import EFFECT_PARAMETERS, Candidate, FreeEffectParameter
from pam_antagonist.inference.law_responses import Responses
from pam_antagonist.model.effects import parameter_path
from pam_antagonist.model.effects.learned import LAWS, OF_JOINT
from pam_antagonist.rig.learned import Law, law_of, numbers_of, value_path

NODES = 5
"""Nodes of a law, at even shares of its argument's range."""
_RANGE = (0.01, 0.99)
"""Quantiles of what was seen of an argument, between which the nodes are; beyond, the table is constant."""
_PLACES = ("strength", "friction", "damping", "torque")
_MEMORIES = (0.03, 0.1, 0.3, 1.0)
"""[s] Time constants of laws with a lag, or that fade."""
_STOPS = (0.02, 0.06, 0.2)
"""[rad] Ways within which a law follows the angle, and then stays: a hysteresis of any form."""
_FROM_THE_START = ("time", "speed")
"""Arguments whose table is 0 at the first node, and not at the middle one: a constant belongs to the other numbers.
Only a constant friction may not be among them."""
_STRENGTH = 0.1
"""Scale of a change of the muscles' strength, and of the pressures' torque that is that of a torque or a friction."""


@dataclass(frozen=True)
class LawCandidate(Candidate):
    """A table at one place."""

    law: Law = Law("friction", (), ())  # with values of 0
    number: int = 1  # of the law in the rig
    signals: tuple[str, ...] = ()  # names of the rig's further signals
    still: int = 0  # index of the node whose value stays 0; −1 for none
    scale: float = 1.0  # of the values, in the unit of the place

    @property
    def name(self) -> str:
        """Its name in a report."""
        return f"learned: {self.law.where} by {self.law.on}"

    @property
    @override
    def constants(self) -> dict[str, float]:
        """What the law is made of, and its value that stays 0, by dotted path."""
        numbers = numbers_of(self.law, self.number, self.signals)
        return {parameter_path("learned", name): value for name, value in numbers.items()}

    @property
    @override
    def free(self) -> tuple[FreeEffectParameter, ...]:
        """The values that a fit moves."""
        paths = [value_path(self.number, k + 1) for k in self.moved]
        return tuple(FreeEffectParameter((path,), replace(EFFECT_PARAMETERS[path], scale=self.scale)) for path in paths)

    @property
    def moved(self) -> list[int]:
        """Indices of the nodes whose values a fit moves."""
        return [k for k in range(len(self.law.nodes)) if k != self.still]


def laws_in(effects: Mapping[str, float], signals: Sequence[str]) -> dict[int, Law]:
    """The learned laws of a model by their numbers. `effects`: values of its effects' parameters, by dotted path."""
    start = parameter_path("learned", "")
    numbers = {path.removeprefix(start): value for path, value in effects.items() if path.startswith(start)}
    found = {number: law_of(numbers, number, signals) for number in range(1, LAWS + 1)}
    return {number: law for number, law in found.items() if law is not None}


def law_candidates(
    seen: Responses, torque: float, known: Mapping[str, float], signals: tuple[str, ...]
) -> Iterator[LawCandidate]:
    """Laws that may be added to a model; none if it has as many as a rig can have.

    `torque`: typical torque of the muscles' pressures [N m]. `known`: values of the model's effects' parameters, by
    dotted path. `signals`: names of the rig's further signals, in their order.
    """
    taken = laws_in(known, signals)
    number = next((k for k in range(1, LAWS + 1) if k not in taken), None)
    if number is None:
        return
    has = [replace(law, nodes=(), values=()) for law in taken.values()]
    has_constant = "effects.friction.coulomb" in known or any(law.place == "friction" for law in has)
    for place in _PLACES:
        for muscle in (None,) if place in OF_JOINT else (1, 2):
            for law in _forms(place, muscle, signals):
                if law in has:
                    continue
                low, high = np.quantile(seen.argument(law), _RANGE)
                low = 0.0 if law.argument in _FROM_THE_START else low
                if not high > low:
                    continue
                nodes = tuple(map(float, np.linspace(low, high, NODES)))
                whole = replace(law, nodes=nodes, values=(0.0,) * NODES)
                still = 0 if law.argument in _FROM_THE_START else NODES // 2
                scale = _STRENGTH if place == "strength" else _STRENGTH * torque
                still = still if place != "friction" or has_constant else -1
                yield LawCandidate("learned", None, whole, number, signals, still, scale)


def _forms(place: str, muscle: int | None, signals: Sequence[str]) -> Iterator[Law]:
    """Arguments and operators at a place, the plain ones first."""
    inputs = [*(("pressure", "other_pressure") if muscle else ("pressure_1", "pressure_2")), *signals]
    ways = ("speed",) if place in ("friction", "damping") else ()
    for argument in ("time", "angle", "pressure_difference", "pressure_sum", *ways, *inputs):
        yield Law(place, (), (), muscle, argument)
    for argument in ("angle", *inputs):
        for time in _MEMORIES:
            if argument != "angle":
                yield Law(place, (), (), muscle, argument, "lag", time)
            yield Law(place, (), (), muscle, argument, "high_pass", time)
    for width in _STOPS:
        yield Law(place, (), (), muscle, "angle", "stop", width=width)
