"""Forward selection of effects over all recordings, with a backward step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.diagnosis import shares
from pam_antagonist.diagnosis.score import Score, as_configured, score_all
from pam_antagonist.diagnosis.store import Kept, Store, key_of
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.gauss_newton import AT_NOISE, STARTS, Fitted, best_of_starts, cost_of, refit, relinearised

Floats = NDArray[np.float64]

MOST_EFFECTS = 3
_REFITTED = 5
"""Candidates a round that are refitted in full simulation: those with the best scores."""
_BEHIND = 0.5
"""A candidate that has won less than this share of the best one's evidence is not tried from other starts."""
_TOLD = 2.0
"""Score below which a recording has nothing to say about a candidate."""
POSITIVE = 2.0
"""Evidence that Kass and Raftery (1995) call positive, that is more than a bare mention."""
STRONG = 6.0
"""Evidence (twice a log likelihood ratio less the price of unknowns) that Kass and Raftery (1995) call strong."""


@dataclass(frozen=True, eq=False)
class Model:
    """One explanation of all recordings.

    Attributes:
        effects: names of the effects in it, in the order in which they came.
        fits: the model of each recording.
    """

    effects: tuple[str, ...]
    fits: tuple[Fitted, ...]


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate beside a model.

    Attributes:
        effect: its name.
        round: how many effects the model had before, plus one.
        score: evidence to first order, over all recordings.
        delta_bic: evidence after a refit in full simulation; None where it was not refitted.
        foretold: evidence on the held-out part, where nothing was fitted and no unknown has a price; None likewise.
        shares: of the held-out and of the fitted excess, what it takes away (:mod:`shares`); None likewise.
        model: the refitted model; None likewise.
        muscles: the score with muscle 1 alone, and with muscle 2 alone; None where the effect belongs to no muscle.
        share: of the excess without effects, fitted and held out together, what it takes away; None likewise.
    """

    effect: str
    round: int
    score: float
    delta_bic: float | None = None
    foretold: float | None = None
    shares: tuple[float, float] | None = None
    model: Model | None = None
    muscles: tuple[float, float] | None = None
    share: float | None = None

    @property
    def standing(self) -> float:
        """Evidence of both parts, by which candidates are compared; the score's place is behind all of these."""
        if self.delta_bic is None or self.foretold is None:
            return -np.inf
        return self.delta_bic + self.foretold


@dataclass(frozen=True, eq=False)
class Selection:
    """What was tried and what was taken.

    Attributes:
        recalibrated: the model without effects.
        model: the one that was chosen.
        trials: every candidate of every round, in the order of evidence.
    """

    recalibrated: Model
    model: Model
    trials: tuple[Trial, ...]


def refitted_without(
    experiments: Sequence[Experiment], model: Model, effects: Sequence[str], jobs: int
) -> tuple[Model, ...]:
    """The model without each of these of its effects, the others and the base fitted anew."""

    def one(effect: str, experiment: Experiment, fitted: Fitted) -> Fitted:
        path = f"effects.{effect}."
        if not any(name.startswith(path) for name in fitted.point.effects):
            return fitted
        left = tuple(unknown for unknown in fitted.free if not unknown.path.startswith(path))
        effects = {name: value for name, value in fitted.point.effects.items() if not name.startswith(path)}
        return refit(experiment, Point(fitted.point.theta, effects), left)

    tasks = [(effect, *pair) for effect in effects for pair in _pairs(experiments, model)]
    fits = iter(Parallel(n_jobs=jobs, prefer="threads")(delayed(one)(*task) for task in tasks))
    return tuple(
        Model(tuple(name for name in model.effects if name != effect), tuple(next(fits) for _ in experiments))
        for effect in effects
    )


def recalibrated(experiments: Sequence[Experiment], jobs: int) -> Model:
    """The base parameters of every recording at their most probable values."""

    def one(experiment: Experiment) -> Fitted:
        return relinearised(experiment, best_of_starts(experiment, refit(experiment, experiment.origin)))

    return Model((), tuple(Parallel(n_jobs=jobs, prefer="threads")(delayed(one)(e) for e in experiments)))


def price(experiment: Experiment, before: Fitted, unknowns: int) -> float:
    """What the Bayesian information criterion charges: k log n, with the independent values counted."""
    return unknowns * float(np.log(max(before.scale.values(before.residual), np.e)))


def evidence(experiment: Experiment, before: Fitted, after: Fitted) -> float:
    """Evidence for a model with more unknowns in one recording, at the pace of the one with fewer."""
    scale = before.scale
    gain = cost_of(experiment, before.point, before.residual, scale)
    gain -= cost_of(experiment, after.point, after.residual, scale)
    visible = sum(1 for k in range(after.effect.shape[2]) if np.any(after.effect[:, :, k]))
    known = sum(1 for k in range(before.effect.shape[2]) if np.any(before.effect[:, :, k]))
    return scale.share * gain - price(experiment, before, visible - known)


