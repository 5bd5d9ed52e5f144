"""Friction of a joint that sticks, judged along its measured motion.

The motion of a joint that sticks and slips differs from that of any model after seconds. So what no effect explains in
a free run is tested again along the measured motion, where all effects compete on equal terms
(:mod:`~pam_antagonist.inference.measured_motion`).
"""

from __future__ import annotations

from dataclasses import replace

from typing_extensions import override

from pam_antagonist.diagnosis import findings, thresholds
from pam_antagonist.diagnosis.catalogue_effects import CatalogueEffect, Score, score_all
from pam_antagonist.diagnosis.hypotheses import Ranking, TriedCandidate, Work
from pam_antagonist.diagnosis.models import Model, explains, in_threads
from pam_antagonist.diagnosis.search import search
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, refit, relinearised
from pam_antagonist.inference.measured_motion import MeasuredMotion, along_motion
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.starts import STARTS, best_of_starts

FRICTION = "friction"
_RIVALS = 4
"""Other effects that are fitted beside friction: those with the best scores."""


class FrictionAlongMotion(CatalogueEffect):
    """Friction, where it is the best effect along the measured motion of a joint that sticks."""

    @override
    def propose(self, now: Ranking, number: int, work: Work) -> list[TriedCandidate]:
        base = replace(now.base, experiments=tuple(_along_motion(*pair) for pair in now.base.pairs))
        stuck = [r for r, experiment in enumerate(base.experiments) if isinstance(experiment, MeasuredMotion)]
        if not stuck:
            return []
        work.progress("where the joint sticks: the balance of its torques along the measured motion")
        fits = list(base.fits)
        for r, fitted in zip(stuck, in_threads(_without_effects, base.of(stuck).pairs, base.jobs), strict=True):
            fits[r] = fitted
        base = Model(base.experiments, tuple(fits))
        scores = dict(zip(stuck, base.of(stuck).each(score_all), strict=True))
        total = {name: sum(max(scores[r][name].gain, 0.0) for r in stuck) for name in scores[stuck[0]]}
        rivals = sorted((name for name in total if name != FRICTION), key=lambda name: -total[name])[:_RIVALS]
        names = (FRICTION, *(name for name in rivals if total[name] > thresholds.LEAST_SCORE))
        tasks = [(name, r) for name in names for r in stuck]
        fitted_with = in_threads(_with_effect, ((*base.pairs[r], scores[r][name]) for name, r in tasks), base.jobs)
        done = dict(zip(tasks, fitted_with, strict=True))

        def tried(name: str) -> TriedCandidate:
            every = [done.get((name, r)) for r in range(len(fits))]
            return TriedCandidate(name, number, total[name], base=base).fitted(base, base, every, (name,))

        best, *others = sorted((tried(name) for name in names), key=lambda one: -one.standing)
        if best.effect != FRICTION or best.model is None:
            return []
        return [replace(best, model=best.model.map(relinearised)), *others]

    @override
    def is_worth_taking(self, tried: TriedCandidate) -> bool:
        return tried.effect == FRICTION and tried.is_worth_taking


def friction_along_motion(found: Ranking, work: Work) -> Ranking | None:
    """Friction that explains what no effect explains in a free run; None if it does not, or if no joint sticks."""
    ranking = search(found.base, work, (FrictionAlongMotion(),), most=1)
    model = ranking.model
    return ranking if model.effects and (explains(ranking.base, model) or ranking.leader) else None


def _along_motion(experiment: Experiment, fitted: Fitted) -> Experiment:
    """A recording along its measured motion, with its calibrations corrected, if the joint sticks; others as is."""
    calibrated = along_motion(experiment.corrected(fitted.point)[0])
    return calibrated if isinstance(calibrated, MeasuredMotion) else experiment


def _without_effects(experiment: Experiment, _: Fitted) -> Fitted:
    """The base parameters at their most probable values, with the usual blocks per independent error.

    If every block counted, as for a model that is right, the data could move a base parameter by many standard
    deviations, and it would imitate the effect.
    """
    return relinearised(experiment, refit(experiment, experiment.origin))


def _with_effect(experiment: Experiment, base: Fitted, score: Score) -> Fitted:
    """An effect beside the base parameters; friction without the numbers that do not pay."""
    start = Point(base.point.theta, {**base.point.effects, **score.start})
    fitted = refit(experiment, start, (*base.free, *score.candidate.free), base.base, renewals=2, beside=base)
    # With as many blocks per error as without the effect: else the weight of the priors would look like evidence.
    fitted = best_of_starts(experiment, fitted, STARTS, finer=False)
    return findings.pruned(experiment, base, fitted, score.candidate.effect)
