"""On what a missing effect depends: regressions of the residual equations on tables of what was measured.

Each channel is whitened by a Kalman filter with a random walk of its own, run over the data and every column of a
table. How strong the walk is follows anew for each law from the likelihood. Base directions are integrated out. A law
is judged on blocks of time that its values were not fitted to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import kernel
from pam_antagonist.diagnosis.place_search import data_columns, noise_of, quiet_of, unit_of
from pam_antagonist.diagnosis.residual_equations import CHANNELS, Equations

Floats = NDArray[np.float64]

WALKS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Intensities of the channels' random walks; the first is none."""
FOLDS = 8
NODES = 8
_SMOOTH = 1e-4
"""Precision of the second differences of a table, as a share of what the data know of its values."""
_TIMES = (0.3, 1.0, 3.0, 10.0, 30.0)
_WIDTHS = (0.1, 0.3, 0.6)
"""Widths of play as shares of the argument's range."""


@kernel
def _whitened(fresh, slope, noise, walk, inside, outside, state_seen, quiet, columns_in, columns_out):
    """Whitens columns of one channel by a filter of its error and of a random walk.

    Args:
        fresh: whether a block begins anew (K,).
        slope: of the error over a block (K,).
        noise: variance (K,), not finite where missing.
        walk: variance of its step, and at the begin.
        inside: what a unit of the walk does over a block (K,).
        outside: likewise, to the channel at once (K,).
        state_seen: 1 where the channel shows the error, else 0.
        quiet: variance of the error's step.
        columns_in: over a block (N, K).
        columns_out: to the channel (N, K).

    Returns:
        Whitened columns (N, K), and the logarithm of each variance (K,).
    """
    count, number = noise.shape[0], columns_in.shape[0]
    white, logs = np.zeros((number, count)), np.zeros(count)
    state = np.zeros((number, 2))
    p00, p01, p11 = 0.0, 0.0, 0.0
    for k in range(count):
        if fresh[k]:
            p00, p01, p11 = 4e8 * state_seen, 0.0, walk[1]
            state[:] = 0.0
        if np.isfinite(noise[k]):
            h0, h1 = state_seen, outside[k]
            g0, g1 = p00 * h0 + p01 * h1, p01 * h0 + p11 * h1
            spread = noise[k] + h0 * g0 + h1 * g1
            logs[k] = np.log(spread)
            scale = 1.0 / np.sqrt(spread)
            p00, p01, p11 = p00 - g0 * g0 / spread, p01 - g0 * g1 / spread, p11 - g1 * g1 / spread
            g0, g1 = g0 / spread, g1 / spread
            for n in range(number):
                left = columns_out[n, k] - h0 * state[n, 0] - h1 * state[n, 1]
                white[n, k] = left * scale
                state[n, 0] += g0 * left
                state[n, 1] += g1 * left
        a, b = slope[k], inside[k]
        for n in range(number):
            state[n, 0] = a * state[n, 0] + b * state[n, 1] + columns_in[n, k]
        p00 = a * a * p00 + 2.0 * a * b * p01 + b * b * p11 + quiet * state_seen
        p01 = a * p01 + b * p11
        p11 += walk[0]
    return white, logs


@dataclass(frozen=True)
class Group:
    """A table that may be a law: where it acts, and on what it depends.

    Attributes:
        place: name of the place.
        argument: as :mod:`~pam_antagonist.model.effects.learned` has it; ``none`` for a constant.
        operator: ``none``, ``lag``, ``high_pass``, ``play`` or ``stop``.
        amount: time [s] or width of the operator.
    """

    place: str
    argument: str
    operator: str = "none"
    amount: float = 0.0

    @property
    def kind(self) -> str:
        """Place without its muscle."""
        return self.place.rsplit("_", 1)[0] if self.place[-2:] in ("_1", "_2") or self.place.endswith("_both") else self.place

    @property
    def muscle(self) -> int | str | None:
        """1, 2 or ``both``; None of the joint."""
        end = self.place.rsplit("_", 1)[-1]
        return {"1": 1, "2": 2, "both": "both"}.get(end)


