"""Profile likelihoods: the loss of likelihood when one parameter is held and all others are fitted anew.

A standard error is the curvature at the best fit. The profile shows whether the log likelihood really is a parabola.
Where it is flat, the recordings do not determine the parameter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, prior_cost, refit
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.unknown import Unknown

Floats = NDArray[np.float64]

_FRACTIONS = (0.0, 0.5)
"""Values of an effect's size, as shares of the best one; at these it must lose likelihood to count as determined."""
_NEAR = (-3.0, -1.5, 1.5, 3.0)
"""Values of an effect's size in standard errors from the best one, to compare the loss with the parabola."""
_CHI_SQUARE = 3.84
"""95 % of a chi-square with one degree of freedom."""


class Profile(NamedTuple):
    """The profile of one parameter."""

    best: float
    std: float
    value: Floats  # values at which it was held (K,), increasing
    loss: Floats  # of the log posterior at these values (K,), 0 at the best
    flat: bool  # whether half of the size explains the recordings as well


def effect_profile(experiment: Experiment, fitted: Fitted, parameter: Unknown, jobs: int = 1) -> Profile:
    """Profile of an effect's size in one recording: at 0, at half of the best value, and near the best value.

    `parameter`: a free size of the model that is not 0.
    """
    best = fitted.point.effects[parameter.path]
    k = len(fitted.covariance) - len(fitted.free) + fitted.free.index(parameter)
    std = float(np.sqrt(fitted.covariance[k, k])) * parameter.slope(best)
    far = [best * share for share in _FRACTIONS]
    near = [parameter.bounded(best + position * std) for position in _NEAR]
    starts = [fitted.point] * len(far) + [_along(fitted, k, parameter, value) for value in near]
    rises = Parallel(n_jobs=jobs, prefer="threads")(
        delayed(_rise)(experiment, fitted, start, parameter, value)
        for start, value in zip(starts, [*far, *near], strict=True)
    )
    _, half = rises[_FRACTIONS.index(0.5)]
    points = sorted([*zip([*far, *near], (rise for rise, _ in rises), strict=True), (best, 0.0)])
    value, rise = np.array(points).T
    return Profile(best, std, value, 0.5 * rise, half < _CHI_SQUARE)


def _along(fitted: Fitted, k: int, parameter: Unknown, value: float) -> Point:
    """The model with one parameter at another value, and the others moved by their covariance with it."""
    best = fitted.point.effects[parameter.path]
    step = parameter.coordinate(value) - parameter.coordinate(best)
    moved = fitted.covariance[:, k] / fitted.covariance[k, k] * step
    count = len(fitted.covariance) - len(fitted.free)
    effects = dict(fitted.point.effects)
    for other, change in zip(fitted.free, moved[count:], strict=True):
        now = effects.get(other.path, other.item.neutral)
        effects.update(dict.fromkeys(other.paths, other.bounded(other.value(other.coordinate(now) + float(change)))))
    return Point(fitted.point.theta + moved[:count], effects)


def _rise(
    experiment: Experiment, fitted: Fitted, start: Point, parameter: Unknown, value: float
) -> tuple[float, float]:
    """Least rise of −2 log posterior with one parameter held: in the scale of standard errors, and of evidence."""
    effects = {**start.effects, **dict.fromkeys(parameter.paths, value)}
    others = tuple(other for other in fitted.free if other != parameter)
    scale, begin = fitted.scale, Point(start.theta, effects)
    pace = scale.blocks_per_error
    moved = refit(experiment, begin, others, fitted.base, rounds=5, renewals=0, blocks_per_error=pace, beside=fitted)
    change = scale.misfits(moved.residual) - scale.misfits(fitted.residual)
    prior = prior_cost(experiment, moved.point.theta) - prior_cost(experiment, fitted.point.theta)
    as_error = max(float(scale.blocks_per_error / scale.length @ change) + prior, 0.0)
    return as_error, scale.share * (float(change.sum()) + prior)
