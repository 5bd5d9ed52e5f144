"""What consecutive rows tell: unmarked resets, and readings that a slow sensor repeats.

A file of many short recordings has resets where its episode column is lost and its time runs on. Because of inertia,
the angle moves in one row about as far as in the rows around it. A row with a much larger move, after which the angle
stays, is a reset. Nor can the pressure of a muscle jump within a few milliseconds. Where one sensor jumps and
all others go on, its zero jumped, whether or not an episode is marked there.

Where a sensor is slower than the log, the log repeats a reading until the next one comes. A repeated reading is no
measurement (:mod:`pam_antagonist.estimation.stamps` tells it from a coarse converter). A fit takes straight lines
between the readings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pam_antagonist.recording.recording import Recording

Floats = NDArray[np.float64]

_LEAST_ANGLE, _LEAST_PRESSURE = math.radians(3.0), 20e3
"""[rad], [Pa] Smaller jumps may be noise."""
_LONGEST_ANGLE_ROW, _LONGEST_PRESSURE_ROW = 21e-3, 3e-3
"""[s] Longest period between rows; in a longer one a joint, or the air of a muscle, can move and come to rest."""
_ROWS = 3
"""Number of rows on either side that a move is compared with."""
_FURTHER = 3.0
"""A reset exceeds the range of the moves around it by at least this many times the range."""
_GAP = 1.5
"""Rows are missing between rows that are more than this many periods apart; the joint may move in between."""
_STEPS = 4.0
"""Smallest reset, in steps of a coarse encoder."""
_SHOWN = 3


@dataclass(frozen=True)
class Resets:
    """Resets of a recording, or jumps of one sensor's zero."""

    signal: str
    rows: tuple[int, ...]  # first rows after the jumps (K,)
    times: tuple[float, ...]  # times of these rows from the start of the recording (K,) [s]
    size: str  # of the first jump, with its unit
    alone: bool = False  # whether all other signals go on

    @property
    def sentence(self) -> str:
        """The observation, its likely cause, and the remedy."""
        where = ", ".join(f"{time:.3f}" for time in self.times[:_SHOWN]) + (" ..." if len(self.times) > _SHOWN else "")
        places = f"at {len(self.times)} places" if len(self.times) > 1 else "at one place"
        if self.alone:
            return (
                f"{self.signal} jumps {places} from one row to the next, at {where} s, first by {self.size}, and all "
                "other signals go on: the zero of this sensor jumped, as by an index pulse, lost counts or an "
                "exchanged plug; use only a part in which it stays"
            )
        return (
            f"{self.signal} jumps {places} from one row to the next, at {where} s: these look like several recordings "
            "in one, without a mark where each begins; name the column that counts them in the map of import_csv "
            "(episode: COLUMN), or publish the topic episode (std_msgs/Header) as each begins"
        )


def resets(recording: Recording) -> Resets | None:
    """Unmarked resets of a recording in SI units, or jumps of one sensor's zero; None where there are none."""
    if len(recording) < 4 * _ROWS:
        return None
    apart = np.diff(recording.stamp_ns) * 1e-9
    period = float(np.median(apart))
    joined = apart <= _GAP * period
    marked = np.zeros(0, dtype=np.intp)
    if recording.episode_ns is not None:
        marked = np.searchsorted(recording.stamp_ns, recording.episode_ns[1:])
    signals = [("the measured angle", recording.angle, recording.angle, _LEAST_ANGLE, _LONGEST_ANGLE_ROW)]
    measured = [k for k in (0, 1) if k not in recording.logged_commands]
    signals += [
        (f"pressure_{k + 1}", recording.pressure, recording.pressure[:, k], _LEAST_PRESSURE, _LONGEST_PRESSURE_ROW)
        for k in measured
    ]
    for name, sensor, values, least, longest in signals:
        if sensor is None or values is None or period > longest:
            continue
        rows = _jumps(values, joined, least)
        if len(rows) and (again := _repeated(sensor, recording.stamp_ns)).any():
            # From one reading of a slow sensor to the next the joint moves on.
            rows = np.zeros(0, dtype=np.intp)
            own = np.flatnonzero(~again)
            steps = np.diff(recording.stamp_ns[own]) * 1e-9
            if float(np.median(steps)) <= longest:
                whole = np.logical_and.reduceat(joined, own[:-1])
                rows = own[_jumps(values[own], whole & (steps <= _GAP * np.median(steps)), least)]
        if len(rows):
            alone = np.array([_others_go_on(recording, name, int(row)) for row in rows])
            jumped = 2 * int(alone.sum()) > len(rows)
            rows = rows[alone] if jumped else np.setdiff1d(rows, marked)
        if len(rows):
            since = (recording.stamp_ns[rows] - recording.stamp_ns[0]) * 1e-9
            by = float(values[rows[0]] - values[rows[0] - 1])
            size = f"{np.degrees(by):+.1f}°" if values is recording.angle else f"{by / 1e3:+.3g} kPa"
            return Resets(name, tuple(rows.tolist()), tuple(since.tolist()), size, jumped)
    return None


