"""Friction of a joint that sticks, judged by predictions over short spans.

A joint that sticks and slips goes another way than any model of it after seconds. What no effect explains in a free run
is therefore asked again in :mod:`~pam_antagonist.inference.short_runs`. The candidates that did best in the free run
are fitted there as well, on equal terms.

How often a joint breaks loose is not smooth in its friction. So the fit starts from the best of a grid, and
Gauss-Newton steps alternate with a random search (an evolution strategy with one parent, Rechenberg 1973).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.diagnosis import explained, findings
from pam_antagonist.diagnosis.candidates import Model, TriedCandidate
from pam_antagonist.diagnosis.preparation import Group, Settings
from pam_antagonist.diagnosis.selection import Selection, recalibrate
from pam_antagonist.inference import calibration
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, moved_by, refit, relinearised
from pam_antagonist.inference.likelihood import solve
from pam_antagonist.inference.short_runs import ShortRuns, in_short_runs
from pam_antagonist.model.effects import parameter_path

Floats = NDArray[np.float64]

FRICTION = "friction"
_PATHS = tuple(parameter_path(FRICTION, name) for name in ("coulomb", "stribeck", "velocity"))
_GRID = (
    tuple(product((-0.02, -0.005, 0.005, 0.015, 0.04, 0.08), (0.0,), (0.3,))),
    *(tuple(product((c,), (0.01, 0.025, 0.06, 0.12), (0.1, 0.3))) for c in (-0.02, 0.0, 0.03, 0.08)),
)
"""Coulomb torque [N m], further torque at rest [N m] and velocity [rad/s] from which fits start: the best of each."""
_FOLLOWED = 2
"""Fits that are followed by a search."""
_SEARCHED = 150
"""Simulations of such a search."""
_STRIDE, _LONGER, _SHORTER = 0.5, 1.5, 0.93
"""Of its steps, in standard deviations, or in scales of the friction's numbers: the first; the factors after one that
led on, and after another."""
_RIVALS = 3
"""Candidates of the free run that are fitted beside friction."""


def search(group: Group, selection: Selection, settings: Settings) -> tuple[Group, Selection] | None:
    """Friction that explains what no effect explains in a free run; None where it does not, or where no joint sticks.

    Args:
        group: the recordings.
        selection: what was tried on them in free runs.
        settings: of the diagnosis.

    Returns:
        The recordings as they are judged, and what was tried on them.
    """
    free_runs = zip(group.experiments, selection.recalibrated.fits, strict=True)
    experiments = tuple(_over_spans(experiment, fitted) for experiment, fitted in free_runs)
    stuck = [r for r, experiment in enumerate(experiments) if isinstance(experiment, ShortRuns)]
    if not stuck:
        return None
    settings.progress("where the joint sticks: predictions over short spans")
    fits = list(selection.recalibrated.fits)
    in_threads = Parallel(n_jobs=settings.jobs, prefer="threads")
    quiet = recalibrate([experiments[r] for r in stuck], settings.jobs).fits
    # As long a search as friction has: without it, a better search would be taken for a better model.
    quiet = in_threads(delayed(searched)(experiments[r], fitted) for r, fitted in zip(stuck, quiet, strict=True))
    for r, fitted in zip(stuck, quiet, strict=True):
        fits[r] = relinearised(experiments[r], fitted)
    base = Model((), tuple(fits))
    before = explained.remaining_residuals(experiments, base.fits)

    def tried(effect: str, score: float, found: Sequence[Fitted]) -> TriedCandidate:
        new = dict(zip(stuck, found, strict=True))
        every = [new.get(r) for r in range(len(experiments))]
        one = TriedCandidate(effect, 1, score)
        return explained.with_fits(one, experiments, before, before, base, (effect,), every)

    rubbing = in_threads(delayed(fit_friction)(experiments[r], base.fits[r]) for r in stuck)
    scores = {one.effect: one.score for one in selection.tried if one.round == 1}
    best = tried(FRICTION, scores.get(FRICTION, 0.0), rubbing)
    if (
        not explained.is_worth_taking(best)
        or best.model is None
        or not explained.explains(experiments, base, best.model)
    ):
        return None
    rivals = [one for one in selection.tried if one.round == 1 and one.model is not None and one.effect != FRICTION]
    tasks = [(one, r) for one in rivals[:_RIVALS] for r in stuck]
    others = iter(in_threads(delayed(_as_in_free_run)(experiments[r], base.fits[r], one, r) for one, r in tasks))
    ranking = [best, *(tried(one.effect, one.score, [next(others) for _ in stuck]) for one in rivals[:_RIVALS])]
    ranking.sort(key=lambda one: -one.standing)
    if ranking[0] is not best:
        return None
    fits = [relinearised(e, f) for e, f in zip(experiments, best.model.fits, strict=True)]
    changed = replace(group, experiments=experiments, held_out=tuple(in_short_runs(other) for other in group.held_out))
    return changed, Selection(base, Model((FRICTION,), tuple(fits)), tuple(ranking))


def _over_spans(experiment: Experiment, fitted: Fitted) -> Experiment:
    """A recording of a joint that sticks, as calibrated sensors would have shown it, in spans; another as it is."""
    calibrated = in_short_runs(experiment.corrected(fitted.point)[0])
    return calibrated if isinstance(calibrated, ShortRuns) else experiment


def fit_friction(experiment: Experiment, base: Fitted) -> Fitted:
    """The most probable friction of a joint, beside the base parameters.

    Args:
        experiment: the recording in spans.
        base: its model without friction beside that of the rig file.
    """
    free, scale = Candidate(FRICTION).free, base.scale

    def beside(theta: Floats, numbers: Sequence[float]) -> tuple[float, Point]:
        """A point of the grid with base parameters that suit it to first order, where they suit it better."""
        start = Point(theta, dict(zip(_PATHS, numbers, strict=True)))
        residual = experiment.residual(start)
        none = np.zeros((*residual.shape, 0))
        moved = Point(theta + solve(residual, base.base, none, scale, experiment.prior, theta).theta, start.effects)
        costs = (cost_of(experiment, point, experiment.residual(point), scale) for point in (start, moved))
        return min(zip(costs, (start, moved), strict=True), key=lambda one: one[0])

    thetas = base.point.theta, np.zeros(experiment.size)
    starts = [min((beside(theta, one) for theta in thetas for one in part), key=lambda one: one[0]) for part in _GRID]
    fits = [refit(experiment, point, free, base.base, renewals=2) for _, point in starts]
    fits.sort(key=lambda fitted: fitted.cost)
    best = min((searched(experiment, fitted) for fitted in fits[:_FOLLOWED]), key=lambda fitted: fitted.cost)
    return findings.pruned(experiment, base, best, FRICTION)


def searched(experiment: Experiment, fitted: Fitted) -> Fitted:
    """A better model near a fit, which may have ended where breaking loose once more or once less costs much.

    Args:
        experiment: the recording in spans.
        fitted: its model.
    """
    rng, scale, free = np.random.default_rng(experiment.seed), fitted.scale, fitted.free
    values, vectors = np.linalg.eigh(fitted.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    point, least, stride = fitted.point, fitted.cost, _STRIDE
    for number in range(_SEARCHED):
        change = root @ rng.standard_normal(len(root))
        if free and number % 2:
            # The covariance is that of a slope, and knows nothing of what lies behind the next jump.
            change[:] = 0.0
            change[experiment.size :] = rng.standard_normal(len(free))
        there = moved_by(point, free, stride * change[: experiment.size], stride * change[experiment.size :])
        value = cost_of(experiment, there, experiment.residual(there), scale)
        if value < least:
            point, least, stride = there, value, stride * _LONGER
        else:
            stride *= _SHORTER
    pace = scale.blocks_per_error
    again = refit(experiment, point, free, fitted.base, renewals=2, blocks_per_error=pace)
    return min((fitted, again), key=lambda one: one.cost)


def _as_in_free_run(experiment: Experiment, base: Fitted, tried: TriedCandidate, r: int) -> Fitted:
    """A candidate of the free run, fitted in spans from where it was."""
    if tried.model is None:
        return base
    fitted = tried.model.fits[r]
    point = Point(fitted.point.theta, calibration.without(fitted.point.effects))
    free = tuple(one for one in fitted.free if not calibration.is_calibration(one.path))
    return refit(experiment, point, free, base.base, renewals=2)
