"""Maximum a posteriori by Gauss-Newton, and what its answer is worth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pam_antagonist.identification.prediction import BLOCK, Problem, stacked
from pam_antagonist.identification.trial import ANGLE, PRESSURE_1, TORQUE

Floats = NDArray[np.float64]

_ROUNDS = 4
_CLUSTER_S = 2.0
"""[s] Residuals closer than this are taken to depend on each other."""
_DETERMINED = 0.5
"""A posterior that is narrower than this share of the prior was learnt from the data."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The answer of a fit.

    Attributes:
        problem: what was asked.
        theta: fitted vector, in units of the prior.
        covariance: of the free parameters (F, F), in units of the prior.
        weights: for each trial, standard deviation of the block residuals of each compared channel.
        cost: half the sum of the squared weighted residuals and of the prior's.
    """

    problem: Problem
    theta: Floats
    covariance: Floats
    weights: tuple[Floats, ...]
    cost: float

    @property
    def values(self) -> dict[str, float]:
        """Fitted parameters by name."""
        return self.problem.values(self.theta)

    @property
    def std(self) -> dict[str, float]:
        """Their standard deviations, in their own units."""
        deviations = np.sqrt(np.diag(self.covariance))
        return {item.name: item.prior_std * float(s) for item, s in zip(self.problem.free, deviations, strict=True)}

    @property
    def determined(self) -> dict[str, bool]:
        """Whether the data told a parameter; where not, it stayed near its prior."""
        deviations = np.sqrt(np.diag(self.covariance))
        return {item.name: bool(s < _DETERMINED) for item, s in zip(self.problem.free, deviations, strict=True)}

    @property
    def correlation(self) -> Floats:
        """Correlations of the free parameters (F, F)."""
        deviations = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(deviations, deviations)


def fit(
    problem: Problem,
    start: Floats | None = None,
    rounds: int = _ROUNDS,
    progress: Callable[[str], None] | None = None,
) -> Fit:
    """Fit by prediction error with the prior of the free parameters.

    The standard deviation of each channel is estimated with the parameters: a model that is right to the noise
    is weighted by the noise, one that is not by what it misses.

    Args:
        problem: the trials and free parameters.
        start: fitted vector to start from; default: the rig's values.
        rounds: how often the weights are estimated anew.
        progress: told what is being done, after every round.
    """
    theta = np.zeros(problem.size) if start is None else start.copy()
    low, high = problem.bounds()
    weights = _first_weights(problem)
    prior = np.eye(problem.size)
    cost = np.inf
    for number in range(rounds):

        def residual(t: Floats, weights: Sequence[Floats] = weights) -> Floats:
            return np.concatenate([stacked(problem.residuals(t), weights), t])

        def jacobian(t: Floats, weights: Sequence[Floats] = weights) -> Floats:
            return np.vstack([stacked(problem.jacobian(t), weights), prior])

        # The first rounds have to come from afar: large residuals count less there.
        loss = "soft_l1" if number < rounds - 1 else "linear"
        solution = least_squares(
            residual,
            np.clip(theta, low, high),
            jac=jacobian,
            bounds=(low, high),
            loss=loss,
            xtol=1e-6,
            ftol=1e-7,
            max_nfev=25,
        )
        theta, cost = solution.x, float(solution.cost)
        weights = _weights(problem, theta)
        if progress:
            progress(f"round {number + 1} of {rounds}")
    covariance = _robust_covariance(problem, theta, weights)
    count = len(problem.free)
    return Fit(problem, theta, covariance[:count, :count], tuple(weights), cost)


def _first_weights(problem: Problem) -> list[Floats]:
    """Deviations of a model that is off by a per cent: wide enough that no channel is taken at its word yet."""
    wide = {ANGLE: np.radians(0.2), TORQUE: 0.03, PRESSURE_1: 2e3, PRESSURE_1 + 1: 2e3}
    return [np.array([wide[channel] for channel in problem.counted(trial)]) for trial in problem.trials]


def _noise(problem: Problem) -> dict[int, float]:
    """Standard deviations of the channels' block means by noise alone."""
    sensors = problem.rig.sensors
    angle = np.hypot(sensors.angle_std, sensors.angle_step / np.sqrt(12.0))
    torque = np.hypot(sensors.torque_std, sensors.torque_step / np.sqrt(12.0))
    pressure = np.hypot(sensors.pressure_std, sensors.pressure_step / np.sqrt(12.0))
    raw = {ANGLE: angle, TORQUE: torque, PRESSURE_1: pressure, PRESSURE_1 + 1: pressure}
    return {channel: value / np.sqrt(BLOCK) for channel, value in raw.items()}


def _weights(problem: Problem, theta: Floats) -> list[Floats]:
    floor = _noise(problem)
    result = []
    for trial, part in zip(problem.trials, problem.residuals(theta), strict=True):
        least = np.array([floor[channel] for channel in problem.counted(trial)])
        result.append(np.maximum(np.sqrt(np.nanmean(part**2, axis=0)), least))
    return result


def _robust_covariance(problem: Problem, theta: Floats, weights: Sequence[Floats]) -> Floats:
    """Covariance that allows for residuals which depend on each other over a cluster of time.

    The sandwich H⁻¹ (S + prior) H⁻¹ with H the information of data and prior and S the scatter of the clusters'
    scores; never less than H⁻¹, which holds for white residuals.
    """
    jacobians, residuals = problem.jacobian(theta), problem.residuals(theta)
    size = problem.size
    information = np.eye(size)
    scatter = np.eye(size)
    for trial, jacobian, residual, weight in zip(problem.trials, jacobians, residuals, weights, strict=True):
        j = np.nan_to_num(jacobian / weight[:, None])
        r = np.nan_to_num(residual / weight)
        information += np.einsum("bci,bcj->ij", j, j)
        length = max(1, round(_CLUSTER_S / (trial.dt * BLOCK)))
        for first in range(0, len(r), length):
            score = np.einsum("bci,bc->i", j[first : first + length], r[first : first + length])
            scatter += np.outer(score, score)
    inverse = np.linalg.inv(information)
    sandwich = inverse @ scatter @ inverse
    widened = np.sqrt(np.maximum(np.diag(sandwich), np.diag(inverse)) / np.diag(sandwich))
    return sandwich * np.outer(widened, widened)
