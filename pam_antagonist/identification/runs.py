"""Recordings as runs: what an identification from measured pressures works on.

A run is a stretch without a hole, from one recording or one of its episodes. Long recordings at a kilohertz and short
trials at 20 Hz become the same thing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.recording.rows import SLOW, between, slow

Floats = NDArray[np.float64]
_Rows = NDArray[np.bool_]

_SHORTEST = 1.0
"""[s] A shorter stretch is left out."""
_FEWEST = 5
"""Fewest rows of a run."""
_FINEST = 4e-3
"""[s] Rows that follow each other more quickly are averaged: the joint moves little in between."""
_JITTER = 2e-3
"""They are not where the commands within such a time scatter by more than this share of their range: a valve that opens
and closes by turns passes more air than one at their mean. One simulated joint, whose loop passed on its sensors' noise
at 1 kHz, was in view: it scattered by 2 %, and pressures were off by 50 kPa after a second."""
_AHEAD = 9.0 / 16.0
"""Share of a pressure's change in the middle of a row: of an exponential whose time constant is two rows."""
_SWING, _LEAST_SWING = 0.2, 1e4
"""Pressures swing from row to row if the RMS of their distance [Pa] from the middle of both neighbours is more, as a
share of their standard deviation too. Sixteen simulated rigs have a share of at most 0.023, two whose pressure loop
swings 0.5 and 1.2 at least."""
SWINGS = "swing from row to row"
"""What is said of such pressures."""
_HOLE = 2.5
"""A distance of more median periods is a hole."""


@dataclass(frozen=True, eq=False)
class Run:
    """A stretch of a recording without a hole (N rows)."""

    name: str
    time: Floats  # from the begin of the recording (N,) [s]
    pressure: Floats  # measured (N, 2) [Pa]
    command: Floats  # voltages [V] or commanded pressures [Pa] over the row's step (N, 2); NaN where unknown
    angle: Floats  # measured (N,) [rad], NaN where missing
    torque: Floats  # measured (N,) [N m], NaN where missing
    velocity: Floats  # slope of the measured angle (N,) [rad/s], 0 where unknown
    locked: bool
    slow: tuple[str, ...]  # sensors that are slower than the log; their values are linear between their own readings

    def __len__(self) -> int:
        return len(self.time)

    @property
    def period(self) -> float:
        """Mean distance of rows [s]."""
        return float(self.time[-1] - self.time[0]) / (len(self) - 1)

    @property
    def moves(self) -> bool:
        """Whether the joint is free and its angle was measured."""
        return not self.locked and bool(np.isfinite(self.angle).any())

    @cached_property
    def acceleration(self) -> Floats:
        """Slope of :attr:`velocity` (N,) [rad/s²], 0 where unknown."""
        return _slope(self.time, self.velocity)

    @cached_property
    def smoothed(self) -> Floats:
        """Pressures (N, 2) [Pa] over the window of :attr:`acceleration`: means of the means of as many rows."""
        size = 2 * _reach(self.time)
        return uniform_filter1d(uniform_filter1d(self.pressure, size, axis=0), size, axis=0, origin=-1)

    def part(self, begin_s: float, end_s: float) -> Run | None:
        """The rows in a time span [s]; None if they are too few."""
        rows = np.flatnonzero((self.time >= begin_s) & (self.time < end_s))
        if len(rows) < 3 or self.time[rows[-1]] - self.time[rows[0]] < _SHORTEST:
            return None
        return self._rows(slice(int(rows[0]), int(rows[-1]) + 1))

    def commanded(self) -> list[Run]:
        """The stretches in which all commands are known."""
        known = np.flatnonzero(np.isfinite(self.command).all(axis=1))
        stretches = [rows for rows in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1) if len(rows) > 2]
        long = [rows for rows in stretches if self.time[rows[-1]] - self.time[rows[0]] >= _SHORTEST]
        return [self._rows(slice(int(rows[0]), int(rows[-1]) + 1)) for rows in long]

    def finer(self) -> Run:
        """This run with a row between any two, where the pressures are ahead of a straight line and readings unknown.

        A valve or regulator that is set once a row moves a pressure quickly at first, then slowly.
        """
        count = 2 * len(self) - 1
        time, pressure, angle, torque = (np.full((count, *column.shape[1:]), np.nan)
                                         for column in (self.time, self.pressure, self.angle, self.torque))  # fmt: skip
        time[::2], pressure[::2], angle[::2], torque[::2] = self.time, self.pressure, self.angle, self.torque
        time[1::2] = 0.5 * (self.time[1:] + self.time[:-1])
        pressure[1::2] = self.pressure[:-1] + _AHEAD * np.diff(self.pressure, axis=0)
        both = np.arange(count) // 2
        return replace(
            self, time=time, pressure=pressure, command=self.command[both], angle=angle, torque=torque,
            velocity=self.velocity[both],
        )  # fmt: skip

    def first(self, count: int) -> Run:
        """Its first rows."""
        return self._rows(slice(count))

    def _rows(self, cut: slice) -> Run:
        return replace(
            self, time=self.time[cut], pressure=self.pressure[cut], command=self.command[cut], angle=self.angle[cut],
            torque=self.torque[cut], velocity=self.velocity[cut],
        )  # fmt: skip


