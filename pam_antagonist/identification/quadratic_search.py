"""The minimum of a smooth function of one or two coordinates that takes seconds to work out.

A quadratic is put through the values near the best one. Its minimum within a trust region is tried next, and the region
shrinks where the quadratic promised too much. A simplex search (Nelder and Mead 1965) takes two to four times as many
values to the same place. The method is that of UOBYQA (Powell 2002), for so few coordinates that the minimum of the
quadratic is looked up on a grid.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_GRID = np.linspace(-1.0, 1.0, 41)
_KEPT, _BROKEN = 0.7, 0.25
"""Shares of what was promised: above the first the region may grow, below the second it shrinks."""
_LEAST = 0.5
"""Radius of the region, in first steps, at which a search may end."""


class Found(NamedTuple):
    """The end of a search.

    Attributes:
        x: coordinates of the least value (n,).
        value: there.
        evaluations: how many values were worked out, that of the start included.
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
        enough: the search ends where the quadratic promises less than this.
        most: values that may be worked out, once the first quadratic has those that it needs.
    """
    search = _Search(function, np.asarray(steps, dtype=np.float64), bounds)
    search.begin(np.asarray(start, dtype=np.float64))
    while len(search.values) < most and search.goes_on(enough):
        pass
    best = int(np.argmin(search.values))
    return Found(search.points[best], search.values[best], len(search.values))


class _Search:
    """Values so far, and the region about the best of them.

    Attributes:
        points: coordinates at which the function was worked out.
        values: there.
    """

    def __init__(
        self, function: Callable[[Floats], float], steps: Floats, bounds: Sequence[tuple[float, float]]
    ) -> None:
        self.points: list[Floats] = []
        self.values: list[float] = []
        self._function, self._steps = function, steps
        self._low, self._high = np.transpose(bounds)
        self._radius = 1.0
        self._left = -1

    @property
    def _reach(self) -> Floats:
        return self._radius * np.abs(self._steps)

    def _value(self, x: Floats) -> float:
        """The function's value at the nearest point within the bounds, worked out once."""
        inside = np.clip(x, self._low, self._high)
        for known, value in zip(self.points, self.values, strict=True):
            if np.allclose(known, inside, rtol=0.0, atol=1e-9):
                return value
        self.points.append(inside)
        self.values.append(self._function(inside))
        return self.values[-1]

    def begin(self, start: Floats) -> None:
        """Work out what the first quadratic needs: two more values along each coordinate, and one across."""
        at_start, corner = self._value(start), start.copy()
        for step in np.diag(self._steps):
            better = self._value(start + step) < at_start
            behind = start + 2.0 * step if better else start - step
            inside = np.all((behind >= self._low) & (behind <= self._high))
            self._value(behind if inside else start + 0.5 * step)
            corner += step if better else -step
        self._value(corner)

    def goes_on(self, enough: float) -> bool:
        """Try what the quadratic promises; False where it promises less than enough, near the best value and far."""
        best = int(np.argmin(self.values))
        trial, gain = self._promise(best)
        if gain < enough:
            # A quadratic through values further off may overlook what is near, and a gentle slope adds up.
            if self._radius > _LEAST:
                self._radius *= 0.5
                return True
            if self._looks_around(self.points[best]):
                return True
            self._radius = 1.0
            trial, gain = self._promise(best)
            if gain < enough or best == self._left:
                return False
            self._left = best
        before, count = self.values[best], len(self.values)
        step = np.max(np.abs(trial - self.points[best]) / self._reach)
        share = (before - self._value(trial)) / gain
        if share > _KEPT and step > 0.9:
            self._radius *= 2.0
        elif share < _BROKEN or len(self.values) == count:
            self._radius *= 0.5
        return True

    def _promise(self, best: int) -> tuple[Floats, float]:
        """The quadratic's minimum in the region (n,), and how much less it promises there than the best value."""
        x = self.points[best][:, None]
        box = np.clip(x + self._reach[:, None] * _GRID, self._low[:, None], self._high[:, None])
        trials = np.array(list(itertools.product(*box)))
        promised = _terms((trials - x[:, 0]) / self._reach) @ self._quadratic(best)
        place = int(np.argmin(promised))
        return trials[place], -float(promised[place])

    def _looks_around(self, x: Floats) -> bool:
        """Work out a value along each coordinate that has none about the radius; whether there was one to work out."""
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
        # A quadratic is true nearby only; several values even out what is ragged.
        weights = 1.0 / (0.5 + np.sum(offsets**2, axis=1))
        return np.asarray(np.linalg.lstsq(weights[:, None] * _terms(offsets), weights * change, rcond=1e-9)[0])


def _terms(x: Floats) -> Floats:
    """Linear and quadratic terms of coordinates (K, n), without a constant: (K, n (n + 3) / 2)."""
    n = x.shape[1]
    return np.column_stack([x, *(x[:, i] * x[:, j] for i in range(n) for j in range(i + 1))])
