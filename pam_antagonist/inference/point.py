"""A model of a recording as a point: amounts of the free directions, values of effects, and when effects act."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Span(NamedTuple):
    """When an effect acts."""

    begin_s: float = -np.inf  # since the first sample [s]
    end_s: float = np.inf  # likewise [s]
    std_s: tuple[float, float] = (0.0, 0.0)  # standard deviations of both [s], where they were fitted

    @property
    def limits(self) -> tuple[float, float]:
        """Begin and end [s], which may be infinite."""
        return self.begin_s, self.end_s

    @property
    def edges(self) -> tuple[float, ...]:
        """Its finite limits [s]: begin and end, as far as they exist."""
        return tuple(float(time) for time in self.limits if np.isfinite(time))


THROUGHOUT = Span()


@dataclass(frozen=True, eq=False)
class Point:
    """A point in the space of models of one recording."""

    theta: Floats  # amounts of the free directions (K,), then the start's deviations in standard deviations (S,)
    # values of the effects' parameters, and of calibrations, by dotted path.
    effects: Mapping[str, float] = field(default_factory=dict)


class Channel(NamedTuple):
    """A compared quantity, as a figure shows it."""

    title: str
    unit: str
    factor: float
