"""A trend over time in values that scatter by more than their standard errors.

Two recordings of one joint on one day differ by more than their standard errors say: temperature, settling muscles, how
the joint was held. A line through the values that does not know of this finds trends everywhere. Here each value has an
error of its own and a deviation of its recording, whose variance is estimated beside the line (a random-effects
meta-regression: variance by restricted maximum likelihood, intervals after Knapp and Hartung, Statistics in Medicine
22, 2693, 2003).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

Floats = NDArray[np.float64]

FEWEST = 4
"""Values for a trend: with three, one degree of freedom is left, and an interval says nothing."""
_SHARE = 0.05


class Trend(NamedTuple):
    """A line through values over time."""

    middle: float  # mean time [the unit of the times]
    level: float  # of the line there
    slope: float  # per unit of time
    covariance: Floats  # of level and slope (2, 2)
    spread: float  # standard deviation between recordings, beside the errors of the values
    freedom: int
    p: float  # probability of such a slope if nothing changes

    @property
    def quantile(self) -> float:
        """Half width of a 95 % interval, in standard errors."""
        return float(student.ppf(0.975, self.freedom))

    def at(self, time: Floats) -> tuple[Floats, Floats]:
        """The line at times (N,), and its standard errors (N,)."""
        apart = time - self.middle
        errors = self.covariance[0, 0] + 2.0 * apart * self.covariance[0, 1] + apart**2 * self.covariance[1, 1]
        return self.level + self.slope * apart, np.sqrt(np.maximum(errors, 0.0))

    def change(self, span: float) -> tuple[float, float]:
        """Change over a span of time, and its standard error."""
        return self.slope * span, math.sqrt(self.covariance[1, 1]) * abs(span)

    def reaches(self, limit: float) -> tuple[float, float, float] | None:
        """When the line meets a limit: best estimate, earliest and latest (Fieller); None if it may never.

        The latest time is infinite where a line within the interval never meets it.
        """
        if self.slope == 0.0:
            return None
        a, b = self.level - limit, self.slope
        (caa, cab), (_, cbb) = self.covariance * self.quantile**2
        # (a + b x)² = q² Var(a + b x)
        square, mixed, plain = b * b - cbb, a * b - cab, a * a - caa
        inside = mixed * mixed - square * plain
        best = -a / b
        if square <= 0.0 or inside < 0.0:
            return None
        roots = sorted((-mixed + sign * math.sqrt(inside)) / square for sign in (-1.0, 1.0))
        return self.middle + best, self.middle + roots[0], self.middle + roots[1]


def trend(time: Floats, value: Floats, std: Floats) -> Trend:
    """Fit a line to values with standard errors.

    Args:
        time: of each value (N,), in any unit, not all the same; N is :data:`FEWEST` or more.
        value: the values (N,).
        std: their standard errors (N,).
    """
    middle = float(np.mean(time))
    design = np.column_stack([np.ones(len(time)), time - middle])
    # Errors of 0 would make one value decide alone.
    least = 1e-9 * max(float(np.max(np.abs(value))), 1e-300)
    own = np.maximum(std, least) ** 2

    def solved(variance: float) -> tuple[Floats, Floats, Floats, float]:
        weight = 1.0 / (own + variance)
        information = design.T @ (weight[:, None] * design)
        line = np.asarray(np.linalg.solve(information, design.T @ (weight * value)))
        rest = value - design @ line
        cost = float(np.sum(weight * rest**2) - np.sum(np.log(weight)) + np.linalg.slogdet(information)[1])
        return line, information, weight * rest**2, cost

    plain, *_ = np.linalg.lstsq(design, value, rcond=None)
    largest = float(np.var(value - design @ plain)) * len(value) + float(np.max(own))
    low, high = math.log(1e-6 * float(np.min(own)) + 1e-300), math.log(10.0 * largest)
    found = minimize_scalar(lambda log: solved(math.exp(log))[-1], bounds=(low, high), method="bounded").x
    variance = math.exp(found) if solved(math.exp(found))[-1] < solved(0.0)[-1] else 0.0
    line, information, squares, _ = solved(variance)
    freedom = len(time) - 2
    covariance = np.asarray(np.linalg.inv(information)) * max(float(np.sum(squares)) / freedom, 1.0)
    ratio = abs(float(line[1])) / math.sqrt(covariance[1, 1])
    p = 2.0 * float(student.sf(ratio, freedom))
    return Trend(middle, float(line[0]), float(line[1]), covariance, math.sqrt(variance), freedom, p)


def significant(probabilities: Sequence[float], share: float = _SHARE) -> list[bool]:
    """Which of several trends are there, with at most `share` of such tests wrong in any (Holm)."""
    out, order = [False] * len(probabilities), np.argsort(probabilities)
    for rank, k in enumerate(order):
        if probabilities[k] * (len(order) - rank) > share:
            break
        out[k] = True
    return out
