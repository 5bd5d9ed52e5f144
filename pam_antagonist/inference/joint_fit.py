"""The most probable parameters of one rig from several recordings, by Gauss-Newton, with their covariance.

The recordings may deviate from each other a little. The size of the deviations shows whether they are of one rig. The
routine differs from :func:`~pam_antagonist.inference.gauss_newton.refit`, which fits one recording some hundred times
and keeps its derivatives. Here all recordings are fitted once, within bounds, with common errors of the channels and a
common spread.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import NoResult
from pam_antagonist.inference.joint_problem import JointProblem
from pam_antagonist.inference.likelihood import correlation_length
from pam_antagonist.inference.normal_equations import Local, weighted
from pam_antagonist.inference.spread import USUAL_SPREAD, Deviations, Variation, most_likely_spread
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, PRESSURE_2, TORQUE, Trial
from pam_antagonist.inference.trust_region import Evaluated, minimise
from pam_antagonist.inference.valve_driven import STARTS
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_ROUNDS = 4
_NEAR = 0.15
"""Derivatives are used again within this distance, in standard deviations of the prior."""
_LEAST_NOISE = {ANGLE: 1e-5, TORQUE: 1e-4, PRESSURE_1: 10.0, PRESSURE_2: 10.0}
"""Lower bounds of the noise, for rigs that declare none."""
_IMPLAUSIBLE = 3.0
"""Two recordings that differ by more than so many standard deviations of the prior are not of the same rig."""
_CERTAIN = 2.0
"""A difference is significant from so many standard errors on."""


@dataclass(frozen=True, eq=False)
class JointFit:
    """Result of a fit.

    Attributes:
        problem: the problem, with the estimated spread of the trials.
        theta: fitted vector.
        full: covariance of the fitted vector (size, size).
        weights: for each trial, standard deviation of the block residuals of each compared channel.
        memory: for each trial and channel, number of blocks per independent one.
        cost: half the sum of the squared weighted residuals and of the prior's.
        spread: relative spread of the trials about their common values in each direction (G,); None if they share all
            parameters.
        evidence_gain: gain in log evidence of this spread over no spread.
        step: what is left to the optimum by the derivatives at the fit (size,); about 0 if the search arrived there.
    """

    problem: JointProblem
    theta: Floats
    full: Floats
    weights: tuple[Floats, ...]
    memory: tuple[Floats, ...]
    cost: float
    spread: Floats | None = None
    evidence_gain: float = 0.0
    step: Floats | None = None

    @property
    def covariance(self) -> Floats:
        """Covariance of the common parameters (F, F), in units of the prior."""
        count = len(self.problem.free)
        return self.full[:count, :count]

    @property
    def predictive(self) -> Floats:
        """Covariance of the parameters in a new recording (F, F): covariance of the common ones plus the spread."""
        between = self.problem.between
        return self.covariance if between is None else self.covariance + between @ between.T

    @property
    def values(self) -> dict[str, float]:
        """Fitted common parameters by name."""
        return self.problem.values(self.theta)

    def own_values(self, index: int) -> dict[str, float]:
        """The parameters of one trial, its deviations included."""
        return self.problem.values(self.problem.local(self.theta, index))

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
    def correlation(self) -> Floats:
        """Correlations of the common parameters (F, F)."""
        deviations = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(deviations, deviations)


def joint_fit(
    problem: JointProblem,
    start: Floats | None = None,
    rounds: int = _ROUNDS,
    deviations: Deviations | None = None,
    progress: Callable[[str], None] | None = None,
) -> JointFit:
    """Fit by prediction error with the prior of the free parameters.

    The standard deviation of each channel is estimated with the parameters, from all trials together. A channel is
    weighted by its noise if the model is right, and by the model's error if it is larger. The weights are common to the
    trials, so that a better fit of one trial cannot be paid for with a channel of another one. If several trials may
    deviate from their common parameters, their spread is estimated as well, by the evidence
    (:mod:`pam_antagonist.inference.spread`).

    Args:
        problem: the trials and free parameters, without deviations.
        start: values of the free parameters (F,) to start from, in units of the prior; default: the rig's values.
        rounds: how often weights and spread are estimated anew.
        deviations: how trials may deviate from their common parameters; None: not at all.
        progress: called with a text after every round.
    """
    if deviations is None or deviations.shape.shape[1] == 0 or len(problem.trials) < 2:
        spread, problem = None, problem.with_between(None)
    else:
        spread = np.full(deviations.shape.shape[1], USUAL_SPREAD)
        problem = problem.with_between(spread * deviations.shape)
    theta = np.zeros(problem.size)
    if start is not None:
        theta[: len(problem.free)] = start[: len(problem.free)]
    theta = _simulated(problem, theta)
    weights = _first_weights(problem)
    cost, gain, slopes = np.inf, 0.0, _Slopes()
    for number in range(rounds):
        # The first rounds start far from the solution: there a robust loss reduces the weight of large residuals.
        theta, cost = _minimise(problem, theta, weights, number < rounds - 1, slopes)
        residuals = problem.residuals(theta)
        weights = _weights(problem, residuals)
        if spread is not None and deviations is not None:
            before = spread
            spread, gain = most_likely_spread(_locals(problem, theta, residuals, weights, slopes)[0], deviations)
            problem = problem.with_between(spread * deviations.shape)
            theta = _rescaled(problem, theta, before / spread)
        if progress:
            progress(f"round {number + 1} of {rounds}")
    # The covariance needs exact derivatives at the solution.
    parts, memory = _locals(problem, theta, problem.residuals(theta), weights, _Slopes(exact=True))
    information, pull = problem.arrow(parts).whole()
    full = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return JointFit(
        problem, theta, full, tuple(weights), tuple(memory), cost, spread, gain, np.asarray(full @ pull - theta)
    )


def _simulated(problem: JointProblem, theta: Floats) -> Floats:
    """A vector to start from at which no simulation diverges: the given one, or else the rig file's values.

    Raises:
        NoResult: the model diverges with both.
    """
    for start in (theta, np.zeros(problem.size)):
        lost = [
            trial.name
            for trial, part in zip(problem.trials, problem.residuals(start), strict=True)
            if np.isinf(part).any()
        ]
        if not lost:
            return start
    raise NoResult(
        f"{lost[0]}: the model with the values of rig {problem.rig.name} diverges, so nothing can be fitted; expected "
        "values near those of the joint (joint.stop, joint.inertia, the muscles' forces)"
    )


class _Slopes:
    """Jacobians of the trials, each computed anew only if the trial's values have moved away from the last ones.

    A Gauss-Newton step with derivatives that are off by a per cent is as good, and takes a fortieth of the time.
    """

    def __init__(self, exact: bool = False) -> None:
        self._exact = exact
        self._known: dict[int, tuple[Floats, Floats]] = {}

    def at(self, problem: JointProblem, theta: Floats, near: float = _NEAR) -> list[Floats]:
        """Derivatives by the local values of each trial, as :meth:`JointProblem.local_jacobian`."""
        for index in range(len(problem.trials)):
            local = problem.local(theta, index)
            if index not in self._known or np.max(np.abs(self._known[index][0] - local)) > near:
                # Free the old one first: it takes as much memory as the new one.
                self._known.pop(index, None)
                self._known[index] = local, problem.local_jacobian(local, index, self._exact)
        return [self._known[index][1] for index in range(len(problem.trials))]


def _minimise(
    problem: JointProblem, theta: Floats, weights: Sequence[Floats], robust: bool, slopes: _Slopes
) -> tuple[Floats, float]:
    """The most probable vector with known weights, and half the sum of its squared residuals and of the prior's.

    A robust loss, 2 √(1 + r²) − 2 in place of r², reduces the weight of large residuals.
    """

    def evaluate(t: Floats) -> Evaluated:
        residuals = problem.residuals(t)
        if any(np.isinf(part).any() for part in residuals):
            return Evaluated(np.inf, lambda renew: (np.eye(len(t)), np.zeros(len(t))))
        parts = [weighted(part, weight) for part, weight in zip(residuals, weights, strict=True)]
        sums = [float(np.sum(2.0 * np.sqrt(1.0 + part**2) - 2.0 if robust else part**2)) for part in parts]

        def equations(renew: bool) -> tuple[Floats, Floats]:
            out = []
            for part, slope, weight in zip(parts, slopes.at(problem, t, 0.0 if renew else _NEAR), weights, strict=True):
                counted = 1.0 / np.sqrt(1.0 + part**2) if robust else np.ones_like(part)
                # The gradient of the loss, and its curvature where that of the residual itself is left out.
                j = weighted(slope, weight)
                pull = -j.T @ (counted * part)
                j *= np.sqrt(counted**3)[:, None]
                out.append(Local(j.T @ j, pull))
            information, pull = problem.arrow(out).whole()
            return information, pull - t

        return Evaluated(0.5 * (sum(sums) + float(t @ t)), equations)

    # The region does not shrink to each trial's part of it as trials are added.
    weight = np.full(problem.size, 1.0 / np.sqrt(len(problem.trials)))
    weight[: len(problem.free)] = 1.0
    return minimise(evaluate, theta, *problem.bounds(), weight)


def _rescaled(problem: JointProblem, theta: Floats, factor: Floats) -> Floats:
    """The same deviations in units of another spread."""
    result = theta.copy()
    for index in range(len(problem.trials)):
        result[problem.place(index)][:-STARTS] *= factor
    return result


def _first_weights(problem: JointProblem) -> list[Floats]:
    """Standard deviations for a model that is off by a per cent: wide, so that no channel dominates the first round."""
    wide = {ANGLE: np.radians(0.2), TORQUE: 0.03, PRESSURE_1: 2e3, PRESSURE_2: 2e3}
    return [np.array([wide[channel] for channel in problem.counted(trial)]) for trial in problem.trials]


def noise_floor(rig: Rig, trials: Sequence[Trial]) -> dict[int, float]:
    """Standard deviations of the channels' block means by the sensors' declared errors, which average out in a block.

    The rounding of a converter does not average out if its noise is smaller than its step
    (:func:`~pam_antagonist.inference.trial.block_noise`). This is ignored here: otherwise the angle, which a joint fit
    follows to a fraction of such a step, would lose weight.

    Args:
        rig: with its sensors.
        trials: the trials; the shortest of their blocks counts.
    """
    sensors, size = rig.sensors, min(trial.block for trial in trials)
    pressure = np.hypot(sensors.pressure_std, sensors.pressure_step / np.sqrt(12.0))
    raw = {ANGLE: sensors.error("angle"), TORQUE: sensors.error("torque"), PRESSURE_1: pressure, PRESSURE_2: pressure}
    return {channel: max(value / np.sqrt(size), _LEAST_NOISE[channel]) for channel, value in raw.items()}


def _weights(problem: JointProblem, residuals: Sequence[Floats]) -> list[Floats]:
    """RMS of each channel's residuals, pooled over the trials that have it, and never below the noise."""
    floor = noise_floor(problem.rig, problem.trials)
    total: dict[int, list[float]] = {}
    for trial, part in zip(problem.trials, residuals, strict=True):
        for column, channel in enumerate(problem.counted(trial)):
            total.setdefault(channel, []).append(float(np.nanmean(part[:, column] ** 2)))
    pooled = {channel: max(float(np.sqrt(np.mean(values))), floor[channel]) for channel, values in total.items()}
    return [np.array([pooled[channel] for channel in problem.counted(trial)]) for trial in problem.trials]


