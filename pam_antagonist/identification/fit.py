"""Maximum a posteriori by Gauss-Newton, and what its answer is worth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pam_antagonist.identification.between import USUAL_SPREAD, Deviations
from pam_antagonist.identification.evidence import Local, most_likely_spread
from pam_antagonist.identification.prediction import BLOCK, Problem, stacked
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE

Floats = NDArray[np.float64]

_ROUNDS = 4
_DETERMINED = 0.5
"""A posterior that is narrower than this share of the prior was learnt from the data."""
_NEAR = 0.15
"""Distance in standard deviations of the prior within which slopes are used again."""
_FAINT = 0.05
"""Correlation of residuals below which they are taken to be independent."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The answer of a fit.

    Attributes:
        problem: what was asked, with the deviations of the trials as they were estimated.
        theta: fitted vector.
        full: covariance of the fitted vector (size, size).
        weights: for each trial, standard deviation of the block residuals of each compared channel.
        memory: for each trial and channel, how many blocks tell as much as one independent one.
        cost: half the sum of the squared weighted residuals and of the prior's.
        spread: how much the trials deviate from their common values in each direction, relative (G,); None where they
            share everything.
        evidence_gain: logarithm of how much more likely the data are with that spread than with none.
    """

    problem: Problem
    theta: Floats
    full: Floats
    weights: tuple[Floats, ...]
    memory: tuple[Floats, ...]
    cost: float
    spread: Floats | None = None
    evidence_gain: float = 0.0

    @property
    def covariance(self) -> Floats:
        """Covariance of the common parameters (F, F), in units of the prior."""
        count = len(self.problem.free)
        return self.full[:count, :count]

    @property
    def predictive(self) -> Floats:
        """Covariance of the parameters in a recording yet to be made (F, F): the common ones' and the spread."""
        between = self.problem.between
        return self.covariance if between is None else self.covariance + between @ between.T

    @property
    def values(self) -> dict[str, float]:
        """Fitted common parameters by name."""
        return self.problem.values(self.theta)

    def own_values(self, index: int) -> dict[str, float]:
        """The parameters of one trial, its deviations included."""
        return self.problem.values(self.problem.map(index) @ self.theta)

    def own_covariance(self, index: int) -> Floats:
        """Covariance of the parameters of one trial (F, F), in units of the prior."""
        part = self.problem.map(index)[: len(self.problem.free)]
        return np.asarray(part @ self.full @ part.T)

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations of the common parameters, in their own units."""
        return self._named(self.covariance)

    def own_std(self, index: int) -> dict[str, float]:
        """Standard deviations of one trial's parameters, in their own units."""
        return self._named(self.own_covariance(index))

    def _named(self, covariance: Floats) -> dict[str, float]:
        deviations = np.sqrt(np.diag(covariance))
        return {item.name: item.prior_std * float(s) for item, s in zip(self.problem.free, deviations, strict=True)}

    @property
    def determined(self) -> dict[str, bool]:
        """Whether the data told a parameter; where not, it stayed near its prior."""
        deviations = np.sqrt(np.diag(self.covariance))
        return {item.name: bool(s < _DETERMINED) for item, s in zip(self.problem.free, deviations, strict=True)}

    @property
    def correlation(self) -> Floats:
        """Correlations of the common parameters (F, F)."""
        deviations = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(deviations, deviations)


def fit(
    problem: Problem,
    start: Floats | None = None,
    rounds: int = _ROUNDS,
    deviations: Deviations | None = None,
    progress: Callable[[str], None] | None = None,
) -> Fit:
    """Fit by prediction error with the prior of the free parameters.

    The standard deviation of each channel is estimated with the parameters, from all trials together: a model that is
    right to the noise is weighted by the noise, one that is not by what it misses, and no trial can buy a better fit
    of one channel by giving up another trial's. Where there are several trials and they may deviate from their common
    parameters, how much they do is estimated as well, by the evidence (:mod:`pam_antagonist.identification.evidence`).

    Args:
        problem: the trials and free parameters, without deviations.
        start: values of the free parameters to start from, in units of the prior; default: the rig's values.
        rounds: how often weights and spread are estimated anew.
        deviations: how trials may deviate from their common parameters; None where they may not.
        progress: told what is being done, after every round.
    """
    if deviations is None or deviations.shape.shape[1] == 0 or len(problem.trials) < 2:
        spread, problem = None, problem.with_between(None)
    else:
        spread = np.full(deviations.shape.shape[1], USUAL_SPREAD)
        problem = problem.with_between(spread * deviations.shape)
    theta = np.zeros(problem.size)
    if start is not None:
        theta[: len(problem.free)] = start[: len(problem.free)]
    weights = _first_weights(problem)
    cost, gain, slopes = np.inf, 0.0, _Slopes()
    for number in range(rounds):
        # The first rounds have to come from afar: large residuals count less there.
        theta, cost = _minimise(problem, theta, weights, "soft_l1" if number < rounds - 1 else "linear", slopes)
        weights = _weights(problem, problem.residuals(theta))
        if spread is not None and deviations is not None:
            before = spread
            spread, gain = most_likely_spread(_locals(problem, theta, weights, slopes), deviations)
            problem = problem.with_between(spread * deviations.shape)
            theta = _rescaled(problem, theta, before / spread)
        if progress:
            progress(f"round {number + 1} of {rounds}")
    # What the answer is worth hangs on the slopes where it stands.
    parts = _locals(problem, theta, weights, _Slopes())
    information = np.eye(problem.size)
    for index, part in enumerate(parts):
        seen = problem.map(index)
        information += seen.T @ part.information @ seen
    return Fit(
        problem,
        theta,
        np.asarray(np.linalg.inv(information), dtype=np.float64),
        tuple(weights),
        tuple(part.memory for part in parts),
        cost,
        spread,
        gain,
    )


