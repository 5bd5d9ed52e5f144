"""What stamps tell of a stream: how old a sample is, the stream's own period, and whether samples are missing.

All of it follows from the stamps since the filter's start alone, never from the time of arrival, so that a replay finds
the same. A stream may have any rate. Its own period is the median of the last distances between stamps. It is the rig's
nominal period where it is near that.
"""

from __future__ import annotations

from typing import Any

from pam_antagonist._jit import in_place, merged

RESTART_AFTER_NS = 500_000_000
"""[ns] Set back by more, a clock was set anew, and no sample is late."""
LONGEST_GAP_NS = 1_000_000_000
"""[ns] Over more without samples nothing is predicted."""
_FAR = 1.75
"""Own periods of an estimated size from one sample to the next, from which on samples are missing between them."""
_NEAR = 0.25
"""Relative difference of a stream's period from the nominal one that jitter may make."""

RUNNING, LAST, STARTED, REJECTED, _SEEN, _FIRST_DISTANCE = range(6)
_DISTANCES = 9
"""Distances between stamps that are remembered, in a ring from ``_FIRST_DISTANCE`` of the clock on."""
CLOCK_SIZE = _FIRST_DISTANCE + _DISTANCES
"""Whether the filter runs, last stamp [ns], stamp of the start [ns], rejected samples in a row, how many distances
between stamps were seen, and the last of these [ns]."""


@in_place
def start(clock, stamp):
    """Set the clock (CLOCK_SIZE,) of a filter that starts at a stamp [ns]."""
    clock[RUNNING] = 1
    clock[LAST] = stamp
    clock[STARTED] = stamp
    clock[REJECTED] = 0
    clock[_SEEN] = 0


def started_ns(clock: Any) -> int | None:
    """Stamp of the sample that the running filter was started with, None before the first."""
    return int(clock[STARTED]) if clock[RUNNING] else None


@merged
def own_period(elapsed, clock, nominal):
    """Period of the stream [s]: the median of the last distances, the nominal one where that is near.

    Args:
        elapsed: distance from the last stamp [ns]; it is remembered.
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
        # The lower of the two in the middle of an even number: a gap among few distances is no period.
        if below <= (count - 1) // 2 < below + equal:
            middle = candidate
            break
    own = middle / 1e9
    return nominal if abs(own - nominal) <= _NEAR * nominal else own


@merged
def steps_over(elapsed, period, nominal, longest):
    """Steps of the model over the time since the last sample.

    Args:
        elapsed: that time [ns].
        period: the stream's own [s].
        nominal: the rig's [s].
        longest: what a step takes, about [s].

    Returns:
        How many; what each takes [s]; whether samples are missing; and the step with which the last period begins.
    """
    seconds = elapsed / 1e9
    steps = max(1, int(seconds / longest + 0.5))
    dt = seconds / steps
    gap = seconds >= (1.5 if period == nominal else _FAR) * period
    since = steps - max(1, int(period / dt + 0.5)) if gap else 0
    return steps, dt, gap, since
