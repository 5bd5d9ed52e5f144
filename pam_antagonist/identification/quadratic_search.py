"""Minimum of a smooth function of one or two coordinates whose evaluation takes seconds.

A quadratic is fitted to the values near the best one. Its minimum within a trust region is tried next. The region
shrinks where the quadratic predicts too large a gain. The method is that of UOBYQA (Powell 2002). With so few
coordinates the minimum of the quadratic is found on a grid. A simplex search (Nelder and Mead 1965) needs two to four
times as many evaluations.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_GRID = np.linspace(-1.0, 1.0, 41)
_GROWS_ABOVE, _SHRINKS_BELOW = 0.7, 0.25
"""Shares of the predicted gain: above the first the region may grow, below the second it shrinks."""
_LEAST = 0.5
"""Radius of the region, in first steps, at which a search may end."""


class Found(NamedTuple):
    """The end of a search.

    Attributes:
        x: coordinates of the least value (n,).
        value: the least value.
        evaluations: how often the function was evaluated, at the start included.
    """

    x: Floats
    value: float
    evaluations: int


def minimum(
    function: Callable[[Floats], float],
    start: Sequence[float],
    steps: Sequence[float],
    bounds: Sequence[tuple[float, float]],
    enough: float,
    most: int,
) -> Found:
    """Search for the minimum of a function.

    Args:
        function: of coordinates (n,), n = 1 or 2.
        start: first coordinates (n,), within the bounds.
        steps: first step along each coordinate (n,), signed.
        bounds: least and largest value of each coordinate.
        enough: the search ends where the predicted gain is less than this.
        most: evaluations at most; the first quadratic always gets those that it needs.
    """
    search = _Search(function, np.asarray(steps, dtype=np.float64), bounds)
    search.begin(np.asarray(start, dtype=np.float64))
    while len(search.values) < most and search.goes_on(enough):
        pass
    best = int(np.argmin(search.values))
    return Found(search.points[best], search.values[best], len(search.values))


class _Search:
    """Values so far, and the trust region about the best of them.

    Attributes:
        points: coordinates at which the function was evaluated.
        values: values at these points.
    """

    def __init__(
        self, function: Callable[[Floats], float], steps: Floats, bounds: Sequence[tuple[float, float]]
    ) -> None:
        self.points: list[Floats] = []
        self.values: list[float] = []
        self._function, self._steps = function, steps
        self._low, self._high = np.transpose(bounds)
        self._radius = 1.0
        self._last_retry = -1

    @property
    def _reach(self) -> Floats:
        return self._radius * np.abs(self._steps)

    def _value(self, x: Floats) -> float:
        """The function's value at the nearest point within the bounds, evaluated once."""
        inside = np.clip(x, self._low, self._high)
        for known, value in zip(self.points, self.values, strict=True):
            if np.allclose(known, inside, rtol=0.0, atol=1e-9):
                return value
        self.points.append(inside)
        self.values.append(self._function(inside))
        return self.values[-1]

    def begin(self, start: Floats) -> None:
        """Evaluate what the first quadratic needs: two more values along each coordinate, and one across."""
        at_start, corner = self._value(start), start.copy()
        for step in np.diag(self._steps):
            better = self._value(start + step) < at_start
            behind = start + 2.0 * step if better else start - step
            inside = np.all((behind >= self._low) & (behind <= self._high))
            self._value(behind if inside else start + 0.5 * step)
            corner += step if better else -step
        self._value(corner)

    def goes_on(self, enough: float) -> bool:
        """Evaluate the quadratic's minimum; False if its gain is too small in a small region and in a large one."""
        best = int(np.argmin(self.values))
        trial, gain = self._predicted_minimum(best)
        if gain < enough:
            # A quadratic through distant values may miss a near minimum, and a gentle slope adds up far away.
            if self._radius > _LEAST:
                self._radius *= 0.5
                return True
            if self._looks_around(self.points[best]):
                return True
            self._radius = 1.0
            trial, gain = self._predicted_minimum(best)
            if gain < enough or best == self._last_retry:
                return False
            self._last_retry = best
        before, count = self.values[best], len(self.values)
        step = np.max(np.abs(trial - self.points[best]) / self._reach)
        share = (before - self._value(trial)) / gain
        if share > _GROWS_ABOVE and step > 0.9:
            self._radius *= 2.0
        elif share < _SHRINKS_BELOW or len(self.values) == count:
            self._radius *= 0.5
        return True

    def _predicted_minimum(self, best: int) -> tuple[Floats, float]:
        """The quadratic's minimum in the region (n,), and the gain over the best value that it predicts there."""
        x = self.points[best][:, None]
        box = np.clip(x + self._reach[:, None] * _GRID, self._low[:, None], self._high[:, None])
        trials = np.array(list(itertools.product(*box)))
        predicted = _terms((trials - x[:, 0]) / self._reach) @ self._quadratic(best)
        place = int(np.argmin(predicted))
        return trials[place], -float(predicted[place])

    def _looks_around(self, x: Floats) -> bool:
        """Evaluate along each coordinate without a value at about the radius; whether there was such a coordinate."""
        count = len(self.values)
        for k in range(len(x)):
            offsets = np.abs(np.array(self.points) - x) / self._reach
            beside = np.delete(offsets, k, axis=1).max(axis=1, initial=0.0)
            if not np.any((offsets[:, k] > 0.5) & (offsets[:, k] < 2.0) & (beside < 0.3)):
                step = np.where(np.arange(len(x)) == k, self._reach, 0.0)
                self._value(x + step if np.all(x + step <= self._high) else x - step)
        return len(self.values) > count

    def _quadratic(self, best: int) -> Floats:
        """Coefficients of the quadratic through the best value and near the others about it, in units of the region."""
        offsets = (np.delete(self.points, best, axis=0) - self.points[best]) / self._reach
        change = np.delete(self.values, best) - self.values[best]
        # A quadratic holds only nearby; several values smooth a ragged function.
        weights = 1.0 / (0.5 + np.sum(offsets**2, axis=1))
        return np.asarray(np.linalg.lstsq(weights[:, None] * _terms(offsets), weights * change, rcond=1e-9)[0])


def _terms(x: Floats) -> Floats:
    """Linear and quadratic terms of coordinates (K, n), without a constant: (K, n (n + 3) / 2)."""
    n = x.shape[1]
    return np.column_stack([x, *(x[:, i] * x[:, j] for i in range(n) for j in range(i + 1))])