def _locals(
    problem: JointProblem, theta: Floats, residuals: Sequence[Floats], weights: Sequence[Floats], slopes: _Slopes
) -> tuple[list[Local], list[Floats]]:
    """Each trial's information about its local values, near the fit, and its channels' blocks per independent one."""
    out, memory = [], []
    jacobians = slopes.at(problem, theta)
    for index, (residual, jacobian, weight) in enumerate(zip(residuals, jacobians, weights, strict=True)):
        slow = np.array([correlation_length(column) for column in residual.T])
        scale = weight * np.sqrt(slow)
        j, r = weighted(jacobian, scale), weighted(residual, scale)
        seen = problem.local(theta, index)
        out.append(Local(j.T @ j, j.T @ (j @ seen - r)))
        memory.append(slow)
    return out, memory


@dataclass(frozen=True)
class Difference:
    """Relative difference between the recordings in one direction.

    Attributes:
        name: of the direction.
        deviations: of each recording from the common value.
        largest: difference of the two recordings that differ most.
        std: standard error of this difference.
        limit: difference beyond which the recordings are taken to be of different rigs.
        pair: indices of the two recordings.
    """

    name: str
    deviations: tuple[float, ...]
    largest: float
    std: float
    limit: float
    pair: tuple[int, int]

    @property
    def certain(self) -> bool:
        """Whether the difference is significant."""
        return abs(self.largest) > _CERTAIN * self.std


