"""Recalibration, and forward selection of effects over all recordings of a group."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis import calibrations, explained, thresholds
from pam_antagonist.diagnosis.candidates import (
    Model,
    Score,
    TriedCandidate,
    as_configured,
    evidence,
    score_all,
)
from pam_antagonist.diagnosis.checkpoint import Checkpoint, Kept, key_of
from pam_antagonist.inference.calibration import is_calibration
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, refit, relinearised
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.starts import STARTS, best_of_starts

_REFITTED = 5
"""Candidates a round that are fitted in full simulation: those with the best scores."""
_BEHIND = 0.5
"""A candidate that has won less than this share of the best one's evidence is not fitted from other starts."""
_SHOWS = 0.2
"""A recording is fitted if the candidate's score there is this share of its score over all recordings."""


@dataclass(frozen=True, eq=False)
class Selection:
    """What was tried and what was taken.

    Attributes:
        tried: every candidate of every round, in the order of evidence.
        calibrations: every calibration of every round, likewise; it is in both models where it was taken.
        rivals: for each effect and calibration that was taken, those that would have done as well in its place; of an
            effect its rivals among calibrations only.
    """

    recalibrated: Model
    model: Model
    tried: tuple[TriedCandidate, ...]
    calibrations: tuple[TriedCandidate, ...] = ()
    rivals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def recalibrate(experiments: Sequence[Experiment], jobs: int, known: Model | None = None) -> Model:
    """The base parameters of every recording at their most probable values.

    Args:
        known: model of the recordings whose calibrations are fitted as well.
    """

    def one(experiment: Experiment, like: Fitted | None) -> Fitted:
        effects = {} if like is None else like.point.effects
        point = Point(experiment.origin.theta, {path: value for path, value in effects.items() if is_calibration(path)})
        free = () if like is None else tuple(free for free in like.free if is_calibration(free.path))
        return relinearised(experiment, best_of_starts(experiment, refit(experiment, point, free)))

    fits = known.fits if known is not None else [None] * len(experiments)
    pairs = zip(experiments, fits, strict=True)
    return Model((), tuple(_in_threads(jobs, (delayed(one)(*pair) for pair in pairs))))


def select(
    experiments: Sequence[Experiment],
    base: Model,
    jobs: int,
    progress: Callable[[str], None],
    checkpoint: Checkpoint,
    before: Sequence[explained.Residuals] = (),
    calibrate: bool = False,
    most: int = thresholds.MOST_EFFECTS,
) -> Selection:
    """Add effects, and calibrations of the recordings, while one is worth taking.

    Args:
        base: the recalibrated model, or one with effects that stay in it.
        before: residuals before an effect that the experiments already contain, which then counts as the first one;
            default: residuals of the recalibrated model.
        calibrate: whether zeros, scales and late stamps may be found as well.
        most: effects at most, with those that are in the model already.
    """
    # Experiments may have an effect in them already; a model may as well.
    begin = 2 if before and not base.effects else 1
    model, tried, weighed = base, list[TriedCandidate](), list[TriedCandidate]()
    rivals: dict[str, tuple[str, ...]] = {}
    first = before or explained.remaining_residuals(experiments, base.fits)
    while (number := len(model.effects) + begin) <= most:
        if explained.at_noise(experiments, model):
            certain = calibrations.hidden(experiments, model, number, jobs) if calibrate else []
            weighed += [replace(candidate, taken=candidate is certain[0]) for candidate in certain]
            if not certain or certain[0].model is None:
                break
            name, standing = certain[0].effect, certain[0].standing
            near = (other.effect for other in certain[1:] if standing - other.standing < thresholds.STRONG)
            rivals[name] = tuple(near)
            base, model = calibrations.taken(experiments, base, model, certain[0].model, name, jobs)
            progress(f"{name} added")
            continue
        found = _round(experiments, first, model, number, jobs, progress, checkpoint)
        # Where a calibration was taken, its round was without it.
        tried = [*(candidate for candidate in tried if candidate.round != number), *found]
        others = calibrations.tried(experiments, first, model, number, jobs) if calibrate else []
        worth = [candidate for candidate in (*found, *others) if explained.is_worth_taking(candidate)]
        worth += [candidate for candidate in others if explained.ends_at_noise(experiments, candidate)]
        best = max(worth, key=lambda candidate: candidate.standing, default=None)
        weighed += [replace(candidate, taken=candidate is best) for candidate in others]
        if best is None or best.model is None:
            break
        rivals[best.effect] = explained.near(best, others if best in found else (*found, *others))
        if best in found:
            model = shared(experiments, _relinearised(experiments, best.model, jobs), jobs)
        else:
            base, model = calibrations.taken(experiments, base, model, best.model, best.effect, jobs)
            first = explained.remaining_residuals(experiments, base.fits)
        progress(f"{best.effect} added")
    base, model = calibrations.needed(experiments, base, model, jobs)
    fits = {each: calibrations.carried_on(experiments, each, jobs) for each in (base, model)}
    base, model = fits[base], fits[model]
    return Selection(base, model, tuple(tried), tuple(weighed), rivals)


