"""What a model says about a recording, effects and sensors included."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.trial import ANGLE, PRESSURE_1, Trial
from pam_antagonist.model import dynamics, rest, sensor

Floats = NDArray[np.float64]

BLOCK = 20
"""Samples that are averaged to one residual: what a model lacks is slower than this, and noise averages out."""
_START_SAMPLES = 20


@dataclass(frozen=True)
class Start:
    """What the sensors showed at the start of a recording: angle [rad], None where it was not measured, and
    pressures (2,) [Pa]."""

    angle: float | None
    pressure: Floats


def start_of(trial: Trial) -> Start:
    """Means over the first samples of a recording."""
    first = trial.measured[:_START_SAMPLES]
    pressure = np.nanmean(first[:, PRESSURE_1:], axis=0)
    if trial.joint == "locked":
        return Start(trial.lock_angle, pressure)
    known = first[np.isfinite(first[:, ANGLE]), ANGLE]
    return Start(float(known.mean()) if known.size else None, pressure)


def predict(trial: Trial, p: Floats, start: Start, shift: Floats | None = None) -> Floats:
    """The model alone, from the start of a recording on.

    Args:
        trial: its voltages are used.
        p: parameter vector.
        start: what the sensors showed first; the added states start settled.
        shift: deviation of the true start from that (3,) [rad, Pa, Pa].

    Returns:
        What the sensors would show (N, 4), in the order of ``trial.CHANNELS``.
    """
    states, torque = run(trial, p, start, shift)
    return np.column_stack([states[:, 0], torque, *(sensor.reading(i, states[:, 2 + i], p) for i in (0, 1))])


def run(trial: Trial, p: Floats, start: Start, shift: Floats | None = None) -> tuple[Floats, Floats]:
    """States (N, n) and torques (N,) [N m] of the same."""
    moved = np.zeros(3) if shift is None else shift
    pressures = [sensor.pressure_behind(i, start.pressure[i] + moved[1 + i], p) for i in (0, 1)]
    angle = rest.rest_angle(pressures[0], pressures[1], p) if start.angle is None else start.angle + moved[0]
    given = trial.voltage if trial.external is None else trial.given
    x0 = rest.initial_state(angle, pressures[0], pressures[1], given[0], p)
    states, torque = dynamics.course(x0, given, p, trial.dt, 1)
    return states, torque


def strides(trial: Trial, stride: int) -> Trial:
    """A recording as a model in longer steps sees it: every so many-th sample, and the means of the inputs between.

    Args:
        trial: the recording.
        stride: samples a step.
    """
    steps = (len(trial) - 1) // stride

    def means(values: Floats) -> Floats:
        # Row k holds over the step that ends at sample k.
        cut = values[1 : 1 + steps * stride]
        return np.concatenate([values[:1], np.add.reduceat(cut, np.arange(0, len(cut), stride)) / stride])

    external = None if trial.external is None else means(np.nan_to_num(trial.external))
    measured = trial.measured[: 1 + steps * stride : stride]
    return replace(trial, dt=stride * trial.dt, voltage=means(trial.voltage), measured=measured, external=external)


def stride_blocks(values: Floats, stride: int, count: int) -> Floats:
    """What :func:`blocks` gives of the samples between as well, (count, C).

    Args:
        values: every stride-th sample (N, C).
        stride: samples from one to the next, a divisor of a block's.
        count: how many blocks.
    """
    steps = BLOCK // stride
    missing = max(count * steps + 1 - len(values), 0)
    values = np.concatenate([values, np.repeat(values[-1:], missing, axis=0)])
    means = np.add.reduceat(values[: count * steps], np.arange(0, count * steps, steps)) / steps
    ends = values[: count * steps + 1 : steps]
    # A block's samples lie half a sample before the middle of its ends, the means half a stride.
    return np.asarray(means + (0.5 - 0.5 / stride) / steps * np.diff(ends, axis=0))


def blocks(values: Floats, size: int = BLOCK) -> Floats:
    """Means over blocks of samples, (N // size, C); NaN where less than half of a block is known."""
    count = len(values) // size
    cut = values[: count * size].reshape(count, size, values.shape[1])
    known = np.isfinite(cut)
    number = known.sum(axis=1)
    total = np.where(known, cut, 0.0).sum(axis=1)
    return np.where(number >= size / 2, total / np.maximum(number, 1), np.nan)
