"""Noise and tuning of the filter from the recordings that the parameters came from.

- R: the sensors' noise is what of the measurements no model could follow, sample by sample.
- Q: what is left in the innovations beyond that is process noise, of the size under which they are most likely.
- Considered directions (Schmidt-Kalman): what a fit does not know of the parameters, as a few directions.
- Scale of these directions: how wrong the estimate is where nothing was fitted, by the errors of the measured angle and
  torque beyond the part that an inner fit had. A process noise of the angle was tried beside it: such errors gave it no
  size.
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
from pam_antagonist.inference.free_parameters import Direction, FreeParameter, moved
from pam_antagonist.inference.joint_fit import JointFit
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, Trial, converter_step, white_std
from pam_antagonist.model import equilibrium
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]


def with_noise(rig: Rig, trials: Sequence[Trial]) -> Rig:
    """The rig with the sensors' noise and R of the tuning ``default`` as the recordings show them."""

    def of(channel: int) -> float:
        stds = [white_std(trial.measured[:, channel], trial.dt) for trial in trials if trial.has(channel)]
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


SETTLE_S = 1.0
"""[s] after the start of the filter that are not judged: its first covariance is a guess."""
_PART_S = 20.0
_APART_S = 0.01
"""[s] between the estimates that count."""
_MOST_CONSIDERED = 10
"""Directions, with the single parameters that were declared uncertain and not fitted: each is two sigma points more."""
_EXPLAINED = 0.99
_GRID = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
"""Of what the supply has beyond the atmosphere: pressures at which the joint may come to rest."""


@dataclass(frozen=True)
class ConsideredDirection(Direction):
    """Parameters that are uncertain together; its amount counts in standard deviations.

    Attributes:
        angle: RMS effect on the estimated angle [rad].
        torque: RMS effect on the estimated torque [N m].
        share: of the whole effect.
    """

    angle: float
    torque: float
    share: float


def with_directions(rig: Rig, directions: Sequence[ConsideredDirection], scale: float) -> Rig:
    """The rig with these directions, all of them times a scale.

    Args:
        rig: without them.
        directions: that the filter considers.
        scale: factor of all changes.
    """
    scaled = {item.name: {name: scale * step for name, step in item.changes.items()} for item in directions}
    return rig.replaced(directions=scaled)


def run_filter(rig: Rig, trial: Trial) -> EstimateRun:
    """The estimator over a trial."""
    estimator = Estimator(rig, joint=trial.joint, lock_angle=trial.lock_angle)
    stamps = np.arange(1, len(trial) + 1, dtype=np.int64) * round(trial.dt * 1e9)
    return estimator.run(stamps, trial.measured[:, PRESSURE_1:], trial.voltage)


def short_part(trial: Trial) -> Trial:
    """As much of a recording as is used to look for Q and for directions."""
    return trial.part(0.0, min(_PART_S, len(trial) * trial.dt))


def considered_directions(
    rig: Rig, trials: Sequence[Trial], free: Sequence[FreeParameter], covariance: Floats, jobs: int
) -> tuple[ConsideredDirection, ...]:
    """The combinations of parameters whose uncertainty moves the estimate most, beside what the filter does not know.

    The estimate is run anew with each eigenvector of the parameters' covariance added; a singular value decomposition
    of what that does to angle and torque, in standard deviations of the estimate at that moment, gives independent
    combinations in the order of their effect. What they do to the angle of rest at other pressures counts as much: a
    joint goes on to where it never was, and there other combinations matter.

    Args:
        rig: with the fitted values and noise.
        trials: recordings; parts of them will do.
        free: the parameters that were fitted.
        covariance: theirs (F, F), in units of the priors.
        jobs: threads.
    """
    values, vectors = np.linalg.eigh(covariance)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))
    plain = rig.replaced(tunings={**rig.tunings, "default": rig.tuning("default").replaced(consider=False)})

    def changed(step: Floats) -> Rig:
        values = {i.name: rig.value(i.name) + i.prior_std * float(s) for i, s in zip(free, step, strict=True)}
        return moved(plain, values)

    def estimate(step: Floats) -> tuple[Floats, Floats]:
        now = changed(step)
        runs = [run_filter(now, trial).rows[trial.samples(SETTLE_S) :: trial.samples(_APART_S)] for trial in trials]
        rows = np.concatenate(runs)
        variances = rows["covariance"][:, (0, 2), (0, 2)]
        return np.column_stack([rows["angle"], rows["torque"]]), variances

    low, high = rig.value("atmosphere.pressure"), rig.value("supply.pressure")
    grid = [low + share * (high - low) for share in _GRID]

    def at_rest(step: Floats) -> Floats:
        p = changed(step).parameters("free", 0.0)
        return np.array([equilibrium.rest_angle(first, second, p) for first in grid for second in grid])

    # A tenth of a standard deviation: far enough for the slope, near enough to stay with it.
    near = 0.1
    steps = [np.zeros(len(free)), *(near * roots.T)]
    runs = Parallel(n_jobs=jobs, prefer="threads")(delayed(estimate)(step) for step in steps)
    effect = np.stack([(run - runs[0][0]) / near for run, _ in runs[1:]], axis=2)
    before = at_rest(steps[0])
    stands = np.stack([(at_rest(step) - before) / near for step in steps[1:]], axis=1)
    scaled = np.vstack(
        [
            _relative(effect.reshape(-1, len(free)), np.maximum(runs[0][1], 0.0).ravel()),
            _relative(stands, np.zeros(len(stands))),
        ]
    )
    _, strength, turned = np.linalg.svd(scaled, full_matrices=False)
    share = strength**2 / max(float(np.sum(strength**2)), 1e-300)
    count = min(int(np.searchsorted(np.cumsum(share), _EXPLAINED)) + 1, max(_MOST_CONSIDERED - len(rig.uncertainty), 1))
    out = []
    for k in range(count):
        if share[k] <= 1e-6:
            break
        step = roots @ turned[k]
        moves = np.sqrt(np.nanmean((effect @ turned[k]) ** 2, axis=0))
        changes = {item.name: float(item.prior_std * s) for item, s in zip(free, step, strict=True)}
        out.append(ConsideredDirection(f"mode_{k + 1}", changes, float(moves[0]), float(moves[1]), float(share[k])))
    return tuple(out)


