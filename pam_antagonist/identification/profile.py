"""Profile likelihoods: how much worse the best fit gets while one parameter is held away from its value.

A standard error is the curvature at the best fit; the profile shows whether the likelihood really is a parabola, and
where it is flat: there the recordings say nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.identification.fit import Fit
from pam_antagonist.identification.prediction import stacked

Floats = NDArray[np.float64]

_POSITIONS = np.array([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0])
_STEPS = 2
_HALF_CHI_SQUARE = 1.92
"""Loss of log-likelihood at the ends of a 95 % interval of one parameter."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of one parameter.

    Attributes:
        name: of the parameter.
        value: values at which it was held (K,).
        loss: of the logarithm of likelihood and prior there (K,), 0 at the best.
        parabola: loss by the standard error alone (K,).
        low: lower end of the 95 % interval, None where it lies beyond the values.
        high: upper end.
    """

    name: str
    value: Floats
    loss: Floats
    parabola: Floats
    low: float | None
    high: float | None


def profiles(
    found: Fit, names: Sequence[str], jobs: int = 1, progress: Callable[[str], None] | None = None
) -> list[Profile]:
    """Profiles of some parameters over ±3 standard errors.

    All others are fitted anew at each value by Gauss-Newton with the slopes at the best fit.

    Args:
        found: the fit.
        names: parameters.
        jobs: threads.
        progress: told which parameter is done.
    """
    problem = found.problem
    weights = [w * np.sqrt(m) for w, m in zip(found.weights, found.memory, strict=True)]
    jacobian = np.vstack([stacked(problem.jacobian(found.theta), weights), np.eye(problem.size)])
    place = {item.name: k for k, item in enumerate(problem.free)}

    def cost(theta: Floats) -> tuple[Floats, float]:
        residual = np.concatenate([stacked(problem.residuals(theta), weights), theta])
        return residual, 0.5 * float(residual @ residual)

    def held(k: int, position: float) -> float:
        std = float(np.sqrt(found.full[k, k]))
        # Along the ridge: where the others go while this one is moved.
        theta = found.theta + found.full[:, k] / found.full[k, k] * position * std
        others = np.arange(problem.size) != k
        normal = np.linalg.pinv(jacobian[:, others])
        best = np.inf
        for _ in range(_STEPS):
            residual, now = cost(theta)
            best = min(best, now)
            theta[others] -= normal @ residual
        return min(best, cost(theta)[1])

    base = cost(found.theta)[1]
    out = []
    for name in names:
        k = place[name]
        item, std = problem.free[k], float(np.sqrt(found.full[k, k]))
        costs = np.array(Parallel(n_jobs=jobs, prefer="threads")(delayed(held)(k, x) for x in _POSITIONS))
        loss = costs - min(base, costs.min())
        value = item.start + item.prior_std * (found.theta[k] + _POSITIONS * std)
        out.append(Profile(name, value, loss, 0.5 * _POSITIONS**2, *_interval(value, loss)))
        if progress:
            progress(f"profile of {name}")
    return out


def _interval(value: Floats, loss: Floats) -> tuple[float | None, float | None]:
    best = int(np.argmin(loss))
    ends: list[float | None] = []
    for way in (-1, 1):
        end = None
        k = best
        while 0 <= k + way < len(value):
            if loss[k + way] >= _HALF_CHI_SQUARE:
                share = (_HALF_CHI_SQUARE - loss[k]) / (loss[k + way] - loss[k])
                end = float(value[k] + share * (value[k + way] - value[k]))
                break
            k += way
        ends.append(end)
    return ends[0], ends[1]
