"""The minimum of a sum of squares within bounds, by Gauss-Newton steps in a trust region.

scipy's routine takes the Jacobian of all recordings as one matrix. Each recording adds rows and columns to it, so that
time grows with the third power of their number, and memory with the second. Here the cost gives its normal equations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Floats = NDArray[np.float64]

_EVALUATIONS = 15
_TOLERANCE = 1e-5
"""The search ends with a step that gains less than this share of the cost, or is shorter than this share of the
point."""
_TRUSTED, _DOUBTFUL = 0.75, 0.25
"""Shares of the promised gain from which on the region grows, and below which it shrinks."""
_LEAST = 1e-12
"""Least radius."""


class Evaluated(NamedTuple):
    """The cost at a point.

    Attributes:
        cost: to be minimised.
        equations: gives its normal equations there: information (S, S) and the negative gradient (S,). Its argument
            says whether derivatives from nearby do not suffice.
    """

    cost: float
    equations: Callable[[bool], tuple[Floats, Floats]]


def minimise(
    evaluate: Callable[[Floats], Evaluated],
    start: Floats,
    low: Floats,
    high: Floats,
    weight: Floats,
    evaluations: int = _EVALUATIONS,
) -> tuple[Floats, float]:
    """The point and cost of a minimum within bounds.

    Args:
        evaluate: the cost at a point (S,).
        start: where to begin (S,).
        low: lower bounds (S,).
        high: upper bounds (S,).
        weight: of each value (S,); the length of a step is that of the weighted values.
        evaluations: how often the cost may be computed.
    """
    point = np.clip(start, low, high)
    now = evaluate(point)
    radius = max(float(np.linalg.norm(weight * point)), 1.0)
    information, pull = now.equations(False)
    renewed = False
    for _ in range(evaluations - 1):
        free = ~(((point <= low) & (pull < 0.0)) | ((point >= high) & (pull > 0.0)))
        step = np.zeros(len(point))
        step[free] = _within(information[np.ix_(free, free)], pull[free], weight[free], radius)
        step = np.clip(point + step, low, high) - point
        length = float(np.linalg.norm(weight * step))
        promised = float(pull @ step - 0.5 * step @ information @ step)
        tried = evaluate(point + step)
        gain = now.cost - tried.cost if np.isfinite(tried.cost) else -np.inf
        if gain <= 0.0 and not renewed:
            renewed, before = True, pull
            information, pull = now.equations(True)
            if not np.array_equal(before, pull):
                continue
        if gain <= 0.0 or gain < _DOUBTFUL * promised:
            radius = 0.25 * length
        elif gain > _TRUSTED * promised and length > 0.95 * radius:
            radius *= 2.0
        small = length < _TOLERANCE * (_TOLERANCE + float(np.linalg.norm(weight * point)))
        little = abs(gain) < _TOLERANCE * now.cost and gain >= _DOUBTFUL * promised
        if gain > 0.0:
            point, now = point + step, tried
        if small or little or radius < _LEAST:
            break
        if gain > 0.0:
            information, pull = now.equations(False)
            renewed = False
    return point, now.cost


def _within(information: Floats, pull: Floats, weight: Floats, radius: float) -> Floats:
    """The best step that is not longer than the radius, by damping (Moré and Sorensen 1983)."""
    damping, step = 0.0, np.zeros(len(pull))
    for _ in range(20):
        factor = cho_factor(information + np.diag(damping * weight**2), lower=True)
        step = cho_solve(factor, pull)
        length = float(np.linalg.norm(weight * step))
        if length <= (1.0 if damping == 0.0 else 1.05) * radius:
            break
        # Newton's step for 1/length = 1/radius, which is nearly linear in the damping.
        squared = weight**2 * step
        damping += length**2 / float(squared @ cho_solve(factor, squared)) * (length / radius - 1.0)
    return np.asarray(step)
