"""Noise and tuning of the filter from the recordings that the parameters came from.

The sensors' noise is what of the measurements no model could follow, sample by sample; R is its variance. What is left
in the innovations beyond it is process noise: Q is the one under which the innovations are most likely. What the
parameters are not known to becomes a few directions that the filter considers (Schmidt-Kalman). How large all this has
to be for the errors of the measured angle and torque is told by :mod:`calibration`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.optimize import minimize

from pam_antagonist.estimation import EstimateRun
from pam_antagonist.identification.calibration import calibrate
from pam_antagonist.identification.directions import (
    SETTLE_S,
    Direction,
    considered_directions,
    run_filter,
    short_part,
    with_directions,
)
from pam_antagonist.identification.fit import Fit
from pam_antagonist.identification.sensor_noise import with_noise
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.trial import Trial
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_EVALUATIONS = 40


@dataclass(frozen=True)
class Tuned:
    """What came of it.

    Attributes:
        rig: with noise, tuning ``default`` and directions.
        directions: what is carried as uncertain, before scaling.
        scale: factor of all directions; 1 where no reference was measured.
        likelihood: mean logarithm of the innovations' likelihood a sample, with the start's Q and with the tuned one.
        evaluations: how many Q were tried.
        calibrated: whether the scale was taken from a measured reference.
    """

    rig: Rig
    directions: tuple[Direction, ...]
    scale: float
    likelihood: tuple[float, float]
    evaluations: int
    calibrated: bool


def tune(
    rig: Rig,
    trials: Sequence[Trial],
    found: Fit,
    inner: Fit,
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
) -> Tuned:
    """Noise, Q, R and uncertain directions.

    Args:
        rig: with the fitted values.
        trials: the parts that were fitted.
        found: the fit.
        inner: the same fit of the first share of these parts: what it makes of the rest tells how wrong a fit is
            where it was not fitted.
        jobs: threads.
        progress: told what is being done.
    """
    tell = progress or (lambda text: None)
    tell("sensor noise")
    fitted = {item.name for item in found.problem.free}
    # What was not fitted stays as uncertain as it was declared.
    rig = rig.replaced(uncertainty={name: std for name, std in rig.uncertainty.items() if name not in fitted})
    rig = with_noise(rig, trials)
    parts = [short_part(trial) for trial in trials]
    tell("uncertain directions")
    directions = considered_directions(rig, parts, found.problem.free, found.predictive, jobs)
    rig = with_directions(rig, directions, 1.0)
    tell("process noise")
    rig, likelihood, evaluations = _tune_process(rig, parts, jobs)
    tell("scale of the uncertainty")
    scale, calibrated = calibrate(moved(rig, inner.values), trials, inner, inner.predictive, jobs)
    return Tuned(with_directions(rig, directions, scale), directions, scale, likelihood, evaluations, calibrated)


def own_tuning(rig: Rig, trial: Trial, found: Fit, inner: Fit, index: int, jobs: int = 1) -> Rig:
    """The rig with one recording's own values, with what these are not known to in place of the common ones', and Q.

    The Q of the common values covers what these miss in a single recording: for its own values it is too large.

    Args:
        rig: with the common values and the tuning that was found for them.
        trial: the part of the recording that was fitted.
        found: the fit.
        inner: the same fit of the first share of the part.
        index: of the recording.
        jobs: threads.
    """
    own, part = moved(rig, found.own_values(index)), short_part(trial)
    directions = considered_directions(own, [part], found.problem.free, found.own_covariance(index), jobs)
    own, _, _ = _tune_process(with_directions(own, directions, 1.0), [part], jobs)
    early = moved(own, inner.own_values(index))
    scale, _ = calibrate(early, [trial], inner, inner.own_covariance(index), jobs)
    return with_directions(own, directions, scale)


def innovation_likelihood(run: EstimateRun, settle: int) -> tuple[float, int]:
    """Sum of the logarithms of the innovations' likelihood, and of how many samples.

    Args:
        run: of the filter.
        settle: samples at its start that are left out.
    """
    rows = run.rows[settle:]
    s = rows["innovation_covariance"]
    determinant = s[:, 0, 0] * s[:, 1, 1] - s[:, 0, 1] * s[:, 1, 0]
    used = np.isfinite(rows["innovation"]).all(axis=1) & np.isfinite(rows["nis"]) & (determinant > 0.0)
    value = -0.5 * (rows["nis"][used] + np.log(determinant[used])) - math.log(2.0 * math.pi)
    return float(value.sum()), int(used.sum())


def _tune_process(rig: Rig, trials: Sequence[Trial], jobs: int) -> tuple[Rig, tuple[float, float], int]:
    tuning = rig.tuning("default")
    settle = round(SETTLE_S / rig.sample_period)

    def with_process(logarithm: Floats) -> Rig:
        velocity, pressure = (float(10.0**value) for value in np.clip(logarithm, [-12.0, -2.0], [1.0, 8.0]))
        # The angle has no noise of its own but what that of the velocity makes of it within a step: white acceleration.
        angle = velocity * rig.sample_period**2 / 3.0
        process = (angle, velocity, pressure, pressure)
        return rig.replaced(tunings={**rig.tunings, "default": tuning.replaced(process=process)})

    def against(logarithm: Floats) -> float:
        now = with_process(logarithm)
        runs = Parallel(n_jobs=jobs, prefer="threads")(delayed(run_filter)(now, trial) for trial in trials)
        sums = [innovation_likelihood(run, settle) for run in runs]
        return -sum(value for value, _ in sums) / max(sum(number for _, number in sums), 1)

    start = np.log10(np.maximum([tuning.process[1], tuning.process[2]], [1e-12, 1e-2]))
    first = against(start)
    simplex = start + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]])
    options = {"initial_simplex": simplex, "maxfev": _EVALUATIONS, "xatol": 0.05, "fatol": 1e-5}
    found = minimize(against, start, method="Nelder-Mead", options=options)
    return with_process(found.x), (-first, -float(found.fun)), int(found.nfev) + 1
