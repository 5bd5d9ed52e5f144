"""Where the model errs, without any law: one unknown input at one place, by the exact likelihood of a Kalman filter.

The input is a random walk at one place, in all channels of all recordings, with the base directions as unknown
constants. Its intensity is that of the greatest likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pam_antagonist.diagnosis.law_kernels import whitened
from pam_antagonist.diagnosis.residual_equations import CHANNELS, PLACES, Equations

LEVELS = 10.0 ** np.arange(-3.0, 2.1, 1.0)
"""Intensities of a random walk, in the unit of a place that shows as much as the noise, per root of a second."""
_SEEN = np.array([0, 1, -1, -1])


class Place(NamedTuple):
    """A place with an unknown input, and the gain of its likelihood over that without an input [nats]."""

    name: str
    gain: float


def _likelihood(one: Equations, place: str, level: float) -> float:
    """Logarithm of the likelihood of an input, the base directions integrated out, each with its prior."""
    at = np.zeros((len(one.time), 2 + len(CHANNELS)))
    walk = np.zeros(2)
    if place in one.places:
        at = np.column_stack(one.places[place]) * one.unit(place)
        walk = level**2 * one.step * np.array([1.0, len(one.time)])
    columns, logs = whitened(one.fresh, one.slope, one.seen, walk, at, one.quiet, _SEEN, *one.data_columns)
    white = columns.reshape(len(columns), -1)
    data, base = white[0], white[1:]
    gram, shared = base @ base.T + np.eye(len(base)), base @ data
    _, volume = np.linalg.slogdet(gram)
    return float(-0.5 * (data @ data - shared @ np.linalg.solve(gram, shared) + logs.sum() + volume))


def search(recordings: Sequence[Equations]) -> list[Place]:
    """All places by the likelihood of an unknown input there, the likeliest first."""
    names = [name for names in PLACES.values() for name in names if any(name in one.places for one in recordings)]
    nothing = sum(_likelihood(one, "", 0.0) for one in recordings)
    found = []
    for name in names:
        best: dict[float, float] = {}
        for factors in ((LEVELS,), (10.0**0.5, 10.0**-0.5)):
            top = max(best, key=lambda level: best[level], default=1.0)
            for level in np.ravel(factors) * top:
                best[level] = sum(_likelihood(one, name, level) for one in recordings)
        found.append(Place(name, max(best.values()) - nothing))
    return sorted(found, key=lambda place: -place.gain)
