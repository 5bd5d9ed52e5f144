"""One number in several recordings: its common value, and whether the recordings contradict each other in it.

Both common values weight each recording by how well it determines the number. They differ in what scatter means. A
calibration belongs to a sensor or a clock, which is the same in all recordings: more scatter than the standard
deviations allow says that these are too small, so they are enlarged by the same factor. The size of an effect may
really differ from recording to recording: no recording decides alone, however certain it is, and the standard
deviation covers the range.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pam_antagonist.diagnosis import thresholds

_SCATTER = 0.02
"""Scatter of a size between recordings that its mean expects, as a share of the largest one."""


def of_calibration(seen: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Weighted mean and its standard deviation, enlarged where the values scatter by more than their own."""
    values, stds = np.array(seen).T
    weights = 1.0 / np.maximum(stds, 1e-12) ** 2
    mean, std = float(weights @ values / weights.sum()), float(weights.sum() ** -0.5)
    chi = float(np.sqrt(weights @ (values - mean) ** 2 / max(len(values) - 1, 1)))
    return mean, std * max(chi, 1.0)


def of_size(seen: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Weighted mean, and its standard deviation with the spread between recordings."""
    values, stds = np.array(seen).T
    floor = _SCATTER * float(np.max(np.abs(values)))
    weights = 1.0 / (stds**2 + floor**2)
    std = float(np.sqrt(1.0 / weights.sum())) if len(seen) > 1 else float(stds[0])
    return float(weights @ values / weights.sum()), max(std, float(np.ptp(values)) / 2.0)


def contradict(seen: Sequence[tuple[float, float]], mean: float) -> bool:
    """Whether the number cannot be the same in all recordings."""
    values, stds = np.array(seen).T
    spread = float(np.ptp(values))
    certain = spread > thresholds.SIZES_DIFFER_STD * float(np.hypot.reduce(stds))
    return certain and spread > thresholds.SIZES_DIFFER * abs(mean)