def _relative(effect: Floats, variance: Floats) -> Floats:
    """Effects (K, F) in standard deviations of what they make together with a variance (K,) beside them.

    The whole counts as one, however many rows it has.
    """
    total = np.sqrt(variance + np.sum(effect**2, axis=1))
    known = np.isfinite(total) & (total > 0.0)
    out = effect[known] / total[known, None]
    return np.asarray(out / math.sqrt(max(float(np.sum(out**2)), 1e-300)))


INNER_SHARE = 2.0 / 3.0
"""Of the fitted part, what an inner fit gets; the rest tells how wrong such a fit is where it was not fitted."""
_SCALES = (1.0, 8.0)
"""Not below 1: a handful of slow errors can show that the parameters' covariance is too small, but not that it is too
large."""
_CALIBRATIONS = 12


def calibrate(rig: Rig, trials: Sequence[Trial], inner: JointFit, covariance: Floats, jobs: int) -> tuple[float, bool]:
    """The scale under which the errors of measured angles and torques are most likely, and whether there were any.

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
    parts = [short_part(trial) for trial in trials]
    directions = considered_directions(rig, parts, inner.problem.free, covariance, jobs)
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
    directions: tuple[ConsideredDirection, ...]
    scale: float
    likelihood: tuple[float, float]
    evaluations: int
    calibrated: bool


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
        inner: the same fit of the first share of these parts: what it makes of the rest tells how wrong a fit is
            where it was not fitted.
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
    directions = considered_directions(rig, parts, found.problem.free, found.predictive, jobs)
    rig = with_directions(rig, directions, 1.0)
    progress("process noise")
    rig, likelihood, evaluations = _tune_process(rig, parts, jobs)
    progress("scale of the uncertainty")
    scale, calibrated = calibrate(moved(rig, inner.values), trials, inner, inner.predictive, jobs)
    return Tuned(with_directions(rig, directions, scale), directions, scale, likelihood, evaluations, calibrated)


def own_tuning(rig: Rig, trial: Trial, found: JointFit, inner: JointFit, index: int, jobs: int = 1) -> Rig:
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

    def with_process(logarithm: Floats) -> Rig:
        velocity, pressure = (float(10.0**value) for value in np.clip(logarithm, [-12.0, -2.0], [1.0, 8.0]))
        # The angle has no noise of its own but what that of the velocity makes of it within a step: white acceleration.
        angle = velocity * rig.sample_period**2 / 3.0
        process = (angle, velocity, pressure, pressure)
        return rig.replaced(tunings={**rig.tunings, "default": tuning.replaced(process=process)})

    def against(logarithm: Floats) -> float:
        now = with_process(logarithm)
        runs = Parallel(n_jobs=jobs, prefer="threads")(delayed(run_filter)(now, trial) for trial in trials)
        sums = [innovation_likelihood(run, trial.samples(SETTLE_S)) for run, trial in zip(runs, trials, strict=True)]
        return -sum(value for value, _ in sums) / max(sum(number for _, number in sums), 1)

    start = np.log10(np.maximum([tuning.process[1], tuning.process[2]], [1e-12, 1e-2]))
    first = against(start)
    simplex = start + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]])
    options = {"initial_simplex": simplex, "maxfev": _EVALUATIONS, "xatol": 0.05, "fatol": 1e-5}
    found = minimize(against, start, method="Nelder-Mead", options=options)
    return with_process(found.x), (-first, -float(found.fun)), int(found.nfev) + 1
