"""The search: ask every hypothesis, take the best answer that is worth it, and ask again.

Of the effects of the catalogue all are scored and the best are fitted, in every recording. A score test asks what a
candidate would explain of a residual beside the base parameters with their priors, to first order. The residual is
regressed on how a finite size of the effect changes it. That takes one simulation a size and shape, no fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import entry_points

import numpy as np
from typing_extensions import override

from pam_antagonist.diagnosis import calibrations, thresholds
from pam_antagonist.diagnosis.calibrations import CalibrationHypothesis
from pam_antagonist.diagnosis.hypotheses import Hypothesis, Kept, Ranking, ResumeFolder, TriedCandidate, Work, key_of
from pam_antagonist.diagnosis.models import Model, as_configured, evidence, in_threads, price, shared
from pam_antagonist.inference.calibration import is_calibration
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, prior_cost, refit, relinearised
from pam_antagonist.inference.likelihood import LinearProblem, Solution
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.starts import STARTS, best_of_starts
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.model.effects import CATALOGUE, experiment_between

_REFITTED = 5
"""Candidates a round that are fitted in full simulation: those with the best scores."""
_BEHIND = 0.5
"""A candidate that has won less than this share of the best one's evidence is not fitted from other starts."""
_SHOWS = 0.2
"""A recording is fitted if the candidate's score there is this share of its score over all recordings."""


class CatalogueEffect(Hypothesis):
    """An effect of the catalogue that acts throughout."""

    @override
    def propose(self, now: Ranking, number: int, work: Work) -> list[TriedCandidate]:
        model = now.model
        if model.is_enough:
            return []
        work.progress(f"round {number}: score tests")
        scored = _scored(model)
        order = sorted(scored, key=lambda name: -scored[name].total)
        wanted = [name for name in order[:_REFITTED] if scored[name].total > thresholds.LEAST_SCORE]
        work.progress(f"round {number}: refitting {', '.join(wanted) or 'nothing'}")
        begun = {
            (name, r): start
            for name in wanted
            for r, start in enumerate(scored[name].starts)
            if start[0].gain > min(thresholds.LEAST_SCORE, _SHOWS * scored[name].total)
        }
        done = _fits(model, begun, work.checkpoint)
        tried = []
        for name in order:
            candidate = TriedCandidate(name, number, scored[name].total, muscles=scored[name].muscles)
            if name in wanted:
                fits = [done.get((name, r)) for r in range(len(model.fits))]
                candidate = candidate.fitted(now.first, model, fits, (*model.effects, name))
            tried.append(candidate)
        return sorted(tried, key=lambda candidate: (-candidate.standing, -candidate.score))

    @override
    def is_worth_taking(self, tried: TriedCandidate) -> bool:
        model = tried.model
        if model is not None and model.is_enough and not model.is_at_noise and _shape_at_bound(model, tried.effect):
            # Within errors that are tolerated, a shape that wants to leave its bounds stands for something else.
            return False
        return tried.is_worth_taking

    @override
    def take(self, now: Ranking, best: TriedCandidate) -> tuple[Model, Model]:
        base, model = super().take(now, best)
        # One that sees the recordings in its own way has a base beside it, and is finished.
        return (now.base, shared(model.map(relinearised))) if best.base is None else (base, model)

    @override
    def knows(self, name: str) -> bool:
        return name in CATALOGUE

    @override
    def sentence(self, name: str, muscle: int | None, values: Mapping[str, float], sealed: bool = False) -> str:
        return CATALOGUE[name].in_words(muscle, values, sealed)

    @override
    def instead(self, name: str) -> str:
        return CATALOGUE[name].sealed.instead or f"{CATALOGUE[name].title} would explain the data as well"

    @override
    def experiment(self, name: str, found: str | None = None, sealed: bool = False) -> str:
        effect = CATALOGUE[name]
        between = effect.sealed.experiment if sealed else experiment_between(name, found) if found else None
        return between or effect.experiment


def _shape_at_bound(model: Model, effect: str) -> bool:
    """Whether a shape of an effect ended at a bound in any recording."""
    shapes = (
        (free, fitted.point.effects[free.path])
        for fitted in model.fits for free in fitted.free
        if free.path.startswith(f"effects.{effect}.") and not free.item.is_size
    )  # fmt: skip
    return any(value in (free.item.low, free.item.high) for free, value in shapes)


