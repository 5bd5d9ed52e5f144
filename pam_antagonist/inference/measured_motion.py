"""A valve-driven joint along its measured motion, as an experiment: what its torques lack to be in balance.

When a joint that sticks breaks loose, and where it stops, follows from small torques. A model that is right goes
another way than the joint within seconds. So this model is given the measured angle beside the voltages, as in
equation-error identification. Its air runs by itself from the voltages in volumes that are known, and its torques are
summed up along the motion: equation (8) solved for what is left of them. Nothing of an error goes on to the next
motion.

Where the joint slides, friction has its full level against the motion, and what is left is an error of the model. Where
it stands still or creeps, friction is anything up to that level: only what is beyond it counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import chdtri
from typing_extensions import override

from pam_antagonist._jit import kernel
from pam_antagonist.inference.angle_driven import Motion, filled_in
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_run import initial_state
from pam_antagonist.inference.point import Channel, Point
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, Trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.model import dynamics, integration, sensor
from pam_antagonist.model import parameters as par

Floats = NDArray[np.float64]

_HALF_S = 0.02
"""[s] To either side of a sample: from there its angle, velocity and acceleration are told by a parabola."""
_CLEAR = 4.0
"""Standard deviations of its noise from which on a velocity shows its direction, where it lasts as long as that."""
_ROUGH = 1e-3
"""Chance with which noise alone looks like a motion that no parabola follows: of a joint that breaks loose or stops."""
_FEWEST = 10.0
"""A second counts as if the joint slid for this part of it at least."""
_RIGHT = 3.0
"""Noises."""
_NEAR_STOP = 0.01
"""[rad] From the mechanical stop, whose torque nobody measures."""
_STILL_S = 0.2
"""[s] A joint that stands still for so long while its torque moves is held by friction."""
_STILL, _MOVES = 4.0, 5.0
"""Noises: the angle's range of one that stands still, and what its torque moves at least."""
_STICKS = 0.02
"""Share of a recording from which on a joint is taken to stick: a second of a minute. Joints of the battery with the
paper's friction have 0.04 to 0.25."""
_PROBE = 1e3
"""[Pa] Of the differences by which the pressures' noise becomes one of the torque."""
_STAGES = integration.STAGES
_step, _needed, _torque = integration.rk4_step_within, dynamics.torque_needed, dynamics.torque


@kernel
def _along(x0, voltage, angle, velocity, acceleration, direction, p, dt, substeps):  # type: ignore[no-untyped-def]
    """States (N, n), torques of the muscles (N,) and what the torques lack to be in balance (N,) [N m]."""
    samples = voltage.shape[0]
    states = np.empty((samples, x0.shape[0]))
    torques, lacking = np.empty(samples), np.empty(samples)
    x = x0.copy()
    u = np.zeros(voltage.shape[1])
    scratch = np.empty((_STAGES + 1, x.shape[0]))
    for k in range(samples):
        if k > 0:
            for i in range(voltage.shape[1]):
                u[i] = voltage[k, i]
            moved = angle[k] - angle[k - 1]
            x[1] = moved / dt
            for j in range(substeps):
                # Held over a step at its middle, of second order.
                x[0] = angle[k - 1] + (j + 0.5) / substeps * moved
                _step(x, u, p, dt / substeps, x, scratch)
        x[0], x[1] = angle[k], velocity[k]
        torques[k] = _torque(x, p)
        if direction[k] != 0.0:
            lacking[k] = _needed(x, acceleration[k], direction[k], p)
        else:
            without = _needed(x, acceleration[k], 0.0, p)
            level = max(_needed(x, acceleration[k], 1.0, p) - without, 0.0)
            lacking[k] = without - min(max(without, -level), level)
        for i in range(x.shape[0]):
            states[k, i] = x[i]
    return states, torques, lacking


