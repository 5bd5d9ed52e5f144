"""What a model says about a recording, effects and sensors included."""

from __future__ import annotations

from dataclasses import dataclass

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


def blocks(values: Floats, size: int = BLOCK) -> Floats:
    """Means over blocks of samples, (N // size, C); NaN where less than half of a block is known."""
    count = len(values) // size
    cut = values[: count * size].reshape(count, size, values.shape[1])
    known = np.isfinite(cut)
    number = known.sum(axis=1)
    total = np.where(known, cut, 0.0).sum(axis=1)
    return np.where(number >= size / 2, total / np.maximum(number, 1), np.nan)
