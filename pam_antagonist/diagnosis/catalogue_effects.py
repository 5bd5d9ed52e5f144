"""An effect of the catalogue as a hypothesis: all are scored, the best are fitted, in every recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from typing_extensions import override

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.candidates import Score, as_configured, score_all
from pam_antagonist.diagnosis.checkpoint import Checkpoint, Kept, key_of
from pam_antagonist.diagnosis.hypotheses import Hypothesis, Ranking, TriedCandidate, Work
from pam_antagonist.diagnosis.models import Model, evidence, in_threads, shared
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


class CatalogueEffect(Hypothesis):
    """An effect of the catalogue that acts throughout."""

    @override
    def propose(self, now: Ranking, number: int, work: Work) -> list[TriedCandidate]:
        """Score all candidates beside a model above noise, and fit the best of them."""
        model = now.model
        if model.is_at_noise:
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
    def take(self, now: Ranking, best: TriedCandidate) -> tuple[Model, Model]:
        """The effect in all recordings that do not rule it out, with derivatives at its own point."""
        assert best.model is not None
        return now.base, shared(best.model.map(relinearised))


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
    tasks = [(r, *pair, far) for r, pair in enumerate(model.pairs) for far in _ways(pair[1])]

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


def _ways(fitted: Fitted) -> tuple[bool, ...]:
    return (False, True) if all(is_calibration(free.path) for free in fitted.free) else (False,)


def _fits(
    model: Model, begun: Mapping[tuple[str, int], tuple[Score, Fitted]], checkpoint: Checkpoint
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