@dataclass(eq=False)
class Whitened:
    """A recording, whitened channel by channel.

    Attributes:
        one: its equations.
        folds: fold of each block (K,).
        data: data and base directions by channel and walk (C, L, 1 + D, K).
        logs: logarithm of the variances by channel, walk and fold (C, L, F).
    """

    one: Equations
    folds: NDArray[np.int64]
    data: Floats
    logs: Floats
    edges: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @classmethod
    def of(cls, one: Equations) -> Whitened:
        """Whiten a recording."""
        count = len(one.time)
        edges = np.linspace(0, count, FOLDS + 1).astype(np.int64)
        folds = np.repeat(np.arange(FOLDS), np.diff(edges))
        made = cls(one, folds, np.zeros(0), np.zeros(0), edges)
        inside, outside = data_columns(one)
        data = np.zeros((len(CHANNELS), len(WALKS), len(inside), count))
        logs = np.zeros((len(CHANNELS), len(WALKS), FOLDS))
        for c in range(len(CHANNELS)):
            for level in range(len(WALKS)):
                data[c, level], log = made.columns(c, level, inside, outside)
                logs[c, level] = np.add.reduceat(log, edges[:-1])
        made.data, made.logs = data, logs
        return made

    def columns(self, c: int, level: int, inside: Floats, outside: Floats) -> tuple[Floats, Floats]:
        """Whitened columns of a channel, and the logarithms of its variances."""
        one = self.one
        air = c < 2
        noise = noise_of(one)[:, c]
        zero = np.zeros(len(one.time))
        if air:
            through = one.places[f"flow_{c + 1}"][0][:, c] * unit_of(one, f"flow_{c + 1}")
            at, slope = zero, one.slope[:, c]
        else:
            there = np.isfinite(noise)
            through, slope = zero, zero
            at = np.full(len(zero), np.sqrt(np.median(noise[there])) if there.any() else 1.0)
        step = WALKS[level] ** 2 * one.step
        walk = np.array([step, step * len(zero)])
        given = inside[:, :, c] if air else np.zeros(inside.shape[:2])
        return _whitened(
            one.fresh, slope, noise, walk, through, at, float(air), quiet_of(one), given, outside[:, :, c]
        )  # type: ignore[no-any-return]


@dataclass(frozen=True, eq=False)
class Grams:
    """Products of whitened columns by recording, channel, walk and fold, for a law's columns beside the data's.

    Attributes:
        products: (R, C, L, F, n, n); data first, base directions of each recording, then the values of the law.
        logs: (R, C, L, F).
        precision: of the prior (n − 1, n − 1), of base and values.
        nodes: of the table (N,).
        unit: of the values.
        offsets: of the base directions of each recording from the middle of their prior.
    """

    products: list[Floats]
    logs: Floats
    precision: Floats
    nodes: Floats
    unit: float
    offsets: tuple[Floats, ...]


def operated(values: Floats, operator: str, amount: float, step: float, fresh: NDArray[np.bool_]) -> Floats:
    """What an operator with memory makes of an argument; it starts at rest."""
    if operator == "none":
        return values
    held = _lagged(values, step / amount, fresh) if operator in ("lag", "high_pass") else _played(values, amount, fresh)
    return held if operator in ("lag", "play") else values - held


@kernel
def _lagged(values, share, fresh):
    out = np.empty(values.shape[0])
    held = 0.0
    for k in range(values.shape[0]):
        if fresh[k]:
            held = values[k]
        else:
            held += (1.0 - np.exp(-share)) * (0.5 * (values[k] + values[k - 1]) - held)
        out[k] = held
    return out


@kernel
def _played(values, width, fresh):
    out = np.empty(values.shape[0])
    held = 0.0
    for k in range(values.shape[0]):
        if fresh[k]:
            held = values[k]
        held = min(max(held, values[k] - 0.5 * width), values[k] + 0.5 * width)
        out[k] = held
    return out


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
    """What a law depends on in a recording (K,)."""
    name = of_muscle(group.argument, muscle)
    values = np.zeros(len(one.time)) if name == "none" else one.arguments[name]
    return operated(values, group.operator, group.amount, one.step, one.fresh)


def nodes_of(group: Group, recordings: Sequence[Equations], number: int = NODES) -> Floats:
    """Nodes of a table: between even ones and such with as many values each; one for a constant."""
    if group.argument == "none":
        return np.zeros(1)
    seen = [
        argument_of(one, group, muscle) for one in recordings for place, muscle in sides(group) if place in one.places
    ]
    values = np.concatenate(seen)
    low, high = np.quantile(values, [0.003, 0.997])
    if not high - low > 1e-9 * max(abs(high), 1e-12):
        return np.zeros(1)
    even = np.linspace(low, high, number)
    often = np.quantile(np.clip(values, low, high), np.linspace(0.0, 1.0, number))
    return np.asarray(0.5 * (even + often))


