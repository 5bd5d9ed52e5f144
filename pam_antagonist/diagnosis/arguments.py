"""On what a missing effect may depend: arguments, operators with memory, and the columns of their tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.law_kernels import lagged, played
from pam_antagonist.diagnosis.residual_equations import CHANNELS, Equations

Floats = NDArray[np.float64]

NODES = 8
FINE = 15
"""Nodes of a table, and of one for a law that is steep somewhere."""
_TIMES = (0.3, 1.0, 3.0, 10.0, 30.0)
_SHORT = (0.03, 0.1, 0.3)
"""[s] Times of lag and high-pass, and those of a sensor."""
_WIDTHS = (0.1, 0.3, 0.6)
"""Widths of play as shares of the argument's range."""
_ARGUMENTS = {
    "flow": ("none", "pressure", "other_pressure", "pressure_difference", "pressure_sum", "length", "length_rate",
             "valve_flow", "open_rate", "time"),
    "valve": ("none", "pressure", "other_pressure", "pressure_difference", "open_rate", "length", "time"),
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
    "sensor": ("pressure",),
}  # fmt: skip


@dataclass(frozen=True)
class Group:
    """A table that may be a law: where it acts, and on what it depends.

    Attributes:
        place: name of the place.
        argument: as :mod:`~pam_antagonist.model.effects.learned` has it; ``none`` for a constant.
        operator: ``none``, ``lag``, ``high_pass``, ``play`` or ``stop``.
        amount: time [s] or width of the operator.
        number: of nodes.
    """

    place: str
    argument: str
    operator: str = "none"
    amount: float = 0.0
    number: int = NODES

    @property
    def kind(self) -> str:
        """Place without its muscle."""
        return (
            self.place.rsplit("_", 1)[0]
            if self.place[-2:] in ("_1", "_2") or self.place.endswith("_both")
            else self.place
        )

    @property
    def muscle(self) -> int | str | None:
        """1, 2 or ``both``; None of the joint."""
        end = self.place.rsplit("_", 1)[-1]
        return int(end) if end in ("1", "2") else "both" if end == "both" else None


def operated(values: Floats, operator: str, amount: float, step: float, fresh: NDArray[np.bool_]) -> Floats:
    """What an operator with memory makes of an argument; it starts at rest.

    Args:
        values: the argument (K,).
        operator: its name.
        amount: time [s], or width in the unit of the argument.
        step: length of a block [s].
        fresh: whether a block begins anew (K,).
    """
    if operator == "none":
        return values
    held = lagged(values, step / amount, fresh) if operator in ("lag", "high_pass") else played(values, amount, fresh)
    return held if operator in ("lag", "play") else values - held


def of_muscle(argument: str, muscle: int) -> str:
    """Name of a muscle's argument among those of the equations."""
    own = {"pressure": f"pressure_{muscle}", "other_pressure": f"pressure_{3 - muscle}"}
    ends = ("length", "length_rate", "open_rate", "valve_flow")
    return own.get(argument, f"{argument}_{muscle}" if argument in ends else argument)


def hats(values: Floats, nodes: Floats) -> Floats:
    """Piecewise linear functions of the nodes, constant outside (N, K)."""
    if len(nodes) == 1:
        return np.ones((1, len(values)))
    at = np.clip(np.searchsorted(nodes, values) - 1, 0, len(nodes) - 2)
    share = np.clip((values - nodes[at]) / (nodes[at + 1] - nodes[at]), 0.0, 1.0)
    out = np.zeros((len(nodes), len(values)))
    rows = np.arange(len(values))
    out[at, rows] = 1.0 - share
    out[at + 1, rows] += share
    return out


def sides(group: Group) -> list[tuple[str, int]]:
    """Places and muscles of a law: both muscles have it each by its own argument."""
    if group.muscle == "both":
        return [(f"{group.kind}_{i}", i) for i in (1, 2)]
    return [(group.place, group.muscle if isinstance(group.muscle, int) else 1)]


def argument_of(one: Equations, group: Group, muscle: int) -> Floats:
    """What a law depends on in a recording (K,).

    Args:
        one: the equations of the recording.
        group: the law.
        muscle: 1 or 2.
    """
    name = of_muscle(group.argument, muscle)
    values = np.zeros(len(one.time)) if name == "none" else one.arguments[name]
    return operated(values, group.operator, group.amount, one.step, one.fresh)


def nodes_of(group: Group, recordings: Sequence[Equations]) -> Floats:
    """Nodes of a table: between even ones and such with as many values each; one for a constant.

    Args:
        group: the law.
        recordings: their equations.
    """
    if group.argument == "none":
        return np.zeros(1)
    seen = [
        argument_of(one, group, muscle) for one in recordings for place, muscle in sides(group) if place in one.places
    ]
    values = np.concatenate(seen)
    low, high = np.quantile(values, [0.003, 0.997])
    if not high - low > 1e-9 * max(abs(high), 1e-12):
        return np.zeros(1)
    even = np.linspace(low, high, group.number)
    often = np.quantile(np.clip(values, low, high), np.linspace(0.0, 1.0, group.number))
    return np.asarray(0.5 * (even + often))


def law_columns(one: Equations, group: Group, nodes: Floats) -> tuple[Floats, Floats]:
    """Columns of the values of a law, over a block (N, K, 2) and to the channels (N, K, 4).

    Args:
        one: the equations of the recording.
        group: the law.
        nodes: of its table (N,).
    """
    count = len(one.time)
    inside, outside = np.zeros((len(nodes), count, 2)), np.zeros((len(nodes), count, len(CHANNELS)))
    for place, muscle in sides(group):
        if place in one.places:
            through, shown = one.places[place]
            shape = hats(argument_of(one, group, muscle), nodes)[:, :, None]
            inside += shape * through[None]
            outside += shape * shown[None]
    return inside, outside


def plain_groups(places: Sequence[str]) -> Iterator[Group]:
    """Laws without memory at some places."""
    for place in places:
        for argument in _ARGUMENTS.get(Group(place, "none").kind, ()):
            yield Group(place, argument)


def groups_with_memory(places: Sequence[str], span: Callable[[Group], float]) -> Iterator[Group]:
    """Laws with memory at some places.

    Args:
        places: where.
        span: range of the argument of a law without memory.
    """
    for place in places:
        kind = Group(place, "none").kind
        for argument in _WITH_MEMORY.get(kind, ()):
            operators = {"draw": ("lag",), "sensor": ("high_pass",)}
            for operator in operators.get(argument, operators.get(kind, ("lag", "high_pass"))):
                for time in _SHORT if kind == "sensor" else _TIMES:
                    yield Group(place, argument, operator, time)
            if argument != "draw":
                for share in _WIDTHS:
                    width = share * span(Group(place, argument))
                    if width > 0.0:
                        yield Group(place, argument, "play", width)
                        yield Group(place, argument, "stop", width)
