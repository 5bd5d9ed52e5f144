"""A recording prepared for fitting: an even grid, one joint condition, its noise, and checks of its content."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.model.integration import substeps_of
from pam_antagonist.model.parameters import LONGEST_STEP
from pam_antagonist.recording import Recording
from pam_antagonist.recording.faults import SensorFault, faults
from pam_antagonist.recording.rows import between, slow
from pam_antagonist.rig import Rig
from pam_antagonist.shown import unlike

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

CHANNELS = ("angle", "torque", "pressure_1", "pressure_2")
"""Columns of measurements and predictions: [rad, N m, Pa, Pa]."""
ANGLE, TORQUE, PRESSURE_1, PRESSURE_2 = range(len(CHANNELS))
BLOCK_S = 0.02
"""[s] Samples of this time are averaged to one residual: errors of a model are slower, and noise averages out."""

_SHORTEST = 5.0
_LEAST_SWING = 30e3
_LEAST_VOLTAGE_SWING = 0.2
_LARGEST_MISSING_SHARE = 0.2
_NEIGHBOURS = 0.05
"""Least share of neighbouring levels of a converted signal that are one step apart."""
_ON_GRID, _SHARE_ON_GRID = 0.02, 0.98
_LEAST_NOISE = 1e-12
_ROUNDED = 3.0**0.5
"""Half a step of a converter over the standard deviation of its rounding: at rest, all readings may be off by that."""
_SLOW_S = 3e-3
"""[s] With longer sample periods, first differences contain too much motion to show the noise."""


@dataclass(frozen=True, eq=False)
class Split:
    """Fitted and held-out blocks of a recording, if they are not simply its first part and its end."""

    fitted: Mask  # blocks that may be fitted (B,)
    held: Mask  # blocks that are held out (B,)
    errors_from: int


@dataclass(frozen=True, eq=False)
class Trial:
    """One recording on an even grid."""

    name: str
    joint: str  # ``free`` or ``locked``
    lock_angle: float  # angle [rad] at which a locked joint is held
    dt: float  # sample period [s]
    voltage: Floats  # (N, 2) [V]; row k is held over the step that ends at sample k
    measured: Floats  # (N, 4) in the order of ``CHANNELS``; NaN where there is no measurement
    external: Floats | None = None  # torque from outside (N,) [N m], None where nothing was applied
    longest_step: float = LONGEST_STEP  # longest step of the integration [s]

    @cached_property
    def given(self) -> Floats:
        """The model's input (N, 3): voltages [V] and external torque [N m]."""
        outside = np.zeros(len(self)) if self.external is None else np.nan_to_num(self.external)
        return np.column_stack([self.voltage, outside])

    def __len__(self) -> int:
        return len(self.voltage)

    @property
    def time(self) -> Floats:
        """Time of each sample (N,) [s]."""
        return np.asarray(np.arange(len(self)) * self.dt)

    @cached_property
    def block(self) -> int:
        """Samples that are averaged to one residual: as near to ``BLOCK_S`` as whole samples allow."""
        return self.samples(BLOCK_S)

    @cached_property
    def block_s(self) -> float:
        """Length of a block [s]."""
        return self.block * self.dt

    @property
    def substeps(self) -> int:
        """Integration steps a sample."""
        return substeps_of(self.dt, self.longest_step)

    @property
    def step(self) -> float:
        """Integration step [s]."""
        return self.dt / self.substeps

    def block_count(self, seconds: float) -> int:
        """Number of blocks nearest to a time, at least one."""
        return max(1, round(seconds / self.block_s))

    def samples(self, seconds: float) -> int:
        """Number of samples nearest to a time, at least one."""
        return max(1, round(seconds / self.dt))

    def whole_blocks(self, samples: float) -> int:
        """A number of samples rounded down to whole blocks."""
        return int(samples) // self.block * self.block

    def blocks(self, values: Floats) -> Floats:
        """Block means (N // block, C) of columns (N, C); NaN where less than half of a block is known."""
        return blocks(values, self.block)

    def has(self, channel: int) -> bool:
        """Whether a channel was measured and is informative; a locked joint's angle is not."""
        if channel == ANGLE and self.joint == "locked":
            return False
        return bool(np.isfinite(self.measured[:, channel]).any())

    def noise(self, channel: int) -> float:
        """Standard deviation of a block mean due to the channel's sensor."""
        return block_noise(self.measured[:, channel], self.block)

    def noise_growth_at_rest(self, channel: int) -> float:
        """How many times as large the noise of block means may be over a stretch in which the joint rests."""
        values = self.measured[:, channel]
        return _ROUNDED if _is_rounded(_smooth_noise(values), converter_step(values)) else 1.0

    def part(self, begin_s: float, end_s: float) -> Trial:
        """The part between two times [s] of the trial."""
        first, last = round(begin_s / self.dt), round(end_s / self.dt)
        external = None if self.external is None else self.external[first:last]
        return replace(self, voltage=self.voltage[first:last], measured=self.measured[first:last], external=external)


