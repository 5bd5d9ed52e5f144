"""Readings that are no measurement: lost ones, held ones, and those at the end of a sensor's range.

All functions judge one column of readings, in any unit, of a recording or of a short window of a live stream.

* A **lost** reading is one exact value, far from the readings before and after it, which are near each other. A bus
  that returns nothing leaves such rows, often zeros. Noise and motion never give the same number again and again.
* At the **end of its range** a sensor gives exactly its largest or least value, row after row, in several stretches. A
  sensor with noise gives no value twice in a row for long. One without noise repeats its readings elsewhere, too; then
  nothing is said.
* A **held** reading repeats for much longer than any other, as from a driver that hangs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .notes import Issue
from .plausible import STANDARD_ATMOSPHERE

if TYPE_CHECKING:
    from .recording import Recording

Floats = NDArray[np.float64]
Rows = NDArray[np.bool_]
Kind = Literal["lost", "end", "held"]

_FEWEST = 50
"""Fewer rows tell nothing."""
_FAR, _FAR_OF_RANGE, _FAR_STEPS = 10.0, 0.02, 5.0
"""A reading is far from its neighbours by so many usual changes from row to row, by this share of the range, and by so
many of the sensor's steps."""
_BACK = 0.25
"""After a lost reading the signal is back within this share of the distance."""
_FEWEST_LOST, _SAME = 3, 0.5
"""Lost readings are so many at least, and this share of all that stand out has one exact value."""
_LONGEST_LOST = 20
"""Rows that are lost in one piece at most."""
_LONG, _LONGER = 5, 4.0
"""A stretch of equal readings is long from so many rows on, and from so many times the usual stretch on."""
_AT_END, _VISITS, _ENDLESS = 0.005, 2, 50.0
"""At the end of its range a sensor is in this share of the rows at least, in so many long stretches. One alone has so
many times the usual length, and does not begin the recording, where a joint rests."""
_ELSEWHERE = 0.2
"""Largest share of equal readings elsewhere, by those at the end: with more, the sensor repeats its readings anyway."""
_HELD_S, _HELD_ROWS = 0.1, 10
"""A held reading lasts longer than both."""
_SELDOM = 0.05
"""Largest share of rows that repeat a reading, of a sensor whose held readings can be told."""


@dataclass(frozen=True, eq=False)
class Fault:
    """Rows of one sensor that are no measurement."""

    kind: Kind
    rows: Rows  # (N,)
    value: float  # of these rows, in the unit of the readings; of held ones that of the first


