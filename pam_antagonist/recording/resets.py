"""Unmarked resets: the angle or a pressure jumps from one row to the next, although no time is missing.

A file of many short recordings has such jumps where its episode column is lost and its time runs on. Because of
inertia, the angle moves in one row about as far as in the rows around it. A row with a much larger move, after which
the angle stays, is a reset. Nor can the pressure of a muscle jump within a few milliseconds.
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
    """Resets of a recording.

    Attributes:
        rows: first rows after the jumps (K,).
        times: times of these rows from the start of the recording (K,) [s].
    """

    signal: str
    rows: tuple[int, ...]
    times: tuple[float, ...]

    @property
    def sentence(self) -> str:
        """The observation, its likely cause, and the remedy."""
        where = ", ".join(f"{time:.3f}" for time in self.times[:_SHOWN]) + (" ..." if len(self.times) > _SHOWN else "")
        places = f"at {len(self.times)} places" if len(self.times) > 1 else "at one place"
        return (
            f"{self.signal} jumps {places} from one row to the next, at {where} s: these look like several recordings "
            "in one, without a mark where each begins; name the column that counts them in the map of import_csv "
            "(episode: COLUMN), or publish the topic episode (std_msgs/Header) as each begins"
        )


def resets(recording: Recording) -> Resets | None:
    """Unmarked resets of a recording; None where there are none."""
    if len(recording) < 4 * _ROWS:
        return None
    apart = np.diff(recording.stamp_ns) * 1e-9
    period = float(np.median(apart))
    joined = apart <= _GAP * period
    if recording.episode_ns is not None:
        joined[np.searchsorted(recording.stamp_ns, recording.episode_ns[1:]) - 1] = False
    signals = [("the measured angle", recording.angle, _LEAST_ANGLE, _LONGEST_ANGLE_ROW)]
    measured = [k for k in (0, 1) if k not in recording.logged_commands]
    signals += [
        (f"pressure_{k + 1}", recording.pressure[:, k], _LEAST_PRESSURE, _LONGEST_PRESSURE_ROW) for k in measured
    ]
    for name, values, least, longest in signals:
        if values is None or period > longest:
            continue
        rows = _jumps(values, joined, least)
        if len(rows):
            since = (recording.stamp_ns[rows] - recording.stamp_ns[0]) * 1e-9
            return Resets(name, tuple(rows.tolist()), tuple(since.tolist()))
    return None


def _jumps(values: Floats, joined: NDArray[np.bool_], least: float) -> NDArray[np.intp]:
    """First rows after a jump.

    Args:
        values: a signal (N,), NaN where missing.
        joined: whether no time is missing between a row and the next (N - 1,).
    """
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
