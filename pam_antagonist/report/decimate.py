"""Decimation of curves for plots, which keeps outliers visible.

Sixty seconds at 1 kHz are 60,000 samples for a plot that is 1,000 pixels wide. Taking every k-th sample would lose
spikes, and a mean would flatten them. Here each bucket of samples keeps its least and its largest value at their times,
so that the drawn curve fills the same pixels as the full one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LIMIT = 2000
"""Most points of one curve: least and largest value for each pixel of a figure that is 1,000 pixels wide."""
_PAUSE = 5.0
"""A time step of more than this many median steps is a pause."""

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def bucket_width(samples: int, limit: int = LIMIT) -> int:
    """Samples in each bucket, so that two points from each stay within the limit (1: all samples are kept)."""
    return 1 if samples <= limit else -(-samples // (limit // 2))


def _buckets(values: FloatArray, width: int, fill: float) -> FloatArray:
    """Rows of `width` samples; `fill` replaces NaN and pads the last row."""
    known = np.where(np.isnan(values), fill, values)
    return np.pad(known, (0, -len(values) % width), constant_values=fill).reshape(-1, width)


def min_max_indices(values: FloatArray, limit: int = LIMIT) -> IndexArray:
    """Indices of the least and the largest sample of each bucket."""
    width = bucket_width(len(values), limit)
    if width == 1:
        return np.arange(len(values))
    low, high = _buckets(values, width, np.inf).argmin(axis=1), _buckets(values, width, -np.inf).argmax(axis=1)
    starts = np.arange(len(low)) * width
    return np.unique(np.concatenate((starts + low, starts + high)))


def envelope(lower: FloatArray, upper: FloatArray, limit: int = LIMIT) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Decimate a band so that it still covers the full one."""
    width = bucket_width(len(lower), limit)
    low, high = _buckets(lower, width, np.inf).min(axis=1), _buckets(upper, width, -np.inf).max(axis=1)
    known = np.isfinite(low) & np.isfinite(high)
    middle = np.minimum(np.arange(len(low)) * width + width // 2, len(lower) - 1)
    return middle, np.where(known, low, np.nan), np.where(known, high, np.nan)


def shares(category: NDArray[np.int64], categories: int, columns: int) -> tuple[IndexArray, FloatArray]:
    """Share of each stretch of time that is spent in each category.

    `category`: (N,) values 0..categories - 1. Returns index of each stretch's middle sample (C,), and the shares
    (categories, C), each column adding up to 1.
    """
    width = max(1, -(-len(category) // columns))
    stretch = np.arange(len(category)) // width
    table = np.zeros((categories, -(-len(category) // width)))
    np.add.at(table, (category, stretch), 1.0)
    middle = np.minimum(np.arange(table.shape[1]) * width + width // 2, max(len(category) - 1, 0))
    return middle, table / np.maximum(table.sum(axis=0), 1.0)


def stretches(x: FloatArray) -> IndexArray:
    """Number of the stretch that each sample (N,) belongs to; a pause of over five median steps starts a new one."""
    if len(x) < 3:
        return np.zeros(len(x), np.int64)
    step = np.diff(x)
    return np.concatenate(([0], np.cumsum(step > _PAUSE * np.median(step))))


def curve(x: FloatArray, y: FloatArray, with_pauses: bool) -> tuple[FloatArray, FloatArray]:
    """A curve with at most about `LIMIT` points; `with_pauses`: those in a recording's time become gaps."""
    index = min_max_indices(y)
    if not with_pauses:
        return x[index], y[index]
    gaps = np.flatnonzero(np.diff(stretches(x)[index]) != 0) + 1
    return np.insert(x[index], gaps, np.nan), np.insert(y[index], gaps, np.nan)


def band(
    x: FloatArray, lower: FloatArray, upper: FloatArray, with_pauses: bool
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """The uninterrupted stretches of a decimated band: x, lower and upper edge of each; as :func:`curve`."""
    index, low, high = envelope(lower, upper)
    group = stretches(x)[index] if with_pauses else np.zeros(len(index), np.int64)
    key = np.where(np.isfinite(low), group, -1)
    runs = np.split(np.arange(len(index)), np.flatnonzero(np.diff(key) != 0) + 1)
    return [(x[index[run]], low[run], high[run]) for run in runs if len(run) > 1 and key[run[0]] >= 0]
