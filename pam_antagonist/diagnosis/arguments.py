"""On what a missing effect may depend: arguments, operators with memory, and the columns of their tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.law_kernels import lagged, played
from pam_antagonist.diagnosis.residual_equations import CHANNELS, Equations
from pam_antagonist.rig.learned import Law

Floats = NDArray[np.float64]

NODES, FINE = 8, 15
"""Nodes of a table, and of one for a law that is steep somewhere."""
_TIMES = (0.3, 1.0, 3.0, 10.0, 30.0)
_SHORT = (0.03, 0.1, 0.3)
"""[s] Times of lag and high-pass, and those of a sensor."""
_WIDTHS = (0.1, 0.3, 0.6)
_NARROW = (0.01, 0.03, 0.1)
"""Widths of play as shares of the argument's range, and those of an encoder."""
_ARGUMENTS = {
    "flow": ("none", "pressure", "other_pressure", "pressure_difference", "pressure_sum", "length", "length_rate",
             "valve_flow", "open_rate", "time"),
    "valve": ("none", "pressure", "other_pressure", "pressure_difference", "open_rate", "length", "time"),
    "passage": ("pressure", "length", "valve_flow", "open_rate", "time"),
    "volume": ("pressure", "length"),
    "force": ("none", "pressure", "other_pressure", "length", "length_rate", "velocity", "time"),
    "strength": ("none", "pressure", "other_pressure", "length", "length_rate", "time"),
    "sensor": ("pressure", "other_pressure", "pressure_difference"), "encoder": ("angle",),
    "exchange": ("none", "pressure_difference", "pressure_sum", "angle", "velocity", "time"),
    "supply": ("none", "pressure_1", "pressure_2", "pressure_sum", "time"),
    "torque": ("none", "angle", "velocity", "pressure_1", "pressure_2", "pressure_difference", "pressure_sum", "time"),
    "friction": ("none", "speed", "angle", "pressure_1", "pressure_2", "pressure_sum", "time"),
}  # fmt: skip
_WITH_MEMORY = {
    "flow": ("pressure",), "valve": ("open_rate",), "force": ("pressure", "length"), "strength": ("pressure", "length"),
    "exchange": ("pressure_difference",), "supply": ("draw",), "torque": ("angle", "pressure_difference"),
    "sensor": ("pressure",), "encoder": ("angle",),
}  # fmt: skip
_OF_A_MUSCLE = ("pressure", "other_pressure", "length", "length_rate", "open_rate", "valve_flow")


