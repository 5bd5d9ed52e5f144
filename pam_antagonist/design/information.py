"""Information that an experiment gives about a model's parameters: Fisher information along a simulated course.

The model and its neighbours are simulated side by side. A neighbour is the model with one parameter moved a little. The
differences are derivatives of the sensors' readings. Their means over blocks of samples and the sensors' noise give the
information matrix ``J' R⁻¹ J`` of the parameters. A prior adds 1 to it, in units of the prior's standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.free_parameters import free_parameters
from pam_antagonist.inference.trial import ANGLE, BLOCK_S, CHANNELS, PRESSURE_1, TORQUE
from pam_antagonist.inference.unknown import Unknown, change_of
from pam_antagonist.model import drive, dynamics, equilibrium
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import rest_pressure

Floats = NDArray[np.float64]

GAUGE_1, GAUGE_2, TANK = range(len(CHANNELS), len(CHANNELS) + 3)
"""Further channels that no recording has: a gauge without error at each muscle, and one at the supply's tank."""

STEP = 2e-3
"""[s] Integration step. Derivatives need no finer one."""
_SHARE = 1e-3
"""Distance of a neighbour from the model, as a share of the parameter's standard deviation."""


@dataclass(frozen=True)
class Departure(Unknown):
    """A direction towards a model with further parameters."""

    # What only the neighbour has, by dotted path: the shapes of an effect.
    fixed: Mapping[str, float] = field(default_factory=dict)
    share: float = 0.1  # distance of the neighbour from the model, as a share of the direction


def block_noise(rig: Rig) -> Floats:
    """Standard deviations of the channels' block means by the rig's sensors (7,): ``CHANNELS``, then the gauges."""
    sensors, size = rig.sensors, max(1, round(BLOCK_S / rig.sample_period))
    pressure = float(np.hypot(sensors.pressure_std, sensors.pressure_step / np.sqrt(12.0)))
    raw = np.array([sensors.error("angle"), sensors.error("torque"), *[pressure] * 5])
    return np.asarray(np.maximum(raw / np.sqrt(size), [1e-5, 1e-4, *[10.0] * 5]))


def unknowns(rig: Rig) -> tuple[Unknown, ...]:
    """The parameters that ``identify`` moves, each by one standard deviation of its prior."""
    return tuple(change_of(item.name, {item.name: item.prior_std}) for item in free_parameters(rig))


@dataclass(frozen=True, eq=False)
class SimulatedPiece:
    """A piece of a simulated experiment."""

    states: Floats  # of the model (N, n)
    shown: Floats  # what its sensors show (N, 4), in the order of ``CHANNELS``; (N, 7) with the gauges
    slopes: Floats  # derivatives of these by each direction's amount (N, 4, K) or (N, 7, K)
    rate_slopes: Floats  # of the angle's rate (N, K)
    ends: tuple[Floats, ...]  # last state of the model and of each neighbour (1 + 2 K or 1 + K of them)


