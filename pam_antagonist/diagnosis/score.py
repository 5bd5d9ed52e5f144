"""Score test: what each candidate would explain of a residual, beside the base parameters, to first order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.candidates import Candidate
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.free_parameters import FreeEffectParameter
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, prior_cost
from pam_antagonist.inference.likelihood import Scale, Step, solve

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """How well a candidate would do in a recording.

    Attributes:
        candidate: which.
        gain: evidence for it, twice a difference of log posteriors, to first order.
        start: values of its unknowns by dotted path, for a refit.
        muscles: evidence for it on muscle 1 alone and on muscle 2 alone; None where it belongs to no muscle.
    """

    candidate: Candidate
    gain: float
    start: Mapping[str, float]
    muscles: tuple[float, float] | None = None


def score_all(experiment: Experiment, fitted: Fitted, at: Fitted | None = None) -> dict[str, Score]:
    """Score of every candidate beside a fitted model, by the effect's name.

    Args:
        experiment: the recording.
        fitted: the model without the candidate, whose residual is to be explained.
        at: model from which the steps are taken; default: the fitted one. From the model as configured, a large
            effect is seen before the base parameters have given way to it.
    """
    here = fitted if at is None else at
    scale = fitted.scale
    before = cost_of(experiment, fitted.point, fitted.residual, scale)
    # Weights from several starts: that of one channel near its noise hides what another could tell.
    firsts = (scale.variances(here.residual), scale.noise**2, np.var(experiment.measured, axis=0))
    known = here.effect.shape[2]
    columns: dict[tuple[tuple[str, ...], tuple[tuple[str, float], ...]], Floats] = {}

    def column(size: FreeEffectParameter, shape: Mapping[str, float]) -> Floats:
        key = size.paths, tuple(sorted(shape.items()))
        if key not in columns:
            values = dict.fromkeys(size.paths, size.item.scale)
            changed = Point(here.point.theta, {**here.point.effects, **shape, **values})
            columns[key] = experiment.residual(changed) - here.residual
        return columns[key]

    def cost(step: Step) -> float:
        return float(scale.misfits(step.residual).sum()) + prior_cost(experiment, here.point.theta + step.theta)

    def score(candidate: Candidate, shape: Mapping[str, float], sizes: Sequence[FreeEffectParameter]) -> Score:
        while sizes:
            effect = np.concatenate([here.effect, np.stack([column(size, shape) for size in sizes], axis=2)], axis=2)
            step = min(
                (
                    solve(here.residual, here.base, effect, scale, experiment.prior, here.point.theta, 4, first=first)
                    for first in firsts
                ),
                key=cost,
            )
            values = [size.value(float(a)) for size, a in zip(sizes, step.effect[known:], strict=True)]
            refused = [size for size, value in zip(sizes, values, strict=True) if value < size.item.low]
            if not refused:
                start = dict(shape)
                for size, value in zip(sizes, values, strict=True):
                    start.update(dict.fromkeys(size.paths, size.bounded(value)))
                return Score(candidate, scale.share * (before - cost(step)), start)
            sizes = [size for size in sizes if size not in refused]
        return Score(candidate, 0.0, {**shape, **{path: 0.0 for size in candidate.sizes for path in size.paths}})

    result: dict[str, Score] = {}
    for candidate in experiment.candidates(fitted.point.effects):
        grid = candidate.grid()
        found = max((score(candidate, shape, candidate.sizes) for shape in grid), key=lambda tried: tried.gain)
        simpler = result.get(candidate.effect)
        if simpler is None or found.gain - simpler.gain > _price_beyond(fitted, candidate, simpler):
            result[candidate.effect] = found
    for name, found in result.items():
        each = [[size for size in found.candidate.sizes if size.muscle == muscle] for muscle in (1, 2)]
        if all(each):
            shape = {unknown.path: found.start[unknown.path] for unknown in found.candidate.shapes}
            first, second = (score(found.candidate, shape, sizes).gain for sizes in each)
            result[name] = replace(found, muscles=(first, second))
    return result


def _price_beyond(fitted: Fitted, candidate: Candidate, simpler: Score) -> float:
    """What the further unknowns of another form of a candidate cost."""
    further = len(candidate.free) - len(simpler.candidate.free)
    return further * float(np.log(max(fitted.scale.values(fitted.residual), np.e)))


def as_configured(experiment: Experiment, effects: Mapping[str, float]) -> Fitted:
    """The model with its base as configured, as a place to take steps from."""
    point = Point(experiment.origin.theta, dict(effects))
    residual = experiment.residual(point)
    base = experiment.jacobian(point, residual)
    return Fitted(
        point,
        (),
        residual,
        base,
        np.zeros((*residual.shape, 0)),
        Scale.of(residual, experiment.noise),
        np.inf,
        np.zeros((0, 0)),
    )