def differences(found: JointFit, ways: tuple[Variation, ...]) -> list[Difference]:
    """All differences between the recordings, the largest in standard errors first.

    Args:
        found: a fit in which trials may deviate.
        ways: the directions, in the order of the fit's.
    """
    problem = found.problem
    if problem.between is None or found.spread is None:
        return []
    trials, free = len(problem.trials), {item.name: item for item in problem.free}
    out = []
    for g, way in enumerate(ways):
        at = [problem.place(index).start + g for index in range(trials)]
        values = found.spread[g] * found.theta[at]
        first, last = int(np.argmin(values)), int(np.argmax(values))
        pick = np.zeros(problem.size)
        pick[at[first]], pick[at[last]] = -found.spread[g], found.spread[g]
        std = float(np.sqrt(pick @ found.full @ pick))
        relative = [free[name].prior_std / abs(change) for name, change in way.changes.items() if change]
        limit = _IMPLAUSIBLE * min(max(relative), 0.2)
        out.append(
            Difference(
                way.name,
                tuple(float(v) for v in values),
                float(values[last] - values[first]),
                std,
                limit,
                (first, last),
            )
        )
    return sorted(out, key=lambda item: -abs(item.largest) / max(item.std, 1e-12))


def check_same_rig(found: JointFit, ways: tuple[Variation, ...]) -> None:
    """Refuse recordings that cannot be of one rig.

    The spread between the recordings is known here. So the bound is tighter than that of a diagnosis, which compares
    fits of single recordings before it has found their effects (:mod:`pam_antagonist.diagnosis.agreement`).

    Args:
        found: a fit in which trials may deviate.
        ways: the directions, in the order of the fit's.

    Raises:
        NoResult: two recordings differ by more than three standard deviations of the prior.
    """
    refused = [item for item in differences(found, ways) if item.largest - _CERTAIN * item.std > item.limit]
    if refused:
        worst = max(refused, key=lambda item: item.largest / item.limit)
        low, high = (found.problem.trials[index].name for index in worst.pair)
        raise NoResult(
            f"{high} and {low} do not fit together: {worst.name} would differ by {100 * worst.largest:.0f} % (at most "
            f"{100 * worst.limit:.0f} % is plausible). They are of two rigs, or the model lacks an effect, or values "
            "of the rig file are far off; identify them one by one, or see what close_loop finds"
        )