def law_columns(one: Equations, group: Group, nodes: Floats) -> tuple[Floats, Floats]:
    """Columns of the values of a law, over a block (N, K, 2) and to the channels (N, K, 4)."""
    count = len(one.time)
    inside, outside = np.zeros((len(nodes), count, 2)), np.zeros((len(nodes), count, len(CHANNELS)))
    for place, muscle in sides(group):
        if place in one.places:
            through, shown = one.places[place]
            shape = hats(argument_of(one, group, muscle), nodes)[:, :, None]
            inside += shape * through[None]
            outside += shape * shown[None]
    return inside, outside


def grams(recordings: Sequence[Whitened], group: Group | None, nodes: Floats | None = None) -> Grams | None:
    """Products of the columns of a law with themselves and those of data and base.

    Args:
        recordings: whitened.
        group: the law; None for none.
        nodes: of its table; None: found here.

    Returns:
        None if the argument does not move.
    """
    equations = [item.one for item in recordings]
    count, unit = 0, 1.0
    if group is not None:
        nodes = nodes_of(group, equations) if nodes is None else nodes
        if len(nodes) == 1 and group.argument != "none":
            return None
        count = len(nodes)
        known = [unit_of(one, place) for one in equations for place, _ in sides(group) if place in one.places]
        unit = min(known, default=1.0)
    bases = [item.data.shape[2] - 1 for item in recordings]
    products = []
    for item, base in zip(recordings, bases, strict=True):
        size = 1 + base + count
        made = np.zeros((len(CHANNELS), len(WALKS), FOLDS, size, size))
        if group is not None and nodes is not None:
            inside, outside = law_columns(item.one, group, nodes)
            inside, outside = inside * unit, outside * unit
        for c in range(len(CHANNELS)):
            touched = group is not None and (outside[:, :, c].any() or (c < 2 and inside[:, :, c].any()))
            for level in range(len(WALKS)):
                rows = item.data[c, level]
                if touched:
                    rows = np.concatenate([rows, item.columns(c, level, inside, outside)[0]])
                for fold in range(FOLDS):
                    part = rows[:, item.edges[fold] : item.edges[fold + 1]]
                    made[c, level, fold, : len(rows), : len(rows)] = part @ part.T
        products.append(made)
    return Grams(products, np.array([item.logs for item in recordings]), _precision(count), nodes if nodes is not None else np.zeros(0), unit, tuple(one.amounts for one in equations))


def _precision(count: int) -> Floats:
    second = np.diff(np.eye(count), 2, axis=0) if count > 2 else np.zeros((0, count))
    return np.asarray(second.T @ second)


@dataclass(frozen=True, eq=False)
class Regression:
    """A law fitted to residual equations.

    Attributes:
        group: where it acts and on what it depends; None for no law.
        nodes: of its table (N,).
        values: in SI units (N,).
        covariance: of the values (N, N).
        base: amounts of the base directions of each recording, in standard deviations.
        walks: chosen walk of each recording and channel (R, C).
        held_out: logarithm of the likelihood of each fold, fitted to the others (F,) [nats].
        squares: of the whitened residuals without a walk (R, C), with all data.
    """

    group: Group | None
    nodes: Floats
    values: Floats
    covariance: Floats
    base: tuple[Floats, ...]
    walks: NDArray[np.int64]
    held_out: Floats
    squares: Floats

    def gain(self, without: Regression) -> float:
        """Gain over another regression on held-out blocks [nats]."""
        return float(np.sum(self.held_out - without.held_out))


def _assembled(given: Grams, picked: list[Floats]) -> tuple[Floats, Floats, float]:
    """Normal equations of all recordings: matrix, right side, and the data's own square."""
    count = len(given.precision)
    sizes = [item.shape[0] - 1 - count for item in picked]
    total = sum(sizes) + count
    matrix, right, square, at = np.zeros((total, total)), np.zeros(total), 0.0, 0
    for item, size in zip(picked, sizes, strict=True):
        where = np.r_[at : at + size, total - count : total]
        matrix[np.ix_(where, where)] += item[1:, 1:]
        right[where] += item[1:, 0]
        square += item[0, 0]
        at += size
    return matrix, right, square


def _prior(given: Grams, matrix: Floats) -> Floats:
    """Prior precision: one standard deviation for each base direction, smoothness for the table."""
    count = len(given.precision)
    prior = np.eye(len(matrix))
    if count:
        known = np.trace(matrix[-count:, -count:]) / count
        prior[-count:, -count:] = _SMOOTH * known * given.precision + 1e-6 * np.eye(count) * max(known, 1e-9)
    return prior


