"""Stamps of the rows of a CSV file, from a column or a rate, and problems with them.

Rows keep their measured times, because the estimator and the identification accept jitter and gaps. They do not accept
repeated or backward times, or uneven rows. Such a file is refused unless the map says what to do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from .csv_map import Time
from .csv_table import Table
from .notes import Issue
from .plausible import UNITS

Stamps = NDArray[np.int64]

START_NS = 1_000_000_000_000_000_000
"""Stamp of the first row (in 2001) where the column does not count from 1970; fixed for reproducible bags."""

LEAST_ROWS = 10
"""Fewest rows of an episode; a shorter one is mostly its start."""
PAUSE_NS = 2_000_000_000
"""[ns] Pause between two episodes, over a second so that a filter starts anew."""

_FIRST_EPOCH, _LAST_EPOCH = 900_000_000.0, 2_147_483_000.0  # [s] since 1970; ROS stamps end with 31 bits of seconds
_SHORTEST_PERIOD, _LONGEST_PERIOD = 20e-6, 0.5  # [s] that are plausible
_USUAL_PERIOD = 2e-3  # [s]
_LONGEST = 100_000_000.0  # [s] from the first to the last row: three years
_ODD = 0.5  # an interval that differs from the median by more than this share of the median is no jitter
_UNEVEN_SHARE = 0.05  # with a larger share of such intervals there is no sample period
_DROPPED_SHARE = 0.05  # a larger share of rows out of order has another cause, which dropping them would hide


@dataclass(frozen=True, eq=False)
class Timing:
    """Stamps of the rows."""

    stamp_ns: Stamps  # Stamps of the kept rows (M,) [ns], strictly increasing
    keep: NDArray[np.intp]  # Indices of the kept rows in the file (M,)
    issues: tuple[str, ...]
    episode_ns: Stamps | None = None  # Stamps at which episodes begin (E,) [ns]; None for a file in one piece


def timing(where: str, time: Time, table: Table, sampled: NDArray[np.bool_]) -> Timing:
    """Stamps of the rows.

    `table`: The file's numbers; those of "time" are used where the map names a column. `sampled`: Which rows are
    samples (N,); the intervals between them are judged.
    """
    if len(table) < 2:
        raise BadInput(f"{where}: {len(table)} row of numbers, expected at least two")
    if "episode" in table.values:
        return _of_episodes(where, time, table)
    if time.rate is not None:
        return Timing(START_NS + _grid(len(table), time.rate), np.arange(len(table)), ())
    assert time.unit is not None
    issues: list[str] = []
    cells = table.values["time"]
    keep = _in_order(where, time, table, issues)
    seconds = cells[keep] * UNITS["time"][time.unit]
    sample = sampled[keep]
    _check_period(where, table.labels["time"], time.unit, cells[keep[sample]])
    if seconds[-1] - seconds[0] > _LONGEST:
        index = int(np.argmax(np.diff(seconds))) + 1
        raise BadInput(
            f"{where}: line {table.line[keep[index]]}: {table.labels['time']} jumps by {np.diff(seconds).max():.4g} s"
        )
    # Subtract before scaling: a time since 1970 in ns has more digits than a float.
    since = np.rint((cells[keep] - cells[keep[0]]) * UNITS["time"][time.unit] * 1e9).astype(np.int64)
    stamp_ns = _begin(seconds) + since
    if np.any(np.diff(stamp_ns) <= 0):
        raise BadInput(f"{where}: {table.labels['time']} has steps of less than a nanosecond")
    _judge_intervals(where, time, table, keep[sample], since[sample], issues)
    return Timing(stamp_ns, keep, tuple(issues))


def _of_episodes(where: str, time: Time, table: Table) -> Timing:
    """Stamps of a file of episodes, one after the other with pauses; each episode's time may begin anew."""
    number = table.values["episode"]
    bad = np.flatnonzero(~np.isfinite(number))
    if len(bad):
        raise BadInput(f"{where}: line {table.line[bad[0]]}: {table.labels['episode']} is missing")
    first = np.flatnonzero(np.diff(number, prepend=np.nan) != 0.0)
    bounds = list(zip(first.tolist(), [*first[1:].tolist(), len(number)], strict=True))
    long = [(begin, end) for begin, end in bounds if end - begin >= LEAST_ROWS]
    issues: list[str] = []
    if len(long) < len(bounds):
        begin = next(begin for begin, end in bounds if end - begin < LEAST_ROWS)
        text = (
            f"{len(bounds) - len(long)} of {len(bounds)} episodes have fewer than {LEAST_ROWS} rows, the first in line "
            f"{table.line[begin]}: left out"
        )
        issues.append(Issue(text, "dropped", len(bounds) - len(long)))
    if len(long) < 2:
        raise BadInput(
            f"{where}: {table.labels['episode']} makes {len(long)} episodes of {LEAST_ROWS} rows or more, expected two "
            "at least; is it the column that counts the rows?"
        )
    start, keep = START_NS, []
    begins: list[int] = []
    stamps = []
    for begin, end in long:
        part = replace(table, values={"time": table.values["time"][begin:end]}) if time.rate is None else None
        if part is None:
            assert time.rate is not None
            since, rows = _grid(end - begin, time.rate), np.arange(end - begin)
        else:
            assert time.unit is not None
            part = replace(part, line=table.line[begin:end])
            rows = _in_order(where, time, part, issues)
            _check_period(where, table.labels["time"], time.unit, part.values["time"][rows])
            seconds = part.values["time"][rows] * UNITS["time"][time.unit]
            since = np.rint((seconds - seconds[0]) * 1e9).astype(np.int64)
            start = start if begins else _begin(seconds)
        begins.append(start)
        stamps.append(start + since)
        keep.append(begin + rows)
        start = int(stamps[-1][-1]) + PAUSE_NS
    return Timing(np.concatenate(stamps), np.concatenate(keep), tuple(issues), np.array(begins, np.int64))


