"""The model along a recording: what is given drives it, and the rest follows. One driver for every kind of recording.

Given are commands, measured pressures or a measured motion, or two of them. Commands drive the whole joint. Measured
pressures drive joint and muscles alone, as if the valves were shut. A measured motion drives the chambers alone, as if
the joint were held. Pressures and motion together leave the torques, and what the effects remember.

The recording is cut into parts, each with a start of its own. Inputs are held over a step of the integration: a command
as it is, pressures and angles at their value in the step's middle, which is a method of second order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import in_place, inlined, kernel
from pam_antagonist.model import dynamics, equilibrium, integration, lanes
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2, VELOCITY
from pam_antagonist.model.integration import STAGES
from pam_antagonist.model.lane_values import FEWEST, LANES, in_lanes
from pam_antagonist.model.parameters import (
    BASE_STATES,
    FRICTION_STEP,
    LOCKED,
    LONGEST_STEP,
    POLYTROPIC_VOLUME,
    SIGNAL,
    STATES,
    STOP,
    VALVE,
    VALVE_SIZE,
)

Floats = NDArray[np.float64]
Driven = tuple[Floats, Floats]
"""States (N, n), and what was wanted beside them (2, N) [N m]."""

BY_COMMAND, BY_PRESSURE, BY_MOTION = 1, 2, 4
"""What is given."""
TORQUE, NEEDED, IMBALANCE = 8, 16, 32
"""What is wanted beside the states: see :func:`drive`."""

_MOTION = 4

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_rk4_step, _initial_state = integration.rk4_step_within, equilibrium.initial_state
_torque, _needed, _imbalance = dynamics.torque, dynamics.torque_needed, dynamics.imbalance
_subsystem, _keep = dynamics.subsystem, lanes.keep
_substeps_of = inlined(integration.substeps_of)


@inlined
def _move(mask, x, u, length, command, pressure, motion, signals, k, p, longest, scratch):
    """The state from row k - 1 to row k, in steps of the integration over which the inputs are held."""
    steps = _substeps_of(length, longest)
    h = length / steps
    p[FRICTION_STEP] = h
    if mask & BY_COMMAND != 0:
        for i in range(command.shape[1]):
            u[i] = command[k, i]
    moved = 0.0
    if mask & BY_MOTION != 0:
        moved = motion[k, 0] - motion[k - 1, 0]
        x[VELOCITY] = moved / length
    for s in range(steps):
        share = (s + 0.5) / steps
        if mask & BY_MOTION != 0:
            x[ANGLE] = motion[k - 1, 0] + share * moved
        if mask & BY_PRESSURE != 0:
            x[PRESSURE_1] = pressure[k - 1, 0] + share * (pressure[k, 0] - pressure[k - 1, 0])
            x[PRESSURE_2] = pressure[k - 1, 1] + share * (pressure[k, 1] - pressure[k - 1, 1])
        for j in range(signals.shape[1]):
            p[SIGNAL + j] = signals[k - 1, j] + share * (signals[k, j] - signals[k - 1, j])
        _rk4_step(x, u, p, h, x, scratch)


@inlined
def _at_row(mask, x, pressure, motion, signals, k, p):
    """What is given at row k, into state and parameters."""
    if mask & BY_MOTION != 0:
        x[ANGLE], x[VELOCITY] = motion[k, 0], motion[k, 1]
    if mask & BY_PRESSURE != 0:
        x[PRESSURE_1], x[PRESSURE_2] = pressure[k, 0], pressure[k, 1]
    for j in range(signals.shape[1]):
        p[SIGNAL + j] = signals[k, j]


@inlined
def _along(
    mask, first, start, keeps, length, command, pressure, motion, signals, p, longest, states, shown, x, u, scratch
):
    """:func:`drive`, into given arrays."""
    n = start.shape[1]
    # Where pressures and motion are given, only added states are left to integrate.
    follows = n > BASE_STATES or mask & (BY_PRESSURE | BY_MOTION) != BY_PRESSURE | BY_MOTION
    for e in range(first.shape[0] - 1):
        for k in range(first[e], first[e + 1]):
            # What a part remembers has gone on over the step to its first row.
            if follows and (k > first[e] or keeps[e]):
                _move(mask, x, u, length[k], command, pressure, motion, signals, k, p, longest, scratch)
            if k == first[e]:
                for i in range(n):
                    if i < BASE_STATES or not keeps[e]:
                        x[i] = start[e, i]
            _at_row(mask, x, pressure, motion, signals, k, p)
            for i in range(n):
                _keep(states, k, i, x[i])
            if mask & TORQUE != 0:
                _keep(shown, 0, k, _torque(x, p))
            if mask & NEEDED != 0:
                _keep(shown, 1, k, _needed(x, motion[k, 2], motion[k, 3], p))
            if mask & IMBALANCE != 0:
                _keep(shown, 1, k, _imbalance(x, motion[k, 2], motion[k, 3], p))


@kernel
def drive(mask, first, start, keeps, length, command, pressure, motion, signals, p, longest):
    """States and torques along a recording (N rows, E parts). :class:`Inputs` calls it.

    Args:
        mask: what is given and what is wanted, a sum of the constants of this module.
        first: index of the first row of each part, then the number of rows (E + 1,).
        start: state with which each part begins (E, n).
        keeps: whether a part goes on from the one before: only angle, velocity and pressures begin anew (E,). The
            first one does not.
        length: of the step that ends at a row (N,) [s]; not used at the first row of a part that does not go on.
        command: of the step that ends at a row (N, 2) or with the torque from outside (N, 3) [V or Pa, N m].
        pressure: P_1, P_2 (N, 2) [Pa], linear between rows.
        motion: ψ, ψ̇, ψ̈ and the direction of motion, -1 to 1 (N, 4) [rad, s]; ψ is linear between rows.
        signals: further signals (N, S) [SI], linear between rows; S = 0 for none.
        p: parameter vector (m,).
        longest: longest step of the integration [s].

    Returns:
        States (N, n). What was wanted (2, N) [N m], else (2, 0): the torque of the muscles, and the torque from outside
        that the motion needs or the imbalance of all torques along the motion.
    """
    rows, n, p = length.shape[0], start.shape[1], p.copy()
    wanted = mask & (TORQUE | NEEDED | IMBALANCE) != 0
    states, shown = np.empty((rows, n)), np.zeros((2, rows if wanted else 0))
    x, u, scratch = np.empty(n), np.zeros(max(command.shape[1], 2)), np.empty((STAGES + 1, n))
    _along(
        mask, first, start, keeps, length, command, pressure, motion, signals, p, longest, states, shown, x, u, scratch
    )
    return states, shown


@in_place
def drive_lanes(
    mask, first, start, keeps, length, command, pressure, motion, signals, p, longest, states, shown, x, u, scratch
):
    """:func:`drive` of several models side by side; ``p`` is changed.

    `start`: (E, n, LANES). `p`: parameter vectors (P, LANES). `states`: result (LANES, N, n). `shown`: result
    (LANES, 2, N) or (LANES, 2, 0) [N m]. `x`: for the state (n, LANES). `u`: zeros for the input (2,) or (3,).
    `scratch`: (STAGES + 1, n, LANES).
    """
    _along(
        mask, first, in_lanes(start), keeps, length, command, pressure, motion, signals, in_lanes(p), longest, states,
        shown, in_lanes(x), u, in_lanes(scratch),
    )  # fmt: skip


@kernel
def _settled(first, start, command, signals, p):
    """States after a long rest (E, n)."""
    p, parts = p.copy(), first.shape[0] - 1
    u, out = np.zeros(max(command.shape[1], 2)), np.empty((parts, int(p[STATES])))
    for e in range(parts):
        # Compiled code does not check indices: a command that is not given has no rows.
        if command.shape[0] > 0:
            for i in range(command.shape[1]):
                u[i] = command[first[e], i]
        for j in range(signals.shape[1]):
            p[SIGNAL + j] = signals[first[e], j]
        out[e] = _initial_state(start[e, 0], start[e, 2], start[e, 3], u, p)
        out[e, VELOCITY] = start[e, 1]
    return out


@kernel
def _subsystems(states, p):
    """The subsystem in which a model is (N,)."""
    out = np.empty(states.shape[0], np.int64)
    for k in range(states.shape[0]):
        out[k] = _subsystem(states[k], p)
    return out


@dataclass(frozen=True, eq=False)
class Inputs:
    """A recording as the driver takes it; shapes and units are those of :func:`drive`."""

    length: Floats  # (N,)
    first: NDArray[np.int64]  # (E + 1,)
    command: Floats | None = None  # (N, 2) or (N, 3)
    pressure: Floats | None = None  # (N, 2)
    # (N, 1) to (N, 4): columns that are not there are 0, which only what is wanted beside the states would show.
    motion: Floats | None = None
    signals: Floats | None = None  # (N, S)
    longest: float = LONGEST_STEP

    @classmethod
    def even(cls, samples: int, period: float, substeps: int = 1, **given: Floats) -> Inputs:
        """A recording in one piece at an even period [s], with so many steps a sample."""
        first = np.array([0, samples])
        return cls(np.full(samples, period), first, longest=period / substeps, **given)  # type: ignore[arg-type]

    @classmethod
    def at(cls, time: Floats, longest: float, first: NDArray[np.int64] | None = None, **given: Floats) -> Inputs:
        """A recording whose rows have a time (N,) [s], in one piece by default."""
        first = np.array([0, len(time)]) if first is None else first
        return cls(np.diff(time, prepend=time[:1]), first, longest=longest, **given)  # type: ignore[arg-type]

    @cached_property
    def _given(self) -> int:
        pairs = ((BY_COMMAND, self.command), (BY_PRESSURE, self.pressure), (BY_MOTION, self.motion))
        return sum(bit for bit, column in pairs if column is not None)

    @cached_property
    def _columns(self) -> tuple[Floats, ...]:
        """Command, pressure, motion and signals as the compiled driver takes them; without rows where not given."""
        motion = self.motion
        if motion is not None and motion.shape[1] < _MOTION:
            motion = np.pad(motion, ((0, 0), (0, _MOTION - motion.shape[1])))
        given = ((self.command, 2), (self.pressure, 2), (motion, _MOTION), (self.signals, 0))
        return tuple(
            np.empty((0, width)) if column is None else np.ascontiguousarray(column, dtype=np.float64)
            for column, width in given
        )

    def vector(self, p: Floats) -> Floats:
        """A parameter vector (P,) for what is given: along a motion the joint is held, with pressures no air flows."""
        p = p.copy()
        if self.pressure is not None:
            # With these zeros, equation (4) keeps the pressures: no flow, and no effect of the volume.
            p[VALVE : VALVE + 2 * VALVE_SIZE] = 0.0
            p[POLYTROPIC_VOLUME] = 0.0
        if self.motion is not None:
            p[LOCKED] = 1.0
            # The motion knows where it ends. With a stop, readings that scatter about it would pump air: a velocity
            # into the stop counts as none, one out of it as it is.
            p[STOP] = math.inf
        return p

    def settled(self, angle: Floats, pressure: Floats, p: Floats, speed: Floats | float = 0.0) -> Floats:
        """States (E, n) of a joint that rested long before each part began, with the commands of its first row.

        Args:
            angle: with which each part begins (E,) [rad].
            pressure: P_1, P_2 (E, 2) [Pa].
            p: parameter vector (P,).
            speed: velocity that the joint suddenly has there (E,) [rad/s].
        """
        command, _, _, signals = self._columns
        start = np.column_stack([angle, np.broadcast_to(speed, len(angle)), pressure])
        return np.asarray(_settled(self.first, start, command, signals, self.vector(p)))

    def driven(self, start: Floats, p: Floats, wanted: int = 0, keeps: NDArray[np.bool_] | None = None) -> Driven:
        """States (N, n) of a model and what is wanted beside them, see :func:`drive`.

        Args:
            start: state with which each part begins (E, n).
            p: parameter vector (P,).
            wanted: a sum of ``TORQUE``, and ``NEEDED`` or ``IMBALANCE``.
            keeps: whether a part goes on from the one before (E,); none by default.
        """
        keeps = np.zeros(len(start), bool) if keeps is None else keeps
        assert self.motion is not None or not wanted & (NEEDED | IMBALANCE)  # compiled code does not check indices
        mask, start = self._given | wanted, np.ascontiguousarray(start)
        return drive(  # type: ignore[no-any-return]
            mask, self.first, start, keeps, self.length, *self._columns, self.vector(p), self.longest
        )

    def driven_each(
        self, starts: Sequence[Floats], vectors: Sequence[Floats], wanted: int = 0,
        keeps: NDArray[np.bool_] | None = None,
    ) -> list[Driven]:  # fmt: skip
        """:meth:`driven` of many models, with the same bits: a group of them in lanes takes little longer than one.

        `starts`: of each model (E, n); n may differ. `vectors`: parameter vector (P,) of each.
        """
        keeps = np.zeros(len(self.first) - 1, bool) if keeps is None else keeps
        assert self.motion is not None or not wanted & (NEEDED | IMBALANCE)
        out: list[Any] = [None] * len(vectors)
        vectors = [self.vector(p) for p in vectors]
        mask, rows = self._given | wanted, len(self.length)
        for group in lanes.groups([[p] for p in vectors]):
            if len(group) < FEWEST or not lanes.possible():
                for k in group:
                    out[k] = self.driven(starts[k], vectors[k], wanted, keeps)
                continue
            # Unused lanes repeat the first model.
            filled = [*group, *group[:1] * (LANES - len(group))]
            start = np.stack([starts[k] for k in filled], axis=2)
            states = np.empty((LANES, rows, start.shape[1]))
            shown = np.zeros((LANES, 2, rows if wanted else 0))
            p, u = lanes.beside([vectors[k] for k in filled]), np.zeros(max(self._columns[0].shape[1], 2))
            x, scratch = np.empty(start.shape[1:]), np.empty((STAGES + 1, *start.shape[1:]))
            drive_lanes(
                mask, self.first, start, keeps, self.length, *self._columns, p, self.longest, states, shown, x, u,
                scratch,
            )  # fmt: skip
            for lane, k in enumerate(group):
                out[k] = states[lane], shown[lane]
        return out


def course(
    x0: Floats, command: Floats, p: Floats, dt: float, substeps: int, signals: Floats | None = None
) -> tuple[Floats, Floats]:
    """The model alone, driven by commands at an even period: states (N, n) and torques (N,) [N m].

    Args:
        x0: state (n,) at the first row.
        command: (N, 2) [V], or (N, 3) with the torque from outside [N m]; row 0 is not used.
        p: parameter vector (P,).
        dt: period of the rows [s].
        substeps: steps of the integration a row.
        signals: further inputs of the model (N, S), if there are any.
    """
    given = {"command": command} if signals is None else {"command": command, "signals": signals}
    states, shown = Inputs.even(len(command), dt, substeps, **given).driven(x0[None], p, TORQUE)
    return states, shown[0]


def simulate(
    x0: Floats, command: Floats, p: Floats, dt: float, substeps: int, signals: Floats | None = None
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """States and torques of :func:`course`, and the subsystem σ (N,) at each row.

    Args:
        x0: state (n,) at the first row.
        command: as for :func:`course`, (N, 2) or (N, 3) [V, N m].
        p: parameter vector (P,).
        dt: period of the rows [s].
        substeps: steps of the integration a row.
        signals: likewise.
    """
    states, torques = course(x0, command, p, dt, substeps, signals)
    return states, torques, np.asarray(_subsystems(states, p))