@dataclass(frozen=True, eq=False)
class ShownMotion(Motion):
    """The motion that an encoder shows; its direction is −1 or 1, and 0 where it is within the noise.

    Attributes:
        clear: where a parabola follows it (N,).
        noise: standard deviations (3,) of angle [rad], velocity [rad/s] and acceleration [rad/s²].
    """

    clear: NDArray[np.bool_]
    noise: Floats


def motion_of(trial: Trial) -> ShownMotion:
    """The motion that the encoder of a recording shows."""
    series = trial.measured[:, ANGLE]
    known = np.isfinite(series)
    filled = filled_in(series)
    half = max(trial.samples(_HALF_S), 2)
    time = np.arange(-half, half + 1) * trial.dt
    basis = np.column_stack([np.ones_like(time), time, 0.5 * time**2])
    weights = np.linalg.pinv(basis)
    windows = sliding_window_view(np.pad(filled - filled.mean(), half, mode="edge"), 2 * half + 1)
    told = windows @ weights.T
    noise = trial.noise(ANGLE) * np.sqrt(trial.block)
    left = np.einsum("nk,nk->n", windows, windows) - np.einsum("ni,ij,nj->n", told, basis.T @ basis, told)
    rough = left > noise**2 * float(chdtri(len(time) - 3, _ROUGH))
    rough[:half] = rough[len(rough) - half :] = True
    unclear = np.convolve(rough | ~known, np.ones(half + 1), mode="same") > 0.0
    std = noise * np.sqrt(np.sum(weights**2, axis=1))
    velocity = told[:, 1]
    direction = _lasting(np.where(np.abs(velocity) > _CLEAR * std[1], np.sign(velocity), 0.0), half)
    # Within a jump a parabola is further off than the encoder's noise.
    angle = np.where(unclear, filled, told[:, 0] + filled.mean())
    return ShownMotion(angle, velocity, told[:, 2], direction, ~unclear, std)


def _lasting(direction: Floats, least: int) -> Floats:
    """Directions (N,) without those that last for less than so many samples: noise exceeds any bound now and then."""
    lengths = np.diff(np.flatnonzero(np.diff(direction)) + 1, prepend=0, append=len(direction))
    return np.where(np.repeat(lengths >= least, lengths), direction, 0.0)


