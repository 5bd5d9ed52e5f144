"""What the model says about a trial, and how that moves with the parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.identification.slopes import STEP, step_directions
from pam_antagonist.inference.free_parameters import FreeParameter
from pam_antagonist.inference.trial import ANGLE, CHANNELS, PRESSURE_1, Trial
from pam_antagonist.model import dynamics, rest, sensor
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

BLOCK = 20
"""Samples that are averaged to one residual: errors of a simulation are slow, and noise averages out."""
STARTS = 3
"""Values of a trial's start that are fitted with the parameters: angle and both pressures."""
_START_SAMPLES = 20
_START_ANGLE_STD = 1.7e-3
"""[rad] How well a measured start angle is known, stiction and encoder step together."""


def simulate(trial: Trial, p: Floats, start: Floats) -> Floats:
    """Predict all channels of a trial by the model alone.

    Args:
        trial: its voltages are used, and its external torque.
        p: parameter vector.
        start: angle [rad] and pressure readings [Pa] at the first sample (3,).

    Returns:
        (N, 4) in the order of ``CHANNELS``.
    """
    behind = [sensor.pressure_behind(i, start[1 + i], p) for i in (0, 1)]
    x0 = rest.initial_state(start[0], behind[0], behind[1], trial.given[0], p)
    states, torque = dynamics.course(x0, trial.given, p, trial.dt, 1)
    shown = [sensor.reading(i, states[:, 2 + i], p) for i in (0, 1)]
    return np.column_stack([states[:, 0], torque, *shown])


def first_state(trial: Trial, p: Floats) -> Floats:
    """Angle [rad] and pressure readings [Pa] (3,) at the start, from the first samples."""
    first = trial.measured[:_START_SAMPLES]
    pressure = np.nanmean(first[:, PRESSURE_1:], axis=0)
    if trial.joint == "locked":
        angle = trial.lock_angle
    elif np.isfinite(first[:, ANGLE]).any():
        angle = float(np.nanmean(first[:, ANGLE]))
    else:
        angle = float(rest.rest_angle(pressure[0], pressure[1], p))
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

    The vector that is fitted holds standard normal values: the free parameters in units of their priors, then for each
    trial its deviations from them (:mod:`pam_antagonist.identification.between`) and those of its start from the
    measured one (pressures, and the angle of a free joint).

    Attributes:
        rig: start values.
        trials: recordings.
        free: parameters that may move.
        channels: indices of ``CHANNELS`` that are compared.
        jobs: threads for the Jacobian.
        between: what a trial's deviations of 1 do to the free parameters (F, G), in units of their priors; without
            columns, all trials share all parameters.
    """

    rig: Rig
    trials: Sequence[Trial]
    free: Sequence[FreeParameter]
    channels: Sequence[int] = tuple(range(len(CHANNELS)))
    jobs: int = 1
    between: Floats | None = None

    @property
    def size(self) -> int:
        """Length of the fitted vector."""
        return len(self.free) + len(self.trials) * self._own

    @property
    def _own(self) -> int:
        """Values that each trial has for itself."""
        return STARTS + (0 if self.between is None else self.between.shape[1])

    @cached_property
    def _parameters(self) -> list[Floats]:
        return [self.rig.parameters(trial.joint, trial.lock_angle) for trial in self.trials]

    @cached_property
    def _steps(self) -> Floats:
        return step_directions(self.rig, self.free)

    def with_between(self, between: Floats | None) -> Problem:
        """The same with other deviations of the trials."""
        return dataclasses.replace(self, between=between)

    def map(self, index: int) -> Floats:
        """What of the fitted vector a trial sees: (F + 3, size), its own parameters and its start."""
        count = len(self.free)
        out = np.zeros((count + STARTS, self.size))
        out[:count, :count] = np.eye(count)
        first = count + index * self._own
        if self.between is not None:
            out[:count, first : first + self.between.shape[1]] = self.between
        last = first + self._own
        out[count:, last - STARTS : last] = np.eye(STARTS)
        return out

    def values(self, theta: Floats) -> dict[str, float]:
        """Parameter values at a fitted vector, or at what a trial sees of it."""
        return {item.name: item.start + item.prior_std * float(t) for item, t in zip(self.free, theta, strict=False)}

    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest fitted vector."""
        low = [(item.low - item.start) / item.prior_std for item in self.free]
        high = [(item.high - item.start) / item.prior_std for item in self.free]
        rest = [8.0] * (self.size - len(self.free))
        return np.array(low + [-value for value in rest]), np.array(high + rest)

    def predict_local(self, local: Floats, index: int) -> Floats:
        """Prediction of one trial (N, 4) at what it sees of a fitted vector (F + 3,)."""
        trial = self.trials[index]
        p = par.changed(self._parameters[index], self.values(local))
        pressure_std = self.rig.sensors.pressure_std / np.sqrt(_START_SAMPLES)
        scale = np.array([0.0 if trial.joint == "locked" else _START_ANGLE_STD, pressure_std, pressure_std])
        return simulate(trial, p, first_state(trial, p) + scale * local[len(self.free) :])

    def predict(self, theta: Floats, index: int) -> Floats:
        """Prediction of one trial (N, 4) at a fitted vector."""
        return self.predict_local(self.map(index) @ theta, index)

    def counted(self, trial: Trial) -> list[int]:
        """Channels of a trial that are compared."""
        return [channel for channel in self.channels if trial.has(channel)]

    def residuals(self, theta: Floats) -> list[Floats]:
        """Prediction minus measurement in blocks, one array (B, counted channels) a trial."""
        predicted = Parallel(n_jobs=self.jobs, prefer="threads")(
            delayed(self.predict)(theta, index) for index in range(len(self.trials))
        )
        return [
            blocks((values - trial.measured)[:, self.counted(trial)])
            for trial, values in zip(self.trials, predicted, strict=True)
        ]

    def local_jacobians(self, theta: Floats) -> list[Floats]:
        """Derivatives of :meth:`residuals` by what each trial sees, one array (B, counted channels, F + 3) a trial."""
        seen = [self.map(index) @ theta for index in range(len(self.trials))]

        width = len(self.free) + STARTS
        steps = STEP * np.eye(width)
        steps[: len(self.free), : len(self.free)] = self._steps
        back = np.linalg.inv(steps)

        def column(index: int, k: int) -> Floats:
            counted = self.counted(self.trials[index])
            up, down = (self.predict_local(seen[index] + sign * steps[:, k], index) for sign in (1.0, -1.0))
            return blocks((up - down)[:, counted]) / 2.0

        # The compiled simulation runs without the interpreter's lock: threads do.
        tasks = [(index, k) for index in range(len(self.trials)) for k in range(width)]
        columns = Parallel(n_jobs=self.jobs, prefer="threads")(delayed(column)(*task) for task in tasks)
        return [
            np.stack(columns[index * width : (index + 1) * width], axis=2) @ back for index in range(len(self.trials))
        ]

    def jacobian(self, theta: Floats) -> list[Floats]:
        """Derivatives of :meth:`residuals`, one array (B, counted channels, size) a trial."""
        return [part @ self.map(index) for index, part in enumerate(self.local_jacobians(theta))]


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
