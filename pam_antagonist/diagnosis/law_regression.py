"""Regressions of the residual equations on a table, judged on blocks of time that they were not fitted to.

Each channel is whitened by a Kalman filter with a random walk of its own, run over the data and every column of a
table. How strong the walk is follows anew for each law from the likelihood. Base directions are integrated out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.arguments import Group
from pam_antagonist.diagnosis.law_kernels import whitened
from pam_antagonist.diagnosis.residual_equations import CHANNELS, Equations
from pam_antagonist.rig.learned import Law

Floats = NDArray[np.float64]

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

    group: Group | None
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


def grams(recordings: Sequence[Whitened], group: Group | None) -> Grams | None:
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

    group: Group | None  # what it is; None for no law
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