class _Slopes:
    """Jacobians of the trials, computed anew only where the parameters have moved: near the last place they still hold.

    A Gauss-Newton step with slopes that are off by a per cent is as good, and costs a fortieth.
    """

    def __init__(self) -> None:
        self._seen: list[Floats] = []
        self._parts: list[Floats] = []

    def at(self, problem: Problem, theta: Floats, near: float = _NEAR) -> list[Floats]:
        """Derivatives by what each trial sees, as :meth:`Problem.local_jacobians`."""
        seen = [problem.map(index) @ theta for index in range(len(problem.trials))]
        stands = self._parts and all(
            np.max(np.abs(old - new)) <= near for old, new in zip(self._seen, seen, strict=True)
        )
        if not stands:
            self._seen, self._parts = seen, problem.local_jacobians(theta)
        return self._parts


def _minimise(
    problem: Problem, theta: Floats, weights: Sequence[Floats], loss: str, slopes: _Slopes
) -> tuple[Floats, float]:
    def jacobian(t: Floats) -> Floats:
        parts = [part @ problem.map(index) for index, part in enumerate(slopes.at(problem, t))]
        return np.vstack([stacked(parts, weights), prior])

    low, high = problem.bounds()
    prior = np.eye(problem.size)
    solution = least_squares(
        lambda t: np.concatenate([stacked(problem.residuals(t), weights), t]),
        np.clip(theta, low, high),
        jac=jacobian,
        bounds=(low, high),
        loss=loss,
        xtol=1e-5,
        ftol=1e-5,
        max_nfev=15,
    )
    return solution.x, float(solution.cost)


def _rescaled(problem: Problem, theta: Floats, factor: Floats) -> Floats:
    """The same deviations in units of another spread."""
    result = theta.copy()
    own = 0 if problem.between is None else problem.between.shape[1]
    for index in range(len(problem.trials)):
        first = len(problem.free) + index * (own + 3)
        result[first : first + own] *= factor
    return result


def _first_weights(problem: Problem) -> list[Floats]:
    """Deviations of a model that is off by a per cent: wide enough that no channel is taken at its word yet."""
    wide = {ANGLE: np.radians(0.2), TORQUE: 0.03, PRESSURE_1: 2e3, PRESSURE_1 + 1: 2e3}
    return [np.array([wide[channel] for channel in problem.counted(trial)]) for trial in problem.trials]


def noise_floor(problem: Problem) -> dict[int, float]:
    """Standard deviations of the channels' block means by sensor noise alone."""
    sensors = problem.rig.sensors
    angle, torque = sensors.error("angle"), sensors.error("torque")
    pressure = np.hypot(sensors.pressure_std, sensors.pressure_step / np.sqrt(12.0))
    raw = {ANGLE: angle, TORQUE: torque, PRESSURE_1: pressure, PRESSURE_1 + 1: pressure}
    # A sensor that is declared without noise still has some: nothing is known to a part in a million.
    least = {ANGLE: 1e-5, TORQUE: 1e-4, PRESSURE_1: 10.0, PRESSURE_1 + 1: 10.0}
    return {channel: max(value / np.sqrt(BLOCK), least[channel]) for channel, value in raw.items()}


def _weights(problem: Problem, residuals: Sequence[Floats]) -> list[Floats]:
    """RMS of each channel's residuals, pooled over the trials that have it, and never below the noise."""
    floor = noise_floor(problem)
    total: dict[int, list[float]] = {}
    for trial, part in zip(problem.trials, residuals, strict=True):
        for column, channel in enumerate(problem.counted(trial)):
            total.setdefault(channel, []).append(float(np.nanmean(part[:, column] ** 2)))
    pooled = {channel: max(float(np.sqrt(np.mean(values))), floor[channel]) for channel, values in total.items()}
    return [np.array([pooled[channel] for channel in problem.counted(trial)]) for trial in problem.trials]


def memory(series: Floats) -> float:
    """How many samples of a series tell as much as one of independent ones, at least 1.

    The integrated autocorrelation 1 + 2 Σ ρ_k up to the first lag at which the correlation is faint.

    Args:
        series: (B,), NaN where there is nothing.
    """
    known = np.isfinite(series)
    values = np.where(known, series, 0.0)
    power = float(np.sum(values * values))
    total = 1.0
    if power <= 0.0:
        return total
    for lag in range(1, len(values) // 4):
        pairs = int(np.count_nonzero(known[lag:] & known[:-lag]))
        rho = float(np.sum(values[lag:] * values[:-lag])) / power * (known.sum() / max(pairs, 1))
        if rho < _FAINT:
            break
        total += 2.0 * rho
    return total


def _locals(problem: Problem, theta: Floats, weights: Sequence[Floats], slopes: _Slopes) -> list[Local]:
    """What each trial says about the parameters that it sees, near the fit."""
    out = []
    residuals, jacobians = problem.residuals(theta), slopes.at(problem, theta)
    for index, (residual, jacobian, weight) in enumerate(zip(residuals, jacobians, weights, strict=True)):
        slow = np.array([memory(residual[:, column]) for column in range(residual.shape[1])])
        scale = weight * np.sqrt(slow)
        j = np.nan_to_num(jacobian / scale[:, None]).reshape(-1, jacobian.shape[2])
        r = np.nan_to_num(residual / scale).ravel()
        seen = problem.map(index) @ theta
        out.append(Local(j.T @ j, j.T @ (j @ seen - r), slow))
    return out
