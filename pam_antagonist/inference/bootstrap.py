"""Confidence intervals over many episodes, by a bootstrap of blocks of neighbouring episodes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

Floats = NDArray[np.float64]

BLOCK = 10
"""Episodes in a block, which are drawn together: if a rig drifts, neighbouring episodes have similar errors."""
_LEAST_BLOCKS = 8
"""Least number of blocks; blocks of few episodes are shorter. With one block all draws would be the same."""
DRAWS = 1000
_STEPS = 300
CHANCE = 0.05
"""Probability that a value lies outside its interval, or that any of the offered effects is taken although absent."""


class Interval(NamedTuple):
    """A value and its 95 % interval; NaN at both ends where the episodes do not determine the value."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, draws: Floats, chance: float = CHANCE) -> Interval:
        """The interval of a bootstrap.

        A step along parameters that replace each other, or into a bound, may lead away from the value in all draws.
        Then they tell nothing about its error.

        `draws`: its value in each draw (D,).
        """
        low, high = np.quantile(draws, [0.5 * chance, 1.0 - 0.5 * chance])
        rounding = 1e-9 * max(abs(value), float(np.max(np.abs(draws))))
        if not low - rounding <= value <= high + rounding:
            return cls(float(value), np.nan, np.nan)
        return cls(float(value), min(float(low), float(value)), max(float(high), float(value)))

    @property
    def is_known(self) -> bool:
        """Whether there is an interval."""
        return bool(np.isfinite(self.low) and np.isfinite(self.high))

    @property
    def std(self) -> float:
        """Standard deviation of a normal value with this interval; NaN where there is none."""
        return (self.high - self.low) / (2.0 * 1.96)


def _blocks(episodes: int) -> int:
    return max(round(episodes / BLOCK), min(episodes, _LEAST_BLOCKS))


def _wider(episodes: int) -> float:
    """By how much draws have to be spread: a bootstrap of n blocks is too narrow, like a variance over n and not n − 1.

    Source: Hesterberg (2015), "What teachers should know about the bootstrap", expanded percentile interval.
    """
    blocks = max(_blocks(episodes), 2)
    student, normal = t.ppf(1.0 - 0.5 * CHANCE, blocks - 1), norm.ppf(1.0 - 0.5 * CHANCE)
    return math.sqrt(blocks / (blocks - 1)) * float(student / normal)


def drawn(episodes: int, seed: int = 0) -> Floats:
    """How often each episode is in each draw of a bootstrap of blocks (DRAWS, E)."""
    blocks = _blocks(episodes)
    edges = np.linspace(0, episodes, blocks + 1).round().astype(int)
    which = np.random.default_rng(seed).integers(0, blocks, (DRAWS, blocks))
    times = np.stack([np.bincount(draw, minlength=blocks) for draw in which])
    return np.repeat(times, np.diff(edges), axis=1).astype(np.float64)


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
    wider = _wider(len(spans))
    return wider * np.array([-np.linalg.lstsq(np.tensordot(d, squares, 1), d @ pulls, rcond=None)[0] for d in draws])


def rmse(sums: Floats, counts: Floats) -> Interval:
    """Root mean square error [deg] with its 95 % interval by episode.

    `sums`: squared errors of each episode (E,) [rad²]. `counts`: number of values of each episode (E,).
    """
    draws = drawn(len(sums))
    error, spread = np.sqrt(sums.sum() / counts.sum()), np.sqrt((draws @ sums) / (draws @ counts))
    return Interval.of(np.degrees(error), np.degrees(np.maximum(error + _wider(len(sums)) * (spread - error), 0.0)))


def ratio(first: Floats, second: Floats, offered: int = 1) -> Interval:
    """Ratio of two sums over the same episodes, with an interval by episode.

    `first`: of each episode (E,). `offered`: number of ratios from which this one was chosen; the interval is corrected
    for it.
    """
    draws = drawn(len(first))
    spread = (draws @ first) / (draws @ second)
    return Interval.of(first.sum() / second.sum(), spread, CHANCE / offered)