class Information:
    """A model with its neighbours, and the information in their differences.

    `central`: whether neighbours lie on both sides: twice the work, smaller errors. `channels`: what is measured,
    indices of ``CHANNELS`` or of the gauges; default: all of a recording.
    """

    def __init__(
        self,
        rig: Rig,
        directions: Sequence[Unknown],
        joint: str = "free",
        lock_angle: float = 0.0,
        central: bool = False,
        channels: Sequence[int] | None = None,
        step: float = STEP,
    ) -> None:
        self.directions = tuple(directions)
        self.dt = step
        self._central = central
        self._locked_at = lock_angle if joint == "locked" else None
        usual = range(len(CHANNELS)) if joint == "free" else (TORQUE, PRESSURE_1, PRESSURE_1 + 1)
        self.channels = tuple(usual if channels is None else channels)
        self._noise = block_noise(rig)[list(self.channels)]
        base = rig.parameters(joint, lock_angle)
        base[par.FRICTION_STEP] = step
        signs = (1.0, -1.0) if central else (1.0,)
        self.vectors = [base]
        for direction in self.directions:
            for sign in signs:
                share = sign * _share(direction)
                moved = {name: base[par.INDEX[name]] + share * amount for name, amount in direction.adds.items()}
                fixed = direction.fixed if isinstance(direction, Departure) else {}
                self.vectors.append(par.changed(base, {**fixed, **moved}))

    def start(self, pressure: tuple[float, float], voltage: Floats) -> tuple[Floats, ...]:
        """States after a long rest, of model and neighbours, by both pressures [Pa] and the voltages (2,) [V]."""
        out = []
        for p in self.vectors:
            angle = equilibrium.rest_angle(*pressure, p) if self._locked_at is None else self._locked_at
            out.append(np.asarray(equilibrium.initial_state(angle, *pressure, voltage, p)))
        return tuple(out)

    def along(self, starts: Sequence[Floats], voltage: Floats) -> SimulatedPiece:
        """Simulate a piece of an experiment.

        `starts`: states (n,) at its beginning, of the model and of each neighbour. `voltage`: (N, 2) [V], a row a step.
        """
        given = np.concatenate([voltage[:1], voltage])
        runs = [drive.course(x, given, p, self.dt, 1) for x, p in zip(starts, self.vectors, strict=True)]
        shown = [
            np.column_stack(
                [states[1:, 0], torque[1:], dynamics.readings(states[1:, 2:4], p), *self._gauges(states[1:], p)]
            )
            for (states, torque), p in zip(runs, self.vectors, strict=True)
        ]
        rates = [states[1:, 1] for states, _ in runs]
        return SimulatedPiece(
            runs[0][0][1:], shown[0], self._slopes(shown), self._slopes(rates), tuple(states[-1] for states, _ in runs)
        )

    def _gauges(self, states: Floats, p: Floats) -> list[Floats]:
        """Pressures in both muscles and in the tank, each (N,) [Pa], along states; none if no gauge is measured."""
        if max(self.channels) < GAUGE_1:
            return []
        chambers = [states[:, int(p[par.SLOT_OF[f"chamber_{i}"]]) or 1 + i] for i in (1, 2)]
        droop = int(p[par.SLOT_OF["supply"]])
        tank = np.full(len(states), p[par.SUPPLY])
        return [*chambers, tank + states[:, droop] if droop else tank]

    def _slopes(self, values: Sequence[Floats]) -> Floats:
        if not self.directions:
            return np.zeros((*values[0].shape, 0))
        shares = [_share(direction) for direction in self.directions]
        if self._central:
            pairs = zip(values[1::2], values[2::2], shares, strict=True)
            return np.stack([(one - other) / (2.0 * share) for one, other, share in pairs], axis=-1)
        return np.stack([(one - values[0]) / share for one, share in zip(values[1:], shares, strict=True)], axis=-1)

    def matrix(self, course: SimulatedPiece, count: int | None = None) -> Floats:
        """Information of a piece about the first directions (count, count), in units of their standard deviations."""
        size = max(1, round(BLOCK_S / self.dt))
        blocks = len(course.slopes) // size
        kept = course.slopes[: blocks * size, list(self.channels), :count]
        means = kept.reshape(blocks, size, len(self.channels), -1).mean(axis=1) / self._noise[:, None]
        flat = means.reshape(-1, means.shape[-1])
        return np.asarray(flat.T @ flat)


def _share(direction: Unknown) -> float:
    return direction.share if isinstance(direction, Departure) else _SHARE


def predicted_std(course: SimulatedPiece, spread: Floats) -> Floats:
    """Standard deviations of angle, rate and pressures along a course (N, 4) by the uncertain directions.

    `spread`: independent ways (K, U) in which the directions' amounts may be off by one standard deviation.
    """
    slopes = np.stack(
        [course.slopes[:, ANGLE], course.rate_slopes, course.slopes[:, PRESSURE_1], course.slopes[:, PRESSURE_1 + 1]],
        axis=1,
    )
    return np.asarray(np.sqrt(np.sum((slopes @ spread) ** 2, axis=2)))


def standard_errors(
    rig: Rig,
    voltage: Floats,
    period: float,
    joint: str = "free",
    lock_angle: float = 0.0,
    pressure: tuple[float, float] | None = None,
) -> dict[str, float]:
    """Standard errors of the parameters that ``identify`` moves, as shares of their priors.

    Args:
        rig: the true joint.
        voltage: (N, 2) [V], a row a period.
        period: [s].
        joint: ``free`` or ``locked``.
        lock_angle: [rad], of a locked joint.
        pressure: of both muscles at the start [Pa]; None: at rest.
    """
    pressure = pressure or (rest_pressure(rig),) * 2
    free = unknowns(rig)
    work = Information(rig, free, joint, lock_angle, central=True, step=min(period, STEP))
    rows = np.repeat(voltage, max(1, round(period / work.dt)), axis=0)
    course = work.along(work.start(pressure, rows[0]), rows)
    covariance = np.linalg.inv(work.matrix(course) + np.eye(len(free)))
    return {item.name: float(np.sqrt(value)) for item, value in zip(free, np.diag(covariance), strict=True)}
