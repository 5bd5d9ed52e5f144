"""A valve-driven joint that sticks, as an experiment: its angle is predicted over short spans.

When a joint that sticks breaks loose, and where it stops, follows from small torques. Within seconds a model that is
right goes another way than the joint. So the prediction starts anew every half second from the angle and velocity that
were measured (multiple shooting, Bock and Plitt 1984). The air is not measured anew: it runs on from the first sample,
and is compressed by what a start moves the angle.

A joint that breaks loose 20 ms late is wrong for 20 ms, by as much as it jumps. Such errors have heavy tails. They
count by their logarithm, r → s asinh(r/s) with the noise s: a block is right or wrong, and how wrong it is tells
little.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pam_antagonist._jit import kernel
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.likelihood import Scale
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, Trial
from pam_antagonist.inference.valve_driven import ValveDriven, initial_state
from pam_antagonist.model import dynamics, muscle, sensor
from pam_antagonist.model import parameters as par

Floats = NDArray[np.float64]

RUN_S = 0.5
"""[s] Long enough that a joint which should stick creeps away, short enough that one late break-away is forgotten."""
_NEAR_S = 0.02
"""[s] To either side of a start, from which its angle and velocity are told by a straight line."""
_EARLIER = 4
"""A start may be a quarter of a span earlier or later, where the angle is the straightest: not within a jump."""
_STILL_S = 0.2
"""[s] A joint that stands still for so long while its torque moves is held by friction."""
_STILL, _MOVES = 4.0, 5.0
"""Noises: the angle's range of one that stands still, and what its torque moves at least."""
_STICKS = 0.02
"""Share of a recording from which on a joint is taken to stick: a second of a minute. Joints of the battery with the
paper's friction have 0.04 to 0.25."""
_RIGHT = 3.0
"""Noises."""
_PROBE = 1e3
"""[Pa] Of the differences by which the pressures' noise becomes one of the torque."""
_model_course, _torque, _volume = dynamics.course, dynamics.torque, muscle.volume
_length, _leverage = muscle.length, muscle.leverage
_VOLUME_INDEX = par.POLYTROPIC_VOLUME


@kernel
def _course(x0, voltage, p, dt, substeps, begins, angle, velocity):  # type: ignore[no-untyped-def]
    """As :func:`~pam_antagonist.model.dynamics.course`, with measured angle [rad] and velocity [rad/s] at the starts.

    What a start moves the angle compresses the air by equation (4) without flow: P V^k_2 stays.
    """
    samples = voltage.shape[0]
    states = np.empty((samples, x0.shape[0]))
    torques = np.empty(samples)
    x = x0.copy()
    first = 0
    while first < samples:
        if begins[first]:
            before, _, _ = _leverage(x[0], p)
            after, _, _ = _leverage(angle[first], p)
            for i in range(2):
                old, _ = _volume(i, _length(i, before, p), p)
                new, _ = _volume(i, _length(i, after, p), p)
                x[2 + i] *= (old / new) ** p[_VOLUME_INDEX]
            x[0] = angle[first]
            x[1] = velocity[first]
        end = first + 1
        while end < samples and not begins[end]:
            end += 1
        # With one sample more: the next span goes on from there.
        run, torque = _model_course(x, voltage[first : end + 1], p, dt, substeps)
        states[first:end], torques[first:end] = run[: end - first], torque[: end - first]
        x = run[-1]
        first = end
    return states, torques


