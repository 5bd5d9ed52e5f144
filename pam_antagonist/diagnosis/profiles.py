"""Profile likelihood of each size that was found: the others at their best while it is held."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis.findings import unknowns_of
from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.diagnosis.select import Model
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.free_parameters import FreeEffectParameter
from pam_antagonist.inference.gauss_newton import Fitted, prior_cost, refit
from pam_antagonist.model.effects import DISTURBANCE

_SHARES = (0.0, 0.5)
"""Of the size: what it takes to be called found."""
_POSITIONS = (-3.0, -1.5, 1.5, 3.0)
"""In standard errors from the size: whether the likelihood is the parabola that these stand for."""
_THRESHOLD = 3.84
"""95 % of a chi-square with one degree of freedom: a profile that does not rise so far at half the size is flat."""


def profile_sizes(
    experiments: Sequence[Experiment],
    model: Model,
    found: Sequence[FoundEffect],
    jobs: int,
    said: Callable[[str], None],
) -> tuple[Mapping[str, Any], ...]:
    """Profiles of the found sizes, each in the recording that shows it first.

    Args:
        experiments: the recordings.
        model: the chosen model.
        found: its effects.
        jobs: threads.
        said: told what is being done.

    Returns:
        For each: parameter, recording, value, its standard error, unit, values (P,), rise of −2 log posterior (P,),
        whether it is flat.
    """
    names = [experiment.trial.name for experiment in experiments]
    result = []
    for effect in found:
        if effect.name == DISTURBANCE:
            continue
        free = [unknown for unknown in unknowns_of(model, effect.name) if unknown.item.is_size]
        sizes = [unknown for unknown in free if unknown.path.split(".")[2] in effect.parameters]
        for unknown in sizes:
            r = _where(model, unknown, [names.index(name) for name in effect.recordings])
            if r is None:
                continue
            said(f"profile of {unknown.path}")
            fitted, experiment = model.fits[r], experiments[r]
            best = fitted.point.effects[unknown.path]
            k = len(fitted.covariance) - len(fitted.free) + fitted.free.index(unknown)
            std = float(np.sqrt(fitted.covariance[k, k])) * unknown.slope(best)
            far = [best * share for share in _SHARES]
            near = [unknown.bounded(best + position * std) for position in _POSITIONS]
            tasks = [delayed(_held)(experiment, fitted, fitted.point, unknown, value) for value in far]
            tasks += [
                delayed(_held)(experiment, fitted, _along(fitted, k, unknown, value), unknown, value) for value in near
            ]
            rises = Parallel(n_jobs=jobs, prefer="threads")(tasks)
            points = sorted([*zip([*far, *near], (rise for rise, _ in rises), strict=True), (best, 0.0)])
            _, half = rises[_SHARES.index(0.5)]
            result.append(
                {
                    "parameter": unknown.path.removeprefix("effects."),
                    "recording": names[r],
                    "value": best,
                    "std": std,
                    "unit": unknown.item.unit,
                    "values": [value for value, _ in points],
                    "rise": [rise for _, rise in points],
                    "flat": half < _THRESHOLD,
                }
            )
    return tuple(result)


def _where(model: Model, unknown: FreeEffectParameter, recordings: Sequence[int]) -> int | None:
    shown = [r for r in recordings if unknown in model.fits[r].free and model.fits[r].point.effects.get(unknown.path)]
    return shown[0] if shown else None


def _along(fitted: Fitted, k: int, unknown: FreeEffectParameter, value: float) -> Point:
    """Where the others go, by the covariance, while one number is moved to a value."""
    best = fitted.point.effects[unknown.path]
    moved = fitted.covariance[:, k] / fitted.covariance[k, k] * (unknown.coordinate(value) - unknown.coordinate(best))
    count = len(fitted.covariance) - len(fitted.free)
    effects = dict(fitted.point.effects)
    for other, change in zip(fitted.free, moved[count:], strict=True):
        now = effects.get(other.path, other.item.neutral)
        effects.update(dict.fromkeys(other.paths, other.bounded(other.value(other.coordinate(now) + float(change)))))
    return Point(fitted.point.theta + moved[:count], effects)


def _held(
    experiment: Experiment, fitted: Fitted, start: Point, unknown: FreeEffectParameter, value: float
) -> tuple[float, float]:
    """Least rise of −2 log posterior with one number held at a value: as errors are told, and as evidence is."""
    effects = {**start.effects, **dict.fromkeys(unknown.paths, value)}
    others = tuple(u for u in fitted.free if u != unknown)
    scale = fitted.scale
    moved = refit(
        experiment,
        Point(start.theta, effects),
        others,
        fitted.base,
        rounds=5,
        renewals=0,
        blocks_per_error=scale.blocks_per_error,
    )
    change = scale.misfits(moved.residual) - scale.misfits(fitted.residual)
    prior = prior_cost(experiment, moved.point.theta) - prior_cost(experiment, fitted.point.theta)
    return max(float(scale.blocks_per_error / scale.length @ change) + prior, 0.0), scale.share * (
        float(change.sum()) + prior
    )
