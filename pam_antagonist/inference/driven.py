"""Base class of everything that a model is fitted to, however the joint is driven and recorded.

Two kinds derive from it: an :class:`~pam_antagonist.inference.experiment.Experiment` is one recording, in blocks;
:class:`~pam_antagonist.inference.episodes.Episodes` are many short recordings, each simulated from its own start.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.point import Point
from pam_antagonist.inference.threads import side_by_side
from pam_antagonist.inference.unknown import Unknown, start_values
from pam_antagonist.model.lane_values import LANES
from pam_antagonist.rig import Rig
from pam_antagonist.rig.schema import limits

Floats = NDArray[np.float64]

_STEP = 2e-3
"""Relative step of finite differences along the base directions, large enough that stiction does not hide it."""


class Driven(ABC):
    """A model of a joint, and its residual to a recording."""

    rig: Rig
    jobs: int

    @property
    @abstractmethod
    def directions(self) -> tuple[Unknown, ...]:
        """Free base directions (K)."""

    @abstractmethod
    def residual(self, point: Point) -> Floats:
        """Measured minus simulated values (B, C) of the fitted part, 0 where nothing was measured."""

    @abstractmethod
    def residuals(self, points: Iterable[Point]) -> list[Floats]:
        """:meth:`residual` of several models, which run side by side."""

    @property
    def start_std(self) -> Floats:
        """Standard deviations of the start values that are fitted with the parameters (S,)."""
        return np.zeros(0)

    def depends_on(self, k: int) -> bool:
        """Whether a compared channel depends on a base coordinate."""
        return True

    def differences(self, point: Point, residual: Floats, moved: Iterable[Point]) -> list[Floats]:
        """Changes of the residual (B, C) from a point to others nearby. `residual`: at this point (B, C)."""
        return [there - residual for there in self.residuals(moved)]

    @property
    def size(self) -> int:
        """Number of base coordinates, start values included (K + S)."""
        return len(self.directions) + len(self.start_std)

    @property
    def origin(self) -> Point:
        """The model as configured."""
        return Point(np.zeros(self.size))

    def changes(self, point: Point) -> dict[str, float]:
        """Values of the base parameters that differ from the rig file's, by dotted path."""
        start, change = self._line
        values = np.clip(start + point.theta[: len(change)] @ change, *self._limits)
        return dict(zip(self._moved, values.tolist(), strict=True))

    @cached_property
    def _moved(self) -> tuple[str, ...]:
        """Parameters that the directions move (M)."""
        return tuple(start_values(self.rig, self.directions))

    @cached_property
    def _line(self) -> tuple[Floats, Floats]:
        """Values of these parameters in the rig file (M,), and their change in each direction (K, M)."""
        start = list(start_values(self.rig, self.directions).values())
        change = [[direction.adds.get(name, 0.0) for name in self._moved] for direction in self.directions]
        return np.array(start), np.array(change).reshape(len(self.directions), len(start))

    @cached_property
    def _limits(self) -> tuple[Floats, Floats]:
        """Least and largest value of these parameters that a rig file may have (M,)."""
        low, high = np.array([limits(name) for name in self._moved]).reshape(-1, 2).T
        return low, high

    def jacobian(self, point: Point, residual: Floats) -> Floats:
        """Derivatives of the residual by the base coordinates (B, C, K + S)."""
        result = np.zeros((*residual.shape, self.size))
        free = [k for k in range(self.size) if self.depends_on(k)]
        steps = np.where(np.arange(self.size) < len(self.directions), _STEP, 1.0)
        moved = (Point(point.theta + np.eye(self.size)[k] * steps, point.effects) for k in free)
        for k, difference in zip(free, self.differences(point, residual, moved), strict=True):
            result[:, :, k] = difference / steps[k]
        return result

    def in_lanes(self, work: Callable[[Sequence[Point]], list[Floats]], points: Iterable[Point]) -> list[Floats]:
        """Compute something for several points: as many at once as run in lanes, on the threads that all fits share."""
        each = list(points)
        groups = [each[k : k + LANES] for k in range(0, len(each), LANES)]
        return list(itertools.chain.from_iterable(side_by_side(work, groups, self.jobs)))
