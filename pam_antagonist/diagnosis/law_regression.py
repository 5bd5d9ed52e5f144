"""Regressions of the residual equations on a table, judged on blocks of time that they were not fitted to.

Each channel is whitened by a Kalman filter with a random walk of its own, run over the data and every column of a
table. How strong the walk is follows anew for each law from the likelihood. Base directions are integrated out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.arguments import Group, law_columns, nodes_of, sides
from pam_antagonist.diagnosis.law_kernels import whitened_channel
from pam_antagonist.diagnosis.place_search import data_columns, noise_of, quiet_of, unit_of
from pam_antagonist.diagnosis.residual_equations import CHANNELS, Equations

Floats = NDArray[np.float64]

WALKS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Intensities of the channels' random walks; the first is none."""
FOLDS = 8
_SMOOTH = 1e-4
"""Precision of the second differences of a table, as a share of what the data know of its values."""


@dataclass(eq=False)
class Whitened:
    """A recording, whitened channel by channel.

    Attributes:
        one: its equations.
        folds: fold of each block (K,).
        data: data and base directions by channel and walk (C, L, 1 + D, K).
        logs: logarithm of the variances by channel, walk and fold (C, L, F).
        products: of the data and base directions with themselves (C, L, F, 1 + D, 1 + D).
        edges: first block of each fold, then the number of blocks (F + 1,).
    """

    one: Equations
    folds: NDArray[np.int64]
    data: Floats
    logs: Floats
    products: Floats
    edges: NDArray[np.int64]

    @classmethod
    def of(cls, one: Equations) -> Whitened:
        """Whiten a recording."""
        count = len(one.time)
        edges = np.linspace(0, count, FOLDS + 1).astype(np.int64)
        folds = np.repeat(np.arange(FOLDS), np.diff(edges))
        made = cls(one, folds, np.zeros(0), np.zeros(0), np.zeros(0), edges)
        inside, outside = data_columns(one)
        data = np.zeros((len(CHANNELS), len(WALKS), len(inside), count))
        logs = np.zeros((len(CHANNELS), len(WALKS), FOLDS))
        for c in range(len(CHANNELS)):
            for level in range(len(WALKS)):
                data[c, level], log = made.columns(c, level, inside, outside)
                logs[c, level] = np.add.reduceat(log, edges[:-1])
        parts = [data[..., edges[k] : edges[k + 1]] for k in range(FOLDS)]
        products = np.stack([part @ np.swapaxes(part, -1, -2) for part in parts], axis=2)
        made.data, made.logs, made.products = data, logs, products
        return made

    def columns(self, c: int, level: int, inside: Floats, outside: Floats) -> tuple[Floats, Floats]:
        """Whitened columns of a channel, and the logarithms of its variances.

        Args:
            c: the channel.
            level: index of the walk.
            inside: what the columns add over a block (N, K, 2).
            outside: what they add to the channels (N, K, 4).
        """
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
        return whitened_channel(
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


def grams(recordings: Sequence[Whitened], group: Group | None, nodes: Floats | None = None) -> Grams | None:
    """Products of the columns of a law with themselves and those of data and base.

    Args:
        recordings: whitened.
        group: the law; None for none.
        nodes: of its table (N,); None: found here.

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
        first, size = 1 + base, 1 + base + count
        made = np.zeros((len(CHANNELS), len(WALKS), FOLDS, size, size))
        made[..., :first, :first] = item.products
        if group is not None and nodes is not None:
            inside, outside = law_columns(item.one, group, nodes)
            inside, outside = inside * unit, outside * unit
            for c in range(len(CHANNELS)):
                if not (outside[:, :, c].any() or (c < 2 and inside[:, :, c].any())):
                    continue
                for level in range(len(WALKS)):
                    own = item.columns(c, level, inside, outside)[0]
                    rows = np.concatenate([item.data[c, level], own])
                    for fold in range(FOLDS):
                        part = slice(item.edges[fold], item.edges[fold + 1])
                        cross = rows[:, part] @ own[:, part].T
                        made[c, level, fold, :, first:] = cross
                        made[c, level, fold, first:, :] = cross.T
        products.append(made)
    return Grams(
        products,
        np.array([item.logs for item in recordings]),
        _precision(count),
        nodes if nodes is not None else np.zeros(0),
        unit,
        tuple(one.amounts for one in equations),
    )


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
    return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64), matrix


def _left(item: Floats, own: Floats) -> Floats:
    """Squares that a solution leaves of products (..., n, n)."""
    full = np.concatenate([[1.0], -own])
    return np.asarray((item @ full) @ full)


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
    inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    covariance = inverse[len(solution) - count :, len(solution) - count :] * given.unit**2
    parts = _split(given, solution)
    squares = np.array([_left(g[:, 0].sum(axis=1), own) for g, own in zip(given.products, parts, strict=True)])
    return Regression(
        group, given.nodes, solution[len(solution) - count :] * given.unit, covariance,
        tuple(part[: len(part) - count] for part in parts), walks, held, squares,
    )  # fmt: skip
