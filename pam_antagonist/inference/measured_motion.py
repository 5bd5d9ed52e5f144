"""A valve-driven joint along its measured motion, as an experiment: the imbalance of its torques is compared with 0.

Small torques decide when a sticking joint breaks loose, and where it stops. So even a right model diverges from the
joint within seconds. Therefore this model gets the measured angle beside the voltages, as in equation-error
identification. Its chambers are simulated from the voltages with known volumes. The imbalance of its torques follows
from equation (8) along the measured motion. An error does not affect later motions.

While the joint slides, friction has its full level against the motion, and the imbalance is an error of the model. If
the joint stands still or creeps, friction may have any value up to that level, and only the excess over it counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import chdtri
from typing_extensions import override

from pam_antagonist.inference.angle_driven import JOINT_PLACES, Motion, filled_in
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import off_stop
from pam_antagonist.inference.free_run import initial_state
from pam_antagonist.inference.point import Channel, Point
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, Trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.model import dynamics
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import IMBALANCE, TORQUE, Driven, Inputs

Floats = NDArray[np.float64]

_HALF_S = 0.02
"""[s] Half width of the window in which a parabola is fitted to get angle, velocity and acceleration."""
_CLEAR = 4.0
"""A velocity shows a direction if it exceeds so many standard deviations of its noise for half a window."""
_ROUGH = 1e-3
"""Probability that noise alone looks like a motion that no parabola fits, such as breaking loose or a stop."""
_MOST_WEIGHT = 10.0
"""Largest square of a weight: a second counts as if the joint slid for at least a tenth of it."""
_RIGHT = 3.0
"""Torques are in balance if their imbalance is within so many standard deviations of its noise."""
_NEAR_STOP = 0.01
"""[rad] Distance from the mechanical stop, whose torque is unknown, within which samples do not count."""
_STILL_S = 0.2
"""[s] A joint that stands still for so long while its torque changes is held by friction."""
_STILL, _MOVES = 4.0, 5.0
"""In standard deviations of the noise: largest range of the angle at standstill, and least change of the torque."""
_STICKS = 0.02
"""A joint is taken to stick if it does so in this share of a recording, about a second in a minute. Simulated joints
with the paper's friction have 0.04 to 0.25."""
_PROBE = 1e3
"""[Pa] Step of the differences that convert noise of the pressures to noise of the torque."""
_torque = dynamics.torque


@dataclass(frozen=True, eq=False)
class ShownMotion(Motion):
    """The motion that an encoder shows; its direction is −1 or 1, and 0 where the velocity is within its noise."""

    clear: NDArray[np.bool_]  # whether a parabola fits the motion (N,)
    noise: Floats  # standard deviations (3,) of angle [rad], velocity [rad/s] and acceleration [rad/s²]


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
    parabola = windows @ weights.T
    noise = trial.noise(ANGLE) * np.sqrt(trial.block)
    left = np.einsum("nk,nk->n", windows, windows) - np.einsum("ni,ij,nj->n", parabola, basis.T @ basis, parabola)
    rough = left > noise**2 * float(chdtri(len(time) - 3, _ROUGH))
    rough[:half] = rough[len(rough) - half :] = True
    unclear = np.convolve(rough | ~known, np.ones(half + 1), mode="same") > 0.0
    std = noise * np.sqrt(np.sum(weights**2, axis=1))
    velocity = parabola[:, 1]
    direction = _lasting(np.where(np.abs(velocity) > _CLEAR * std[1], np.sign(velocity), 0.0), half)
    # At a jump, the error of a parabola exceeds the encoder's noise.
    angle = np.where(unclear, filled, parabola[:, 0] + filled.mean())
    return ShownMotion(angle, velocity, parabola[:, 2], direction, ~unclear, std)


def _lasting(direction: Floats, least: int) -> Floats:
    """Directions (N,) with short ones, of less than ``least`` samples, set to 0: noise exceeds any bound at times."""
    lengths = np.diff(np.flatnonzero(np.diff(direction)) + 1, prepend=0, append=len(direction))
    return np.where(np.repeat(lengths >= least, lengths), direction, 0.0)


