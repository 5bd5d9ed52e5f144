"""Pressures of a sensor that is slower than the log: the log repeats a reading until the next one comes.

A repeated reading is no measurement. It is told from a coarse converter by both pressures: a board reads them together,
so they repeat together and change together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MOST_REPEATS = 3
"""A slow sensor repeats a reading in at most so many rows; in longer repeats the pressure itself is at rest."""
_SHARE = 0.15
"""Share of repeated rows from which on a sensor is called slower than the log."""
_TOGETHER = 0.6
"""Share of the changes in which both pressures change; of two independent converters it is smaller."""
_FASTEST_S = 2e-3
"""[s] In logs with shorter periods a repeated value is mostly a pressure at rest, on a converter's step."""


def repeated(pressure: NDArray[np.float64], period_s: float) -> NDArray[np.bool_]:
    """Which rows repeat the last reading of a slow sensor (N,); none where the sensor is as quick as the log.

    Args:
        pressure: both pressures (N, 2) [Pa].
        period_s: of the rows [s].
    """
    none = np.zeros(len(pressure), dtype=bool)
    if len(pressure) < 3 or period_s < _FASTEST_S:
        return none
    changed = np.diff(pressure, axis=0) != 0.0
    any_changed = changed.any(axis=1)
    if not any_changed.any() or changed[any_changed].all(axis=1).mean() < _TOGETHER:
        return none
    fresh = np.concatenate([[True], any_changed])
    since = np.arange(len(fresh)) - np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))
    out = np.asarray((since > 0) & (since <= _MOST_REPEATS))
    # Long rests do not count: there the pressure is as it was.
    counted = since <= _MOST_REPEATS
    return out if out.sum() >= _SHARE * counted.sum() else none
