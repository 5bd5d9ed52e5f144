"""A stream of samples: its own period, whether samples are missing, and sensors that are slower than it.

Both follow from the stamps since the filter's start alone, never from the time of arrival, so that a replay gets the
same result. A stream may have any rate. Its own period is the median of the last intervals between stamps, or the
rig's nominal period if the median is near it.

A repeated reading of a slow sensor is no new measurement. A board that converts 33 times a second leaves the same
values in several rows of a log at 50 Hz, and so do the messages of a live stream. A converter with coarse steps repeats
values, too, but where the signal moves, the two differ. The signal moves where a reading differs from the last one by
more than a few of the smallest steps that were seen.

* A sensor as quick as the samples changes from row to row there.
* A slow one has stood still in the row before.

So the share of such changes that follow a repeated row tells the two apart. The sensor's own period is the median of
the times between its changes. A sensor that still shows the same values after its own period has measured them anew.

All this follows from values and stamps of the samples up to now, so that a replay finds what the live filter found.
"""

from __future__ import annotations

import math
from typing import Any, SupportsFloat

import numpy as np
from numpy.typing import NDArray

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


_AFTER_REPEAT, _CHANGES, _REPEATED, _AGE, _SINCE, _PERIOD, _VALUES = range(7)
"""Entries of the memory: changes that followed a repeated row and all changes, both fading; whether the last row was
repeated; time since the last reading and since the last change [s]; the sensor's own period [s]; and from ``_VALUES``
on the last values, then the smallest change of each."""
_MOVES = 2.5
"""Changes of more than so many smallest steps are motion."""
_FADING = 0.97
"""Factor by which earlier changes count less: about 33 count."""
_FEWEST_CHANGES = 8.0
"""Changes that are needed before a sensor is called slow."""
_SHARE = 0.35
"""Least share of changes after a repeated row: 0.5 for a sensor with 1.5 rows a reading, 1 for two rows and more. A
quick sensor has the change that ends a rest, one of three or more."""
_FOLLOWS, _NUDGE = 0.3, 0.1
"""Share of a deviation by which the period follows the times between changes, and its largest growth by one of them:
rests are longer. One of less than half the period halves it."""
PRESSURES = _VALUES + 4
"""Numbers in the memory of the readings of both pressures."""


def new_readings(columns: int) -> np.ndarray:
    """Memory of a sensor with some columns that has not been read (_VALUES + 2 columns,)."""
    memory = np.zeros(_VALUES + 2 * columns)
    memory[_VALUES : _VALUES + columns] = np.nan
    memory[_VALUES + columns :] = np.inf
    return memory


@in_place
def forget(memory):
    """Make the memory that of a sensor that has not been read."""
    columns = (memory.shape[0] - _VALUES) // 2
    for i in range(memory.shape[0]):
        memory[i] = 0.0 if i < _VALUES else (np.nan if i < _VALUES + columns else np.inf)


@merged
def repeats(values, elapsed, memory):
    """Whether a sample only repeats the last reading of a slow sensor.

    `values`: of the sample (C,), all from one board. `elapsed`: time since the last sample [s]. `memory`: of the
    sensor, see :func:`new_readings`; changed in place.
    """
    columns = len(values)
    memory[_AGE] += elapsed
    memory[_SINCE] += elapsed
    changed, moves = False, False
    for i in range(columns):
        step = abs(values[i] - memory[_VALUES + i])
        if step > 0.0:
            changed = True
            memory[_VALUES + columns + i] = min(memory[_VALUES + columns + i], step)
            moves = moves or step > _MOVES * memory[_VALUES + columns + i]
        elif not step == 0.0:  # missing, or the first one
            if not math.isfinite(values[i]):
                return False
            changed = True
    slow = memory[_CHANGES] >= _FEWEST_CHANGES and memory[_AFTER_REPEAT] > _SHARE * memory[_CHANGES]
    if not changed:
        memory[_REPEATED] = 1.0
        if slow and memory[_AGE] < memory[_PERIOD]:
            return True
        memory[_AGE] = 0.0
        return False
    if moves:
        memory[_AFTER_REPEAT] = _FADING * memory[_AFTER_REPEAT] + memory[_REPEATED]
        memory[_CHANGES] = _FADING * memory[_CHANGES] + 1.0
        period, since = memory[_PERIOD], memory[_SINCE]
        if period == 0.0:
            memory[_PERIOD] = since
        elif since < 0.5 * period:
            memory[_PERIOD] = 0.5 * period
        else:
            memory[_PERIOD] += min(_FOLLOWS * (since - period), _NUDGE * period)
    for i in range(columns):
        memory[_VALUES + i] = values[i]
    memory[_REPEATED] = memory[_AGE] = memory[_SINCE] = 0.0
    return False


@in_place
def _repeats_all(values, stamps, memory, out):
    """:func:`repeats` for every row (N, C) of a recording; ``out`` (N,) is the result."""
    for k in range(values.shape[0]):
        out[k] = repeats(values[k], (stamps[k] - stamps[max(k - 1, 0)]) * 1e-9, memory)


def repeated(values: NDArray[np.float64], stamp_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which rows of a recording repeat the last reading of a slow sensor (N,); none where it is as quick as the log.

    A second pass knows the sensor from its first row on.

    `values`: of the sensor (N, C), such as both pressures, which one board reads. `stamp_ns`: of the rows (N,) [ns].
    """
    columns = np.array(values, dtype=np.float64, order="C")
    stamps, memory, out = (
        np.array(stamp_ns, dtype=np.int64),
        new_readings(columns.shape[1]),
        np.zeros(len(columns), dtype=bool),
    )
    for _ in range(2):
        _repeats_all(columns, stamps, memory, out)
    return out