@dataclass(frozen=True)
class Group:
    """A table that may be a law: at a place, of an argument, with an operator and its time [s] or width."""

    place: str
    argument: str = "none"
    operator: str = "none"
    amount: float = 0.0
    number: int = NODES

    @property
    def kind(self) -> str:
        """Place without its muscle."""
        return self.place.rsplit("_", 1)[0] if self.muscle is not None else self.place

    @property
    def muscle(self) -> int | str | None:
        """1, 2 or ``both``; None of the joint."""
        end = self.place.rsplit("_", 1)[-1]
        return int(end) if end in ("1", "2") else "both" if end == "both" else None

    @property
    def sides(self) -> list[tuple[str, int]]:
        """Places and muscles: of a law of both, each has it by its own argument."""
        if self.muscle == "both":
            return [(f"{self.kind}_{i}", i) for i in (1, 2)]
        return [(self.place, self.muscle if isinstance(self.muscle, int) else 1)]

    @property
    def rests_at_zero(self) -> bool:
        """Whether it only damps: it is 0 at rest, where a constant would be a force of the base."""
        rates = self.argument in ("velocity", "length_rate") and self.operator == "none"
        return rates and self.kind in ("torque", "force", "strength")

    def argument_of(self, one: Equations, muscle: int) -> Floats:
        """What it depends on in a recording, at a muscle (K,)."""
        if self.argument == "none":
            return np.zeros(len(one.time))
        name = f"{self.argument}_{muscle}" if self.argument in _OF_A_MUSCLE else self.argument
        if self.argument == "other_pressure":
            name = f"pressure_{3 - muscle}"
        # What a drive does not have stays: a regulator shows no open rate.
        values = one.arguments.get(name, np.zeros(len(one.time)))
        return operated(values, self.operator, self.amount, one.step, one.fresh)

    def nodes(self, recordings: Sequence[Equations]) -> Floats:
        """Nodes of its table; one for a constant."""
        if self.argument == "none":
            return np.zeros(1)
        seen = [self.argument_of(one, muscle) for one in recordings for at, muscle in self.sides if at in one.places]
        return nodes_of(np.concatenate(seen), self.number)

    def columns(self, one: Equations, nodes: Floats) -> tuple[Floats, Floats]:
        """Columns of its values, over a block (N, K, 2) and to the channels (N, K, 4)."""
        shape = (len(nodes), len(one.time))
        inside, outside = np.zeros((*shape, 2)), np.zeros((*shape, len(CHANNELS)))
        for place, muscle in self.sides:
            if place in one.places:
                through, shown = one.places[place]
                columns = hats(self.argument_of(one, muscle), nodes)[:, :, None]
                if self.rests_at_zero:
                    columns = columns - hats(np.zeros(1), nodes)[:, :, None]
                inside += columns * through[None]
                outside += columns * shown[None]
        return inside, outside

    def law(self, nodes: Floats, values: Floats) -> Law:
        """Its table as a law."""
        if self.rests_at_zero:
            values = values - np.interp(0.0, nodes, values)
        time = self.amount if self.operator in ("lag", "high_pass") else 0.0
        return Law(
            self.kind, tuple(nodes.tolist()), tuple(values.tolist()), self.muscle, self.argument, self.operator, time,
            self.amount - time,
        )  # fmt: skip


def operated(values: Floats, operator: str, amount: float, step: float, fresh: NDArray[np.bool_]) -> Floats:
    """What an operator with memory makes of an argument (K,) in steps [s]; it starts at rest where a stretch begins."""
    if operator == "none":
        return values
    held = lagged(values, step / amount, fresh) if operator in ("lag", "high_pass") else played(values, amount, fresh)
    return held if operator in ("lag", "play") else values - held


def nodes_of(values: Floats, number: int) -> Floats:
    """Nodes of a table, between even ones and such with as many values each; one if the values do not move."""
    low, high = np.quantile(values, [0.003, 0.997])
    if not high - low > 1e-9 * max(abs(high), 1e-12):
        return np.zeros(1)
    even = np.linspace(low, high, number)
    often = np.quantile(np.clip(values, low, high), np.linspace(0.0, 1.0, number))
    return np.asarray(0.5 * (even + often))


def hats(values: Floats, nodes: Floats) -> Floats:
    """Piecewise linear functions of the nodes, constant outside (N, K)."""
    if len(nodes) == 1:
        return np.ones((1, len(values)))
    return np.array([np.interp(values, nodes, one) for one in np.eye(len(nodes))])


def plain_groups(places: Sequence[str]) -> Iterator[Group]:
    """Laws without memory at some places."""
    for place in places:
        for argument in _ARGUMENTS.get(Group(place).kind, ()):
            yield Group(place, argument)


def groups_with_memory(places: Sequence[str], span: Callable[[Group], float]) -> Iterator[Group]:
    """Laws with memory at some places; ``span`` is the range of the argument of a law without memory."""
    for place in places:
        kind = Group(place).kind
        for argument in _WITH_MEMORY.get(kind, ()):
            operators = {"draw": ("lag",), "sensor": ("high_pass",), "encoder": ()}
            for operator in operators.get(argument, operators.get(kind, ("lag", "high_pass"))):
                for time in _SHORT if kind == "sensor" else _TIMES:
                    yield Group(place, argument, operator, time)
            for share in () if argument == "draw" else _NARROW if kind == "encoder" else _WIDTHS:
                width = share * span(Group(place, argument))
                if width > 0.0:
                    yield Group(place, argument, "play", width)
                    yield Group(place, argument, "stop", width)