@dataclass(frozen=True, eq=False)
class ShortRuns(ValveDriven):
    """A recording of a joint that sticks, predicted over spans."""

    @cached_property
    def noise(self) -> Floats:
        """Standard deviation of a block mean by the sensors alone (C,).

        The angle cannot be predicted better than the torque follows from the pressures: the pressures' noise moves it
        by what the joint's stiffness makes of it.
        """
        noise = ValveDriven.noise.func(self).copy()  # type: ignore[attr-defined]
        column = self.channels.index(ANGLE)
        x = _middle(self.trial, self.vector)
        stiffness = max(abs(dynamics.torque_slope(x, self.vector)), abs(self.vector[par.STIFFNESS]))
        noise[column] = np.hypot(noise[column], torque_noise(self.trial, self.vector) / stiffness)
        return np.asarray(noise)

    @property
    def free_run(self) -> Experiment:
        """The recording with a model that runs by itself from the first sample on."""
        judged = tuple(other.free_run for other in self.judged)
        return ValveDriven(**{**_fields(self), "judged": judged})

    def scale(self, residual: Floats | None = None, blocks_per_error: float | None = None) -> Scale:
        """How residuals are judged. Nothing lasts longer than one independent error, since every span starts anew.

        Args:
            residual: whose memory counts (B, C); default: of none.
            blocks_per_error: blocks per value that a fit counts; default: those of a model that lacks something.
        """
        usual = super().scale(residual, blocks_per_error)
        return replace(usual, length=np.minimum(usual.length, self.blocks_per_error))

    def residual_of(self, simulated: Floats) -> Floats:
        """Measured minus simulated block means (B, C), large ones by their logarithm; 0 where nothing was measured.

        Args:
            simulated: the latter (B, C).
        """
        return np.asarray(self.noise * np.arcsinh(super().residual_of(simulated) / self.noise))

    def right(self, point: Point) -> float:
        """Share of the held-out time in which a model shows the angle, to within three noises."""
        column = self.channels.index(ANGLE)
        left = self.held(self.residual(point, whole=True))[:, column]
        return float(np.mean(np.abs(left) <= np.arcsinh(_RIGHT) * self.noise[column])) if len(left) else float("nan")

    def states(self, point: Point) -> tuple[Floats, Floats]:
        """States (N, n) and torques (N,) [N m] of the model over all of the recording, span by span."""
        return self._course(self.trial, point)

    def _shown(self, trial: Trial, point: Point) -> Floats:
        """What the sensors would show (N, 4), in the steps of a trial."""
        states, torque = self._course(trial, point)
        p = self.parameters(point)
        return np.column_stack([states[:, 0], torque, sensor.readings(states[:, 2:4], p)])

    def _course(self, trial: Trial, point: Point) -> tuple[Floats, Floats]:
        p = self.parameters(point)
        p[par.FRICTION_STEP] = trial.step
        x0 = initial_state(trial, p, self.first, self.start_shift(point))
        stride = round(trial.dt / self.trial.dt)
        starts = (column[::stride][: len(trial)].copy() for column in self._starts)
        states, torque = _course(x0, trial.given, p, trial.dt, trial.substeps, *starts)
        return states, torque

    @cached_property
    def _starts(self) -> tuple[NDArray[np.bool_], Floats, Floats]:
        """Whether a span begins at a sample, the angle [rad] and the velocity [rad/s] there (N,) each."""
        trial = self.trial
        angle, velocity, rough = _lines(_known(trial.measured[:, ANGLE]), trial.samples(_NEAR_S), trial.dt)
        rough = rough[:: trial.block][: len(trial) // trial.block]
        every = max(round(RUN_S / trial.block_s), 2)
        near = every // _EARLIER
        begins = np.zeros(len(trial), dtype=np.bool_)
        for middle in range(every, len(rough), every):
            first = middle - near
            begins[(first + int(np.argmin(rough[first : middle + near + 1]))) * trial.block] = True
        return begins, angle, velocity


def in_short_runs(experiment: Experiment) -> Experiment:
    """A recording predicted over spans where its joint sticks; else as it is."""
    if not isinstance(experiment, ValveDriven) or sticking_share(experiment) < _STICKS:
        return experiment
    judged = tuple(in_short_runs(other) for other in experiment.judged)
    return ShortRuns(**{**_fields(experiment), "judged": judged})


def _fields(experiment: Experiment) -> dict[str, Any]:
    return {one.name: getattr(experiment, one.name) for one in fields(experiment)}


def sticking_share(experiment: ValveDriven) -> float:
    """Share of a recording in which the joint stands still while the torque of its pressures moves; 0 if unknown."""
    trial, p = experiment.trial, experiment.vector
    if ANGLE not in experiment.channels:
        return 0.0
    shown = trial.blocks(trial.measured)
    known = shown[np.isfinite(shown[:, [ANGLE, PRESSURE_1, PRESSURE_1 + 1]]).all(axis=1)]
    window = max(round(_STILL_S / trial.block_s), 2)
    if len(known) <= window:
        return 0.0
    angle = known[:, ANGLE]
    torque = np.array(
        [_torque(np.array([a, 0.0, *pressure]), p) for a, pressure in zip(angle, known[:, PRESSURE_1:], strict=True)]
    )
    still = np.ptp(sliding_window_view(angle, window), axis=1) <= _STILL * trial.noise(ANGLE)
    moves = np.abs(torque[window - 1 :] - torque[: len(torque) - window + 1]) >= _MOVES * torque_noise(trial, p)
    return float(np.mean(still & moves))


def torque_noise(trial: Trial, p: Floats) -> float:
    """Standard deviation [N m] that the noise of the pressures' block means gives to the torque that follows from them.

    Args:
        trial: the recording.
        p: parameter vector (P,).
    """
    x = _middle(trial, p)
    moved = []
    for i in (0, 1):
        other = x.copy()
        other[2 + i] += _PROBE
        moved.append((_torque(other, p) - _torque(x, p)) / _PROBE * trial.noise(PRESSURE_1 + i))
    return float(np.hypot(*moved))


def _middle(trial: Trial, p: Floats) -> Floats:
    """A state in the middle of what was recorded."""
    x = np.zeros(int(p[par.STATES]))
    x[ANGLE] = np.nanmean(trial.measured[:, ANGLE])
    x[2:4] = np.nanmean(trial.measured[:, PRESSURE_1:], axis=0)
    return x


def _known(series: Floats) -> Floats:
    """A series (N,) with what is missing interpolated."""
    known = np.isfinite(series)
    return np.interp(np.arange(len(series)), np.flatnonzero(known), series[known])


def _lines(series: Floats, half: int, dt: float) -> tuple[Floats, Floats, Floats]:
    """Straight lines through a series: value and slope in the middle of each, and what it leaves (N,).

    Args:
        series: (N,).
        half: samples to either side.
        dt: between samples [s].
    """
    half = max(half, 2)
    time = np.arange(-half, half + 1) * dt
    padded = sliding_window_view(np.pad(series - series.mean(), half, mode="edge"), 2 * half + 1)
    value = padded.mean(axis=1)
    slope = padded @ (time / np.sum(time**2))
    left = np.einsum("nk,nk->n", padded, padded) / len(time) - value**2 - slope**2 * np.mean(time**2)
    return value + series.mean(), slope, np.maximum(left, 0.0)
