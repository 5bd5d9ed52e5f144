"""Where the model errs, without any law: one unknown input at one place, by the exact likelihood of a Kalman filter.

The input is a random walk at one place, in all channels of all recordings, with the base directions as unknown
constants. Its intensity is that of the greatest likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.law_kernels import whitened_at_place
from pam_antagonist.diagnosis.places import PLACES
from pam_antagonist.diagnosis.residual_equations import CHANNELS, Equations

Floats = NDArray[np.float64]

LEVELS = 10.0 ** np.arange(-3.0, 2.1, 0.5)
"""Intensities of a random walk, in the unit of a place that shows as much as the noise, per root of a second."""
_START = 2e4
"""[Pa] Standard deviation of a pressure's error at the begin."""


def data_columns(one: Equations) -> tuple[Floats, Floats]:
    """Columns of data and base directions: over a block (1 + D, K, 2), and to the channels (1 + D, K, 4)."""
    moved, static = one.base
    inside = np.concatenate([one.jumps[None], moved])
    outside = np.zeros((len(inside), len(one.time), len(CHANNELS)))
    outside[0] = np.nan_to_num(one.residual)
    outside[1:, :, 2:] = static
    return inside, outside


def noise_of(one: Equations) -> Floats:
    """Variances of the channels, infinite where there is no residual."""
    return np.asarray(np.where(np.isfinite(one.residual), one.noise, np.inf))


def quiet_of(one: Equations) -> float:
    """Variance of the errors' steps that the discrete equations themselves have [Pa²]."""
    return float(0.01 * np.median(one.noise[:, 0]))


def unit_of(one: Equations, place: str) -> float:
    """Amount at a place that shows within a second as much as the noise of a block."""
    inside, outside = one.places[place]
    shows = [np.sqrt(np.mean((inside[:, i] / one.step) ** 2 / one.noise[:, i])) for i in (0, 1)]
    for c in range(len(CHANNELS)):
        there = np.isfinite(one.residual[:, c])
        if there.any():
            shows.append(np.sqrt(np.mean((outside[there, c] ** 2) / one.noise[there, c])))
    return float(1.0 / max(*shows, 1e-30))


def marginal(white: Floats, logs: float) -> float:
    """Logarithm of the likelihood with the base directions integrated out, each with its prior.

    Args:
        white: whitened data and base directions (1 + D, n).
        logs: of the variances.
    """
    data, base = white[0], white[1:]
    gram = base @ base.T + np.eye(len(base))
    shared = base @ data
    _, volume = np.linalg.slogdet(gram)
    return float(-0.5 * (data @ data - shared @ np.linalg.solve(gram, shared) + logs + volume))


@dataclass(frozen=True)
class Place:
    """A place with an unknown input.

    Attributes:
        name: of the place; empty for none.
        gain: logarithm of its likelihood over that without an input [nats].
        level: intensity of the walk.
    """

    name: str
    gain: float
    level: float


def _likelihood(one: Equations, place: str, level: float) -> float:
    at = np.zeros((len(one.time), 2 + len(CHANNELS)))
    walk = np.zeros(2)
    if place and place in one.places:
        unit = unit_of(one, place)
        at = np.column_stack(one.places[place]) * unit
        step = level**2 * one.step
        walk = np.array([step, step * len(one.time)])
    white, logs = whitened_at_place(one.fresh, one.slope, noise_of(one), walk, at, quiet_of(one), *data_columns(one))
    return marginal(white.reshape(len(white), -1), float(logs.sum()))


def search(recordings: Sequence[Equations]) -> list[Place]:
    """All places by the likelihood of an unknown input there, the likeliest first.

    Args:
        recordings: of one rig.
    """
    names = [name for names in PLACES.values() for name in names if any(name in one.places for one in recordings)]
    nothing = sum(_likelihood(one, "", 0.0) for one in recordings)
    found = []
    for name in names:
        best: dict[float, float] = {}
        for level in LEVELS[::2]:
            best[level] = sum(_likelihood(one, name, level) for one in recordings)
        top = max(best, key=lambda level: best[level])
        for level in (top * 10.0**0.5, top / 10.0**0.5):
            best[level] = sum(_likelihood(one, name, level) for one in recordings)
        top = max(best, key=lambda level: best[level])
        found.append(Place(name, best[top] - nothing, float(top)))
    return sorted(found, key=lambda place: -place.gain)
