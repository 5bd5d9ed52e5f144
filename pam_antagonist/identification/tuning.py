"""Noise and tuning of the filter from the recordings that the parameters came from.

- R: the sensors' noise, which is what no model could follow from sample to sample.
- Q: the process noise under which the innovations are most likely.
- Considered directions (Schmidt-Kalman): the uncertainty of the fitted parameters as a few directions.
- Scale of these directions: from errors of the measured angle and torque after the part that an inner fit used. These
  errors gave no further process noise of the angle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.estimation import EstimateRun
from pam_antagonist.identification.directions import (
    SETTLE_S,
    ConsideredDirection,
    Sensitivity,
    considered_directions,
    run_filter,
    short_part,
    with_directions,
)
from pam_antagonist.identification.quadratic_search import minimum
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.joint_fit import JointFit
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, Trial, converter_step, white_std
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]


def with_noise(rig: Rig, trials: Sequence[Trial]) -> Rig:
    """The rig with the sensors' noise and R of the tuning ``default`` as the recordings show them."""

    def noise_of(channel: int) -> float:
        stds = [white_std(trial.measured[:, channel], trial.dt) for trial in trials if trial.has(channel)]
        known = [std for std in stds if math.isfinite(std)]
        return float(np.sqrt(np.mean(np.square(known)))) if known else float("nan")

    def less_step(std: float, step: float) -> float:
        return float(np.sqrt(max(std**2 - step**2 / 12.0, 0.0)))

    sensors = rig.sensors
    pressure = [max(noise_of(PRESSURE_1 + i), sensors.pressure_step / np.sqrt(12.0), 10.0) for i in (0, 1)]
    changes = {"pressure_std": max(less_step(float(np.hypot(*pressure)) / np.sqrt(2.0), sensors.pressure_step), 10.0)}
    for channel, name in ((ANGLE, "angle"), (TORQUE, "torque")):
        std = noise_of(channel)
        if math.isfinite(std):
            seen = [converter_step(trial.measured[:, channel]) for trial in trials if trial.has(channel)]
            step = max(*seen, getattr(sensors, f"{name}_step"))
            changes |= {f"{name}_std": less_step(std, step), f"{name}_step": step}
    tuning = rig.tuning("default").replaced(measurement=tuple(float(std**2) for std in pressure), consider=True)
    # Noise that no sensor may have makes an identified rig impossible; it is no fault of the rig that was given.
    return rig.unchecked(
        sensors=sensors.unchecked(**changes), tunings={**rig.tunings, "default": tuning}, directions={}
    )


INNER_SHARE = 2.0 / 3.0
"""Share of the fitted part that an inner fit gets; the rest shows how wrong such a fit is outside its data."""
_SCALES = (1.0, 8.0)
"""Bounds of the scale. A handful of slow errors can show that the parameters' covariance is too small, but not that it
is too large. So the scale is never below 1."""
_CALIBRATIONS = 12
_LIKELIER_SCALE = 1e-3
"""Least gain of the mean log likelihood of a sample that is worth another scale: errors of a second count as one."""


def calibrate(
    rig: Rig, trials: Sequence[Trial], known: Sensitivity, covariance: Floats, jobs: int
) -> tuple[float, bool]:
    """The scale under which the errors of measured angles and torques are most likely, and whether any were measured.

    Only errors after the part that the inner fit used are judged. Within it a fit follows the measurement more closely
    than the truth.

    Args:
        rig: with the values of the inner fit, noise and Q.
        trials: the parts that were fitted; their errors count after :data:`INNER_SHARE`.
        known: derivatives of the estimate of these trials by the parameters.
        covariance: of the inner fit's parameters (F, F), in units of the priors.
        jobs: threads.
    """
    fields = {ANGLE: ("angle", 0), TORQUE: ("torque", 2)}
    judged = [(k, channel) for k, trial in enumerate(trials) for channel in fields if trial.has(channel)]
    directions = considered_directions(rig, [short_part(trial) for trial in trials], known, covariance)
    if not judged or not directions:
        return 1.0, False
    noise = {ANGLE: rig.sensors.error("angle") ** 2, TORQUE: rig.sensors.error("torque") ** 2}

    def against(logarithm: Floats) -> float:
        now = with_directions(rig, directions, math.exp(logarithm[0]))
        runs = Parallel(n_jobs=jobs, prefer="threads")(delayed(run_filter)(now, trial) for trial in trials)
        total = 0.0
        for k, channel in judged:
            name, place = fields[channel]
            begin = round(INNER_SHARE * len(runs[k].rows))
            rows, index = runs[k].rows[begin:], runs[k].index[begin:]
            error = rows[name] - trials[k].measured[index, channel]
            variance = rows["covariance"][:, place, place] + max(noise[channel], 1e-12)
            good = np.isfinite(error)
            total += float(np.mean(0.5 * error[good] ** 2 / variance[good] + 0.5 * np.log(variance[good])))
        return total

    bounds = [(math.log(_SCALES[0]), math.log(_SCALES[1]))]
    found = minimum(against, (bounds[0][0],), (0.5,), bounds, _LIKELIER_SCALE, _CALIBRATIONS)
    return math.exp(found.x[0]), True


_EVALUATIONS = 40
_LIKELIER = 1e-4
"""Least gain of the mean log likelihood of a sample that is worth another Q. Where a joint sticks now and then, the
likelihood is ragged by more than this."""
_PROCESS = ((-12.0, 1.0), (-2.0, 8.0))
"""Bounds of log10 of the process noise of velocity [rad²/s²] and pressure [Pa²]."""


