"""What of a residual is beyond the sensors' noise, and how much of that is gone with another model.

Both measures give what is gone, negative where it has grown, and what was there to go.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.likelihood import BLOCKS_PER_ERROR

Floats = NDArray[np.float64]

_STRETCH = int(BLOCKS_PER_ERROR)
"""[blocks] In each of them a model is right or wrong once: a fit counts one independent error likewise."""
_QUIET = 1.5
"""The mean square of a stretch of noise alone, over its variance, is hardly ever more."""
_FULL = 20.0
"""[dB] A stretch is explained where the error falls to a tenth: no law has quite the form of what is there."""


def in_decibels(before: Floats, after: Floats, noise: Floats) -> tuple[float, float]:
    """Second by second and in decibels: each counts down to the noise, or down to a tenth.

    A model that is wrong for a second has that second against it, however wrong it was. Where a joint sticks at another
    angle than the model's, squares would count nothing else.

    Args:
        before: residual of a model (B, C).
        after: of another one (B, C).
        noise: standard deviation of each channel's noise (C,).
    """
    old, new = _levels(before, noise), _levels(after, noise)
    there = np.minimum(old, _FULL)
    return float(np.sum(np.clip(old - new, -_FULL, there))), float(np.sum(there))


def in_mean_squares(before: Floats, after: Floats, noise: Floats) -> tuple[float, float]:
    """By the mean square of each channel.

    Args:
        before: residual of a model (B, C).
        after: of another one (B, C).
        noise: standard deviation of each channel's noise (C,).
    """
    old, new = (_squares(residual, noise) for residual in (before, after))
    return float(np.sum(old - new)), float(np.sum(old))


def _levels(residual: Floats, noise: Floats) -> Floats:
    """How far each stretch of each channel is above its noise [dB] (S, C)."""
    if not len(residual):
        return np.zeros((0, residual.shape[1]))
    # A rest of less than half a stretch belongs to the last one.
    begin = np.arange(0, max(len(residual) - _STRETCH // 2, 1), _STRETCH)
    lengths = np.diff(np.append(begin, len(residual)))
    squares = np.add.reduceat((residual / noise) ** 2, begin, axis=0) / lengths[:, None]
    return np.asarray(10.0 * np.log10(np.maximum(squares / _QUIET, 1.0)))


def _squares(residual: Floats, noise: Floats) -> Floats:
    if not len(residual):
        return np.zeros(residual.shape[1])
    return np.asarray(np.maximum(np.mean((residual / noise) ** 2, axis=0) - 1.0, 0.0))
