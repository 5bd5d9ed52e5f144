"""Pressures of a sensor that is slower than the log: the log repeats a reading until the next one comes.

A repeated reading is no measurement. It is told from a coarse converter by both pressures: a board reads them together,
so they repeat together and change together.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_MOST_REPEATS = 3
"""A slow sensor repeats a reading in at most so many rows; in longer repeats the pressure itself is at rest."""
_SHARE = 0.15
"""Share of repeated rows from which on a sensor is called slower than the log."""
_TOGETHER = 0.6
"""Share of the changes in which both pressures change; of two independent converters it is smaller."""
_FEWEST_READINGS = 64
"""Fewer tell no period."""
_MOST_LOST = 1.15
"""Times as many readings as are seen, since equal ones are not seen as new."""
_STEADY = 1.1
"""Largest range of the readings' ages, in rows of the log: 1 but for the jitter of its stamps."""
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


def reading_times(time: NDArray[np.float64], period_s: float) -> NDArray[np.float64]:
    """When a slow sensor took its readings (K,) [s], but for a constant delay; as logged if it has no steady period.

    The log shows a reading in its next row. So the reading's age varies by up to a row, which a quick joint
    shows. A sensor with a period of its own has taken its readings at one distance.

    Args:
        time: of the rows that show a new reading first (K,) [s].
    """
    if len(time) < _FEWEST_READINGS:
        return time
    since, count = time - time[0], _FEWEST_READINGS
    # Of the periods that explain the first readings the longest one: it has lost the fewest.
    tried = since[count - 1] / np.arange(count - 1, _MOST_LOST * count, 0.05)
    period = next((one for one in tried if _spread(since[:count], one)[0] <= _STEADY * period_s), math.nan)
    while math.isfinite(period) and count < len(time):
        count = min(2 * count, len(time))
        # Over a longer part, the period is known more exactly.
        near = period + 1.2 * period_s / count * np.linspace(-2.0, 2.0, 121)
        period = min(near, key=lambda one: _spread(since[:count], one)[0])
    if not math.isfinite(period):
        return time
    spread, first = _spread(since, period)
    if spread > _STEADY * period_s:
        return time
    age = (since - first) % period
    taken = since - age
    if np.diff(taken).min() < 0.5 * period:  # two readings in one period: it is none
        return time
    return np.asarray(time[0] + taken + age.mean())


def _spread(time: NDArray[np.float64], period: float) -> tuple[float, float]:
    """Length of the shortest arc of a period that holds all times [s], and its begin [s]."""
    phase = np.sort(time % period)
    gap = np.diff(phase, append=phase[0] + period)
    widest = int(np.argmax(gap))
    return float(period - gap[widest]), float(phase[(widest + 1) % len(phase)])
