"""Clock of a stream of samples: its own period, and whether samples are missing.

Both follow from the stamps since the filter's start alone, never from the time of arrival, so that a replay gets the
same result. A stream may have any rate. Its own period is the median of the last intervals between stamps, or the
rig's nominal period if the median is near it.
"""

from __future__ import annotations

from typing import Any, SupportsFloat

import numpy as np

from pam_antagonist._jit import in_place, merged
from pam_antagonist.errors import BadInput

RESTART_AFTER_NS = 500_000_000
"""[ns] If a stamp is older than the last one by more, the clock was set back; otherwise the sample is late."""
LONGEST_GAP_NS = 1_000_000_000
"""[ns] The filter does not predict over a longer gap."""
PATIENCE = 20
"""Largest number of rejected samples in a row, at any sample rate; with more, the filter is taken to be wrong."""
_FAR = 1.75
"""Samples are missing in an interval of so many own periods, if the own period is not the nominal one."""
_NEAR = 0.25
"""Relative difference within which a stream's period counts as the nominal one: jitter can cause so much."""

RUNNING, LAST, STARTED, REJECTED, _SEEN, _FIRST_DISTANCE = range(6)
_DISTANCES = 9
"""Number of stored intervals between stamps: a ring buffer from ``_FIRST_DISTANCE`` of the clock on."""
CLOCK_SIZE = _FIRST_DISTANCE + _DISTANCES
"""Entries of the clock: whether the filter runs, last stamp [ns], stamp of the start [ns], rejected samples in a row,
number of intervals seen, and the last intervals [ns]."""


_SHORTEST_NS = 50_000
"""[ns] A stream at more than 20 kHz has stamps in another unit."""
_FEW = 5
"""Intervals of a stream that are enough to know the unit of its stamps."""


def whole_ns(stamp_ns: SupportsFloat) -> int:
    """A stamp [ns] as an integer."""
    if isinstance(stamp_ns, (int, np.integer)):
        return int(stamp_ns)
    if isinstance(stamp_ns, float) and stamp_ns.is_integer():
        return int(stamp_ns)
    raise BadInput(f"stamp_ns {stamp_ns!r}: expected a whole number of ns; of seconds, give round(1e9 * seconds)")


def all_ns(stamp_ns: Any) -> np.ndarray:
    """Stamps (N,) [ns] as integers, in an array of their own."""
    given = np.array(stamp_ns)
    try:
        stamps = given.astype(np.int64)
        whole = given.ndim == 1 and bool((stamps == given).all())
    except (TypeError, ValueError):
        whole = False
    if not whole:
        raise BadInput("stamp_ns: expected (N,) whole numbers of ns; of seconds, give np.rint(1e9 * seconds)")
    check_unit(np.diff(stamps))
    return stamps


def check_unit(intervals: np.ndarray) -> None:
    """Refuse stamps that cannot be in ns. `intervals`: between them (M,) [ns]."""
    if len(intervals) >= _FEW and abs(middle := float(np.median(intervals))) < _SHORTEST_NS:
        raise BadInput(f"stamp_ns: the stamps are {middle:g} ns apart; expected ns, not seconds, ms or us")


@in_place
def start(clock, stamp):
    """Set the clock (CLOCK_SIZE,) of a filter that starts at a stamp [ns]."""
    clock[RUNNING] = 1
    clock[LAST] = stamp
    clock[STARTED] = stamp
    clock[REJECTED] = 0
    clock[_SEEN] = 0


def refuse_other_units(clock: np.ndarray) -> None:
    """Refuse the first stamps of a stream if they cannot be in ns. `clock`: of a running filter (CLOCK_SIZE,)."""
    seen = int(clock[_SEEN])
    if seen <= _DISTANCES:
        check_unit(clock[_FIRST_DISTANCE : _FIRST_DISTANCE + seen])


def started_ns(clock: Any) -> int | None:
    """Stamp [ns] of the sample that started the running filter; None if it does not run."""
    return int(clock[STARTED]) if clock[RUNNING] else None


@merged
def own_period(elapsed, clock, nominal):
    """Period of the stream [s]: the median of the last intervals, or the nominal period if that is near.

    `elapsed`: interval since the last stamp [ns]; it is stored. `clock`: of the filter (CLOCK_SIZE,), changed in place.
    `nominal`: the rig's period [s].
    """
    clock[_FIRST_DISTANCE + clock[_SEEN] % _DISTANCES] = elapsed
    clock[_SEEN] += 1
    count = min(clock[_SEEN], _DISTANCES)
    middle = elapsed
    for i in range(count):
        candidate = clock[_FIRST_DISTANCE + i]
        below, equal = 0, 0
        for j in range(count):
            other = clock[_FIRST_DISTANCE + j]
            below += other < candidate
            equal += other == candidate
        # Of an even number, the lower median: a single gap among few intervals must not become the period.
        if below <= (count - 1) // 2 < below + equal:
            middle = candidate
            break
    own = middle / 1e9
    return nominal if abs(own - nominal) <= _NEAR * nominal else own


@merged
def steps_over(elapsed, period, nominal, longest):
    """Steps of the model over the time since the last sample.

    `elapsed`: time since the last sample [ns]. `period`: the stream's own period [s]. `nominal`: the rig's period [s].
    `longest`: approximate length of a step [s]. Returns number of steps; length of each [s]; whether samples are
    missing; and the step with which the last period begins.
    """
    seconds = elapsed / 1e9
    steps = max(1, int(seconds / longest + 0.5))
    dt = seconds / steps
    gap = seconds >= (1.5 if period == nominal else _FAR) * period
    since = steps - max(1, int(period / dt + 0.5)) if gap else 0
    return steps, dt, gap, since
