"""One measured ratio, and how it is taken on a machine that others use as well."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_ROUNDS = 15


@dataclass(frozen=True)
class Figure:
    """A ratio that was measured.

    Attributes:
        name: what it is called in the JSON.
        meaning: what was measured, and against what.
        value: the ratio (or a plain number with `unit`).
        wanted: bound in words, empty where there is none.
        holds: whether the bound holds; None where there is none.
        unit: ``×`` for a ratio.
        parts: the quantities behind it, by name with their unit.
    """

    name: str
    meaning: str
    value: float
    wanted: str
    holds: bool | None
    unit: str
    parts: dict[str, float]


def at_most(name: str, meaning: str, value: float, bound: float, unit: str, parts: dict[str, float]) -> Figure:
    """A figure that should not exceed a bound.

    Args:
        name: of the figure.
        meaning: what it is, in a sentence.
        value: as measured.
        bound: that it is compared with.
        unit: of both.
        parts: what it was computed from, by name.
    """
    return Figure(name, meaning, value, f"≤ {bound:g}", bool(value <= bound), unit, parts)


def at_least(name: str, meaning: str, value: float, bound: float, unit: str, parts: dict[str, float]) -> Figure:
    """A figure that should not fall below a bound.

    Args:
        name: of the figure.
        meaning: what it is, in a sentence.
        value: as measured.
        bound: that it is compared with.
        unit: of both.
        parts: what it was computed from, by name.
    """
    return Figure(name, meaning, value, f"≥ {bound:g}", bool(value >= bound), unit, parts)


def pairwise(
    numerator: Callable[[], object], denominator: Callable[[], object], rounds: int = _ROUNDS
) -> tuple[float, float, float]:
    """Time two callables in turn, so that a machine that slows down slows both.

    Args:
        numerator: what is measured.
        denominator: what it is measured against.
        rounds: how often each is timed, after one call that is not.

    Returns:
        Median of the ratios of neighbouring pairs, and the median time [s] of each.
    """
    numerator()
    denominator()
    times = np.empty((rounds, 2))
    for k in range(rounds):
        begin = time.perf_counter()
        numerator()
        middle = time.perf_counter()
        denominator()
        times[k] = middle - begin, time.perf_counter() - middle
    first, second = np.median(times, axis=0)
    return float(np.median(times[:, 0] / times[:, 1])), float(first), float(second)