@dataclass(frozen=True, eq=False)
class _Scored:
    """A candidate's scores in all recordings, each with the model from which its steps were taken."""

    starts: tuple[tuple[Score, Fitted], ...]

    @property
    def total(self) -> float:
        return sum(max(score.gain, 0.0) for score, _ in self.starts)

    @property
    def muscles(self) -> tuple[float, float] | None:
        each = [score.muscles for score, _ in self.starts if score.muscles is not None]
        return (sum(max(a, 0.0) for a, _ in each), sum(max(b, 0.0) for _, b in each)) if each else None


def _scored(model: Model) -> dict[str, _Scored]:
    """Every candidate with its best score in each recording, beside its model and beside the base as configured."""
    ways = [(False, True) if all(is_calibration(free.path) for free in fit.free) else (False,) for fit in model.fits]
    tasks = [(r, *pair, far) for r, pair in enumerate(model.pairs) for far in ways[r]]

    def one(r: int, experiment: Experiment, fitted: Fitted, far: bool) -> tuple[int, dict[str, Score], Fitted]:
        start = as_configured(experiment, fitted) if far else fitted
        return r, score_all(experiment, fitted, start), start

    found = in_threads(one, tasks, model.jobs)
    # An effect of the model may be absent from the model of a recording in which it did not pay.
    names = [name for name in found[0][1] if name not in model.effects]

    def best(name: str, recording: int) -> tuple[Score, Fitted]:
        each = ((scores[name], start) for r, scores, start in found if r == recording)
        return max(each, key=lambda pair: pair[0].gain)

    return {name: _Scored(tuple(best(name, r) for r in range(len(model.fits)))) for name in names}


def _fits(
    model: Model, begun: Mapping[tuple[str, int], tuple[Score, Fitted]], checkpoint: ResumeFolder
) -> dict[tuple[str, int], Fitted]:
    """Candidates (effect, recording), fitted from the start of a score test; the best from other starts as well."""
    keys = {(name, r): key_of(model.experiments[r], (*model.effects, name)) for name, r in begun}
    free = {(name, r): (*model.fits[r].free, *score.candidate.free) for (name, r), (score, _) in begun.items()}

    def descent(which: tuple[str, int]) -> tuple[Fitted, float, bool]:
        experiment, (score, start), kept = model.experiments[which[1]], begun[which], checkpoint.load(keys[which])
        if kept is not None:
            again = refit(experiment, kept.point, free[which], rounds=0, blocks_per_error=kept.blocks_per_error)
            return again, kept.gain, True
        point = Point(start.point.theta, {**start.point.effects, **score.start})
        fitted = refit(experiment, point, free[which], start.base, renewals=2, beside=start)
        return fitted, max(evidence(experiment, model.fits[which[1]], fitted), 0.0), False

    def end(which: tuple[str, int], descended: Fitted, gain: float, starts: int) -> Fitted:
        fitted = best_of_starts(model.experiments[which[1]], descended, starts)
        checkpoint.save(keys[which], Kept(fitted.point, fitted.scale.blocks_per_error, gain))
        return fitted

    first = dict(zip(begun, in_threads(descent, ((which,) for which in begun), model.jobs), strict=True))
    gains = dict.fromkeys((name for name, _ in begun), 0.0)
    for (name, _), (_, gain, _) in first.items():
        gains[name] += gain
    bound = _BEHIND * max(gains.values(), default=0.0)
    unfinished = [
        (which, fitted, gain, STARTS if gains[which[0]] >= bound else 0)
        for which, (fitted, gain, finished) in first.items()
        if not finished
    ]
    ends = dict(zip((which for which, *_ in unfinished), in_threads(end, unfinished, model.jobs), strict=True))
    return {which: ends.get(which, fitted) for which, (fitted, _, _) in first.items()}


# Score tests.


@dataclass(frozen=True)
class Score:
    """How well a candidate would do in a recording."""

    candidate: Candidate
    gain: float  # evidence for it, twice a difference of log posteriors, to first order
    start: Mapping[str, float]
    # evidence for it on muscle 1 alone and on muscle 2 alone; None where it belongs to no muscle.
    muscles: tuple[float, float] | None = None


_Key = tuple[tuple[str, ...], tuple[tuple[str, float], ...]]