def select(
    experiments: Sequence[Experiment],
    base: Model,
    jobs: int,
    worth: Callable[[Trial], bool],
    said: Callable[[str], None],
    store: Store,
    first: Sequence[shares.Left] = (),
) -> Selection:
    """Add effects while one pays.

    Args:
        experiments: the recordings.
        base: the recalibrated model.
        jobs: threads.
        worth: decides on a refitted candidate.
        said: told what is being done.
        store: keeps finished candidates.
        first: what was left before an effect that is in the experiments already, and is the first then; default: what
            the recalibrated model leaves.
    """
    begin = 2 if first else 1
    model, tried, first = base, [], first or shares.left_by(experiments, base.fits)
    for number in range(begin, MOST_EFFECTS + 1):
        if all(np.max(e.times_noise(f.residual)) < AT_NOISE for e, f in _pairs(experiments, model)):
            break
        found = _round(experiments, first, model, number, jobs, said, store)
        tried += found
        best = next((trial for trial in found if worth(trial)), None)
        if best is None or best.model is None:
            break
        model = shared(experiments, _renewed(experiments, best.model, jobs), jobs)
        said(f"{best.effect} added")
    return Selection(base, model, tuple(tried))


def _renewed(experiments: Sequence[Experiment], model: Model, jobs: int) -> Model:
    """The model with derivatives at its own points: of a candidate that is not taken nobody asks for them."""
    pairs = _pairs(experiments, model)
    return Model(
        model.effects, tuple(Parallel(n_jobs=jobs, prefer="threads")(delayed(relinearised)(*p) for p in pairs))
    )


def shared(experiments: Sequence[Experiment], model: Model, jobs: int) -> Model:
    """A model whose recordings have the effects of the others as well, where that costs them nothing.

    What one recording shows and another hardly does, the rig has in both: its values are taken over, beside base
    parameters that are fitted anew. What a recording rules out it does not get.

    Args:
        experiments: the recordings.
        model: of which each recording has the effects that paid in it.
        jobs: threads.
    """

    def one(experiment: Experiment, fitted: Fitted) -> Fitted:
        for effect in model.effects:
            path = f"effects.{effect}."
            if any(name.startswith(path) for name in fitted.point.effects):
                continue
            shows = max(model.fits, key=lambda other: _certainty(other, path))
            values = {name: value for name, value in shows.point.effects.items() if name.startswith(path)}
            point = Point(fitted.point.theta, {**fitted.point.effects, **values})
            given = refit(experiment, point, fitted.free, renewals=2, blocks_per_error=fitted.scale.blocks_per_error)
            if evidence(experiment, fitted, given) >= -POSITIVE:
                fitted = given
        return fitted

    fits = Parallel(n_jobs=jobs, prefer="threads")(delayed(one)(e, f) for e, f in _pairs(experiments, model))
    return Model(model.effects, tuple(fits))


def _certainty(fitted: Fitted, path: str) -> float:
    """How many standard deviations the sizes of an effect are; 0 where it is not free."""
    std = np.sqrt(np.diag(fitted.effect_covariance))
    here = [k for k, u in enumerate(fitted.free) if u.path.startswith(path) and u.item.is_size and std[k] > 0.0]
    return max((abs(fitted.point.effects.get(fitted.free[k].path, 0.0)) / std[k] for k in here), default=0.0)


