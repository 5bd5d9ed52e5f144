"""Noise and tuning of the filter from the recordings that the parameters came from.

The sensors' noise is what of the measurements no model could follow, sample by sample; R is its variance. What is left
in the innovations beyond it is process noise: Q is the one under which the innovations are most likely. What the
parameters are not known to becomes a few directions that the filter considers (Schmidt-Kalman), and one scale for all
of them, under which the errors of the measured angle and torque are most likely, beyond the part that an inner fit had.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from pam_antagonist.estimation import EstimateRun, Estimator
from pam_antagonist.identification.change import moved
from pam_antagonist.identification.fit import Fit
from pam_antagonist.identification.freedom import FreeParameter
from pam_antagonist.identification.trial import ANGLE, PRESSURE_1, TORQUE, Trial
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_PART_S = 20.0
"""[s] of each recording that are used to look for Q and for directions."""
_EVALUATIONS = 40
_MOST_CONSIDERED = 5
"""Directions, with the single parameters that were declared uncertain and not fitted."""
_EXPLAINED = 0.99
_SETTLE_S = 1.0
"""[s] after the start of the filter that are not judged: its first covariance is a guess."""
_SCALES = (1.0, 8.0)
"""Not below 1: a handful of slow errors can show that the parameters' covariance is too small, but not that it is too
large."""
INNER_SHARE = 2.0 / 3.0
"""Of the fitted part, what an inner fit gets; the rest tells how wrong such a fit is where it was not fitted."""
_MOST_LEVELS = 0.3
"""Distinct values a sample of a converted signal: a signal without steps has nearly as many as samples."""
_ON_GRID, _SHARE_ON_GRID = 0.02, 0.98
_CALIBRATIONS = 12


@dataclass(frozen=True)
class Direction:
    """Parameters that are uncertain together.

    Attributes:
        name: in the rig file.
        changes: by parameter, for one standard deviation.
        angle: RMS effect on the estimated angle [rad].
        torque: RMS effect on the estimated torque [N m].
        share: of the whole effect.
    """

    name: str
    changes: dict[str, float]
    angle: float
    torque: float
    share: float


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
    parts = [_part(trial) for trial in trials]
    tell("uncertain directions")
    directions = considered_directions(rig, parts, found.problem.free, found.predictive, jobs)
    rig = with_directions(rig, directions, 1.0)
    tell("process noise")
    rig, likelihood, evaluations = _tune_process(rig, parts, jobs)
    tell("scale of the uncertainty")
    scale, calibrated = _calibrate(moved(rig, inner.values), trials, inner, inner.predictive, jobs)
    return Tuned(with_directions(rig, directions, scale), directions, scale, likelihood, evaluations, calibrated)


def white_std(values: Floats) -> float:
    """Standard deviation of the noise of a slow signal: that of its differences over √2.

    Args:
        values: (N,), NaN where missing.
    """
    step = np.diff(values)
    step = step[np.isfinite(step)]
    return float(np.sqrt(np.mean(step * step) / 2.0)) if step.size else float("nan")


def converter_step(values: Floats) -> float:
    """Step of the converter behind a signal; 0 where its values lie on no grid.

    A slow signal shows little of its converter in the differences of neighbours, which are mostly none, so that its
    noise looks smaller than the error of a reading is.

    Args:
        values: (N,), NaN where missing.
    """
    known = values[np.isfinite(values)]
    levels = np.unique(known)
    if len(levels) < 2 or len(levels) > _MOST_LEVELS * len(known):
        return 0.0
    step = float(np.median(np.diff(levels)))
    off = np.abs(np.diff(levels) / step - np.rint(np.diff(levels) / step))
    return step if np.mean(off < _ON_GRID) > _SHARE_ON_GRID else 0.0


def with_noise(rig: Rig, trials: Sequence[Trial]) -> Rig:
    """The rig with the sensors' noise and R of the tuning ``default`` as the recordings show them."""

    def of(channel: int) -> float:
        stds = [white_std(trial.measured[:, channel]) for trial in trials if trial.has(channel)]
        known = [std for std in stds if math.isfinite(std)]
        return float(np.sqrt(np.mean(np.square(known)))) if known else float("nan")

    def less_step(std: float, step: float) -> float:
        return float(np.sqrt(max(std**2 - step**2 / 12.0, 0.0)))

    sensors = rig.sensors
    pressure = [max(of(PRESSURE_1 + i), sensors.pressure_step / np.sqrt(12.0), 10.0) for i in (0, 1)]
    changes = {"pressure_std": max(less_step(float(np.hypot(*pressure)) / np.sqrt(2.0), sensors.pressure_step), 10.0)}
    for channel, name in ((ANGLE, "angle"), (TORQUE, "torque")):
        std = of(channel)
        if math.isfinite(std):
            seen = [converter_step(trial.measured[:, channel]) for trial in trials if trial.has(channel)]
            step = max(*seen, getattr(sensors, f"{name}_step"))
            changes |= {f"{name}_std": less_step(std, step), f"{name}_step": step}
    tuning = rig.tuning("default").replaced(measurement=tuple(float(std**2) for std in pressure), consider=True)
    return rig.replaced(sensors=sensors.replaced(**changes), tunings={**rig.tunings, "default": tuning}, directions={})


def with_directions(rig: Rig, directions: Sequence[Direction], scale: float) -> Rig:
    """The rig with these directions, all of them times a scale."""
    scaled = {item.name: {name: scale * step for name, step in item.changes.items()} for item in directions}
    return rig.replaced(directions=scaled)