def blocks(values: Floats, size: int) -> Floats:
    """Means over blocks of samples.

    `values`: columns (N, C), NaN where a value is missing. Returns (N // size, C); NaN where less than half of a block
    is known.
    """
    count = len(values) // size
    cut = values[: count * size].reshape(count, size, values.shape[1])
    known = np.isfinite(cut)
    number = known.sum(axis=1)
    total = np.where(known, cut, 0.0).sum(axis=1)
    return np.where(number >= size / 2, total / np.maximum(number, 1), np.nan)


def continued(columns: Floats) -> Floats:
    """Columns (N, C) with the nearest value in a row without one; a column without any stays as it is."""
    out, row = columns.copy(), np.arange(len(columns))
    for column in out.T:
        known = ~np.isnan(column)
        if known.any() and not known.all():
            column[:] = np.interp(row, row[known], column[known])
    return out


def make_trial(recording: Recording, rig: Rig, joint: str, lock_angle: float, name: str) -> Trial:
    """Put a recording on an even grid of its own period; :func:`check` then checks its content. `lock_angle` [rad]."""
    dt, step = recording.even_grid(rig.sample_period)
    keep = np.concatenate(([True], np.diff(step) > 0))
    step = step[keep]
    samples = int(step[-1]) + 1
    measured = np.full((samples, len(CHANNELS)), np.nan)
    again, time = slow(recording), recording.time_s
    for channel, sensor, values in ((ANGLE, "angle", recording.angle), (TORQUE, "torque", recording.torque)):
        if values is not None:
            measured[step, channel] = between(time, values, again.get(sensor))[keep]
    measured[step, PRESSURE_1:] = between(time, recording.pressure, again.get("pressures"))[keep]
    voltage = np.full((samples, 2), np.nan)
    voltage[step] = recording.voltage[keep]
    external = None
    if recording.external_torque is not None:
        external = np.full(samples, np.nan)
        external[step] = recording.external_torque[keep]
    return Trial(name, joint, lock_angle, dt, _held(voltage, name), measured, external)


def _held(voltage: Floats, name: str) -> Floats:
    """Voltages without gaps: a missing value is replaced by the one before it, at the start by the first known one."""
    known = np.isfinite(voltage).all(axis=1)
    if not known.any():
        raise BadInput(f"{name}: valve_state holds no finite voltages")
    source = np.maximum.accumulate(np.where(known, np.arange(len(voltage)), 0))
    source[: int(np.argmax(known))] = int(np.argmax(known))
    return voltage[source]


def check(trial: Trial, drive: str = "valve") -> None:
    """Refuse a trial that is not informative enough for a fit.

    Args:
        trial: the part that is to be fitted.
        drive: ``valve``, or ``regulator`` where the commands are pressures.

    Raises:
        BadInput: too short, too many samples missing, valves that never moved, pressures that never moved, or a
            saturated sensor.
    """
    duration = len(trial) * trial.dt
    if duration < _SHORTEST:
        raise BadInput(
            f"{trial.name}: {unlike(duration, _SHORTEST, 1)} s is too short to identify anything; expected at least "
            f"{_SHORTEST:g} s"
        )
    pressure = trial.measured[:, PRESSURE_1:]
    missing = float(np.mean(~np.isfinite(pressure)))
    if missing > _LARGEST_MISSING_SHARE:
        share = unlike(100 * missing, 100 * _LARGEST_MISSING_SHARE, 0)
        raise BadInput(f"{trial.name}: {share} % of the pressures are missing; expected at most "
                       f"{100 * _LARGEST_MISSING_SHARE:.0f} %")  # fmt: skip
    moved = float(np.ptp(trial.voltage, axis=0).max())
    if drive == "regulator" and moved < _LEAST_SWING:
        raise BadInput(
            f"{trial.name}: the commanded pressures never changed (by {moved / 1e3:.2g} kPa); record steps of both "
            "regulators over their working range"
        )
    if drive == "valve" and moved < _LEAST_VOLTAGE_SWING:
        raise BadInput(
            f"{trial.name}: the valves never moved (by {moved:.2f} V); record steps of both valves over their working "
            "range"
        )
    swing = np.nanpercentile(pressure, 99.5, axis=0) - np.nanpercentile(pressure, 0.5, axis=0)
    for muscle in (0, 1):
        _refuse_saturated(trial, f"pressure_{muscle + 1}", pressure[:, muscle])
        if swing[muscle] < _LEAST_SWING:
            raise BadInput(
                f"{trial.name}: pressure_{muscle + 1} moves by {swing[muscle] / 1e3:.0f} kPa only; expected at least "
                f"{_LEAST_SWING / 1e3:.0f} kPa, so that flow and force can be told from noise"
            )
    if trial.has(TORQUE):
        _refuse_saturated(trial, "measured torque", trial.measured[:, TORQUE])


