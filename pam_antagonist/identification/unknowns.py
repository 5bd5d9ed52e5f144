"""Unknown numbers of a rig with their priors and bounds, and the fit that finds them.

A positive number is unknown by its logarithm, so that no fit makes it negative. All unknowns are in standard deviations
of their priors. A fit stays inside the bounds of the rig file's schema.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.optimize import least_squares

Floats = NDArray[np.float64]

_WIDEST = 5.0
"""A fit moves a number by at most so many standard deviations of its prior."""
_STEP = 1e-3
"""Step of the derivatives, in standard deviations of the priors."""
_ROBUST = 20.0
"""Residuals beyond so many units count less and less."""
_AT_BOUND = 1e-3
_FAILED = 1e3
"""Residual of a simulation that is not finite."""


@dataclass(frozen=True)
class Unknown:
    """A number that a fit may find.

    Attributes:
        name: what it is; a dotted path where it is a single parameter.
        paths: parameters that have its value, by dotted path.
        start: value of the prior's middle.
        std: of the prior; of the logarithm where ``positive``.
        positive: whether it stays above 0.
        low: least value.
        high: largest value.
    """

    name: str
    paths: tuple[str, ...]
    start: float
    std: float
    positive: bool = False
    low: float = -math.inf
    high: float = math.inf

    def value(self, amount: float) -> float:
        """Value at an amount, in standard deviations from the start."""
        if self.positive:
            return self.start * math.exp(self.std * amount)
        return self.start + self.std * amount

    def amount(self, value: float) -> float:
        """The inverse of :meth:`value`."""
        return (math.log(value / self.start) if self.positive else value - self.start) / self.std

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and largest amount."""
        low = -_WIDEST if self.positive and self.low <= 0.0 else max(-_WIDEST, self._limited(self.low, -_WIDEST))
        return min(low, 0.0), max(min(_WIDEST, self._limited(self.high, _WIDEST)), 0.0)

    def _limited(self, value: float, otherwise: float) -> float:
        return self.amount(value) if math.isfinite(value) else otherwise


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit.

    Attributes:
        unknowns: in order.
        amounts: found values in standard deviations of the priors (F,).
        covariance: of the amounts (F, F), from the curvature with the priors.
        cost: half the sum of squares, priors included.
    """

    unknowns: tuple[Unknown, ...]
    amounts: Floats
    covariance: Floats
    cost: float

    @property
    def values(self) -> dict[str, float]:
        """Value of each unknown, by name."""
        return {item.name: item.value(float(amount)) for item, amount in zip(self.unknowns, self.amounts, strict=True)}

    @property
    def parameters(self) -> dict[str, float]:
        """Value of each parameter, by dotted path."""
        return parameters(self.unknowns, self.amounts)

    @property
    def stds(self) -> dict[str, float]:
        """Standard error of each unknown, by name, in its unit."""
        found = self.values
        return {
            item.name: item.std * math.sqrt(variance) * (abs(found[item.name]) if item.positive else 1.0)
            for item, variance in zip(self.unknowns, np.diag(self.covariance), strict=True)
        }

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Names of the unknowns that stand at a bound."""
        return tuple(
            item.name
            for item, amount in zip(self.unknowns, self.amounts, strict=True)
            if min(abs(amount - bound) for bound in item.bounds) < _AT_BOUND
        )


def parameters(unknowns: Sequence[Unknown], amounts: Floats) -> dict[str, float]:
    """Value of each parameter, by dotted path."""
    return {path: item.value(float(a)) for item, a in zip(unknowns, amounts, strict=True) for path in item.paths}


def fitted(
    unknowns: Sequence[Unknown],
    residual: Callable[[Mapping[str, float]], Floats],
    begin: Floats | None = None,
    evaluations: int = 20,
    jobs: int = 1,
) -> Fit:
    """Find the unknowns that explain the data best, with their priors, within their bounds.

    Args:
        unknowns: what may move (F).
        residual: of the data (N,), in standard deviations, for values by name; not finite where a simulation diverged.
        begin: first amounts (F,); None: the priors' middles.
        evaluations: the most derivatives.
        jobs: threads.
    """
    low, high = (np.array(side) for side in zip(*(item.bounds for item in unknowns), strict=True))

    def of_data(amounts: Floats) -> Floats:
        values = {item.name: item.value(a) for item, a in zip(unknowns, amounts, strict=True)}
        left = np.nan_to_num(residual(values), nan=_FAILED, posinf=_FAILED, neginf=-_FAILED)
        return np.asarray(_ROBUST * np.arctan(left / _ROBUST))

    def whole(amounts: Floats) -> Floats:
        return np.concatenate([of_data(amounts), amounts])

    def jacobian(amounts: Floats) -> Floats:
        base = of_data(amounts)
        steps = np.where(amounts + _STEP <= high, _STEP, -_STEP)

        def column(k: int) -> Floats:
            moved = amounts.copy()
            moved[k] += steps[k]
            return np.asarray((of_data(moved) - base) / steps[k])

        columns = Parallel(n_jobs=jobs, prefer="threads")(delayed(column)(k) for k in range(len(amounts)))
        return np.vstack([np.column_stack(columns), np.eye(len(amounts))])

    first = np.zeros(len(unknowns)) if begin is None else begin
    inside = np.clip(first, low + 1e-6, high - 1e-6)
    found = least_squares(whole, inside, jacobian, bounds=(low, high), max_nfev=evaluations, xtol=1e-4, ftol=1e-4)
    information = found.jac.T @ found.jac
    return Fit(tuple(unknowns), found.x, np.linalg.inv(information), float(found.cost))
