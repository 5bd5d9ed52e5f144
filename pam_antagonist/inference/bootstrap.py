"""Confidence intervals over many episodes, by a bootstrap of blocks of neighbouring episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

BLOCK = 10
"""Episodes in a block, which are drawn together: if a rig drifts, neighbouring episodes have similar errors."""
_LEAST_BLOCKS = 8
"""Least number of blocks; blocks of few episodes are shorter. With one block all draws would be the same."""
DRAWS = 1000
_STEPS = 300
CHANCE = 0.05
"""Probability that a value lies outside its interval, or that any of the offered effects is taken although absent."""


class Interval(NamedTuple):
    """A value and its 95 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, draws: Floats, chance: float = CHANCE) -> Interval:
        """The interval of a bootstrap. `draws`: its value in each draw (D,)."""
        low, high = np.quantile(draws, [0.5 * chance, 1.0 - 0.5 * chance])
        return cls(float(value), float(low), float(high))


def drawn(episodes: int, seed: int = 0) -> Indices:
    """Episodes of each draw of a bootstrap of blocks (DRAWS, about E)."""
    blocks = max(round(episodes / BLOCK), min(episodes, _LEAST_BLOCKS))
    edges = np.linspace(0, episodes, blocks + 1).round().astype(int)
    size = int(np.min(np.diff(edges)))
    which = np.random.default_rng(seed).integers(0, blocks, (DRAWS, blocks))
    return np.asarray((edges[which][:, :, None] + np.arange(size)).reshape(DRAWS, -1))


def steps(spans: Sequence[tuple[int, int]], slopes: Floats, left: Floats, seed: int = 0) -> Floats:
    """Changes of fitted parameters in draws of a bootstrap by episode, each by one Gauss-Newton step (D, K).

    Args:
        spans: first row of each episode, and the row after its last (E,).
        slopes: derivatives of the residual at the fit (N, K).
        left: residual at the fit (N,).
    """
    squares = np.stack([slopes[a:b].T @ slopes[a:b] for a, b in spans])
    pulls = np.stack([slopes[a:b].T @ left[a:b] for a, b in spans])
    draws = drawn(len(spans), seed)[:_STEPS]
    return np.array([-np.linalg.lstsq(squares[d].sum(axis=0), pulls[d].sum(axis=0), rcond=None)[0] for d in draws])


def rmse(sums: Floats, counts: Floats) -> Interval:
    """Root mean square error [deg] with its 95 % interval by episode.

    `sums`: squared errors of each episode (E,) [rad²]. `counts`: number of values of each episode (E,).
    """
    draws = drawn(len(sums))
    spread = np.sqrt(sums[draws].sum(axis=1) / counts[draws].sum(axis=1))
    return Interval.of(np.degrees(np.sqrt(sums.sum() / counts.sum())), np.degrees(spread))


def ratio(first: Floats, second: Floats, offered: int = 1) -> Interval:
    """Ratio of two sums over the same episodes, with an interval by episode.

    `first`: of each episode (E,). `offered`: number of ratios from which this one was chosen; the interval is corrected
    for it.
    """
    draws = drawn(len(first))
    spread = first[draws].sum(axis=1) / second[draws].sum(axis=1)
    return Interval.of(first.sum() / second.sum(), spread, CHANCE / offered)