def runs_of(recording: Recording, state: JointCondition, name: str) -> list[Run]:
    """The runs of a recording."""
    again = slow(recording)
    found = [run for rows in _stretches(recording) if (run := _run(recording, rows, state, name, again)) is not None]
    if not found:
        raise BadInput(
            f"{name}: no stretch of {_SHORTEST:g} s without a hole, with both pressures; expected at least one"
        )
    return found


def _stretches(recording: Recording) -> Iterator[NDArray[np.intp]]:
    """Rows with both pressures, between holes and between episodes."""
    known = np.flatnonzero(np.isfinite(recording.pressure).all(axis=1))
    bound = _HOLE * recording.sample_period_s * 1e9
    for episode in recording.episodes:
        rows = known[(known >= episode.start) & (known < episode.stop)]
        if len(rows):
            yield from np.split(rows, np.flatnonzero(np.diff(recording.stamp_ns[rows]) > bound) + 1)


def is_long(time: Floats) -> bool:
    """Whether a stretch with rows at such times (N,) [s] tells something."""
    return bool(time[-1] - time[0] >= _SHORTEST)


def _run(
    recording: Recording, rows: NDArray[np.intp], state: JointCondition, name: str, again: Mapping[str, _Rows]
) -> Run | None:
    time = recording.time_s[rows]
    if len(rows) < _FEWEST or not is_long(time):
        return None
    slow_rows = {sensor: repeats[rows] for sensor, repeats in again.items()}
    pressure = between(time, recording.pressure[rows], slow_rows.get("pressures"))
    missing, locked = np.full(len(rows), np.nan), state.condition == "locked"
    angle = missing if recording.angle is None else between(time, recording.angle[rows], slow_rows.get("angle"))
    angle = np.full(len(rows), state.lock_angle) if locked and not np.isfinite(angle).any() else angle
    torque = missing if recording.torque is None else between(time, recording.torque[rows], slow_rows.get("torque"))
    # The lag of a regulator is as short as some rows.
    finest = 0.0 if recording.drive == "regulator" else _FINEST
    command, size = recording.voltage[rows], int(finest / recording.sample_period_s + 1e-6)
    size = 1 if size > 1 and _jitters(command, size) else size
    if size > 1:
        # A command belongs to the step that ends at its row: here, to the time between the means of two blocks.
        command = np.concatenate([np.repeat(command[:1], size // 2, axis=0), command[: -(size // 2)]])
    columns = np.column_stack([time, pressure, command, angle, torque])
    if size > 1:
        whole = len(columns) // size * size
        columns = columns[:whole].reshape(-1, size, columns.shape[1]).mean(axis=1)
    time, angle = columns[:, 0], columns[:, 5]
    return Run(
        name, time, columns[:, 1:3], columns[:, 3:5], angle, columns[:, 6], _slope(time, angle), locked, tuple(again)
    )  # fmt: skip


def _jitters(command: Floats, size: int) -> bool:
    """Whether commands (N, 2) scatter within most blocks of so many rows."""
    blocks = command[: len(command) // size * size].reshape(-1, size, 2)
    known = blocks[np.isfinite(blocks).all(axis=(1, 2))]
    if not len(known):
        return False
    return bool(np.any(np.median(known.std(axis=1), axis=0) > _JITTER * np.ptp(known, axis=(0, 1))))


def _slope(time: Floats, angle: Floats) -> Floats:
    """Velocity over a window of about 40 ms, two rows at least, to both sides."""
    reach = _reach(time)
    out = np.zeros(len(time))
    if len(time) > 2 * reach:
        moved = angle[2 * reach :] - angle[: -2 * reach]
        out[reach:-reach] = moved / (time[2 * reach :] - time[: -2 * reach])
    return np.nan_to_num(out)


def _reach(time: Floats) -> int:
    """Rows in 20 ms, one at least."""
    return max(round(0.02 / max(float(np.median(np.diff(time))), 1e-6)), 1)


def notes_of(runs: Sequence[Run]) -> tuple[str, ...]:
    """What a user should know of the runs, in sentences."""
    names = {sensor: dict.fromkeys(run.name for run in runs if sensor in run.slow) for sensor in SLOW}
    slow_ones = tuple(
        f"The {sensor} of {', '.join(of)} {'repeat' if sensor == 'pressures' else 'repeats'} from row to row: the "
        "sensor is slower than the log. Values between its readings are interpolated."
        for sensor, of in names.items() if of
    )  # fmt: skip
    swinging = dict.fromkeys(run.name for run in runs if _swings(run))
    if not swinging:
        return slow_ones
    return (*slow_ones, f"The pressures of {', '.join(swinging)} {SWINGS}: what they do in between is not "
            "known, and moves the joint. Calm the loop that sets the valves, or log faster.")  # fmt: skip


def _swings(run: Run) -> bool:
    """Whether a row of the pressures does not tell what they are in its middle."""
    apart = np.sqrt(np.mean((run.pressure[1:-1] - 0.5 * (run.pressure[2:] + run.pressure[:-2])) ** 2, axis=0))
    return bool((apart > np.maximum(_SWING * np.std(run.pressure, axis=0), _LEAST_SWING)).any())
