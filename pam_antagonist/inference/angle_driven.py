"""A sealed joint that is moved from outside, as an experiment: its measured angle is the input.

No voltage moves such a joint. A simulation driven by the torque says little: while the joint sticks, the model cannot
predict when it will slip. So the measured angle drives the model. Its two pressures (the *air*) and the torque from
outside that the motion needs by equation (8) (the *balance*) are compared with the recording. Air and balance have
different base parameters, and no effect that is observable here acts on both. The pressures are compared by their mean
and half their difference, because an error of the encoder changes only the latter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.free_run import StartedModel, predict, start_of
from pam_antagonist.inference.likelihood import in_mean_squares
from pam_antagonist.inference.point import Channel, Point
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, PRESSURE_2, TORQUE, Trial, block_noise
from pam_antagonist.inference.unknown import Unknown, change_of
from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.model.drive import NEEDED, Inputs
from pam_antagonist.model.effects import CATALOGUE, places
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

AIR, BALANCE = "air", "balance"
"""Parts of a driven joint. The catalogue has for each effect which part shows it."""

JOINT_PLACES, AIR_PLACES = places.of_parts([places.JOINT]), places.of_parts([places.AIR])
"""Where laws may stand in joint and muscles, and in their chambers."""
_CORNER_HZ = 3.0
_STEP_S = 4e-3
"""[s] Longest step: a motion that is filtered at 3 Hz hardly changes within it."""
_SMOOTH = 1e-6
"""[rad] An angle with less white noise needs no smoothing to show its direction of motion."""
SLIDING = 0.02
"""[rad/s] At a higher velocity a joint slides; at a lower one friction may have any value up to its bound."""
_STICKING_LEAST = 1e-9
_CLEAR = 3.0
"""A velocity shows a direction if it exceeds so many standard deviations of its noise."""
_FORCE = 10.0
"""[N] Prior of the force difference between two muscles of one kind."""
_VISCOUS = 0.02
"""[N m s/rad] Prior of a change of the viscous friction. Ten times as much looks like Coulomb friction."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A measured angle as an input."""

    angle: Floats  # (N,) [rad]
    velocity: Floats  # (N,) [rad/s]
    acceleration: Floats  # (N,) [rad/s²]
    direction: Floats  # of motion (N,), −1 to 1

    @property
    def columns(self) -> Floats:
        """The motion as the driver takes it (N, 4)."""
        return np.column_stack([self.angle, self.velocity, self.acceleration, self.direction])


def filled_in(measured: Floats) -> Floats:
    """A measured angle (N,) [rad] with linear interpolation over missing values.

    `measured`: the angle (N,) [rad], NaN where missing.
    """
    known = np.isfinite(measured)
    return np.interp(np.arange(len(measured)), np.flatnonzero(known), measured[known])


def motion_of(measured: Floats, dt: float) -> Motion:
    """The motion behind a measured angle.

    An angle with noise is smoothed without a phase shift. The direction fades where the velocity is within its noise.

    `measured`: angle (N,) [rad], NaN where missing. `dt`: sample period [s].
    """
    known = np.isfinite(measured)
    angle = filled_in(measured)
    # The sixth difference of white noise has 924 times its variance; that of a smooth motion is negligible.
    noise = float(np.sqrt(np.mean(np.diff(measured[known], 6) ** 2) / 924.0))
    fuzzy = noise * np.sqrt(0.5) / dt
    if noise > _SMOOTH:
        # The import takes a third of a second, and few recordings need it.
        from scipy import signal

        corner = signal.butter(2, _CORNER_HZ, fs=1.0 / dt, output="sos")
        angle = signal.sosfiltfilt(corner, angle)
        _, response = signal.sosfreqz(corner, 4096, fs=1.0 / dt)
        omega = np.linspace(0.0, np.pi / dt, 4096, endpoint=False)
        fuzzy = noise * float(np.sqrt(np.mean(np.abs(response) ** 4 * omega**2)))
    velocity = np.gradient(angle, dt)
    direction = velocity / np.hypot(velocity, max(_CLEAR * fuzzy, _STICKING_LEAST))
    return Motion(angle, velocity, np.gradient(velocity, dt), direction)


