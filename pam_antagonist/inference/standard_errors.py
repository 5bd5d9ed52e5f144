"""The last steps of a fit, and the standard errors of its parameters.

A step of a fit uses one-sided differences over long steps. If base parameters have nearly the same effect, the errors
of such differences do not cancel. They look like information that the recording does not have, and spoil the solution
along such directions. So the differences here are central and short. Measured parameters, which no fit moves, are
uncertain as well, by the error of their measurement. Directions that the recording does not determine are assumed to be
as far off as the determined ones have turned out to be.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import measured_directions, moved
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, moved_by, relinearised
from pam_antagonist.inference.likelihood import LinearProblem
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.unknown import Unknown, parameters, start_values

Floats = NDArray[np.float64]

_CLOSE = 1e-4, 0.1
"""Steps of the derivatives for standard errors: of a base parameter, and of a start value."""
_SHARE = 0.01
"""Step of a measured parameter, as a share of its standard deviation."""
_ROUNDS = 6
_SHARES = (1.0, 0.3)
"""Shares of a last step that are tried."""
_LEAST_GAIN = 0.1
"""Least gain of a last step, in −2 log posterior."""
_DETERMINED = 4.0
"""A recording determines a direction if its information exceeds that of the prior by this factor."""
_LEAST_DISTANCE = 0.2
"""Least assumed error of a rig file, as a share of the priors: one per cent."""


def well_known(experiment: Experiment, fitted: Fitted) -> Fitted:
    """A fit with the covariance of its parameters from exact derivatives."""
    theta = fitted.point.theta
    base, effect = _slopes(experiment, fitted)
    near = replace(fitted, base=base, effect=effect)
    measured = [_slope(experiment, fitted.point, direction) for direction in measured_directions(experiment.rig)]
    both = np.concatenate([base, np.stack(measured, axis=2)], axis=2)
    known = experiment.prior.copy()
    known[: len(experiment.directions)] /= _distance(experiment, near) ** 2
    prior, at_rest = np.append(known, np.ones(len(measured))), np.append(theta, np.zeros(len(measured)))
    scale = fitted.scale
    last = LinearProblem.of(fitted.residual, both, effect).solved(scale, prior, at_rest, rounds=1, length=scale.length)
    covariance = last.covariance
    own = np.r_[0 : experiment.size, both.shape[2] : len(covariance)]
    return replace(near, covariance=covariance[np.ix_(own, own)])


def settled(experiment: Experiment, fitted: Fitted) -> Fitted:
    """A fit continued until it has converged."""
    for _ in range(_ROUNDS):
        base, effect = _slopes(experiment, fitted)
        begun = fitted.cost
        while (better := _step(experiment, replace(fitted, base=base, effect=effect))) is not None:
            fitted = better
        if fitted.cost == begun:
            break
    return relinearised(experiment, fitted)


def _step(experiment: Experiment, fitted: Fitted) -> Fitted | None:
    """A step with the model's derivatives, which may be those of a nearby point; None if it gains too little."""
    base, effect, scale, theta = fitted.base, fitted.effect, fitted.scale, fitted.point.theta
    step = LinearProblem.of(fitted.residual, base, effect).solved(scale, experiment.prior, theta, rounds=1)
    for share in _SHARES:
        point = moved_by(fitted.point, fitted.free, share * step.theta, share * step.effect)
        residual = experiment.residual(point)
        cost = cost_of(experiment, point, residual, scale)
        if cost < fitted.cost - _LEAST_GAIN:
            return replace(fitted, point=point, residual=residual, cost=cost)
    return None


def _slopes(experiment: Experiment, fitted: Fitted) -> tuple[Floats, Floats]:
    """Derivatives of the residual by the base coordinates (B, C, K + S) and by the effects' coordinates (B, C, m)."""
    theta, effects = fitted.point.theta, fitted.point.effects
    free = [k for k in range(experiment.size) if experiment.depends_on(k)]
    steps = [_CLOSE[k >= len(experiment.directions)] for k in free]
    pairs = [
        (Point(theta + step * unit, effects), Point(theta - step * unit, effects))
        for step, unit in zip(steps, np.eye(experiment.size)[free], strict=True)
    ]
    for parameter in fitted.free:
        at = parameter.coordinate(effects.get(parameter.path, parameter.item.neutral))
        steps.append(parameter.step(parameter.value(at)))
        up, down = (
            Point(theta, {**effects, **dict.fromkeys(parameter.paths, parameter.value(at + sign * steps[-1]))})
            for sign in (1.0, -1.0)
        )
        pairs.append((up, down))
    left = experiment.residuals(point for pair in pairs for point in pair)
    slopes = [(one - other) / (2.0 * step) for one, other, step in zip(left[::2], left[1::2], steps, strict=True)]
    base = np.zeros_like(fitted.base)
    base[:, :, free] = np.stack(slopes[: len(free)], axis=2)
    effect = np.stack(slopes[len(free) :], axis=2) if fitted.free else fitted.effect
    return base, effect


def _slope(experiment: Experiment, point: Point, direction: Unknown) -> Floats:
    """Derivative of the residual (B, C) by a measured direction, for one standard deviation."""

    def left(share: float) -> Floats:
        values = parameters((direction,), {direction.name: share}, start=start_values(experiment.rig, (direction,)))
        return replace(experiment, rig=moved(experiment.rig, values)).residual(point)

    return (left(_SHARE) - left(-_SHARE)) / (2.0 * _SHARE)


def _distance(experiment: Experiment, fitted: Fitted) -> float:
    """Error of the rig file, in standard deviations of the priors (RMS).

    It is computed from those directions of the base parameters that the recording determines. The others are assumed
    to be as far off.
    """
    count = len(experiment.directions)
    columns = np.concatenate([fitted.base, fitted.effect], axis=2)
    weights = 1.0 / (fitted.scale.variances(fitted.residual) * fitted.scale.length)
    information = np.einsum("bci,bcj,c->ij", columns, columns, weights, optimize=True)
    prior = experiment.prior
    rest = information[count:, count:] + np.diag([*prior[count:], *np.zeros(len(fitted.free))])
    across = information[:count, count:]
    alone = information[:count, :count] - across @ np.linalg.pinv(rest, hermitian=True) @ across.T
    units = np.sqrt(prior[:count])
    gains, vectors = np.linalg.eigh(alone / np.outer(units, units))
    moves = (vectors.T @ (units * fitted.point.theta[:count]))[gains > _DETERMINED]
    return max(_LEAST_DISTANCE, float(np.sqrt(np.mean(moves**2)))) if len(moves) else 1.0