def refitted_without(
    experiments: Sequence[Experiment], model: Model, effects: Sequence[str], jobs: int
) -> tuple[Model, ...]:
    """The model without each of these of its effects, the others and the base fitted anew."""

    def one(effect: str, experiment: Experiment, fitted: Fitted) -> Fitted:
        path = f"effects.{effect}."
        if not any(name.startswith(path) for name in fitted.point.effects):
            return fitted
        others = tuple(free for free in fitted.free if not free.path.startswith(path))
        values = {name: value for name, value in fitted.point.effects.items() if not name.startswith(path)}
        return refit(experiment, Point(fitted.point.theta, values), others, beside=fitted)

    tasks = [(effect, *pair) for effect in effects for pair in _pairs(experiments, model)]
    fits = iter(_in_threads(jobs, (delayed(one)(*task) for task in tasks)))
    return tuple(
        Model(tuple(name for name in model.effects if name != effect), tuple(next(fits) for _ in experiments))
        for effect in effects
    )


def shared(experiments: Sequence[Experiment], model: Model, jobs: int) -> Model:
    """A model whose recordings also have the effects of the others, where that costs them nothing.

    A rig has an effect in all recordings, even if one of them hardly shows it. That one takes over the values, with its
    base parameters fitted anew. A recording does not get an effect that it rules out.
    """

    def one(experiment: Experiment, fitted: Fitted) -> Fitted:
        for effect in model.effects:
            path = f"effects.{effect}."
            if any(name.startswith(path) for name in fitted.point.effects):
                continue
            shows = max(model.fits, key=lambda other: _certainty(other, path))
            values = {name: value for name, value in shows.point.effects.items() if name.startswith(path)}
            point = Point(fitted.point.theta, {**fitted.point.effects, **values})
            pace = fitted.scale.blocks_per_error
            given = refit(experiment, point, fitted.free, renewals=2, blocks_per_error=pace, beside=fitted)
            if evidence(experiment, fitted, given) >= -thresholds.POSITIVE:
                fitted = given
        return fitted

    fits = _in_threads(jobs, (delayed(one)(*pair) for pair in _pairs(experiments, model)))
    return Model(model.effects, tuple(fits))


def _relinearised(experiments: Sequence[Experiment], model: Model, jobs: int) -> Model:
    """The model with derivatives at its own points, which a candidate that is not taken does not need."""
    fits = _in_threads(jobs, (delayed(relinearised)(*pair) for pair in _pairs(experiments, model)))
    return Model(model.effects, tuple(fits))


def _certainty(fitted: Fitted, path: str) -> float:
    """How many standard deviations the sizes of an effect are; 0 where it is not free."""
    std = np.sqrt(np.diag(fitted.effect_covariance))
    here = [k for k, f in enumerate(fitted.free) if f.path.startswith(path) and f.item.is_size and std[k] > 0.0]
    return max((abs(fitted.point.effects.get(fitted.free[k].path, 0.0)) / std[k] for k in here), default=0.0)


@dataclass(frozen=True, eq=False)
class _Scored:
    """A candidate's scores in all recordings, each with the model from which its steps were taken."""

    starts: tuple[tuple[Score, Fitted], ...]

    @property
    def total(self) -> float:
        return sum(max(score.gain, 0.0) for score, _ in self.starts)

    @property
    def muscles(self) -> tuple[float, float] | None:
        """Evidence for each muscle alone over all recordings."""
        each = [score.muscles for score, _ in self.starts if score.muscles is not None]
        return (sum(max(a, 0.0) for a, _ in each), sum(max(b, 0.0) for _, b in each)) if each else None