def chamber_directions(rig: Rig, number: int) -> tuple[Unknown, Unknown]:
    """Directions that the pressure of a sealed muscle determines: the slope of its volume, and its charge.

    `number`: of the muscle, 1 or 2.
    """
    slope, charge = getattr(rig, f"muscle_{number}").volume.d2, f"valves.charge_{number}"
    # The volume at angle 0 does not change.
    turned = {f"muscle_{number}.volume.d2": slope, f"muscle_{number}.volume.d3": -slope * rig.geometry.length}
    return (
        change_of(f"muscle_{number}.volume, slope", turned, 0.1),
        change_of(charge, {charge: rig.value(charge)}, 0.01),
    )


@dataclass(frozen=True, eq=False)
class AngleDriven(Experiment):
    """A part of a driven joint as an experiment: its air, or its balance of torques."""

    part: str = AIR  # ``air`` or ``balance``
    # whether only samples count in which the joint slides, and the encoder shows the direction of motion.
    resolved: bool = False

    @cached_property
    @override
    def directions(self) -> tuple[Unknown, ...]:
        rig = self.rig
        if self.part == BALANCE:
            apart = {"muscle_1.force.w2": _FORCE, "muscle_2.force.w2": -_FORCE}
            return (
                change_of("joint.stiffness", {"joint.stiffness": max(rig.joint.stiffness, 1.0)}, 1.0),
                change_of("difference of the muscles' forces", apart, 1.0),
                change_of("joint.viscous_friction", {"joint.viscous_friction": _VISCOUS}, 1.0),
            )
        return tuple(direction for number in (1, 2) for direction in chamber_directions(rig, number))

    @cached_property
    @override
    def channels(self) -> tuple[int, ...]:
        return (TORQUE,) if self.part == BALANCE else (PRESSURE_1, PRESSURE_2)

    @override
    def excess_removed(self, before: Floats, after: Floats) -> tuple[float, float]:
        """Excess over noise that another model removes from a residual, and the excess before, in mean squares.

        A model driven by the measured angle does not drift away, so that its errors do not depend on earlier ones.

        `before`: residual of a model (B, C). `after`: of another one (B, C).
        """
        return in_mean_squares(before, after, self.noise)

    @property
    @override
    def titles(self) -> tuple[Channel, ...]:
        if self.part == BALANCE:
            return (Channel("Torque from outside", "N m", 1.0),)
        return Channel("Mean pressure", "kPa", 1e-3), Channel("Half difference", "kPa", 1e-3)

    @cached_property
    @override
    def measured(self) -> Floats:
        values = _parted(self.trial.measured)[:, list(self.channels)]
        if self.resolved:
            values = np.where(np.abs(self.motion.velocity)[:, None] > SLIDING, values, np.nan)
        return self.trial.blocks(values)

    @cached_property
    def motion(self) -> Motion:
        """The measured angle as an input."""
        return motion_of(self.trial.measured[:, ANGLE], self.trial.dt)

    @cached_property
    @override
    def noise(self) -> Floats:
        """Standard deviation of a block mean by the sensors (C,), with the effect of the encoder's error.

        The error of the encoder is constant while the joint stands, so it does not average out in a block.
        """
        p, angle = self.vector, self.rig.sensors.angle_std
        slopes = [
            (equilibrium.closed_pressure(i, 0.01, p) - equilibrium.closed_pressure(i, -0.01, p)) / 0.02 for i in (0, 1)
        ]
        if self.part == BALANCE:
            pressures = (equilibrium.closed_pressure(i, 0.0, p) for i in (0, 1))
            x = equilibrium.initial_state(0.0, *pressures, np.zeros(3), p)
            stiffness = self.rig.joint.stiffness - dynamics.torque_slope(x, p)
            return np.array([np.hypot(self.rig.sensors.torque_std, stiffness * angle)])
        values = _parted(self.trial.measured)
        by_angle = np.array([slopes[0] + slopes[1], slopes[0] - slopes[1]]) / 2.0 * angle
        return np.array(
            [
                np.hypot(block_noise(values[:, c], self.trial.block), by)
                for c, by in zip(self.channels, by_angle, strict=True)
            ]
        )

    @cached_property
    @override
    def vector(self) -> Floats:
        return self.rig.parameters("locked", 0.0)

    @property
    @override
    def runs_by_itself(self) -> bool:
        return False

    @override
    def candidates(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        present = {path.split(".")[1] for path in taken}
        return tuple(
            Candidate(name, form)
            for name, effect in CATALOGUE.items()
            if effect.sealed.part == self.part and name not in present
            for form in effect.sealed.forms
        )

    def driven(self, points: Sequence[Point], whole: bool = False) -> list[tuple[Floats, Floats]]:
        """Of several models, the pressures (N, 2) [Pa] and the torque from outside (N,) [N m] that the motion needs."""
        motion, vectors, starts = self.motion, [self.parameters(point) for point in points], []
        # A joint that moves at the start is assumed to have moved for long.
        first, velocity = motion.angle[0], float(motion.velocity[0]) if abs(motion.velocity[0]) > SLIDING else 0.0
        for p in vectors:
            pressures = [equilibrium.closed_pressure(i, first, p) for i in (0, 1)]
            x0 = equilibrium.initial_state(first, pressures[0], pressures[1], np.zeros(3), p, velocity)
            starts.append(np.asarray(x0)[None])
        end = len(self.trial) if whole else self.fitted
        stride = self.trial.samples(_STEP_S)
        at = np.arange(0, end, stride)
        course = motion.columns[:end][at]
        # The mean direction of a step: it is about 0 for a sticking joint that vibrates.
        course[:, 3] = np.add.reduceat(motion.direction[:end], at) / np.diff(np.append(at, end))
        along = replace(Inputs.even(len(at), stride * self.trial.dt, motion=course), longest=_STEP_S)
        every, out = np.arange(end), []
        for states, (_, needed) in along.driven_each(starts, vectors, NEEDED):
            columns = [np.interp(every, at, column) for column in (*states[:, 2:4].T, needed)]
            out.append((np.column_stack(columns[:2]), columns[2]))
        return out

    @override
    def states(self, point: Point) -> tuple[Floats, Floats]:
        ((pressure, needed),) = self.driven([point], whole=True)
        return np.column_stack([self.motion.angle, self.motion.velocity, pressure]), needed

    @override
    def shown(self, point: Point, rig: Rig) -> Floats:
        """Simulated readings of all sensors (N, 4).

        Torque and pressures belong to the measured motion. The angle is that of the model alone under the torque from
        outside; NaN if this torque was not recorded.

        `point`: not used; the rig has the fitted parameters of both parts.
        """
        whole = replace(self, rig=rig, part=BALANCE)
        ((pressure, needed),) = whole.driven([whole.origin], whole=True)
        alone = np.full(len(self.trial), np.nan)
        if self.trial.has(TORQUE):
            alone = predict(self.trial, StartedModel(rig.parameters("free")), start_of(self.trial))[:, ANGLE]
        return np.column_stack([alone, needed, pressure])

    @property
    @override
    def noise_memory(self) -> float:
        return self.blocks_per_error

    @property
    @override
    def judged_channels(self) -> tuple[int, ...]:
        return (ANGLE, TORQUE, PRESSURE_1, PRESSURE_2) if self.trial.has(TORQUE) else (PRESSURE_1, PRESSURE_2)

    @property
    @override
    def is_kept_near(self) -> bool:
        return True

    @property
    @override
    def law_places(self) -> tuple[str, ...]:
        return JOINT_PLACES if self.part == BALANCE else AIR_PLACES

    @property
    @override
    def for_laws(self) -> tuple[AngleDriven, ...]:
        # Where the joint sticks, friction may be anything up to its bound: that says nothing of a law.
        return (replace(self, resolved=True) if self.part == BALANCE and not self.resolved else self,)

    @property
    @override
    def slides(self) -> NDArray[np.bool_]:
        return np.asarray(np.abs(self.motion.velocity) > SLIDING)

    @override
    def simulated_each(self, points: Sequence[Point], whole: bool = False) -> list[Floats]:
        return [
            _parted(np.column_stack([self.motion.angle[: len(needed)], needed, pressure]))
            for pressure, needed in self.driven(points, whole)
        ]


def sweeps(trial: Trial, first: int, last: int) -> int:
    """Number of sweeps in one direction in a part of a recording; each is one independent value."""
    velocity = motion_of(trial.measured[:, ANGLE], trial.dt).velocity[first:last]
    directions = np.sign(velocity[np.abs(velocity) > SLIDING])
    return 0 if not len(directions) else 1 + int(np.sum(np.diff(directions) != 0.0))


def _parted(values: Floats) -> Floats:
    """Columns of ``CHANNELS`` with the two pressures replaced by their mean and half their difference."""
    first, second = values[:, PRESSURE_1], values[:, PRESSURE_2]
    return np.column_stack([values[:, ANGLE], values[:, TORQUE], 0.5 * (first + second), 0.5 * (first - second)])