def _solved(given: Grams, picked: list[Floats]) -> tuple[Floats, Floats]:
    matrix, right, _ = _assembled(given, picked)
    matrix = matrix + _prior(given, matrix)
    flat = np.concatenate(given.offsets)
    right[: len(flat)] -= flat
    return np.linalg.solve(matrix, right), matrix


def _left(item: Floats, own: Floats) -> Floats:
    """Squares that a solution leaves of products (..., n, n)."""
    full = np.concatenate([[1.0], -own])
    return np.asarray(np.einsum("...ij,i,j->...", item, full, full))


def _split(given: Grams, solution: Floats) -> list[Floats]:
    count, at, out = len(given.precision), 0, []
    for item in given.products:
        size = item.shape[-1] - 1 - count
        out.append(np.r_[solution[at : at + size], solution[len(solution) - count :]])
        at += size
    return out


def regression(given: Grams, group: Group | None, level: bool = False) -> Regression:
    """Fit a law, with the walk that is likeliest beside it.

    Args:
        given: products of its columns.
        group: the law.
        level: without any walk.
    """
    recordings, channels = len(given.products), len(CHANNELS)
    walks = np.zeros((recordings, channels), dtype=np.int64)
    if not level:
        walks[:] = len(WALKS) - 2
    for _ in range(1 if level else 4):
        picked = [sum(g[c, walks[r, c]].sum(axis=0) for c in range(channels)) for r, g in enumerate(given.products)]
        solution, matrix = _solved(given, picked)
        if level:
            break
        before = walks.copy()
        for r, own in enumerate(_split(given, solution)):
            left = _left(given.products[r], own).sum(axis=2) + given.logs[r].sum(axis=2)
            walks[r] = np.argmin(left, axis=1)
        if np.array_equal(before, walks):
            break
    held = np.zeros(FOLDS)
    by_fold = [sum(g[c, walks[r, c]] for c in range(channels)) for r, g in enumerate(given.products)]
    logs = sum(given.logs[r, c, walks[r, c]] for r in range(recordings) for c in range(channels))
    for fold in range(FOLDS):
        others, _ = _solved(given, [g.sum(axis=0) - g[fold] for g in by_fold])
        held[fold] = -0.5 * sum(_left(g[fold], own) for g, own in zip(by_fold, _split(given, others), strict=True))
    held -= 0.5 * np.asarray(logs)
    count = len(given.precision)
    covariance = np.linalg.inv(matrix)[len(solution) - count :, len(solution) - count :] * given.unit**2
    parts = _split(given, solution)
    squares = np.array([_left(g[:, 0].sum(axis=1), own) for g, own in zip(given.products, parts, strict=True)])
    return Regression(
        group, given.nodes, solution[len(solution) - count :] * given.unit, covariance,
        tuple(part[: len(part) - count] for part in parts), walks, held, squares,
    )  # fmt: skip


_ARGUMENTS = {
    "flow": ("none", "pressure", "other_pressure", "pressure_difference", "pressure_sum", "length", "length_rate",
             "valve_flow", "open_rate", "time"),
    "valve": ("none", "pressure", "other_pressure", "pressure_difference", "open_rate", "length", "time"),
    "force": ("none", "pressure", "other_pressure", "length", "length_rate", "velocity", "time"),
    "strength": ("none", "pressure", "other_pressure", "length", "length_rate", "time"),
    "sensor": ("none", "pressure"),
    "exchange": ("none", "pressure_difference", "pressure_sum", "angle", "velocity", "time"),
    "supply": ("none", "pressure_1", "pressure_2", "pressure_sum", "time"),
    "torque": ("none", "angle", "velocity", "pressure_1", "pressure_2", "pressure_difference", "pressure_sum", "time"),
    "friction": ("none", "speed", "angle", "pressure_1", "pressure_2", "pressure_sum", "time"),
}  # fmt: skip
_WITH_MEMORY = {
    "flow": ("pressure",), "valve": ("open_rate",), "force": ("pressure", "length"), "strength": ("pressure", "length"),
    "exchange": ("pressure_difference",), "supply": ("draw",), "torque": ("angle", "pressure_difference"),
}  # fmt: skip


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
            operators = ("lag",) if argument == "draw" else ("lag", "high_pass")
            for operator in operators:
                for time in _TIMES:
                    yield Group(place, argument, operator, time)
            if argument != "draw":
                for share in _WIDTHS:
                    width = share * span(Group(place, argument))
                    if width > 0.0:
                        yield Group(place, argument, "play", width)
                        yield Group(place, argument, "stop", width)