@dataclass(frozen=True, eq=False)
class MeasuredMotion(ValveDriven):
    """A recording of a free joint, the measured angle an input; the balance of torques has the angle's column."""

    @cached_property
    def motion(self) -> ShownMotion:
        """The measured motion."""
        return motion_of(self.trial)

    @cached_property
    @override
    def measured(self) -> Floats:
        """Block means of the measurements (B, C); of the balance 0, NaN where the motion is not clear."""
        values = self.trial.measured[:, list(self.channels)].copy()
        values[:, self.channels.index(ANGLE)] = self.measured_samples
        return self.trial.blocks(values)

    @cached_property
    def measured_samples(self) -> Floats:
        """What the torques lack (N,) [N m]: nothing; NaN where the motion is not clear."""
        clear = self.motion.clear & (np.abs(self.motion.angle) < self.vector[par.STOP] - _NEAR_STOP)
        return np.where(clear, 0.0, np.nan)

    @cached_property
    @override
    def noise(self) -> Floats:
        """Standard deviation of a block mean by the sensors alone (C,); of the balance by the encoder's.

        The parabolas of a block's samples have most of their samples in common.
        """
        noise = ValveDriven.noise.func(self).copy()  # type: ignore[attr-defined]
        p, x = self.vector, _middle(self.trial, self.vector)
        by = p[par.STIFFNESS] - dynamics.torque_slope(x, p), p[par.VISCOUS], p[par.INERTIA]
        noise[self.channels.index(ANGLE)] = np.hypot.reduce(np.multiply(by, self.motion.noise))
        return np.asarray(noise)

    @property
    @override
    def titles(self) -> tuple[Channel, ...]:
        """The channels' names and units."""
        named = zip(self.channels, super().titles, strict=True)
        return tuple(Channel("Balance of torques", "N m", 1.0) if c == ANGLE else title for c, title in named)

    @property
    @override
    def free_run(self) -> Experiment:
        """The recording with a model that runs by itself from the first sample on."""
        judged = tuple(other.free_run for other in self.judged)
        return ValveDriven(**{**_fields(self), "judged": judged})

    @cached_property
    def weights(self) -> Floats:
        """What a block's imbalance is multiplied by (B,): a second counts what it lacks while the joint slides.

        A joint that sticks moves in short bursts. Each of them is one independent error, as a second is elsewhere.
        """
        motion, size = self.motion, self.trial.block
        slides = ((motion.direction != 0.0) & np.isfinite(self.measured_samples)).astype(float)
        shares = slides[: len(slides) // size * size].reshape(-1, size).mean(axis=1)
        second = np.ones(max(round(self.blocks_per_error), 1))
        near, there = (np.convolve(one, second, mode="same") for one in (shares, np.ones(len(shares))))
        near = np.where(near > 0.0, np.maximum(near, there / _FEWEST), there)
        return np.asarray(np.sqrt(there / near))

    @override
    def residual_of(self, simulated: Floats) -> Floats:
        """Measured minus simulated block means (B, C), 0 where nothing was measured.

        Args:
            simulated: the latter (B, C).
        """
        residual = super().residual_of(simulated)
        residual[:, self.channels.index(ANGLE)] *= self.weights[: len(residual)]
        return residual

    def right(self, point: Point) -> float:
        """Share of the held-out time with a clear motion in which a model's torques are in balance, to three noises."""
        column = self.channels.index(ANGLE)
        left = self.residual(point, whole=True)[: len(self.measured)] / self.weights[:, None]
        left = self.held(left)[:, column]
        left = left[np.isfinite(self.held(self.measured)[:, column])]
        return float(np.mean(np.abs(left) <= _RIGHT * self.noise[column])) if len(left) else float("nan")

    @override
    def states(self, point: Point) -> tuple[Floats, Floats]:
        """States (N, n) and torques (N,) [N m] of the model along the motion of all of the recording."""
        states, torque, _ = self._course(self.trial, point)
        return states, torque

    @override
    def _shown(self, trial: Trial, point: Point) -> Floats:
        """What the sensors would show (N, 4), in the steps of a trial; the balance in the angle's place."""
        states, torque, lacking = self._course(trial, point)
        return np.column_stack([lacking, torque, sensor.readings(states[:, 2:4], self.parameters(point))])

    @override
    def _made_of_each(self, trial: Trial, points: Sequence[Point], made: Callable[[Floats], Floats]) -> list[Floats]:
        """What is made of :meth:`_shown` of several models."""
        return self.side_by_side(lambda point: made(self._shown(trial, point)), points)

    def _course(self, trial: Trial, point: Point) -> tuple[Floats, Floats, Floats]:
        p = self.parameters(point)
        p[par.FRICTION_STEP] = trial.step
        x0 = initial_state(trial, p, self.first, self.start_shift(point))
        p[par.LOCKED] = 1.0
        stride = round(trial.dt / self.trial.dt)
        m = self.motion
        motion = (part[::stride][: len(trial)].copy() for part in (m.angle, m.velocity, m.acceleration, m.direction))
        return _along(x0, trial.given, *motion, p, trial.dt, trial.substeps)  # type: ignore[no-any-return]


def along_motion(experiment: Experiment) -> Experiment:
    """A recording along its measured motion where its joint sticks; else as it is."""
    if not isinstance(experiment, ValveDriven) or sticking_share(experiment) < _STICKS:
        return experiment
    return _given_its_motion(experiment)


def _given_its_motion(experiment: Experiment) -> Experiment:
    """A recording of a free joint along its motion, and those that it is judged by, which may stick less."""
    shown = isinstance(experiment, ValveDriven) and experiment.trial.joint == "free" and ANGLE in experiment.channels
    if not shown:
        return experiment
    judged = tuple(_given_its_motion(other) for other in experiment.judged)
    return MeasuredMotion(**{**_fields(experiment), "judged": judged})


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
