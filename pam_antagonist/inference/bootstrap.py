"""Errors of many episodes with intervals: a bootstrap of blocks of neighbouring episodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

BLOCK = 10
"""Episodes that are drawn together: neighbouring ones err alike where a rig drifts."""
_LEAST_BLOCKS = 8
"""Blocks are shorter where there would be fewer: of one block all draws are the same."""
DRAWS = 1000
CHANCE = 0.05
"""Chance that any of the effects that were offered is taken although it is not there."""


class Interval(NamedTuple):
    """A value and its 95 % interval.

    Attributes:
        value: the value.
        low: lower end.
        high: upper end.
    """

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, draws: Floats, chance: float = CHANCE) -> Interval:
        """The interval of a bootstrap.

        Args:
            value: the value.
            draws: what it is in each draw (D,).
            chance: that it lies outside.
        """
        low, high = np.quantile(draws, [0.5 * chance, 1.0 - 0.5 * chance])
        return cls(float(value), float(low), float(high))


def drawn(episodes: int, seed: int = 0) -> Indices:
    """Episodes of each draw of a bootstrap of blocks (DRAWS, about E).

    Args:
        episodes: how many there are.
        seed: of the draws.
    """
    blocks = max(round(episodes / BLOCK), min(episodes, _LEAST_BLOCKS))
    edges = np.linspace(0, episodes, blocks + 1).round().astype(int)
    size = int(np.min(np.diff(edges)))
    which = np.random.default_rng(seed).integers(0, blocks, (DRAWS, blocks))
    return np.asarray((edges[which][:, :, None] + np.arange(size)).reshape(DRAWS, -1))


def rmse(sums: Floats, counts: Floats) -> Interval:
    """Root mean square error [deg] with its 95 % interval by episode.

    Args:
        sums: squared errors of each episode (E,) [rad²].
        counts: values in each (E,).
    """
    draws = drawn(len(sums))
    spread = np.sqrt(sums[draws].sum(axis=1) / counts[draws].sum(axis=1))
    return Interval.of(np.degrees(np.sqrt(sums.sum() / counts.sum())), np.degrees(spread))


def ratio(first: Floats, second: Floats, offered: int = 1) -> Interval:
    """Ratio of two sums over the same episodes, with an interval by episode.

    Args:
        first: of each episode (E,).
        second: likewise.
        offered: ratios among which this one was chosen: the interval is wider for it.
    """
    draws = drawn(len(first))
    spread = first[draws].sum(axis=1) / second[draws].sum(axis=1)
    return Interval.of(first.sum() / second.sum(), spread, CHANCE / offered)