def _begin(seconds: NDArray[np.float64]) -> int:
    """Stamp [ns] of the first of some times [s], which count from 1970 or from anywhere."""
    epoch = _FIRST_EPOCH <= seconds[0] and seconds[-1] <= _LAST_EPOCH
    return round(float(seconds[0]) * 1e6) * 1000 if epoch else START_NS


def even_grid(stamp_ns: Stamps, rate: float) -> Stamps:
    """Stamps at a rate [Hz] from the first to the last one given (M,) [ns]."""
    count = int((stamp_ns[-1] - stamp_ns[0]) * 1e-9 * rate + 1e-6) + 1
    return np.asarray(stamp_ns[0] + _grid(count, rate))


def _grid(count: int, rate: float) -> Stamps:
    return np.asarray(np.rint(np.arange(count) * (1e9 / rate)).astype(np.int64))


def _in_order(where: str, time: Time, table: Table, issues: list[str]) -> NDArray[np.intp]:
    """Indices of the rows that are later than all rows before them; the map says whether others are dropped."""
    cells, label = table.values["time"], table.labels["time"]
    known = np.isfinite(cells)
    newest = np.maximum.accumulate(np.where(known, cells, -np.inf))
    later = known & (cells > np.concatenate(([-np.inf], newest[:-1])))
    wrong = np.flatnonzero(~later)
    if len(wrong) == 0:
        return np.arange(len(cells))
    row = int(wrong[0])
    if time.out_of_order == "drop" and len(wrong) <= max(1, _DROPPED_SHARE * len(cells)):
        text = f"{len(wrong)} rows are not later than those before them, the first in line {table.line[row]}: dropped"
        issues.append(Issue(text, "dropped", len(wrong)))
        return np.flatnonzero(later)
    begin = f"{where}: line {table.line[row]}: {label}"
    if not known[row]:
        what, hint = "is missing", "give out_of_order: drop under time to leave such rows out"
    elif cells[row] == newest[row - 1]:
        what = f"repeats, {cells[row]:.12g} {time.unit}"
        hint = (
            "where the column has too few decimals but the rows came evenly, give time: {rate: ROWS_PER_SECOND} in "
            "place of it; where a few rows were written twice, give out_of_order: drop"
        )
    else:
        what = f"runs backwards, {cells[row]:.12g} {time.unit} after {newest[row - 1]:.12g} {time.unit}"
        hint = (
            "of a file that holds several recordings, name the column that counts them (episode: COLUMN), or cut it "
            "at such lines; for a few stray rows, give out_of_order: drop"
        )
    many = f" ({len(wrong)} of {len(cells)} rows are not later than those before them)" if len(wrong) > 1 else ""
    raise BadInput(f"{begin} {what}{many}, expected increasing times; {hint}")


def _check_period(where: str, label: str, unit: str, cells: NDArray[np.float64]) -> None:
    if len(cells) < 2:
        raise BadInput(f"{where}: one row with a usable time, expected at least two")
    step = float(np.median(np.diff(cells)))
    period = step * UNITS["time"][unit]
    if _SHORTEST_PERIOD <= period <= _LONGEST_PERIOD:
        return
    fits = {name: abs(np.log(step * factor / _USUAL_PERIOD)) for name, factor in UNITS["time"].items()
            if _SHORTEST_PERIOD <= step * factor <= _LONGEST_PERIOD}  # fmt: skip
    names = " or ".join(sorted(fits, key=lambda name: fits[name])[:2])
    hint = f"; steps of {step:.4g} look like {names}" if fits else ""
    counter = "; if it only counts rows, give time: {rate: ROWS_PER_SECOND} in place of it" if step == 1.0 else ""
    raise BadInput(
        f"{where}: {label} declared in {unit} makes {period:.4g} s between rows, expected {_SHORTEST_PERIOD:g} to "
        f"{_LONGEST_PERIOD:g} s{hint}{counter}"
    )


def _judge_intervals(
    where: str, time: Time, table: Table, keep: NDArray[np.intp], since: Stamps, issues: list[str]
) -> None:
    """Report uneven intervals; refuse a file with many of them."""
    interval = np.diff(since) * 1e-9
    median = float(np.median(interval))
    odd = np.abs(interval - median) > _ODD * median
    if np.count_nonzero(odd) > _UNEVEN_SHARE * len(interval) and time.resample is None:
        raise BadInput(
            f"{where}: {table.labels['time']} is uneven, {100.0 * np.mean(odd):.0f} % of the intervals differ by more "
            f"than half from the median of {median * 1e3:.4g} ms (from {interval.min() * 1e3:.4g} to "
            f"{interval.max() * 1e3:.4g} ms); give time.resample, the rate [Hz] of an even grid to put the rows on"
        )
    if np.any(odd):
        longest = int(np.argmax(interval))
        text = (
            f"{np.count_nonzero(odd)} of {len(interval)} intervals between rows are no {median * 1e3:.4g} ms, the "
            f"longest ({interval[longest] * 1e3:.4g} ms) before line {table.line[keep[longest + 1]]}"
            + ("" if time.resample is not None else ": times kept as they are")
        )
        issues.append(Issue(text, size=int(np.count_nonzero(odd))))
