"""Where the model errs, without any law: one unknown input at one place, by the exact likelihood of a Kalman filter.

The input is a random walk at one place, in all channels of all recordings, with the base directions as unknown
constants. Its intensity is that of the greatest likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import kernel
from pam_antagonist.diagnosis.residual_equations import CHANNELS, PLACES, Equations

Floats = NDArray[np.float64]

LEVELS = 10.0 ** np.arange(-3.0, 2.1, 0.5)
"""Intensities of a random walk, in the unit of a place that shows as much as the noise, per root of a second."""
_START = 2e4
"""[Pa] Standard deviation of a pressure's error at the begin."""


@kernel
def whitened(fresh, slope, noise, walk, at, quiet, columns_in, columns_out):
    """Whitens columns by a Kalman filter whose unknowns are the errors of both pressures and a random walk at a place.

    Args:
        fresh: whether a block begins anew (K,).
        slope: of the errors over a block (K, 2).
        noise: variance of each channel, not finite where it is missing (K, C); the first two are the pressures.
        walk: variance of the walk's step [unit²], and at the begin.
        at: what a unit of the walk does over a block and to the channels (K, 2 + C).
        quiet: variance of the errors' steps [Pa²].
        columns_in: of data and regressors, over a block (N, K, 2).
        columns_out: likewise, to the channels (N, K, C).

    Returns:
        Whitened columns (N, K, C), 0 where missing, and the logarithms of the variances (C,), summed.
    """
    count, channels = noise.shape
    white = np.zeros(columns_out.shape)
    logs = np.zeros(channels)
    cov, gain, row = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    old = np.zeros((3, 3))
    state = np.zeros((columns_in.shape[0], 3))
    for k in range(count):
        if fresh[k]:
            cov[:] = 0.0
            cov[0, 0] = cov[1, 1] = 4e8
            cov[2, 2] = walk[1]
            state[:] = 0.0
        for c in range(channels):
            if not np.isfinite(noise[k, c]):
                continue
            row[0], row[1], row[2] = 1.0 if c == 0 else 0.0, 1.0 if c == 1 else 0.0, at[k, 2 + c]
            for i in range(3):
                gain[i] = cov[i, 0] * row[0] + cov[i, 1] * row[1] + cov[i, 2] * row[2]
            spread = noise[k, c] + row[0] * gain[0] + row[1] * gain[1] + row[2] * gain[2]
            logs[c] += np.log(spread)
            for i in range(3):
                for j in range(3):
                    old[i, j] = gain[i] * gain[j] / spread
            for i in range(3):
                for j in range(3):
                    cov[i, j] -= old[i, j]
            scale = 1.0 / np.sqrt(spread)
            g0, g1, g2 = gain[0] / spread, gain[1] / spread, gain[2] / spread
            for n in range(state.shape[0]):
                s0, s1, s2 = state[n, 0], state[n, 1], state[n, 2]
                left = columns_out[n, k, c] - row[0] * s0 - row[1] * s1 - row[2] * s2
                white[n, k, c] = left * scale
                state[n, 0], state[n, 1], state[n, 2] = s0 + g0 * left, s1 + g1 * left, s2 + g2 * left
        a0, a1, b0, b1 = slope[k, 0], slope[k, 1], at[k, 0], at[k, 1]
        for n in range(state.shape[0]):
            walked = state[n, 2]
            state[n, 0] = a0 * state[n, 0] + b0 * walked + columns_in[n, k, 0]
            state[n, 1] = a1 * state[n, 1] + b1 * walked + columns_in[n, k, 1]
        p00, p01, p11, p02, p12, p22 = cov[0, 0], cov[0, 1], cov[1, 1], cov[0, 2], cov[1, 2], cov[2, 2]
        cov[0, 0] = a0 * a0 * p00 + 2.0 * a0 * b0 * p02 + b0 * b0 * p22 + quiet
        cov[1, 1] = a1 * a1 * p11 + 2.0 * a1 * b1 * p12 + b1 * b1 * p22 + quiet
        cov[0, 1] = cov[1, 0] = a0 * a1 * p01 + a0 * b1 * p02 + b0 * a1 * p12 + b0 * b1 * p22
        cov[0, 2] = cov[2, 0] = a0 * p02 + b0 * p22
        cov[1, 2] = cov[2, 1] = a1 * p12 + b1 * p22
        cov[2, 2] = p22 + walk[0]
    return white, logs


def data_columns(one: Equations) -> tuple[Floats, Floats]:
    """Columns of data and base directions: over a block (1 + D, K, 2), and to the channels (1 + D, K, 4)."""
    moved, static = one.base
    inside = np.concatenate([-one.jumps[None], moved])
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
    white, logs = whitened(one.fresh, one.slope, noise_of(one), walk, at, quiet_of(one), *data_columns(one))
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