def _others_go_on(recording: Recording, name: str, row: int) -> bool:
    """Whether no other sensor jumps at a row; false where no other was measured."""
    sensors = {"the measured angle": recording.angle, "the measured torque": recording.torque}
    sensors |= {f"pressure_{k + 1}": recording.pressure[:, k] for k in (0, 1) if k not in recording.logged_commands}
    others = (values for other, values in sensors.items() if values is not None and other != name)
    known = [seen for values in others if (seen := _goes_on(values, row)) is not None]
    return bool(known) and all(known)


def _goes_on(values: Floats, row: int) -> bool | None:
    """Whether a signal (N,) moves over a few rows around a row as it does beside it; None where it is not known."""
    middle = np.arange(row - 5 * _ROWS, row + 5 * _ROWS + 1)
    middle = middle[(middle >= _ROWS) & (middle < len(values) - _ROWS)]
    moved = values[middle + _ROWS - 1] - values[middle - _ROWS]
    beside = np.abs(middle - row) >= 2 * _ROWS
    here = moved[middle == row]
    if not len(here) or not beside.any() or not np.isfinite(moved).all():
        return None
    low, high = min(float(moved[beside].min()), 0.0), max(float(moved[beside].max()), 0.0)
    return bool(low - _FURTHER * (high - low) <= here[0] <= high + _FURTHER * (high - low))


def _jumps(values: Floats, joined: NDArray[np.bool_], least: float) -> NDArray[np.intp]:
    """First rows after a jump of a signal (N,); ``joined``: no time is missing up to the next row (N - 1,)."""
    moved = np.where(joined, np.diff(values), np.nan)
    sizes = np.abs(moved)
    least = max(least, _STEPS * np.min(sizes, initial=np.inf, where=sizes > 0.0))
    candidates = np.flatnonzero(sizes > least)
    candidates = candidates[(candidates >= _ROWS) & (candidates < len(moved) - _ROWS)]
    if len(candidates) == 0:
        return candidates
    beside = np.concatenate([np.arange(-_ROWS, 0), np.arange(1, _ROWS + 1)])
    around = moved[candidates[:, None] + beside]
    known = np.isfinite(around).all(axis=1)
    candidates, around = candidates[known], around[known]
    low, high = around.min(axis=1, initial=np.inf), around.max(axis=1, initial=-np.inf)
    low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    beyond = np.maximum(moved[candidates] - high, low - moved[candidates])
    return np.asarray(candidates[beyond > np.maximum(least, _FURTHER * (high - low))] + 1)


_FEWEST_READINGS = 64
"""Fewer tell no period."""
_MOST_LOST = 1.15
"""Times as many readings as are seen, since equal ones are not seen as new."""
_STEADY = 1.1
"""Largest range of the readings' ages, in rows of the log: 1 but for the jitter of its stamps."""
_FEW_REPEATS = 0.1
"""A sensor that repeats fewer of its readings is as quick as the log."""

_EVEN = 0.5
"""Of the distances between changes of a slow sensor, the 5 % quantile is at least this share of the 25 % quantile. A
sensor with 1.5 rows a reading has 1; the distances of chance have 0.18."""

SLOW = ("pressures", "angle", "torque")
"""Sensors that may be slower than the log. One board reads both pressures."""


def slow(recording: Recording) -> dict[str, NDArray[np.bool_]]:
    """Rows that repeat the last reading (N,), of each sensor that is slower than the log, by its name in ``SLOW``."""
    columns = zip(SLOW, (recording.pressure, recording.angle, recording.torque), strict=True)
    found = {name: _repeated(values, recording.stamp_ns) for name, values in columns if values is not None}
    return {name: again for name, again in found.items() if again.any()}


def own_readings(recording: Recording) -> tuple[Floats, Floats | None, Floats | None]:
    """Pressures (N, 2), angle (N,) and torque (N,) to judge by: NaN where a slow sensor's last reading is repeated."""
    again = slow(recording)

    def of(name: str, values: Floats | None) -> Floats | None:
        if values is None or name not in again:
            return values
        return np.where(again[name] if values.ndim == 1 else again[name][:, None], np.nan, values)

    pressure = of("pressures", recording.pressure)
    assert pressure is not None
    return pressure, of("angle", recording.angle), of("torque", recording.torque)


def slow_sentence(name: str, again: NDArray[np.bool_]) -> str:
    """What a user should know of a slow sensor, one of ``SLOW``; ``again``: rows that repeat its last reading (N,)."""
    subject, verb = ("both pressures", "repeat") if name == "pressures" else (f"the measured {name}", "repeats")
    return (
        f"{subject} {verb} the last reading in {100 * again.mean():.0f} % of the rows: the sensor is slower than the "
        "log, and a repeated reading is not used again"
    )


