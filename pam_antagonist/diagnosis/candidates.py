"""Score tests: the evidence for candidates beside a model to first order, before any fit.

A score test asks what a candidate would explain of a residual beside the base parameters with their priors. The
residual is regressed on how a finite size of the effect changes it. That takes one simulation a size and shape, no fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.models import price
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import Candidate, FreeEffectParameter
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, effect_jacobian, prior_cost
from pam_antagonist.inference.likelihood import Equations, Scale, Step
from pam_antagonist.inference.point import Point

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """How well a candidate would do in a recording.

    Attributes:
        gain: evidence for it, twice a difference of log posteriors, to first order.
        muscles: evidence for it on muscle 1 alone and on muscle 2 alone; None where it belongs to no muscle.
    """

    candidate: Candidate
    gain: float
    start: Mapping[str, float]
    muscles: tuple[float, float] | None = None


_Key = tuple[tuple[str, ...], tuple[tuple[str, float], ...]]


def score_all(experiment: Experiment, fitted: Fitted, at: Fitted | None = None) -> dict[str, Score]:
    """Score of every candidate beside a fitted model, by the effect's name.

    Args:
        fitted: the model without the candidate, whose residual is to be explained.
        at: model from which the steps are taken; default: the fitted one. The model as configured shows a large
            effect to which the fitted base parameters have adapted.
    """
    here = fitted if at is None else at
    scale = fitted.scale
    before = cost_of(experiment, fitted.point, fitted.residual, scale)
    # Weights from several starts: that of one channel near its noise hides what another could tell.
    firsts = (scale.variances(here.residual), scale.noise**2, np.var(experiment.measured, axis=0))
    known = here.effect.shape[2]
    offered = experiment.candidates(fitted.point.effects)
    # A score is a first guess, for which the steps of a derivative are fine enough.
    steps = {_key(size, shape): (size, shape) for each in offered for shape in each.grid() for size in each.sizes}
    moved = (_with(here.point, size, shape) for size, shape in steps.values())
    columns = np.stack(experiment.differences(here.point, here.residual, moved), axis=2)
    # The sums over the blocks are made once, and each candidate takes those that it needs.
    everything = Equations.of(here.residual, here.base, np.concatenate([here.effect, columns], axis=2))
    place = {key: known + k for k, key in enumerate(steps)}
    del columns

    def cost(step: Step) -> float:
        misfits = scale.misfits_of(step.squares, len(here.residual))
        return float(misfits.sum()) + prior_cost(experiment, here.point.theta + step.theta)

    def score(candidate: Candidate, shape: Mapping[str, float], sizes: Sequence[FreeEffectParameter]) -> Score:
        while sizes:
            linear = everything.among([*range(known), *(place[_key(size, shape)] for size in sizes)])
            each = (linear.solved(scale, experiment.prior, here.point.theta, 4, first=first) for first in firsts)
            step = min(each, key=cost)
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
    for candidate in offered:
        grid = candidate.grid()
        found = max((score(candidate, shape, candidate.sizes) for shape in grid), key=lambda tried: tried.gain)
        simpler = result.get(candidate.effect)
        if simpler is None or found.gain - simpler.gain > _further_price(fitted, candidate, simpler):
            result[candidate.effect] = found
    for name, found in result.items():
        each = [[size for size in found.candidate.sizes if size.muscle == muscle] for muscle in (1, 2)]
        if all(each):
            shape = {free.path: found.start[free.path] for free in found.candidate.shapes}
            first, second = (score(found.candidate, shape, sizes).gain for sizes in each)
            result[name] = replace(found, muscles=(first, second))
    return result


def _key(size: FreeEffectParameter, shape: Mapping[str, float]) -> _Key:
    """What a step along a size depends on: the parameters that move, and the effect's shape."""
    return size.paths, tuple(sorted(shape.items()))


def _with(point: Point, size: FreeEffectParameter, shape: Mapping[str, float]) -> Point:
    """A point with an effect of a shape, neither small nor large."""
    values = dict.fromkeys(size.paths, size.item.scale)
    return Point(point.theta, {**point.effects, **shape, **values})


def _further_price(fitted: Fitted, candidate: Candidate, simpler: Score) -> float:
    """What the further parameters of another form of a candidate cost."""
    return price(fitted, len(candidate.free) - len(simpler.candidate.free))


def as_configured(experiment: Experiment, fitted: Fitted | None = None) -> Fitted:
    """The model with its base as configured, as a place to take steps from.

    Args:
        fitted: a model whose effects and calibrations are kept; default: none.
    """
    point = experiment.origin if fitted is None else Point(experiment.origin.theta, fitted.point.effects)
    free = () if fitted is None else fitted.free
    residual = experiment.residual(point)
    return Fitted(
        point=point,
        free=free,
        residual=residual,
        base=experiment.jacobian(point, residual),
        effect=effect_jacobian(experiment, point, residual, free),
        scale=Scale.of(residual, experiment.noise),
        cost=np.inf,
        covariance=np.zeros((0, 0)),
    )
