"""Figures that several commands draw: one function for each, from arrays; `x` and what is drawn over it are (N,)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.report import decimate
from pam_antagonist.report.figure import TIME, Axis, FloatArray, Heatmap, Line, Panel
from pam_antagonist.report.style import DEEP, PALE


def seconds(stamp_ns: NDArray[np.int64], origin_ns: int) -> FloatArray:
    """Time of samples (N,) since an origin [s], from stamps [ns]."""
    return np.asarray((stamp_ns - origin_ns) * 1e-9, dtype=np.float64)


def moving_mean(values: FloatArray, window: int) -> FloatArray:
    """Centred mean of the finite values in `window` samples (N,); NaN without finite values."""
    known = np.isfinite(values)
    total = np.concatenate(([0.0], np.cumsum(np.where(known, values, 0.0))))
    count = np.concatenate(([0], np.cumsum(known)))
    low = np.maximum(np.arange(len(values)) - window // 2, 0)
    high = np.minimum(low + window, len(values))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((total[high] - total[low]) / (count[high] - count[low]))


def with_mean(name: str, x: FloatArray, values: FloatArray, color: str, window: int) -> tuple[Line, Line]:
    """Single samples as a faint line, and in front their moving mean, which reduces the sensor's noise."""
    faint = Line(name, x, values, color, width=0.8, quiet=True, opacity=0.3)
    return faint, Line(name, x, moving_mean(values, window), color, width=1.8, quiet=True)


def strip(names: Sequence[str], category: NDArray[np.int64], x: FloatArray, columns: int = 400) -> Panel:
    """Active category over time: one row for each category, darker where it is active for more of the time.

    `names`: of the categories, with a short name before a colon; a category that never occurs has no row. `category`:
    (N,) indices into `names`.
    """
    middle, share = decimate.shares(category, len(names), columns)
    seen = [int(number) for number in np.flatnonzero(share.sum(axis=1) > 0.0)]
    cells = np.where(share[seen] > 0.0, share[seen], np.nan)
    rows = tuple(names[number] for number in seen)
    hover = "{row}\n{column} s: {value:.0%} of the time"
    short = tuple(name.split(":")[0] for name in rows)
    y = Axis("Subsystem σ [-]", labels=short, bounds=(-0.5, len(seen) - 0.5))
    part = Heatmap(x[middle], cells, rows, (PALE, DEEP), (0.0, 1.0), hover)
    return Panel(TIME, y, (part,), max(66, 26 * len(seen) + 36))