def _repeated(values: Floats, stamp_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    columns = values if values.ndim == 2 else values[:, None]
    moved = np.diff(columns, axis=0)
    # A slow sensor changes at one distance while the signal moves; one that shows a joint at rest, at any distance.
    apart = np.diff(np.flatnonzero((np.abs(moved) > 0.0).any(axis=1)))
    steady = len(apart) > 0 and float(np.quantile(apart, 0.05)) >= _EVEN * float(np.quantile(apart, 0.25))
    if not steady or (moved == 0.0).all(axis=1).sum() <= _FEW_REPEATS * len(columns):
        return np.zeros(len(columns), dtype=bool)
    from ..estimation.stamps import repeated  # takes a second, which most recordings do not need

    return repeated(columns, stamp_ns)


def between(time: Floats, values: Floats, again: NDArray[np.bool_] | None) -> Floats:
    """Values of a slow sensor (N,) or (N, C), linear between its own readings; ``again``: rows that repeat one (N,)."""
    if again is None or not again.any():
        return values
    columns = values if values.ndim == 2 else values[:, None]
    fresh = np.concatenate([[True], (np.diff(columns, axis=0) != 0.0).any(axis=1)])
    taken = time.copy()
    taken[fresh] = reading_times(time[fresh], float(np.median(np.diff(time))))
    known = ~again & np.isfinite(columns).all(axis=1)
    known[-1] |= bool(np.isfinite(columns[-1]).all())
    if known.sum() < 2:
        return values
    lines = np.column_stack([np.interp(time, taken[known], column[known]) for column in columns.T])
    return np.asarray(np.where(np.isfinite(columns), lines, np.nan).reshape(values.shape))


def curve(there: Floats, time: Floats, values: Floats, slope: Floats | None = None) -> Floats:
    """Values (N,) of a signal at other times (K,) [s], on cubics through its rows; NaN outside of them.

    A straight line cuts the bends of a quick motion: at 50 rows a second and 5 Hz by a degree of 30. Beside a missing
    row it is one all the same.

    `slope`: of the signal at its rows (N,); None: by the rows around each.
    """
    k = np.clip(np.searchsorted(time, there, side="right") - 1, 0, len(time) - 2)
    length, slope = np.diff(time)[k], np.gradient(values, time) if slope is None else slope
    share, step = (there - time[k]) / length, values[k + 1] - values[k]
    bend = (1.0 - share) * (slope[k] * length - step) - share * (slope[k + 1] * length - step)
    # At a row itself its neighbours do not count, be they missing.
    found = np.where(share == 0.0, values[k], values[k] + share * (step + (1.0 - share) * np.nan_to_num(bend)))
    return np.asarray(np.where((there < time[0]) | (there > time[-1]), np.nan, found))


def reading_times(time: NDArray[np.float64], period_s: float) -> NDArray[np.float64]:
    """When a slow sensor took its readings (K,) [s], but for a constant delay; as logged if it has no steady period.

    The log shows a reading in its next row. So the reading's age varies by up to a row, which a quick joint
    shows. A sensor with a period of its own has taken its readings at one distance.

    `time`: of the rows that show a new reading first (K,) [s].
    """
    if len(time) < _FEWEST_READINGS:
        return time
    since, count = time - time[0], _FEWEST_READINGS
    # Of the periods that explain the first readings the longest one: it has lost the fewest.
    tried = since[count - 1] / np.arange(count - 1, _MOST_LOST * count, 0.05)
    period = next((one for one in tried if _spread(since[:count], one)[0] <= _STEADY * period_s), math.nan)
    while math.isfinite(period) and count < len(time):
        count = min(2 * count, len(time))
        # Over a longer part, the period is known more exactly.
        near = period + 1.2 * period_s / count * np.linspace(-2.0, 2.0, 121)
        period = min(near, key=lambda one: _spread(since[:count], one)[0])
    if not math.isfinite(period):
        return time
    spread, first = _spread(since, period)
    if spread > _STEADY * period_s:
        return time
    age = (since - first) % period
    taken = since - age
    if np.diff(taken).min() < 0.5 * period:  # two readings in one period: it is none
        return time
    return np.asarray(time[0] + taken + age.mean())


def _spread(time: NDArray[np.float64], period: float) -> tuple[float, float]:
    """Length of the shortest arc of a period that holds all times [s], and its begin [s]."""
    phase = np.sort(time % period)
    gap = np.diff(phase, append=phase[0] + period)
    widest = int(np.argmax(gap))
    return float(period - gap[widest]), float(phase[(widest + 1) % len(phase)])
