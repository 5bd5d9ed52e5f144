"""Readings of sensors that are slower than the samples: a repeated one is no new measurement.

A board that converts 33 times a second leaves the same values in several rows of a log at 50 Hz, and so do the messages
of a live stream. A converter with coarse steps repeats values, too, but where the signal moves, the two differ. The
signal moves where a reading differs from the last one by more than a few of the smallest steps that were seen.

* A sensor as quick as the samples changes from row to row there.
* A slow one has stood still in the row before.

So the share of such changes that follow a repeated row tells the two apart. The sensor's own period is the median of
the times between its changes. A sensor that still shows the same values after its own period has measured them anew.

All this follows from values and stamps of the samples up to now, so that a replay finds what the live filter found.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import in_place, merged

_AFTER_REPEAT, _CHANGES, _REPEATED, _AGE, _SINCE, _PERIOD, _VALUES = range(7)
"""Entries of the memory: changes that followed a repeated row and all changes, both fading; whether the last row was
repeated; time since the last reading and since the last change [s]; the sensor's own period [s]; and from ``_VALUES``
on the last values, then the smallest change of each."""
_MOVES = 2.5
"""Changes of more than so many smallest steps are motion."""
_FADING = 0.97
"""Factor by which earlier changes count less: about 33 count."""
_FEWEST = 8.0
"""Changes that are needed before a sensor is called slow."""
_SHARE = 0.35
"""Least share of changes after a repeated row: 0.5 for a sensor with 1.5 rows a reading, 1 for two rows and more. A
quick sensor has the change that ends a rest, one of three or more."""
_FOLLOWS, _NUDGE = 0.3, 0.1
"""Share of a deviation by which the period follows the times between changes, and its largest growth by one of them:
rests are longer. One of less than half the period halves it."""


PRESSURES = _VALUES + 4
"""Numbers in the memory of both pressures."""


def new(columns: int) -> np.ndarray:
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
    sensor, see :func:`new`; changed in place.
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
    slow = memory[_CHANGES] >= _FEWEST and memory[_AFTER_REPEAT] > _SHARE * memory[_CHANGES]
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
def _all(values, stamps, memory, out):
    """:func:`repeats` for every row (N, C) of a recording; ``out`` (N,) is the result."""
    for k in range(values.shape[0]):
        out[k] = repeats(values[k], (stamps[k] - stamps[max(k - 1, 0)]) * 1e-9, memory)


def repeated(values: NDArray[np.float64], stamp_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which rows of a recording repeat the last reading of a slow sensor (N,); none where it is as quick as the log.

    A second pass knows the sensor from its first row on.

    `values`: of the sensor (N, C), such as both pressures, which one board reads. `stamp_ns`: of the rows (N,) [ns].
    """
    columns = np.array(values, dtype=np.float64, order="C")
    stamps, memory, out = np.array(stamp_ns, dtype=np.int64), new(columns.shape[1]), np.zeros(len(columns), dtype=bool)
    for _ in range(2):
        _all(columns, stamps, memory, out)
    return out


def own_period(memory: NDArray[np.float64]) -> float:
    """Period of a sensor that is slower than the samples [s]; NaN for one that is not."""
    slow = memory[_CHANGES] >= _FEWEST and memory[_AFTER_REPEAT] > _SHARE * memory[_CHANGES]
    return float(memory[_PERIOD]) if slow and memory[_PERIOD] > 0.0 else math.nan
