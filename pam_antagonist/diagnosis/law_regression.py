"""What a law may depend on, and regressions of the residual equations on its table.

Laws are judged on blocks of time that they were not fitted to. Each channel is whitened by a Kalman filter with a
random walk of its own, run over the data and every column of a table. How strong the walk is follows anew for each law
from the likelihood. Base directions are integrated out.

Where the model errs shows without any law: an unknown input that is a random walk at one place, in all channels of all
recordings, has a likelihood there. Its intensity is that of the greatest one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.law_kernels import lagged, played, whitened
from pam_antagonist.diagnosis.residual_equations import CHANNELS, Equations
from pam_antagonist.model.effects.places import TABLE
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
_OF_A_MUSCLE = ("pressure", "other_pressure", "length", "length_rate", "open_rate", "valve_flow")


@dataclass(frozen=True)
class LawForm:
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


def plain_groups(places: Sequence[str]) -> Iterator[LawForm]:
    """Laws without memory at some places."""
    for place in places:
        for argument in TABLE[LawForm(place).kind].arguments:
            yield LawForm(place, argument)


def groups_with_memory(places: Sequence[str], span: Callable[[LawForm], float]) -> Iterator[LawForm]:
    """Laws with memory at some places; ``span`` is the range of the argument of a law without memory."""
    for place in places:
        kind = LawForm(place).kind
        for argument in TABLE[kind].with_memory:
            operators = {"draw": ("lag",), "sensor": ("high_pass",), "encoder": ()}
            for operator in operators.get(argument, operators.get(kind, ("lag", "high_pass"))):
                for time in _SHORT if kind == "sensor" else _TIMES:
                    yield LawForm(place, argument, operator, time)
            for share in () if argument == "draw" else _NARROW if kind == "encoder" else _WIDTHS:
                width = share * span(LawForm(place, argument))
                if width > 0.0:
                    yield LawForm(place, argument, "play", width)
                    yield LawForm(place, argument, "stop", width)


WALKS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Intensities of the channels' random walks; the first is none."""
FOLDS = 8
SMOOTH = 1e-4
"""Precision of the second differences of a table, as a share of what the data know of its values."""


class Whitened:
    """A recording, whitened channel by channel (C) with each walk (L), in folds (F).

    `edges`: first block of each fold, then the number of blocks (F + 1,). `data`: data and base directions (C, L, 1 +
    D, K). `logs`: logarithm of the variances (C, L, F). `products`: of data and base directions with themselves (C, L,
    F, 1 + D, 1 + D).
    """

    def __init__(self, one: Equations) -> None:
        self.one = one
        self.edges = np.linspace(0, len(one.time), FOLDS + 1).astype(np.int64)
        self._noise, self._at, self._quiet = one.seen, np.zeros((len(CHANNELS), len(one.time), 3)), one.quiet
        for c in range(len(CHANNELS)):
            if c < 2:
                self._at[c, :, c] = one.places[f"flow_{c + 1}"][0][:, c] * one.unit(f"flow_{c + 1}")
            else:
                there = np.isfinite(self._noise[:, c])
                self._at[c, :, 2] = np.sqrt(np.median(self._noise[there, c])) if there.any() else 1.0
        each = [[self.columns(c, level, *one.data_columns) for level in WALKS] for c in range(len(CHANNELS))]
        self.data = np.array([[data for data, _ in row] for row in each])
        self.logs = np.array([[np.add.reduceat(logs, self.edges[:-1]) for _, logs in row] for row in each])
        parts = [self.data[..., begin:end] for begin, end in self.folds]
        self.products = np.stack([part @ np.swapaxes(part, -1, -2) for part in parts], axis=2)

    @property
    def folds(self) -> list[tuple[int, int]]:
        """First and last block of each fold."""
        return list(zip(self.edges[:-1].tolist(), self.edges[1:].tolist(), strict=True))

    def columns(self, c: int, level: float, inside: Floats, outside: Floats) -> tuple[Floats, Floats]:
        """Whitened columns of a channel (N, K) beside a walk, and the logarithms of its variances (K,)."""
        one = self.one
        walk = level**2 * one.step * np.array([1.0, len(one.time)])
        white, logs = whitened(
            one.fresh, one.slope, self._noise[:, c, None], walk, self._at[c], self._quiet,
            np.array([c if c < 2 else -1]), inside, outside[:, :, c, None],
        )  # fmt: skip
        return white[:, :, 0], logs[:, 0]