def run_filter(rig: Rig, trial: Trial) -> EstimateRun:
    """The estimator over a trial."""
    estimator = Estimator(rig, joint=trial.joint, lock_angle=trial.lock_angle)
    stamps = np.arange(1, len(trial) + 1, dtype=np.int64) * round(trial.dt * 1e9)
    return estimator.run(stamps, trial.measured[:, PRESSURE_1:], trial.voltage)


def _part(trial: Trial) -> Trial:
    return trial.part(0.0, min(_PART_S, len(trial) * trial.dt))


def own_tuning(rig: Rig, trial: Trial, found: Fit, inner: Fit, index: int, jobs: int = 1) -> Rig:
    """The rig with one recording's own values, and with what these are not known to in place of the common ones'.

    Args:
        rig: with the common values and the tuning that was found for them.
        trial: the part of the recording that was fitted.
        found: the fit.
        inner: the same fit of the first share of the part.
        index: of the recording.
        jobs: threads.
    """
    own = moved(rig, found.own_values(index))
    directions = considered_directions(own, [_part(trial)], found.problem.free, found.own_covariance(index), jobs)
    early = moved(rig, inner.own_values(index))
    scale, _ = _calibrate(early, [trial], inner, inner.own_covariance(index), jobs)
    return with_directions(own, directions, scale)


def considered_directions(
    rig: Rig, trials: Sequence[Trial], free: Sequence[FreeParameter], covariance: Floats, jobs: int
) -> tuple[Direction, ...]:
    """The combinations of parameters whose uncertainty moves the estimate most.

    The estimate is run anew with each eigenvector of the parameters' covariance added; a singular value decomposition
    of what that does to angle and torque gives independent combinations in the order of their effect.

    Args:
        rig: with the fitted values and noise.
        trials: recordings.
        free: the parameters that were fitted.
        covariance: theirs (F, F), in units of the priors.
        jobs: threads.
    """
    values, vectors = np.linalg.eigh(covariance)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))
    plain = rig.replaced(tunings={**rig.tunings, "default": rig.tuning("default").replaced(consider=False)})
    settle = round(_SETTLE_S / rig.sample_period)

    def estimate(step: Floats) -> Floats:
        now = moved(
            plain,
            {item.name: rig.value(item.name) + item.prior_std * float(s) for item, s in zip(free, step, strict=True)},
        )
        parts = []
        for trial in trials:
            rows = run_filter(now, trial).rows[settle::10]
            parts.append(np.column_stack([rows["angle"], rows["torque"]]))
        return np.concatenate(parts)

    # A tenth of a standard deviation: far enough for the slope, near enough to stay with it.
    near = 0.1
    steps = [np.zeros(len(free)), *(near * roots.T)]
    runs = Parallel(n_jobs=jobs, prefer="threads")(delayed(estimate)(step) for step in steps)
    effect = np.stack([(run - runs[0]) / near for run in runs[1:]], axis=2)
    size = np.sqrt(np.mean(np.sum(effect**2, axis=2), axis=0))
    scaled = (effect / np.where(size > 0.0, size, 1.0)[None, :, None]).reshape(-1, len(free))
    _, strength, turned = np.linalg.svd(scaled, full_matrices=False)
    share = strength**2 / max(float(np.sum(strength**2)), 1e-300)
    count = min(int(np.searchsorted(np.cumsum(share), _EXPLAINED)) + 1, max(_MOST_CONSIDERED - len(rig.uncertainty), 1))
    out = []
    for k in range(count):
        if share[k] <= 1e-6:
            break
        step = roots @ turned[k]
        moves = np.sqrt(np.mean((effect @ turned[k]) ** 2, axis=0))
        changes = {item.name: float(item.prior_std * s) for item, s in zip(free, step, strict=True)}
        out.append(Direction(f"mode_{k + 1}", changes, float(moves[0]), float(moves[1]), float(share[k])))
    return tuple(out)


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
    settle = round(_SETTLE_S / rig.sample_period)

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


def _calibrate(rig: Rig, trials: Sequence[Trial], inner: Fit, covariance: Floats, jobs: int) -> tuple[float, bool]:
    """The scale of the uncertainty under which the errors of measured angles and torques are most likely.

    They are those after the part that ``inner`` was fitted to: in that part a fit comes nearer to what was measured
    than to the truth, by as much as it is uncertain.

    Args:
        rig: with the values of ``inner``, noise and Q.
        trials: recordings beyond the part that ``inner`` was fitted to.
        inner: a fit of their beginnings.
        covariance: of its parameters (F, F), in units of the priors.
        jobs: threads.
    """
    fields = {ANGLE: ("angle", 0), TORQUE: ("torque", 2)}
    judged = [(k, channel) for k, trial in enumerate(trials) for channel in fields if trial.has(channel)]
    directions = considered_directions(rig, [_part(trial) for trial in trials], inner.problem.free, covariance, jobs)
    if not judged or not directions:
        return 1.0, False
    noise = {ANGLE: rig.sensors.error("angle") ** 2, TORQUE: rig.sensors.error("torque") ** 2}

    def against(logarithm: float) -> float:
        now = with_directions(rig, directions, math.exp(logarithm))
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

    bounds = (math.log(_SCALES[0]), math.log(_SCALES[1]))
    options = {"xatol": 0.05, "maxiter": _CALIBRATIONS}
    found = minimize_scalar(against, bounds=bounds, method="bounded", options=options)
    return float(math.exp(found.x)), True