def faults(values: Floats, period_s: float) -> Iterator[Fault]:
    """All faults of a sensor. `values`: its readings (N,), NaN where missing. `period_s`: from row to row [s]."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < _FEWEST or np.ptp(values[known]) == 0.0:
        return
    for kind, rows in _judged(values[known], period_s):
        every = np.zeros(len(values), dtype=bool)
        every[known[rows]] = True
        yield Fault(kind, every, float(values[known[rows][0]]))


def _judged(values: Floats, period_s: float) -> Iterator[tuple[Kind, NDArray[np.intp]]]:
    """Kind and rows of each fault of readings without missing ones (N,)."""
    if len(lost := _lost(values)):
        yield "lost", lost
    rest = np.delete(np.arange(len(values)), lost)
    stretches = _Stretches.of(values[rest])
    for end in (values[rest].max(), values[rest].min()):
        if len(at := stretches.at_end(values[rest], end)):
            yield "end", rest[at]
    if len(held := stretches.held(values[rest], period_s)):
        yield "held", rest[held]


def _lost(values: Floats) -> NDArray[np.intp]:
    """Rows of lost readings (K,)."""
    begin = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    if len(begin) < 3:
        return np.zeros(0, dtype=np.intp)
    length, level = np.diff(begin, append=len(values)), values[begin]
    moved = np.abs(np.diff(values))
    low, high = np.quantile(values, [0.01, 0.99])
    far = max(_FAR * float(np.quantile(moved, 0.75)), _FAR_OF_RANGE * float(high - low),
              _FAR_STEPS * float(moved[moved > 0.0].min()))  # fmt: skip
    before, here, after = level[:-2], level[1:-1], level[2:]
    away = np.minimum(np.abs(here - before), np.abs(here - after))
    back = np.abs(after - before) <= _BACK * away
    stands_out = 1 + np.flatnonzero((away > far) & back & (length[1:-1] <= _LONGEST_LOST))
    if not len(stands_out):
        return np.zeros(0, dtype=np.intp)
    found, counts = np.unique(level[stands_out], return_counts=True)
    most = int(np.argmax(counts))
    if counts[most] < _FEWEST_LOST or counts[most] < _SAME * len(stands_out):
        return np.zeros(0, dtype=np.intp)
    mine = stands_out[level[stands_out] == found[most]]
    return np.concatenate([np.arange(begin[k], begin[k] + length[k]) for k in mine])


@dataclass(frozen=True, eq=False)
class _Stretches:
    """Stretches of equal readings, (K,) each."""

    begin: NDArray[np.intp]
    length: NDArray[np.intp]

    @classmethod
    def of(cls, values: Floats) -> _Stretches:
        begin = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
        return cls(begin, np.diff(begin, append=len(values)))

    def rows(self, which: Rows) -> NDArray[np.intp]:
        """The rows of some stretches."""
        pairs = zip(self.begin[which], self.length[which], strict=True)
        return np.concatenate([np.zeros(0, dtype=np.intp), *(np.arange(b, b + n) for b, n in pairs)])

    def at_end(self, values: Floats, end: float) -> NDArray[np.intp]:
        """Rows in which the sensor gives the end of its range, if it ends there; else none."""
        at = values[self.begin] == end
        usual = float(np.quantile(self.length[~at], 0.99)) if not at.all() else 1.0
        long = self.length >= max(_LONG, _LONGER * usual)
        count, elsewhere = (int(self.length[which].sum()) for which in (at & long, ~at & (self.length >= _LONG)))
        endless = at & (self.length >= _ENDLESS * usual) & (self.begin > 0)
        often = (at & long).sum() >= _VISITS or endless.any()
        if not often or count < _AT_END * len(values) or elsewhere > _ELSEWHERE * count:
            return np.zeros(0, dtype=np.intp)
        return self.rows(at)

    def held(self, values: Floats, period_s: float) -> NDArray[np.intp]:
        """Rows after the first one of each held reading, of a sensor that seldom repeats one; else none."""
        inside = (values[self.begin] != values.max()) & (values[self.begin] != values.min())
        held = inside & (self.length >= _HELD_ROWS) & (self.length * period_s >= _HELD_S)
        others = self.length[~held]
        if not held.any() or 2 * others.sum() < len(values) or (others - 1).sum() > _SELDOM * others.sum():
            return np.zeros(0, dtype=np.intp)
        rows = self.rows(held)
        return np.asarray(rows[~np.isin(rows, self.begin)])


# The sensors of a recording.

_VENTED = 1.1 * STANDARD_ATMOSPHERE
"""[Pa] A sensor whose range begins at the atmosphere loses nothing: no muscle has less."""


class SensorFault(NamedTuple):
    """A fault of one sensor of a recording."""

    sensor: str  # ``pressure_1``, ``pressure_2``, ``measured angle`` or ``measured torque``
    fault: Fault

    @property
    def is_possible(self) -> bool:
        """Whether the joint itself does so: it stands still, or a muscle is vented."""
        if self.fault.kind == "held":
            return self.sensor == "measured angle"
        return self.fault.kind == "end" and self.sensor.startswith("pressure") and self.fault.value <= _VENTED

    @property
    def size(self) -> str:
        """The value of its rows."""
        value = self.fault.value
        if self.sensor.startswith("pressure"):
            return f"{value / 1e3:.6g} kPa"
        if self.sensor == "measured torque":
            return f"{value:.4g} N m"
        return f"{value:.4g} rad" + (f" ({np.degrees(value):.1f}°)" if value else "")


def faults_of(recording: Recording) -> list[SensorFault]:
    """Faults of all sensors of a recording, in SI units; lost readings first."""
    columns = {"pressure_1": recording.pressure[:, 0], "pressure_2": recording.pressure[:, 1]}
    measured = {"measured angle": recording.angle, "measured torque": recording.torque}
    columns |= {name: values for name, values in measured.items() if values is not None}
    for k in recording.logged_commands:
        del columns[f"pressure_{k + 1}"]
    every = [
        SensorFault(name, one) for name, values in columns.items() for one in faults(values, recording.sample_period_s)
    ]
    # Where nothing at all is new, the log stood still, and no sensor.
    again = np.all([np.diff(values, prepend=np.nan) == 0.0 for values in columns.values()], axis=0)
    found = [one for one in every if not one.is_possible and (one.fault.kind != "held" or one.fault.rows[~again].any())]
    lost = [one for one in found if one.fault.kind == "lost"]
    if lost:
        # One bus loses the readings of all its sensors, also where the lost value happens to be near the true one.
        any_lost = np.any([one.fault.rows for one in lost], axis=0)
        lost = [
            SensorFault(name, replace(one, rows=one.rows | (any_lost & (columns[name] == one.value))))
            for name, one in lost
        ]
    return [*lost, *(one for one in found if one.fault.kind == "end"), *(o for o in found if o.fault.kind == "held")]


def in_words(found: list[SensorFault], time_s: Floats) -> list[tuple[Kind, str]]:
    """What a user should know: the kind of the faults, and a sentence. `time_s`: of the rows (N,) [s]."""
    out: list[tuple[Kind, str]] = []
    for kind, group in groupby(found, key=lambda one: one.fault.kind):
        every = list(group)
        if kind == "lost":
            rows = np.any([one.fault.rows for one in every], axis=0)
            each = ", ".join(f"{one.sensor} {one.size}" for one in every)
            text = f"{int(rows.sum())} rows hold exactly one value, far from the rows before and after: {each}, first "
            out.append((kind, f"{text}at {time_s[int(np.argmax(rows))]:.3f} s: these readings were lost"))
            continue
        for one in every:
            rows, first = one.fault.rows, time_s[int(np.argmax(one.fault.rows))]
            text = f"{one.sensor} reads exactly {one.size} in {100.0 * rows.mean():.2g} % of the rows"
            if kind == "end":
                stop = ", or the joint rests at its stop" if one.sensor == "measured angle" else ""
                text += f", first at {first:.3f} s: its range ends there{stop}; such rows are no measurement"
            else:
                text = (
                    f"{one.sensor} stays exactly the same in {int(rows.sum())} rows, first from {first:.3f} s on, "
                    f"at {one.size}: held values, as nothing was measured there"
                )
            out.append((kind, text))
    return out


def without_faults(recording: Recording) -> Recording:
    """A recording in SI units whose faults are missing values; its issues say so."""
    found = faults_of(recording)
    left_out = [Issue(f"{text}: left out", "dropped") for _, text in in_words(found, recording.time_s)]
    return replace(masked(recording, found), issues=(*recording.issues, *left_out)) if found else recording


def masked(recording: Recording, found: list[SensorFault]) -> Recording:
    """A recording in any unit whose faults are missing values."""
    pressure = recording.pressure.copy()
    measured: dict[str, Any] = {"angle": recording.angle, "torque": recording.torque}
    for sensor, fault in found:
        name = sensor.removeprefix("measured ")
        if name in measured:
            measured[name] = np.where(fault.rows, np.nan, measured[name])
        else:
            pressure[fault.rows, int(name[-1]) - 1] = np.nan
    return replace(recording, pressure=pressure, **measured)
