"""Friction of a joint that sticks, judged along its measured motion.

The motion of a joint that sticks and slips differs from that of any model after seconds. So what no effect explains in
a free run is tested again along the measured motion, where all effects compete on equal terms
(:mod:`~pam_antagonist.inference.measured_motion`).
"""

from __future__ import annotations

from dataclasses import replace

from joblib import Parallel, delayed

from pam_antagonist.diagnosis import explained, findings, thresholds
from pam_antagonist.diagnosis.candidates import Model, Score, TriedCandidate, score_all
from pam_antagonist.diagnosis.preparation import Group, Settings
from pam_antagonist.diagnosis.selection import Selection
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, refit, relinearised
from pam_antagonist.inference.measured_motion import MeasuredMotion, along_motion
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.starts import STARTS, best_of_starts

FRICTION = "friction"
_RIVALS = 4
"""Other effects that are fitted beside friction: those with the best scores."""


def search(group: Group, selection: Selection, settings: Settings) -> tuple[Group, Selection] | None:
    """Friction that explains what no effect explains in a free run; None if it does not, or if no joint sticks."""
    free_runs = zip(group.experiments, selection.recalibrated.fits, strict=True)
    experiments = tuple(_along_motion(experiment, fitted) for experiment, fitted in free_runs)
    stuck = [r for r, experiment in enumerate(experiments) if isinstance(experiment, MeasuredMotion)]
    if not stuck:
        return None
    settings.progress("where the joint sticks: the balance of its torques along the measured motion")
    in_threads = Parallel(n_jobs=settings.jobs, prefer="threads")
    fits = list(selection.recalibrated.fits)
    for r, fitted in zip(stuck, in_threads(delayed(_without_effects)(experiments[r]) for r in stuck), strict=True):
        fits[r] = fitted
    base = Model((), tuple(fits))
    before = explained.remaining_residuals(experiments, fits)
    scores = dict(zip(stuck, in_threads(delayed(score_all)(experiments[r], fits[r]) for r in stuck), strict=True))
    total = {name: sum(max(scores[r][name].gain, 0.0) for r in stuck) for name in scores[stuck[0]]}
    rivals = sorted((name for name in total if name != FRICTION), key=lambda name: -total[name])[:_RIVALS]
    names = (FRICTION, *(name for name in rivals if total[name] > thresholds.LEAST_SCORE))
    tasks = [(name, r) for name in names for r in stuck]
    found = in_threads(delayed(_with_effect)(experiments[r], fits[r], scores[r][name]) for name, r in tasks)
    done = dict(zip(tasks, found, strict=True))

    def tried(name: str) -> TriedCandidate:
        every = [done.get((name, r)) for r in range(len(experiments))]
        one = TriedCandidate(name, 1, total[name])
        return explained.with_fits(one, experiments, before, before, base, (name,), every)

    ranking = sorted((tried(name) for name in names), key=lambda one: -one.standing)
    best = ranking[0]
    if best.effect != FRICTION or not explained.is_worth_taking(best) or best.model is None:
        return None
    if not explained.explains(experiments, base, best.model) and explained.leader(ranking) is not best:
        return None
    changed = replace(group, experiments=experiments, held_out=tuple(along_motion(other) for other in group.held_out))
    chosen = tuple(relinearised(e, f) for e, f in zip(experiments, best.model.fits, strict=True))
    return changed, Selection(base, Model((FRICTION,), chosen), tuple(ranking))


def _along_motion(experiment: Experiment, fitted: Fitted) -> Experiment:
    """A recording along its measured motion, with its calibrations corrected, if the joint sticks; others as is."""
    calibrated = along_motion(experiment.corrected(fitted.point)[0])
    return calibrated if isinstance(calibrated, MeasuredMotion) else experiment


def _without_effects(experiment: Experiment) -> Fitted:
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