@dataclass(frozen=True, eq=False)
class Grams:
    """Products of whitened columns of all recordings, for a law's columns beside the data's."""

    group: LawForm | None
    products: list[Floats]  # by recording: (C, L, F, n, n); data first, base directions, then the values of the law
    logs: Floats  # (R, C, L, F)
    nodes: Floats  # of the table (N,)
    unit: float  # of the values
    offsets: tuple[Floats, ...]  # of the base directions of each recording from the middle of their prior

    def solved(self, picked: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Amounts of all base directions and values, of products (n, n) of each recording; and their precision."""
        count, at = len(self.nodes), 0
        flat = np.concatenate(self.offsets)
        total = len(flat) + count
        matrix, right = np.zeros((total, total)), np.concatenate([-flat, np.zeros(count)])
        for item, own in zip(picked, self.offsets, strict=True):
            where = np.r_[at : at + len(own), len(flat) : total]
            matrix[np.ix_(where, where)] += item[1:, 1:]
            right[where] += item[1:, 0]
            at += len(own)
        prior = np.eye(total)
        if count:
            known = np.trace(matrix[-count:, -count:]) / count
            prior[-count:, -count:] = SMOOTH * known * roughness(count) + 1e-6 * np.eye(count) * max(known, 1e-9)
        matrix += prior
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64), matrix

    def left(self, products: Sequence[Floats], solution: Floats) -> list[Floats]:
        """Squares that a solution leaves of products (..., n, n) of each recording."""
        at, out = 0, []
        for item, own in zip(products, self.offsets, strict=True):
            full = np.r_[1.0, -solution[at : at + len(own)], -solution[len(solution) - len(self.nodes) :]]
            out.append(np.asarray((item @ full) @ full))
            at += len(own)
        return out


def roughness(count: int) -> Floats:
    """Precision of the second differences of a table (N, N)."""
    second = np.diff(np.eye(count), 2, axis=0) if count > 2 else np.zeros((0, count))
    return np.asarray(second.T @ second)


def grams(recordings: Sequence[Whitened], group: LawForm | None) -> Grams | None:
    """Products of the columns of a law, or of none, beside data and base; None if the argument does not move."""
    equations = [item.one for item in recordings]
    nodes, unit = np.zeros(0), 1.0
    if group is not None:
        nodes = group.nodes(equations)
        if len(nodes) == 1 and group.argument != "none":
            return None
        unit = min(one.unit(place) for one in equations for place, _ in group.sides if place in one.places)
    products = []
    for item in recordings:
        first = item.data.shape[2]
        size = first + len(nodes)
        made = np.zeros((len(CHANNELS), len(WALKS), FOLDS, size, size))
        made[..., :first, :first] = item.products
        if group is not None:
            inside, outside = (columns * unit for columns in group.columns(item.one, nodes))
            for c in range(len(CHANNELS)):
                if not (outside[:, :, c].any() or (c < 2 and inside[:, :, c].any())):
                    continue
                for k, level in enumerate(WALKS):
                    own = item.columns(c, level, inside, outside)[0]
                    rows = np.concatenate([item.data[c, k], own])
                    for fold, (begin, end) in enumerate(item.folds):
                        cross = rows[:, begin:end] @ own[:, begin:end].T
                        made[c, k, fold, :, first:] = cross
                        made[c, k, fold, first:, :] = cross.T
        products.append(made)
    logs = np.array([item.logs for item in recordings])
    return Grams(group, products, logs, nodes, unit, tuple(one.amounts for one in equations))


@dataclass(frozen=True, eq=False)
class Regression:
    """A law fitted to residual equations."""

    group: LawForm | None  # what it is; None for no law
    law: Law | None  # with its values in SI units
    base: tuple[Floats, ...]  # amounts of the base directions of each recording, in standard deviations
    level: bool  # whether no channel has a walk
    held_out: Floats  # logarithm of the likelihood of each fold, fitted to the others (F,) [nats]

    def gain(self, without: Regression) -> float:
        """Gain over another regression on held-out blocks [nats]."""
        return float(np.sum(self.held_out - without.held_out))


def regression(given: Grams, level: bool = False) -> Regression:
    """Fit a law, with the walk that is likeliest beside it, or without any."""
    recordings, channels = len(given.products), len(CHANNELS)
    walks = np.full((recordings, channels), 0 if level else len(WALKS) - 2)
    for _ in range(1 if level else 4):
        picked = [sum(g[c, walks[r, c]] for c in range(channels)) for r, g in enumerate(given.products)]
        solution, _ = given.solved([item.sum(axis=0) for item in picked])
        if level:
            break
        left = np.array([item.sum(axis=2) for item in given.left(given.products, solution)])
        before, walks = walks, np.argmin(left + given.logs.sum(axis=3), axis=2)
        if np.array_equal(before, walks):
            break
    by_fold = [sum(g[c, walks[r, c]] for c in range(channels)) for r, g in enumerate(given.products)]
    held = -0.5 * np.sum([[given.logs[r, c, walks[r, c]] for c in range(channels)] for r in range(recordings)], (0, 1))
    for fold in range(FOLDS):
        others, _ = given.solved([g.sum(axis=0) - g[fold] for g in by_fold])
        held[fold] -= 0.5 * sum(float(item) for item in given.left([g[fold] for g in by_fold], others))
    group, values = given.group, solution[len(solution) - len(given.nodes) :] * given.unit
    law = None if group is None or not values.any() else group.law(given.nodes, values)
    ends = np.cumsum([len(own) for own in given.offsets])
    base = tuple(np.split(solution[: ends[-1]], ends[:-1]))
    return Regression(group, law, base, bool(np.all(walks == 0)), held)


LEVELS = 10.0 ** np.arange(-3.0, 2.1, 1.0)
"""Intensities of a random walk, in the unit of a place that shows as much as the noise, per root of a second."""
_SHOWN_BY = np.array([0, 1, -1, -1])


class LikelyPlace(NamedTuple):
    """A place with an unknown input, and the gain of its likelihood over that without an input [nats]."""

    name: str
    gain: float


def _likelihood(one: Equations, place: str, level: float) -> float:
    """Logarithm of the likelihood of an input, the base directions integrated out, each with its prior."""
    at = np.zeros((len(one.time), 2 + len(CHANNELS)))
    walk = np.zeros(2)
    if place in one.places:
        at = np.column_stack(one.places[place]) * one.unit(place)
        walk = level**2 * one.step * np.array([1.0, len(one.time)])
    columns, logs = whitened(one.fresh, one.slope, one.seen, walk, at, one.quiet, _SHOWN_BY, *one.data_columns)
    white = columns.reshape(len(columns), -1)
    data, base = white[0], white[1:]
    gram, shared = base @ base.T + np.eye(len(base)), base @ data
    _, volume = np.linalg.slogdet(gram)
    return float(-0.5 * (data @ data - shared @ np.linalg.solve(gram, shared) + logs.sum() + volume))


def place_search(recordings: Sequence[Equations]) -> list[LikelyPlace]:
    """All places by the likelihood of an unknown input there, the likeliest first."""
    names = list(dict.fromkeys(name for one in recordings for name in one.places))
    nothing = sum(_likelihood(one, "", 0.0) for one in recordings)
    found = []
    for name in names:
        best: dict[float, float] = {}
        for factors in ((LEVELS,), (10.0**0.5, 10.0**-0.5)):
            top = max(best, key=lambda level: best[level], default=1.0)
            for level in np.ravel(factors) * top:
                best[level] = sum(_likelihood(one, name, level) for one in recordings)
        found.append(LikelyPlace(name, max(best.values()) - nothing))
    return sorted(found, key=lambda place: -place.gain)
