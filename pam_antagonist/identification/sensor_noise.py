"""The sensors' noise and their converters' steps, from what was measured alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, Trial
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_MOST_LEVELS = 0.3
"""Distinct values a sample of a converted signal: a signal without steps has nearly as many as samples."""
_ON_GRID, _SHARE_ON_GRID = 0.02, 0.98


def white_std(values: Floats) -> float:
    """Standard deviation of the noise of a slow signal: that of its differences over √2.

    Args:
        values: (N,), NaN where missing.
    """
    step = np.diff(values)
    step = step[np.isfinite(step)]
    return float(np.sqrt(np.mean(step * step) / 2.0)) if step.size else float("nan")


def converter_step(values: Floats) -> float:
    """Step of the converter behind a signal; 0 where its values lie on no grid.

    A slow signal shows little of its converter in the differences of neighbours, which are mostly none, so that its
    noise looks smaller than the error of a reading is.

    Args:
        values: (N,), NaN where missing.
    """
    known = values[np.isfinite(values)]
    levels = np.unique(known)
    if len(levels) < 2 or len(levels) > _MOST_LEVELS * len(known):
        return 0.0
    step = float(np.median(np.diff(levels)))
    off = np.abs(np.diff(levels) / step - np.rint(np.diff(levels) / step))
    return step if np.mean(off < _ON_GRID) > _SHARE_ON_GRID else 0.0


def with_noise(rig: Rig, trials: Sequence[Trial]) -> Rig:
    """The rig with the sensors' noise and R of the tuning ``default`` as the recordings show them."""

    def of(channel: int) -> float:
        stds = [white_std(trial.measured[:, channel]) for trial in trials if trial.has(channel)]
        known = [std for std in stds if math.isfinite(std)]
        return float(np.sqrt(np.mean(np.square(known)))) if known else float("nan")

    def less_step(std: float, step: float) -> float:
        return float(np.sqrt(max(std**2 - step**2 / 12.0, 0.0)))

    sensors = rig.sensors
    pressure = [max(of(PRESSURE_1 + i), sensors.pressure_step / np.sqrt(12.0), 10.0) for i in (0, 1)]
    changes = {"pressure_std": max(less_step(float(np.hypot(*pressure)) / np.sqrt(2.0), sensors.pressure_step), 10.0)}
    for channel, name in ((ANGLE, "angle"), (TORQUE, "torque")):
        std = of(channel)
        if math.isfinite(std):
            seen = [converter_step(trial.measured[:, channel]) for trial in trials if trial.has(channel)]
            step = max(*seen, getattr(sensors, f"{name}_step"))
            changes |= {f"{name}_std": less_step(std, step), f"{name}_step": step}
    tuning = rig.tuning("default").replaced(measurement=tuple(float(std**2) for std in pressure), consider=True)
    return rig.replaced(sensors=sensors.replaced(**changes), tunings={**rig.tunings, "default": tuning}, directions={})