@dataclass(frozen=True)
class Tuned:
    """The result of a tuning.

    Attributes:
        rig: with noise, tuning ``default`` and directions.
        directions: that the filter considers, before scaling.
        scale: factor of all directions; 1 where no reference was measured.
        likelihood: mean log likelihood of the innovations per sample, with the start's Q and with the tuned one.
        evaluations: how many Q were tried.
        calibrated: whether the scale was taken from a measured reference.
        sensitivity: derivatives of the estimates by the parameters, of the parts that were fitted.
    """

    rig: Rig
    directions: tuple[ConsideredDirection, ...]
    scale: float
    likelihood: tuple[float, float]
    evaluations: int
    calibrated: bool
    sensitivity: Sensitivity


def tune(
    rig: Rig,
    trials: Sequence[Trial],
    found: JointFit,
    inner: JointFit,
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
) -> Tuned:
    """Noise, Q, R and uncertain directions.

    Args:
        rig: with the fitted values.
        trials: the parts that were fitted.
        found: the fit.
        inner: the same fit of the first share of these parts; its errors on the rest show how wrong a fit is outside
            its data.
        jobs: threads.
        progress: called with what is being done.
    """
    progress = progress or (lambda text: None)
    progress("sensor noise")
    fitted = {item.name for item in found.problem.free}
    # What was not fitted stays as uncertain as it was declared.
    rig = rig.replaced(uncertainty={name: std for name, std in rig.uncertainty.items() if name not in fitted})
    rig = with_noise(rig, trials)
    parts = [short_part(trial) for trial in trials]
    progress("uncertain directions")
    known = Sensitivity.of(rig, parts, found.problem.free, found.predictive, jobs)
    directions = considered_directions(rig, parts, known, found.predictive)
    rig = with_directions(rig, directions, 1.0)
    progress("process noise")
    rig, likelihood, evaluations = _tune_process(rig, parts, jobs)
    progress("scale of the uncertainty")
    scale, calibrated = calibrate(moved(rig, inner.values), trials, known, inner.predictive, jobs)
    tuned = with_directions(rig, directions, scale)
    return Tuned(tuned, directions, scale, likelihood, evaluations, calibrated, known)


def own_tuning(tuned: Tuned, trial: Trial, found: JointFit, inner: JointFit, index: int, jobs: int = 1) -> Rig:
    """The rig with one recording's own values, and with the directions and the Q that belong to them.

    The Q of the common values also covers their errors in a single recording. For its own values it is too large.

    Args:
        tuned: the rig with the common values and the tuning that was found for them.
        trial: the part of the recording that was fitted.
        found: the fit.
        inner: the same fit of the first share of the part.
        index: of the recording.
        jobs: threads.
    """
    own, part = moved(tuned.rig, found.own_values(index)), short_part(trial)
    known = tuned.sensitivity.of_trial(index)
    directions = considered_directions(own, [part], known, found.own_covariance(index))
    own, _, _ = _tune_process(with_directions(own, directions, 1.0), [part], jobs)
    early = moved(own, inner.own_values(index))
    scale, _ = calibrate(early, [trial], known, inner.own_covariance(index), jobs)
    return with_directions(own, directions, scale)


def innovation_likelihood(run: EstimateRun, counted: slice | NDArray[np.bool_]) -> tuple[float, int]:
    """Sum of the innovations' log likelihoods, and the number of samples in it.

    Args:
        run: of the filter.
        counted: samples of it that count: a slice, or for each sample whether it does (M,).
    """
    rows = run.rows[counted]
    s = rows["innovation_covariance"]
    determinant = s[:, 0, 0] * s[:, 1, 1] - s[:, 0, 1] * s[:, 1, 0]
    used = np.isfinite(rows["innovation"]).all(axis=1) & np.isfinite(rows["nis"]) & (determinant > 0.0)
    value = -0.5 * (rows["nis"][used] + np.log(determinant[used])) - math.log(2.0 * math.pi)
    return float(value.sum()), int(used.sum())


def _tune_process(rig: Rig, trials: Sequence[Trial], jobs: int) -> tuple[Rig, tuple[float, float], int]:
    tuning = rig.tuning("default")

    def with_process(logarithm: Floats) -> Rig:
        velocity, pressure = (float(10.0**value) for value in logarithm)
        # The angle's noise is only what the velocity's noise causes within a step: white acceleration.
        angle = velocity * rig.sample_period**2 / 3.0
        process = (angle, velocity, pressure, pressure)
        return rig.replaced(tunings={**rig.tunings, "default": tuning.replaced(process=process)})

    def against(logarithm: Floats) -> float:
        now = with_process(logarithm)
        runs = Parallel(n_jobs=jobs, prefer="threads")(delayed(run_filter)(now, trial) for trial in trials)
        sums = [
            innovation_likelihood(run, slice(trial.samples(SETTLE_S), None))
            for run, trial in zip(runs, trials, strict=True)
        ]
        return -sum(value for value, _ in sums) / max(sum(number for _, number in sums), 1)

    start = np.clip(np.log10(np.maximum([tuning.process[1], tuning.process[2]], 1e-300)), *np.transpose(_PROCESS))
    tried: list[float] = []

    def remembered(logarithm: Floats) -> float:
        tried.append(against(logarithm))
        return tried[-1]

    found = minimum(remembered, start, (1.0, -1.0), _PROCESS, _LIKELIER, _EVALUATIONS)
    return with_process(found.x), (-tried[0], -found.value), found.evaluations