@dataclass(frozen=True, eq=False)
class MeasuredMotion(ValveDriven):
    """A recording of a free joint with the angle as an input; the imbalance of torques takes the angle's column."""

    sliding: bool = False  # whether only samples count in which the joint slides

    @property
    @override
    def for_laws(self) -> tuple[MeasuredMotion, ...]:
        # Where the joint stands still, its friction is at least what holds it. That says nothing of other laws.
        return (self,) if self.sliding else (self, replace(self, sliding=True))

    @cached_property
    def motion(self) -> ShownMotion:
        """The measured motion."""
        return motion_of(self.trial)

    @cached_property
    @override
    def measured(self) -> Floats:
        values = self.trial.measured[:, list(self.channels)].copy()
        values[:, self.channels.index(ANGLE)] = self.measured_samples
        return self.trial.blocks(values)

    @cached_property
    def measured_samples(self) -> Floats:
        """Imbalance of a right model (N,) [N m]: 0, NaN where the motion is not clear."""
        clear = self.motion.clear & (np.abs(self.motion.angle) < off_stop(self.rig, _NEAR_STOP))
        clear &= (self.motion.direction != 0.0) | (not self.sliding)
        return np.where(clear, 0.0, np.nan)

    @cached_property
    @override
    def noise(self) -> Floats:
        """Standard deviation of a block mean by the sensors alone (C,); for the imbalance by the encoder's noise.

        The noise of the imbalance does not average out in a block, because the parabolas share most of their samples.
        """
        noise = ValveDriven.noise.func(self).copy()  # type: ignore[attr-defined]
        p, x = self.vector, _middle(self.trial, self.vector)
        by = p[par.STIFFNESS] - dynamics.torque_slope(x, p), p[par.VISCOUS], p[par.INERTIA]
        noise[self.channels.index(ANGLE)] = np.hypot.reduce(np.multiply(by, self.motion.noise))
        return np.asarray(noise)

    @property
    @override
    def titles(self) -> tuple[Channel, ...]:
        named = zip(self.channels, super().titles, strict=True)
        return tuple(Channel("Balance of torques", "N m", 1.0) if c == ANGLE else title for c, title in named)

    @property
    @override
    def is_kept_near(self) -> bool:
        return True

    @property
    @override
    def law_places(self) -> tuple[str, ...]:
        return tuple(at for at in JOINT_PLACES if (at == "friction") != self.sliding)

    @property
    @override
    def free_run(self) -> Experiment:
        judged = tuple(other.free_run for other in self.judged)
        return ValveDriven(**{**_fields(self), "judged": judged})

    @cached_property
    def weights(self) -> Floats:
        """Weights of the imbalance of each block (B,): larger where the joint slides for a small part of a second.

        A sticking joint moves in short bursts. Each burst is one independent error, like a second of other signals.
        """
        motion, size = self.motion, self.trial.block
        slides = ((motion.direction != 0.0) & np.isfinite(self.measured_samples)).astype(float)
        shares = slides[: len(slides) // size * size].reshape(-1, size).mean(axis=1)
        second = np.ones(max(round(self.blocks_per_error), 1))
        near, there = (np.convolve(one, second, mode="same") for one in (shares, np.ones(len(shares))))
        near = np.where(near > 0.0, np.maximum(near, there / _MOST_WEIGHT), there)
        return np.asarray(np.sqrt(there / near))

    @override
    def residual_of(self, simulated: Floats) -> Floats:
        """Measured minus simulated block means (B, C), 0 where nothing was measured.

        `simulated`: simulated block means (B, C).
        """
        residual = super().residual_of(simulated)
        residual[:, self.channels.index(ANGLE)] *= self.weights[: len(residual)]
        return residual

    def right(self, point: Point) -> float:
        """Share of the held-out time with clear motion in which a model's imbalance is within three noise std."""
        column = self.channels.index(ANGLE)
        left = self.residual(point, whole=True)[: len(self.measured)] / self.weights[:, None]
        left = self.held(left)[:, column]
        left = left[np.isfinite(self.held(self.measured)[:, column])]
        return float(np.mean(np.abs(left) <= _RIGHT * self.noise[column])) if len(left) else float("nan")

    @override
    def states(self, point: Point) -> tuple[Floats, Floats]:
        states, (torque, _) = self._courses(self.trial, [point])[0]
        return states, torque

    @override
    def _made_of_each(self, trial: Trial, points: Sequence[Point], made: Callable[[Floats], Floats]) -> list[Floats]:
        def together(group: Sequence[Point]) -> list[Floats]:
            found = zip(self._courses(trial, group), group, strict=True)
            return [
                made(np.column_stack([shown[1], shown[0], dynamics.readings(states[:, 2:4], self.parameters(point))]))
                for (states, shown), point in found
            ]

        return self.in_lanes(together, points)

    def _courses(self, trial: Trial, points: Sequence[Point]) -> list[Driven]:
        """Of several models: states (N, n), torques and imbalances (2, N)."""
        vectors = [self.parameters(point) for point in points]
        starts = [
            initial_state(trial, p, self.first, self.start_shift(point))[None]
            for p, point in zip(vectors, points, strict=True)
        ]
        stride = round(trial.dt / self.trial.dt)
        motion = self.motion.columns[::stride][: len(trial)]
        along = Inputs.even(len(trial), trial.dt, trial.substeps, command=trial.given, motion=motion)
        return along.driven_each(starts, vectors, TORQUE | IMBALANCE)


def along_motion(experiment: Experiment) -> Experiment:
    """A recording along its measured motion if its joint sticks; otherwise unchanged."""
    if not isinstance(experiment, ValveDriven) or sticking_share(experiment) < _STICKS:
        return experiment
    return _given_its_motion(experiment)


def _given_its_motion(experiment: Experiment) -> Experiment:
    """A recording of a free joint along its motion, together with the recordings that judge its fit."""
    shown = isinstance(experiment, ValveDriven) and experiment.trial.joint == "free" and ANGLE in experiment.channels
    if not shown:
        return experiment
    judged = tuple(_given_its_motion(other) for other in experiment.judged)
    return MeasuredMotion(**{**_fields(experiment), "judged": judged})


def _fields(experiment: Experiment) -> dict[str, Any]:
    return {one.name: getattr(experiment, one.name) for one in fields(ValveDriven)}


def sticking_share(experiment: ValveDriven) -> float:
    """Share of a recording in which the joint stands still while its torque changes; 0 if unknown."""
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
    """Standard deviation [N m] of the computed torque due to the noise of the pressures' block means.

    `p`: parameter vector (P,).
    """
    x = _middle(trial, p)
    moved = []
    for i in (0, 1):
        other = x.copy()
        other[2 + i] += _PROBE
        moved.append((_torque(other, p) - _torque(x, p)) / _PROBE * trial.noise(PRESSURE_1 + i))
    return float(np.hypot(*moved))


def _middle(trial: Trial, p: Floats) -> Floats:
    """A state at the mean angle and pressures of a recording."""
    x = np.zeros(int(p[par.STATES]))
    x[ANGLE] = np.nanmean(trial.measured[:, ANGLE])
    x[2:4] = np.nanmean(trial.measured[:, PRESSURE_1:], axis=0)
    return x