def _round(
    experiments: Sequence[Experiment],
    first: Sequence[explained.Residuals],
    model: Model,
    number: int,
    jobs: int,
    progress: Callable[[str], None],
    checkpoint: Checkpoint,
) -> list[TriedCandidate]:
    """Score all candidates beside a model, and fit the best of them."""
    progress(f"round {number}: score tests")
    scored = _scored(experiments, model, jobs)
    order = sorted(scored, key=lambda name: -scored[name].total)
    wanted = [name for name in order[:_REFITTED] if scored[name].total > thresholds.LEAST_SCORE]
    progress(f"round {number}: refitting {', '.join(wanted) or 'nothing'}")
    begun = {
        (name, r): start
        for name in wanted
        for r, start in enumerate(scored[name].starts)
        if start[0].gain > min(thresholds.LEAST_SCORE, _SHOWS * scored[name].total)
    }
    done = _fits(experiments, model, begun, jobs, checkpoint)
    before = explained.remaining_residuals(experiments, model.fits)
    tried = []
    for name in order:
        candidate = TriedCandidate(name, number, scored[name].total, muscles=scored[name].muscles)
        if name in wanted:
            fits = [done.get((name, r)) for r in range(len(experiments))]
            effects = (*model.effects, name)
            candidate = explained.with_fits(candidate, experiments, first, before, model, effects, fits)
        tried.append(candidate)
    tried.sort(key=lambda candidate: (-candidate.standing, -candidate.score))
    return tried


def _scored(experiments: Sequence[Experiment], model: Model, jobs: int) -> dict[str, _Scored]:
    """Every candidate with its best score in each recording."""
    tasks = [list(_score_tasks(e, f)) for e, f in _pairs(experiments, model)]
    scores = iter(_in_threads(jobs, (task for per in tasks for task in per)))
    starts = [[next(scores) for _ in per] for per in tasks]
    # An effect of the model may be absent from the model of a recording in which it did not pay.
    names = [name for name in starts[0][0][0] if name not in model.effects]
    best = {name: [max(per, key=lambda pair: pair[0][name].gain) for per in starts] for name in names}
    return {name: _Scored(tuple((scores[name], start) for scores, start in best[name])) for name in names}


def _score_tasks(experiment: Experiment, fitted: Fitted) -> Iterator[Any]:
    yield delayed(lambda: (score_all(experiment, fitted), fitted))()
    if all(is_calibration(free.path) for free in fitted.free):

        def far() -> tuple[dict[str, Score], Fitted]:
            start = as_configured(experiment, fitted)
            return score_all(experiment, fitted, start), start

        yield delayed(far)()


def _fits(
    experiments: Sequence[Experiment],
    model: Model,
    begun: Mapping[tuple[str, int], tuple[Score, Fitted]],
    jobs: int,
    checkpoint: Checkpoint,
) -> dict[tuple[str, int], Fitted]:
    """Candidates (effect, recording), fitted from the start of a score test; the best from other starts as well."""
    keys = {(name, r): key_of(experiments[r], (*model.effects, name)) for name, r in begun}
    free = {(name, r): (*model.fits[r].free, *score.candidate.free) for (name, r), (score, _) in begun.items()}

    def descent(which: tuple[str, int]) -> tuple[Fitted, float, bool]:
        experiment, (score, start), kept = experiments[which[1]], begun[which], checkpoint.load(keys[which])
        if kept is not None:
            again = refit(experiment, kept.point, free[which], rounds=0, blocks_per_error=kept.blocks_per_error)
            return again, kept.gain, True
        point = Point(start.point.theta, {**start.point.effects, **score.start})
        fitted = refit(experiment, point, free[which], start.base, renewals=2, beside=start)
        return fitted, max(evidence(experiment, model.fits[which[1]], fitted), 0.0), False

    def end(which: tuple[str, int], descended: Fitted, gain: float, starts: int) -> Fitted:
        fitted = best_of_starts(experiments[which[1]], descended, starts)
        checkpoint.save(keys[which], Kept(fitted.point, fitted.scale.blocks_per_error, gain))
        return fitted

    first = dict(zip(begun, _in_threads(jobs, (delayed(descent)(which) for which in begun)), strict=True))
    gains = dict.fromkeys((name for name, _ in begun), 0.0)
    for (name, _), (_, gain, _) in first.items():
        gains[name] += gain
    bound = _BEHIND * max(gains.values(), default=0.0)
    unfinished = {which: (fitted, gain) for which, (fitted, gain, finished) in first.items() if not finished}
    ends = _in_threads(
        jobs,
        (
            delayed(end)(which, fitted, gain, STARTS if gains[which[0]] >= bound else 0)
            for which, (fitted, gain) in unfinished.items()
        ),
    )
    return {which: fitted for which, (fitted, _, _) in first.items()} | dict(zip(unfinished, ends, strict=True))


def _in_threads(jobs: int, tasks: Any) -> list[Any]:
    return list(Parallel(n_jobs=jobs, prefer="threads")(tasks))


def _pairs(experiments: Sequence[Experiment], model: Model) -> list[tuple[Experiment, Fitted]]:
    return list(zip(experiments, model.fits, strict=True))