def _round(
    experiments: Sequence[Experiment],
    first: Sequence[shares.Left],
    model: Model,
    number: int,
    jobs: int,
    said: Callable[[str], None],
    store: Store,
) -> list[Trial]:
    said(f"round {number}: score tests")
    tasks = [list(_score_tasks(e, f)) for e, f in _pairs(experiments, model)]
    scored = iter(Parallel(n_jobs=jobs, prefer="threads")(task for per in tasks for task in per))
    starts = [[next(scored) for _ in per] for per in tasks]
    # An effect of the model may be absent from the model of a recording in which it did not pay.
    names = [name for name in starts[0][0][0] if name not in model.effects]
    best = {name: [max(per, key=lambda pair: pair[0][name].gain) for per in starts] for name in names}
    totals = {name: sum(max(scores[name].gain, 0.0) for scores, _ in best[name]) for name in names}
    muscles = {name: _by_muscle([scores[name] for scores, _ in best[name]]) for name in names}
    order = sorted(names, key=lambda name: -totals[name])
    wanted = [name for name in order[:_REFITTED] if totals[name] > _TOLD]
    said(f"round {number}: refitting {', '.join(wanted) or 'nothing'}")
    pairs = [
        (name, r)
        for name in wanted
        for r in range(len(experiments))
        if best[name][r][0][name].gain > min(_TOLD, 0.2 * totals[name])
    ]
    begun = {(name, r): (best[name][r][0][name], best[name][r][1]) for name, r in pairs}
    done = _fits(experiments, model, begun, jobs, store)
    before = shares.left_by(experiments, model.fits)
    trials = []
    for name in order:
        if name not in wanted:
            trials.append(Trial(name, number, totals[name], muscles=muscles[name]))
            continue
        chosen, total, foretold = [], 0.0, 0.0
        for r, (experiment, old) in enumerate(_pairs(experiments, model)):
            new = done.get((name, r))
            gain = evidence(experiment, old, new) if new is not None else 0.0
            # A recording in which the candidate does not pay keeps its model.
            chosen.append(new if new is not None and gain > 0.0 else old)
            total += max(gain, 0.0)
            if new is not None and gain > 0.0:
                foretold += _foretold(experiment, old, new)
        extended = Model((*model.effects, name), tuple(chosen))
        after = shares.left_by(experiments, extended.fits)
        each = shares.held_share(experiments, before, after), shares.fitted_share(experiments, before, after)
        share = shares.further_share(experiments, first, before, after)
        trials.append(Trial(name, number, totals[name], total, foretold, each, extended, muscles[name], share))
    trials.sort(key=lambda trial: (-trial.standing, -trial.score))
    return trials


def _by_muscle(scores: Sequence[Score]) -> tuple[float, float] | None:
    """Evidence for each muscle alone over all recordings."""
    each = [score.muscles for score in scores if score.muscles is not None]
    return (sum(max(a, 0.0) for a, _ in each), sum(max(b, 0.0) for _, b in each)) if each else None


def _fits(
    experiments: Sequence[Experiment],
    model: Model,
    begun: Mapping[tuple[str, int], tuple[Score, Fitted]],
    jobs: int,
    store: Store,
) -> dict[tuple[str, int], Fitted]:
    """Candidates (effect, recording), refitted from the start that a score test tells; the best from others as well."""
    keys = {(name, r): key_of(experiments[r], (*model.effects, name)) for name, r in begun}
    unknowns = {(name, r): (*model.fits[r].free, *score.candidate.free) for (name, r), (score, _) in begun.items()}
    parallel = Parallel(n_jobs=jobs, prefer="threads")

    def descent(which: tuple[str, int]) -> tuple[Fitted, float, bool]:
        experiment, (score, start), kept = experiments[which[1]], begun[which], store.load(keys[which])
        if kept is not None:
            return refit(experiment, kept.point, unknowns[which], rounds=0, blocks_per_error=kept.pace), kept.gain, True
        point = Point(start.point.theta, {**start.point.effects, **score.start})
        fitted = refit(experiment, point, unknowns[which], start.base, renewals=2)
        return fitted, max(evidence(experiment, model.fits[which[1]], fitted), 0.0), False

    def end(which: tuple[str, int], descended: Fitted, gain: float, starts: int) -> Fitted:
        fitted = best_of_starts(experiments[which[1]], descended, starts)
        store.save(keys[which], Kept(fitted.point, fitted.scale.blocks_per_error, gain))
        return fitted

    first = dict(zip(begun, parallel(delayed(descent)(which) for which in begun), strict=True))
    gains = dict.fromkeys((name for name, _ in begun), 0.0)
    for (name, _), (_, gain, _) in first.items():
        gains[name] += gain
    bound = _BEHIND * max(gains.values(), default=0.0)
    left = {which: (fitted, gain) for which, (fitted, gain, finished) in first.items() if not finished}
    ends = parallel(
        delayed(end)(which, fitted, gain, STARTS if gains[which[0]] >= bound else 0)
        for which, (fitted, gain) in left.items()
    )
    return {which: fitted for which, (fitted, _, _) in first.items()} | dict(zip(left, ends, strict=True))


def _foretold(experiment: Experiment, old: Fitted, new: Fitted) -> float:
    """Evidence for a model on the held-out part of a recording."""
    before, after = (experiment.held(experiment.residual(f.point, whole=True)) for f in (old, new))
    gain = float(old.scale.misfits(before).sum() - old.scale.misfits(after).sum())
    return old.scale.share * gain


def _pairs(experiments: Sequence[Experiment], model: Model) -> list[tuple[Experiment, Fitted]]:
    return list(zip(experiments, model.fits, strict=True))


def _score_tasks(experiment: Experiment, fitted: Fitted):  # type: ignore[no-untyped-def]
    yield delayed(lambda: (score_all(experiment, fitted), fitted))()
    if not fitted.free:

        def far() -> tuple[dict[str, Score], Fitted]:
            start = as_configured(experiment, {})
            return score_all(experiment, fitted, start), start

        yield delayed(far)()