def _refuse_saturated(trial: Trial, sensor: str, values: Floats) -> None:
    """Refuse a channel whose sensor ends within the signal. `values`: its readings (N,)."""
    for fault in faults(values, trial.dt):
        one = SensorFault(sensor, fault)
        if fault.kind == "end" and not one.is_possible:
            raise BadInput(
                f"{trial.name}: {sensor} reads exactly {one.size} in {100 * fault.rows.mean():.0f} % of the samples: "
                "the sensor is saturated; use one with a larger range, or leave such readings out (--leave-out-faults)"
            )


def white_std(values: Floats, dt: float) -> float:
    """Standard deviation of the noise of a slow signal: that of its differences over √2.

    `values`: readings of the sensor (N,), NaN where missing. `dt`: sample period [s]; if it is long, second differences
    replace the first.
    """
    if dt > _SLOW_S and np.isfinite(values).sum() > 2:
        return _smooth_noise(values)
    step = np.diff(values)
    step = step[np.isfinite(step)]
    return float(np.sqrt(np.mean(step * step) / 2.0)) if step.size else float("nan")


def converter_step(values: Floats) -> float:
    """Step of the converter of a signal; 0 if its values are not on a grid.

    Differences of neighbouring samples of a slow signal are mostly 0. So the noise estimated from them is smaller than
    the error of a reading, which includes the step.

    `values`: readings of the sensor (N,), NaN where missing.
    """
    levels, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    apart = np.diff(levels[counts >= np.quantile(counts, 0.5)]) if len(levels) > 1 else np.zeros(0)
    if not len(apart):
        return 0.0
    # With few samples, many levels of a fine converter are missing, and most neighbours are several steps apart.
    step = float(np.median(apart[apart <= 1.5 * np.quantile(apart, _NEIGHBOURS)]))
    off = np.abs(apart / step - np.rint(apart / step))
    return step if np.mean(off < _ON_GRID) > _SHARE_ON_GRID else 0.0


def block_noise(values: Floats, size: int) -> float:
    """Standard deviation of the mean of a block of samples, due to the sensor.

    If a signal is smooth over three samples, its second difference is noise with six times the variance. The largest
    twentieth of the differences is left out, because jumps of the joint are not noise. If the step of a converter is
    larger than the noise, all samples of a block are rounded to the same value, and this error does not average out.

    `values`: readings of the sensor (N,), NaN where missing.
    """
    white, step = _smooth_noise(values), converter_step(values)
    averaged = white / np.sqrt(size)
    both = np.hypot(step / np.sqrt(12.0), averaged) if _is_rounded(white, step) else averaged
    return float(max(both, _LEAST_NOISE))


def _is_rounded(white: float, step: float) -> bool:
    """Whether a converter rounds all samples of a block to one value: its step exceeds the noise."""
    return white < step / 2.0


def _smooth_noise(values: Floats) -> float:
    """Standard deviation of a sample's noise, if the signal is smooth over three samples."""
    second = np.diff(values[np.isfinite(values)], 2)
    bound = 2.0 * float(np.quantile(np.abs(second), 0.95))
    return float(np.sqrt(np.mean(second[np.abs(second) <= bound] ** 2) / 6.0))
