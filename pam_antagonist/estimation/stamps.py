"""Clock of a stream of samples: its own period, and whether samples are missing.

Both follow from the stamps since the filter's start alone, never from the time of arrival, so that a replay gets the
same result. A stream may have any rate. Its own period is the median of the last intervals between stamps, or the
rig's nominal period if the median is near it.
"""

from __future__ import annotations

from typing import Any

from pam_antagonist._jit import in_place, merged

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


@in_place
def start(clock, stamp):
    """Set the clock (CLOCK_SIZE,) of a filter that starts at a stamp [ns]."""
    clock[RUNNING] = 1
    clock[LAST] = stamp
    clock[STARTED] = stamp
    clock[REJECTED] = 0
    clock[_SEEN] = 0


def started_ns(clock: Any) -> int | None:
    """Stamp [ns] of the sample that started the running filter; None if it does not run."""
    return int(clock[STARTED]) if clock[RUNNING] else None


@merged
def own_period(elapsed, clock, nominal):
    """Period of the stream [s]: the median of the last intervals, or the nominal period if that is near.

    Args:
        elapsed: interval since the last stamp [ns]; it is stored.
        clock: of the filter (CLOCK_SIZE,), changed in place.
        nominal: the rig's period [s].
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

    Args:
        elapsed: time since the last sample [ns].
        period: the stream's own period [s].
        nominal: the rig's period [s].
        longest: approximate length of a step [s].

    Returns:
        Number of steps; length of each [s]; whether samples are missing; and the step with which the last period
        begins.
    """
    seconds = elapsed / 1e9
    steps = max(1, int(seconds / longest + 0.5))
    dt = seconds / steps
    gap = seconds >= (1.5 if period == nominal else _FAR) * period
    since = steps - max(1, int(period / dt + 0.5)) if gap else 0
    return steps, dt, gap, since
