"""From where on a model that was simulated has diverged: one rule for runs, residuals and errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

DIVERGED = 1e12
"""A model whose values are larger, in SI units, or no numbers, has diverged."""


def diverged_from(shown: FloatArray) -> int:
    """First row from which a simulated course (N, C) has diverged; N where it has not."""
    lost = ~np.all(np.abs(shown) < DIVERGED, axis=1)
    return int(np.argmax(lost)) if lost.any() else len(shown)


def has_diverged(values: ArrayLike) -> bool:
    """Whether a model's values say that it diverges. NaN is no value, as where a delay reaches beyond the recording."""
    return bool(np.any(np.abs(np.asarray(values, dtype=np.float64)) >= DIVERGED))
