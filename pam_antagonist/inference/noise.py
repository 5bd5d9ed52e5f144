"""The sensors' noise, from what was measured alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.trial import BLOCK

Floats = NDArray[np.float64]

_LEAST = 1e-12


def block_noise(values: Floats) -> float:
    """Standard deviation that a sensor gives to the mean of a block of samples.

    Noise is told from what changes between samples only: the second difference of a signal that is smooth over three
    samples is noise of six times the variance. A converter whose step is coarser than the noise rounds all samples of
    a block alike; its error does not average out.

    Args:
        values: what the sensor showed (N,), NaN where missing.
    """
    known = values[np.isfinite(values)]
    second = np.diff(known, 2)
    bound = 2.0 * float(np.quantile(np.abs(second), 0.95))
    white = float(np.sqrt(np.mean(second[np.abs(second) <= bound] ** 2) / 6.0))
    step = _converter_step(known)
    averaged = white / np.sqrt(BLOCK)
    return float(max(np.hypot(step / np.sqrt(12.0), averaged) if white < step / 2.0 else averaged, _LEAST))


def _converter_step(known: Floats) -> float:
    """Step of the converter behind a signal; 0 where hardly a value comes twice."""
    levels, counts = np.unique(known, return_counts=True)
    if len(levels) < 2 or len(levels) > len(known) / 4:
        return 0.0
    common = levels[counts >= np.quantile(counts, 0.5)]
    return float(np.median(np.diff(common))) if len(common) > 1 else 0.0
