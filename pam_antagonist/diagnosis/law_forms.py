"""What a law may be: a table at a place, of an argument, with a memory or none; and the columns of its values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.model.effects.places import TABLE
from pam_antagonist.model.linearised import remembered
from pam_antagonist.rig.learned import Law

Floats = NDArray[np.float64]

NODES, FINE = 8, 15
"""Nodes of a table, and of one for a law that is steep somewhere."""
SMOOTH = (1e-4, 1e-2)
"""Precisions of the second differences of a table that are tried, as a share of what the data know of its values."""


@dataclass(frozen=True)
class LawForm:
    """A table that may be a law: at a place, of an argument, with an operator and its time [s] or width."""

    place: str
    argument: str = "none"
    operator: str = "none"
    amount: float = 0.0
    number: int = NODES

    @classmethod
    def of(cls, law: Law) -> LawForm:
        """That of a law."""
        place = law.place if law.muscle is None else f"{law.place}_{law.muscle}"
        return cls(place, law.argument, law.operator, law.time or law.width, len(law.nodes))

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
    def muscles(self) -> tuple[int, ...]:
        """Muscles by which it is seen: of a law of both, each has it by its own argument; of the joint, the first."""
        if self.muscle == "both":
            return (1, 2)
        return (self.muscle if isinstance(self.muscle, int) else 1,)

    def is_of_term(self, other: LawForm) -> bool:
        """Whether it acts in the term of the equations in which another one acts."""
        alike = set(TABLE[self.kind].alike) & set(TABLE[other.kind].alike)
        return self.place == other.place or bool(alike and set(self.muscles) & set(other.muscles))

    @property
    def rests_at_zero(self) -> bool:
        """Whether it only damps: it is 0 at rest, where a constant would be a force of the base."""
        rates = self.argument in ("velocity", "length_rate") and self.operator == "none"
        return rates and self.kind in ("torque", "force", "strength")

    def argument_of(self, seen: Mapping[str, Floats], muscle: int, step: float) -> Floats:
        """What it depends on at a muscle (K,), with its memory.

        `seen`: every argument, by name. `step`: distance of their values [s].
        """
        number = 3 - muscle if self.argument == "other_pressure" else muscle
        name = self.argument.replace("other_", "")
        # What a recording does not show stays: regulators have no open rate, and trials no time since the start.
        values = seen.get(f"{name}_{number}", seen.get(name, np.zeros(len(seen["angle"]))))
        return operated(values, self.operator, self.amount, step)

    def law(self, nodes: Floats, values: Floats) -> Law:
        """Its table as a law."""
        if self.rests_at_zero:
            values = values - np.interp(0.0, nodes, values)
        time = self.amount if self.operator in ("lag", "high_pass") else 0.0
        return Law(
            self.kind, tuple(nodes.tolist()), tuple(values.tolist()), self.muscle, self.argument, self.operator, time,
            self.amount - time,
        )  # fmt: skip


def operated(values: Floats, operator: str, amount: float, step: float) -> Floats:
    """What an operator with memory makes of an argument (K,) in steps [s]; it starts at rest."""
    if operator == "none":
        return values
    lags = operator in ("lag", "high_pass")
    time = step * np.arange(len(values) + 1)
    # What is held at the end of each step: that at the begin of the next one.
    held = remembered(np.append(values, values[-1:]), time, np.full(len(time), step), amount, lags)[1:]
    return np.asarray(held if operator in ("lag", "play") else values - held)


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


def plain_groups(places: Sequence[str]) -> Iterator[LawForm]:
    """Laws without memory at some places."""
    for place in places:
        for argument in TABLE[LawForm(place).kind].arguments:
            yield LawForm(place, argument)


def groups_with_memory(places: Sequence[str], span: Callable[[LawForm], float]) -> Iterator[LawForm]:
    """Laws with memory at some places; ``span`` is the range of the argument of a law without memory."""
    for place in places:
        row = TABLE[LawForm(place).kind]
        for argument in row.with_memory:
            of_draw = argument == "draw"  # which a rig holds with a lag only
            for operator in ("lag",) if of_draw else row.fading:
                for time in row.times:
                    yield LawForm(place, argument, operator, time)
            for share in () if of_draw else row.widths:
                width = share * span(LawForm(place, argument))
                if width > 0.0:
                    yield LawForm(place, argument, "play", width)
                    yield LawForm(place, argument, "stop", width)


def roughness(count: int) -> Floats:
    """Precision of the second differences of a table (N, N)."""
    second = np.diff(np.eye(count), 2, axis=0) if count > 2 else np.zeros((0, count))
    return np.asarray(second.T @ second)
