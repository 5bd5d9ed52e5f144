"""The sensors' noise, from what was measured alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.trial import BLOCK

Floats = NDArray[np.float64]

_MOST_LEVELS = 0.25
"""Distinct values a sample of a converted signal: a signal without steps has nearly as many as samples."""
_ON_GRID, _SHARE_ON_GRID = 0.02, 0.98
_LEAST = 1e-12


def white_std(values: Floats) -> float:
    """Standard deviation of the noise of a slow signal: that of its differences over √2.

    Args:
        values: what the sensor showed (N,), NaN where missing.

    Returns:
        In the unit of the values; NaN where no two neighbours are known.
    """
    step = np.diff(values)
    step = step[np.isfinite(step)]
    return float(np.sqrt(np.mean(step * step) / 2.0)) if step.size else float("nan")


def converter_step(values: Floats) -> float:
    """Step of the converter behind a signal; 0 where hardly a value comes twice, or where they lie on no grid.

    A slow signal shows little of its converter in the differences of neighbours, which are mostly none, so that its
    noise looks smaller than the error of a reading is.

    Args:
        values: what the sensor showed (N,), NaN where missing.
    """
    known = values[np.isfinite(values)]
    levels, counts = np.unique(known, return_counts=True)
    if len(levels) < 2 or len(levels) > _MOST_LEVELS * len(known):
        return 0.0
    apart = np.diff(levels[counts >= np.quantile(counts, 0.5)])
    if not len(apart):
        return 0.0
    step = float(np.median(apart))
    off = np.abs(apart / step - np.rint(apart / step))
    return step if np.mean(off < _ON_GRID) > _SHARE_ON_GRID else 0.0


def block_noise(values: Floats) -> float:
    """Standard deviation that a sensor gives to the mean of a block of samples.

    Noise is what changes between samples: the second difference of a signal that is smooth over three
    samples is noise of six times the variance. Its largest twentieth is left out: a joint that jumps is not noise. A
    converter whose step is coarser than the noise rounds all samples of a block alike; its error does not average out.

    Args:
        values: what the sensor showed (N,), NaN where missing.
    """
    second = np.diff(values[np.isfinite(values)], 2)
    bound = 2.0 * float(np.quantile(np.abs(second), 0.95))
    white = float(np.sqrt(np.mean(second[np.abs(second) <= bound] ** 2) / 6.0))
    step = converter_step(values)
    averaged = white / np.sqrt(BLOCK)
    return float(max(np.hypot(step / np.sqrt(12.0), averaged) if white < step / 2.0 else averaged, _LEAST))
