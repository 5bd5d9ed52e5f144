"""Fits of large calibrations, which start with the base parameters as configured.

A zero of 2°, or a clock that is 50 ms early, biases base parameters that are fitted without it. A fit that begins there
may not find the way back. So each calibration is tried in several sizes beside the base as configured, and the best of
them are fitted from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from pam_antagonist.diagnosis.candidates import as_configured
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.gauss_newton import Fitted, prior_cost, refit
from pam_antagonist.inference.likelihood import Equations
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.starts import best_of_starts

_SIZES = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Values that are tried, in scales of the calibration, in either direction."""
_NEAR = 0.05
"""Tolerance of the best value at which a fit begins, in scales of the calibration."""
_FITTED = 2
"""Calibrations of a recording that are fitted, those with the best scores."""


class _Score(NamedTuple):
    cost: float
    value: float
    candidate: Candidate


def fits(experiment: Experiment, fitted: Fitted, candidates: Sequence[Candidate]) -> dict[str, Fitted]:
    """The calibrations that do best beside the base as configured, fitted from there, by name."""
    start = as_configured(experiment, fitted)
    none = _cost(experiment, start, start.point, start.residual)
    scores = (_score(experiment, start, candidate) for candidate in candidates)
    chosen = sorted((score for score in scores if score.cost < none), key=lambda score: score.cost)[:_FITTED]

    def fit(score: _Score) -> Fitted:
        point = _moved(start.point, score.candidate, _refined(experiment, start, score))
        found = refit(experiment, point, (*fitted.free, *score.candidate.free), start.base, renewals=2, beside=start)
        return best_of_starts(experiment, found, 0)

    return {score.candidate.effect: fit(score) for score in chosen}


def _score(experiment: Experiment, start: Fitted, candidate: Candidate) -> _Score:
    """The best of the tried values of a calibration."""
    (number,) = candidate.free
    values = [way * size * number.item.scale for size in _SIZES for way in (-1.0, 1.0)]
    points = {
        value: _moved(start.point, candidate, value) for value in values if number.item.low <= value <= number.item.high
    }
    changes = experiment.differences(start.point, start.residual, points.values())
    scores = (
        _Score(_cost(experiment, start, point, start.residual + change), value, candidate)
        for (value, point), change in zip(points.items(), changes, strict=True)
    )
    return min(scores, key=lambda score: score.cost)


def _refined(experiment: Experiment, start: Fitted, score: _Score) -> float:
    """The best value between the neighbours of the one that was tried."""
    low, high = sorted((0.5 * score.value, 2.0 * score.value))

    def cost(value: float) -> float:
        point = _moved(start.point, score.candidate, float(value))
        return _cost(experiment, start, point, experiment.near(point, start.point, start.residual))

    found = minimize_scalar(
        cost,
        bounds=(low, high),
        method="bounded",
        options={"xatol": _NEAR * score.candidate.free[0].item.scale},
    )
    return float(found.x) if found.fun < score.cost else score.value


def _moved(point: Point, candidate: Candidate, value: float) -> Point:
    return Point(point.theta, {**point.effects, **{free.path: value for free in candidate.free}})


def _cost(experiment: Experiment, start: Fitted, point: Point, residual: NDArray[np.float64]) -> float:
    """What is left to first order once the base parameters have moved to their best: twice a negative log posterior."""
    theta, scale = point.theta, start.scale
    step = Equations.of(residual, start.base, start.effect).solved(scale, experiment.prior, theta, rounds=4)
    return float(scale.misfits_of(step.squares, len(residual)).sum()) + prior_cost(experiment, theta + step.theta)
