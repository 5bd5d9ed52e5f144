"""What the model says about a trial, and how that moves with the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.identification.freedom import FreeParameter
from pam_antagonist.identification.trial import ANGLE, CHANNELS, PRESSURE_1, Trial
from pam_antagonist.model import dynamics
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

BLOCK = 20
"""Samples that are averaged to one residual: errors of a simulation are slow, and noise averages out."""
_START_SAMPLES = 20
_STEP = 0.02
"""Step of the central differences in standard deviations of the prior."""
_START_ANGLE_STD = 1.7e-3
"""[rad] How well a measured start angle is known, stiction and encoder step together."""


def simulate(trial: Trial, p: Floats, start: Floats) -> Floats:
    """Predict all channels of a trial by the model alone.

    Args:
        trial: its voltages are used.
        p: parameter vector.
        start: angle [rad] and pressures [Pa] at the first sample (3,).

    Returns:
        (N, 4) in the order of ``CHANNELS``.
    """
    x0 = np.array([start[0], 0.0, start[1], start[2]])
    states, torque, _ = dynamics.simulate(x0, trial.voltage, p, trial.dt, 1)
    return np.column_stack([states[:, 0], torque, states[:, 2], states[:, 3]])


def first_state(trial: Trial, p: Floats) -> Floats:
    """Angle [rad] and pressures [Pa] (3,) at the start, from the first samples."""
    first = trial.measured[:_START_SAMPLES]
    pressure = np.nanmean(first[:, PRESSURE_1:], axis=0)
    if trial.joint == "locked":
        angle = trial.lock_angle
    elif np.isfinite(first[:, ANGLE]).any():
        angle = float(np.nanmean(first[:, ANGLE]))
    else:
        angle = float(dynamics.rest_angle(pressure[0], pressure[1], p))
    return np.array([angle, *pressure])


def blocks(values: Floats, size: int = BLOCK) -> Floats:
    """Means over blocks of samples, (N // size, C); NaN where a block has less than half of its samples."""
    count = len(values) // size
    cut = values[: count * size].reshape(count, size, values.shape[1])
    known = np.isfinite(cut)
    total = np.where(known, cut, 0.0).sum(axis=1)
    number = known.sum(axis=1)
    return np.where(number >= size / 2, total / np.maximum(number, 1), np.nan)


@dataclass(frozen=True, eq=False)
class Problem:
    """A fit: trials, free parameters, and the channels that count.

    The vector that is fitted is in units of the prior: first the free parameters, then for each trial the
    deviations of its start from the measured one (pressures, and the angle of a free joint).

    Attributes:
        rig: start values.
        trials: recordings.
        free: parameters that may move.
        channels: indices of ``CHANNELS`` that are compared.
        jobs: threads for the Jacobian.
    """

    rig: Rig
    trials: Sequence[Trial]
    free: Sequence[FreeParameter]
    channels: Sequence[int] = tuple(range(len(CHANNELS)))
    jobs: int = 1

    @property
    def size(self) -> int:
        """Length of the fitted vector."""
        return len(self.free) + 3 * len(self.trials)

    def values(self, theta: Floats) -> dict[str, float]:
        """Parameter values at a fitted vector."""
        return {item.name: item.start + item.prior_std * float(t) for item, t in zip(self.free, theta, strict=False)}

    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest fitted vector."""
        low = [(item.low - item.start) / item.prior_std for item in self.free]
        high = [(item.high - item.start) / item.prior_std for item in self.free]
        rest = [8.0] * (3 * len(self.trials))
        return np.array(low + [-value for value in rest]), np.array(high + rest)

    def predict(self, theta: Floats, index: int) -> Floats:
        """Prediction of one trial (N, 4) at a fitted vector."""
        trial = self.trials[index]
        p = par.changed(self.rig.parameters(trial.joint, trial.lock_angle), self.values(theta))
        offset = len(self.free) + 3 * index
        pressure_std = self.rig.sensors.pressure_std / np.sqrt(_START_SAMPLES)
        scale = np.array([0.0 if trial.joint == "locked" else _START_ANGLE_STD, pressure_std, pressure_std])
        return simulate(trial, p, first_state(trial, p) + scale * theta[offset : offset + 3])

    def counted(self, trial: Trial) -> list[int]:
        """Channels of a trial that are compared."""
        return [channel for channel in self.channels if trial.has(channel)]

    def residuals(self, theta: Floats) -> list[Floats]:
        """Prediction minus measurement in blocks, one array (B, counted channels) a trial."""
        result = []
        for index, trial in enumerate(self.trials):
            counted = self.counted(trial)
            result.append(blocks(self.predict(theta, index)[:, counted] - trial.measured[:, counted]))
        return result

    def jacobian(self, theta: Floats) -> list[Floats]:
        """Derivatives of :meth:`residuals`, one array (B, counted channels, size) a trial."""

        def column(k: int) -> list[Floats]:
            up, down = theta.copy(), theta.copy()
            up[k] += _STEP
            down[k] -= _STEP
            trial = (k - len(self.free)) // 3 if k >= len(self.free) else None
            parts = []
            for index, item in enumerate(self.trials):
                counted = self.counted(item)
                if trial is not None and trial != index:
                    parts.append(np.zeros((len(item) // BLOCK, len(counted))))
                    continue
                difference = self.predict(up, index)[:, counted] - self.predict(down, index)[:, counted]
                parts.append(blocks(difference) / (2.0 * _STEP))
            return parts

        # The compiled simulation runs without the interpreter's lock: threads do.
        columns = Parallel(n_jobs=self.jobs, prefer="threads")(delayed(column)(k) for k in range(self.size))
        return [np.stack([part[index] for part in columns], axis=2) for index in range(len(self.trials))]


def stacked(parts: Sequence[Floats], weights: Sequence[Floats]) -> Floats:
    """Residuals (B, C) or Jacobians (B, C, K) of all trials as one array (R,) or (R, K).

    Args:
        parts: one array a trial.
        weights: for each trial the standard deviation of its channels (C,), by which they are divided.

    Returns:
        All rows, one after the other; what is missing (NaN) counts as 0.
    """
    rows = []
    for part, weight in zip(parts, weights, strict=True):
        scaled = np.nan_to_num(part / weight.reshape(-1, *[1] * (part.ndim - 2)))
        rows.append(scaled.reshape(-1, *part.shape[2:]))
    return np.concatenate(rows)