def score_all(experiment: Experiment, fitted: Fitted, at: Fitted | None = None) -> dict[str, Score]:
    """Score of every candidate beside a fitted model, by the effect's name.

    `fitted`: the model without the candidate, whose residual is to be explained. `at`: model from which the steps are
    taken; default: the fitted one. The model as configured shows a large effect to which the fitted base parameters
    have adapted.
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
    everything = LinearProblem.of(here.residual, here.base, np.concatenate([here.effect, columns], axis=2))
    place = {key: known + k for k, key in enumerate(steps)}
    del columns

    def cost(step: Solution) -> float:
        misfits = scale.misfits_of(step.squares, len(here.residual))
        return float(misfits.sum()) + prior_cost(experiment, here.point.theta + step.theta)

    def score(candidate: Candidate, shape: Mapping[str, float], sizes: Sequence[Unknown]) -> Score:
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
        # The further parameters of another form of a candidate have their price.
        more = 0 if simpler is None else len(candidate.free) - len(simpler.candidate.free)
        if simpler is None or found.gain - simpler.gain > price(fitted, more):
            result[candidate.effect] = found
    for name, found in result.items():
        each = [[size for size in found.candidate.sizes if size.muscle == muscle] for muscle in (1, 2)]
        if all(each):
            shape = {free.path: found.start[free.path] for free in found.candidate.shapes}
            first, second = (score(found.candidate, shape, sizes).gain for sizes in each)
            result[name] = replace(found, muscles=(first, second))
    return result


def _key(size: Unknown, shape: Mapping[str, float]) -> _Key:
    """What a step along a size depends on: the parameters that move, and the effect's shape."""
    return size.paths, tuple(sorted(shape.items()))


def _with(point: Point, size: Unknown, shape: Mapping[str, float]) -> Point:
    """A point with an effect of a shape, neither small nor large."""
    values = dict.fromkeys(size.paths, size.item.scale)
    return Point(point.theta, {**point.effects, **shape, **values})


EFFECTS: tuple[Hypothesis, ...] = (CatalogueEffect(),)
"""What is looked for where calibrations are known already."""
CALIBRATIONS: tuple[Hypothesis, ...] = (CalibrationHypothesis(),)
"""What is looked for where the catalogue was asked already."""
GROUP = "pam_antagonist.hypotheses"


def hypotheses() -> tuple[Hypothesis, ...]:
    """What is looked for in recordings as they were made; of equals the first one is taken."""
    return (*EFFECTS, *CALIBRATIONS, *(point.load()() for point in entry_points(group=GROUP)))


def about(name: str) -> Hypothesis:
    """The hypothesis that speaks for an effect or a calibration."""
    return next(one for one in hypotheses() if one.knows(name))


def search(
    base: Model,
    work: Work,
    asked: Sequence[Hypothesis] = EFFECTS,
    first: Model | None = None,
    most: int = thresholds.MOST_EFFECTS,
) -> Ranking:
    """Add effects, and calibrations of the recordings, while one is worth taking.

    Args:
        base: the recalibrated model, or one with effects that stay in it.
        asked: hypotheses, in order.
        first: the model before an effect that the recordings already contain, which then counts as the first one;
            default: the base model.
        most: effects at most, with those that are in the model already.
    """
    # Recordings may have an effect in them already; a model may as well.
    begin = 2 if first is not None and not base.effects else 1
    now, finished = Ranking(base, base, start=first), False
    while (number := len(now.model.effects) + begin) <= most:
        found = {hypothesis: hypothesis.propose(now, number, work) for hypothesis in asked}
        worth = [(one, by) for by, each in found.items() for one in each if by.is_worth_taking(one)]
        best, by = max(worth, key=lambda pair: pair[0].standing, default=(None, None))
        now = _noted(now, found, best)
        if best is None or by is None:
            break
        # Of an effect, other effects that do as well stand in the ranking.
        others = [one for other, each in found.items() for one in each if not (by.is_effect and other is by)]
        finished, (without, model) = best.base is not None, by.take(now, best)
        now = replace(now, base=without, model=model, rivals={**now.rivals, best.effect: best.near(others)})
        work.progress(f"{best.effect} added")
    if finished or (now.model is base and first is None):
        return now
    base, model = calibrations.without_needless(now.base, now.model)
    known = {each: calibrations.converged(each) for each in (base, model)}
    return replace(now, base=known[base], model=known[model])


def _noted(now: Ranking, found: dict[Hypothesis, list[TriedCandidate]], best: TriedCandidate | None) -> Ranking:
    """A ranking with what a round has tried."""
    tried, weighed = now.tried, now.calibrations
    for hypothesis, each in found.items():
        if not hypothesis.is_effect:
            weighed += tuple(replace(one, taken=one is best) for one in each)
        elif each:
            # Where a calibration was taken, its round was without it.
            tried = (*(one for one in tried if one.round != each[0].round), *each)
    return replace(now, tried=tried, calibrations=weighed)
