"""Errors of many episodes with intervals: a bootstrap of blocks of neighbouring episodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

BLOCK = 10
"""Episodes that are drawn together: neighbouring ones err alike where a rig drifts."""
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


def drawn(episodes: int, seed: int = 0) -> Indices:
    """Episodes of each draw of a bootstrap of blocks (DRAWS, about E).

    Args:
        episodes: how many there are.
        seed: of the draws.
    """
    blocks = max(1, round(episodes / BLOCK))
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
    low, high = np.quantile(spread, [0.025, 0.975])
    return Interval(*(float(np.degrees(value)) for value in (np.sqrt(sums.sum() / counts.sum()), low, high)))


def ratio(first: Floats, second: Floats, offered: int = 1) -> Interval:
    """Ratio of two sums over the same episodes, with an interval by episode.

    Args:
        first: of each episode (E,).
        second: likewise.
        offered: ratios among which this one was chosen: the interval is wider for it.
    """
    draws = drawn(len(first))
    spread = first[draws].sum(axis=1) / second[draws].sum(axis=1)
    low, high = np.quantile(spread, [0.5 * CHANCE / offered, 1.0 - 0.5 * CHANCE / offered])
    return Interval(float(first.sum() / second.sum()), float(low), float(high))
