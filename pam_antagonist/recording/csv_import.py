"""A file with columns and a map of them -> one :class:`~pam_antagonist.recording.recording.Recording`.

Rows keep their measured times, because the estimator and the identification accept jitter and gaps. They do not accept
repeated or backward times, or uneven rows. Such a file is refused unless the map says what to do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import plausible
from .csv_map import CsvMap, Time
from .csv_table import NumberTable, read_table
from .notes import REGULATOR, SEALED, Issue, read_notes, sha256
from .plausible import UNITS, Signal, unwrapped
from .recording import FurtherSignal, Recording
from .rows import resets
from .stamps import interpolate, judge_pairing
from .storage import SUFFIXES
from .topics import ALSO

Floats = NDArray[np.float64]

Stamps = NDArray[np.int64]

START_NS = 1_000_000_000_000_000_000
"""Stamp of the first row (in 2001) where neither column nor map tells a date; fixed for reproducible bags."""
SOURCE_TIME = "pam_antagonist.source_time"
"""Name of the note with the time at which the file was written last."""

LEAST_ROWS = 10
"""Fewest rows of an episode; a shorter one is mostly its start."""
PAUSE_NS = 2_000_000_000
"""[ns] Pause between two episodes, over a second so that a filter starts anew."""

_FIRST_EPOCH, _LAST_EPOCH = 900_000_000.0, 2_147_483_000.0  # [s] since 1970; ROS stamps end with 31 bits of seconds
_DAY_NS = 86_400_000_000_000
_SHORTEST_PERIOD, _LONGEST_PERIOD = 20e-6, 0.5  # [s] that are plausible
_USUAL_PERIOD = 2e-3  # [s]
_LONGEST = 100_000_000.0  # [s] from the first to the last row: three years
_ODD = 0.5  # an interval that differs from the median by more than this share of the median is no jitter
_UNEVEN_SHARE = 0.05  # with a larger share of such intervals there is no sample period
_DROPPED_SHARE = 0.05  # a larger share of rows out of order has another cause, which dropping them would hide
_FEWEST_ROWS = 3  # with a first pressure, to have intervals between them
_COMMANDS = ("valve_1", "valve_2", "command_1", "command_2")


def read_csv(path: str | Path, mapping: CsvMap, progress: Callable[[int], object] | None = None) -> Recording:
    """Read a recording from a file with columns.

    Values are converted to SI units and absolute pressures. A sealed chamber has the constant voltage of the map in
    every sample; :func:`notes` names the sealed muscles, the recording does not.
    """
    path = Path(path)
    where = str(path)
    table = read_table(path, mapping.file, mapping.columns(), progress)
    issues = list(table.issues)
    apart = _apart(table)
    if apart:
        table = _joined(table)
        apart = _apart(table)
    own = np.isfinite(table.values["pressure_1"]) | (not apart)
    stamp_ns, keep, episode_ns = _timing(where, mapping.time, table, own, issues)
    first = np.searchsorted(stamp_ns, [] if episode_ns is None else episode_ns)
    rate, own = mapping.time.resample, own[keep]
    moved = tuple(table.values) if rate is not None else apart
    signals = _signals(mapping, table, keep, issues)
    _judge(where, mapping, signals, issues)
    columns = {name: signal.si() for name, signal in signals.items()}
    begins = np.union1d([0], first).astype(np.intp)
    for name in set(columns) - set(moved):
        if mapping.holds_on(name):
            # A sample's command held before the sample; before the first row it is not known.
            held = np.concatenate((columns[name][:1], columns[name][:-1]))
            held[begins] = columns[name][begins]
            columns[name] = held
    if apart:
        issues.append(_apart_issue(table, apart))
    if rate is not None:
        issues.append(_resampling_issue(stamp_ns[own], rate))
    if moved:
        grid = stamp_ns[own] if rate is None else _even_grid(stamp_ns, rate)
        columns = {
            name: _on_grid(mapping, name, grid, stamp_ns, values) if name in moved else values[own]
            for name, values in columns.items()
        }
        stamp_ns = grid
    recording = _recording(path, mapping, table, stamp_ns, columns, episode_ns, issues)
    jumped = resets(recording)
    if jumped is not None:
        issues.append(Issue(jumped.sentence, "jump", len(jumped.rows), jumped.times[0]))
    return _cut(where, replace(recording, issues=Issue.sorted(issues)), mapping)


def notes(path: str | Path, mapping: CsvMap) -> dict[str, str]:
    """Notes for a bag that is made of this file: its source, the sealed muscles, a missing regulator command.

    Returns name -> text, for :func:`~pam_antagonist.recording.notes.write_notes`.
    """
    path = Path(path)
    written = datetime.fromtimestamp(path.stat().st_mtime, timezone.utc).isoformat(timespec="seconds")
    found = {
        "pam_antagonist.source": path.name,
        "pam_antagonist.source_sha256": sha256(path).hex(),
        SOURCE_TIME: written,
    }
    if mapping.sealed:
        found[SEALED] = " ".join(map(str, mapping.sealed))
    if mapping.drive == "regulator" and mapping.command_1 is None:
        found[REGULATOR] = "true"
    return found


def began_ns(recording: Recording) -> int | None:
    """When a recording began [ns]: its first stamp; for an import without a date, the time of its file, if known."""
    first = int(recording.stamp_ns[0])
    if not START_NS <= first < START_NS + _DAY_NS:
        return first
    path = recording.path
    try:
        if path.is_file() and not path.name.endswith(SUFFIXES):  # the table itself
            return path.stat().st_mtime_ns
        return round(datetime.fromisoformat(read_notes(path)[SOURCE_TIME]).timestamp()) * 1_000_000_000
    except (BadInput, OSError, ValueError, KeyError):
        return None


def _apart(table: NumberTable) -> tuple[str, ...]:
    """Columns whose cells mostly stand in rows without a first pressure: each row holds the cells of some topic."""
    there = {name: np.isfinite(cells) for name, cells in table.values.items() if name != "time"}
    if "time" not in table.values or "episode" in table.values or np.count_nonzero(there["pressure_1"]) < _FEWEST_ROWS:
        return ()
    shared = {name: np.count_nonzero(its & there["pressure_1"]) for name, its in there.items()}
    return tuple(name for name, its in there.items() if 2 * shared[name] < np.count_nonzero(its))


def _joined(table: NumberTable) -> NumberTable:
    """A table with one row for each time, sorted; the same where a column's own times do not increase."""
    time = table.values["time"]
    known = np.isfinite(time)
    there = {name: known & np.isfinite(cells) for name, cells in table.values.items()}
    if any(np.any(np.diff(time[its]) <= 0.0) for name, its in there.items() if name != "time"):
        return table
    stamps, first, place = np.unique(time[known], return_index=True, return_inverse=True)
    values = {name: np.full(len(stamps), np.nan) for name in table.values}
    for name, cells in table.values.items():
        values[name][place[there[name][known]]] = cells[there[name]]
    return replace(table, values=values, line=table.line[known][first])


def _apart_issue(table: NumberTable, apart: tuple[str, ...]) -> Issue:
    held = [table.labels[name] for name in apart if name in _COMMANDS]
    others = [table.labels[name] for name in apart if name not in _COMMANDS]
    text = f"the rows hold the cells of some columns each: samples are the rows with {table.labels['pressure_1']}"
    text += f"; {', '.join(others)} interpolated between rows with a value" if others else ""
    text += f"; {', '.join(held)} held between such rows" if held else ""
    return Issue(text, "resampled", len(table))


def _signals(mapping: CsvMap, table: NumberTable, keep: NDArray[np.intp], issues: list[str]) -> dict[str, Signal]:
    """Scaled numbers of every column, in its unit; NaN for what is not finite."""
    signals, entries = {}, mapping.entries()
    for name, cells in table.values.items():
        if name in ("time", "episode"):
            continue
        entry = entries[name]
        values = cells[keep] * entry.scale + entry.offset
        infinite = np.abs(values) >= plausible.NO_VALUE
        if np.any(infinite):
            issues.append(f"{np.count_nonzero(infinite)} cells of {table.labels[name]} are infinite: left out")
            values[infinite] = np.nan
        turn = getattr(entry, "wraps", None)
        if turn is not None:
            jumps = int(np.count_nonzero(np.abs(np.diff(values[np.isfinite(values)])) > 0.5 * turn))
            values = unwrapped(values, turn)
            if jumps:
                text = f"{table.labels[name]} begins again after {turn:g} {entry.unit} at {jumps} places: jumps removed"
                issues.append(Issue(text, size=jumps))
        signals[name] = mapping.signal(name, table.labels[name], values)
    return signals


def _judge(where: str, mapping: CsvMap, signals: dict[str, Signal], issues: list[str]) -> None:
    """Refuse what is implausible in its unit."""
    plausible.judge_muscles(where, signals["pressure_1"], signals["pressure_2"], issues)
    for number, valve in ((1, mapping.valve_1), (2, mapping.valve_2)):
        if valve is not None and valve.constant is not None:
            values = np.array([valve.constant])
            plausible.judge(where, mapping.signal(f"valve_{number}", f"valve_{number} (constant)", values), issues)
    if "command_1" in signals:
        plausible.judge_muscles(where, signals["command_1"], signals["command_2"], issues)
    for name in ("valve_1", "valve_2", "angle", "torque", "external_torque"):
        if name in signals:
            plausible.judge(where, signals[name], issues)


def _on_grid(mapping: CsvMap, name: str, grid: Stamps, stamp_ns: Stamps, values: Floats) -> Floats:
    """Values on the grid: measured ones linear between rows with a value; voltages and commands held."""
    if name not in _COMMANDS:
        return interpolate(grid, stamp_ns, values)
    there = np.isfinite(values)
    if not np.any(there):
        return np.full(len(grid), np.nan)
    # A row's value held up to that row, or from then on.
    rows = np.searchsorted(stamp_ns[there], grid, side="left") - int(mapping.holds_on(name))
    return np.asarray(values[there][np.clip(rows, 0, np.count_nonzero(there) - 1)])


def _resampling_issue(stamp_ns: Stamps, rate: float) -> str:
    before = 1e9 / float(np.median(np.diff(stamp_ns)))
    text = f"resampled from about {before:.4g} to {rate:g} Hz by interpolation; gaps of over five rows stay empty"
    return text + ("; there is no filter before it, so faster motion is aliased" if rate < 0.8 * before else "")


def _recording(
    path: Path,
    mapping: CsvMap,
    table: NumberTable,
    stamp_ns: Stamps,
    columns: dict[str, Floats],
    episode_ns: Stamps | None,
    issues: list[str],
) -> Recording:
    """The columns as a recording, unless it could not be read back from a bag; issues count missing values."""
    size, labels = len(stamp_ns), table.labels
    # A joint with regulators has no voltages. Without commands in the file a placeholder is written.
    command = "valve" if mapping.command_1 is None else "command"
    constants = [np.full(size, (valve.constant or 0.0) * UNITS["voltage"][valve.unit]) for valve in mapping.valves]
    voltage = np.column_stack([columns.get(f"{command}_{n}", constants[n - 1]) for n in (1, 2)])
    present = {labels[name]: np.isfinite(columns[name]) for name in ("pressure_1", "pressure_2")}
    if commands := [label for name, label in labels.items() if name in _COMMANDS]:
        present[" and ".join(commands)] = np.asarray(np.isfinite(voltage).all(axis=1))
    measured: dict[str, Floats | None] = {}
    for name in mapping.measured():
        missing = int(np.count_nonzero(np.isnan(columns[name])))
        text = f"{missing} of {size} samples without {labels[name]}"
        text = text if missing < size else f"{labels[name]} holds no value: left out"
        measured[name] = columns[name] if missing < size else None
        issues += [Issue(text, "missing", missing)] if missing else []
    judge_pairing(str(path), stamp_ns, present, issues, episode_ns)
    for label, there in present.items():
        if not np.any(there):
            raise BadInput(f"{path}: {label} holds no value in {len(there)} samples")
    return Recording(
        path=path,
        stamp_ns=stamp_ns,
        pressure=np.column_stack([columns["pressure_1"], columns["pressure_2"]]),
        voltage=voltage,
        angle=measured.get("angle"),
        torque=measured.get("torque"),
        external_torque=measured.get("external_torque"),
        signals={
            name: FurtherSignal(columns[f"{ALSO}{name}"], next(iter(UNITS[entry.quantity])))
            for name, entry in mapping.also.items()
        },
        episode_ns=episode_ns,
        drive={"valve": "valve", "command": "regulator"}[command],
    )


def _cut(where: str, recording: Recording, mapping: CsvMap) -> Recording:
    """The part that the map asks for."""
    begin, end = mapping.time.begin, mapping.time.end
    if begin == 0.0 and end is None:
        return recording
    try:
        return recording.slice(begin, float("inf") if end is None else end)
    except BadInput:
        raise BadInput(
            f"{where}: no row from time.begin {begin:g} to time.end {end}, the file has {recording.duration_s:.3f} s"
        ) from None


def _timing(
    where: str, time: Time, table: NumberTable, sampled: NDArray[np.bool_], issues: list[str]
) -> tuple[Stamps, NDArray[np.intp], Stamps | None]:
    """Stamps of the kept rows (M,) [ns], their indices in the file (M,), and the stamps at which episodes begin (E,).

    `sampled`: Which rows are samples (N,); the intervals between them are judged.
    """
    if len(table) < 2:
        raise BadInput(f"{where}: {len(table)} row of numbers, expected at least two")
    if "episode" in table.values:
        return _of_episodes(where, time, table, issues)
    start, since, rows = _piece(where, time, table, sampled, issues)
    if time.rate is None:
        _judge_intervals(where, time, table, rows[sampled[rows]], since[sampled[rows]], issues)
    return start + since, rows, None


def _piece(
    where: str, time: Time, table: NumberTable, sampled: NDArray[np.bool_], issues: list[str]
) -> tuple[int, Stamps, NDArray[np.intp]]:
    """Stamp of the first row [ns], times of the kept rows since then (M,) [ns], and their indices (M,)."""
    start = START_NS if time.date_ns is None else time.date_ns
    if time.rate is not None:
        return start, _grid(len(table), time.rate), np.arange(len(table))
    assert time.unit is not None
    label, factor = table.labels["time"], UNITS["time"][time.unit]
    rows = _in_order(where, time, table, issues)
    cells = table.values["time"][rows]
    _check_period(where, label, time.unit, cells[sampled[rows]])
    apart = np.diff(cells) * factor
    if (cells[-1] - cells[0]) * factor > _LONGEST:
        line = table.line[rows[int(np.argmax(apart)) + 1]]
        raise BadInput(f"{where}: line {line}: {label} jumps by {apart.max():.4g} s")
    # Subtract before scaling: a time since 1970 in ns has more digits than a float.
    since = np.rint((cells - cells[0]) * factor * 1e9).astype(np.int64)
    if np.any(np.diff(since) <= 0):
        raise BadInput(f"{where}: {label} has steps of less than a nanosecond")
    begin, end = cells[0] * factor, cells[-1] * factor
    is_epoch = _FIRST_EPOCH <= begin and end <= _LAST_EPOCH
    if is_epoch and time.date is not None:
        raise BadInput(f"{where}: time.date is {time.date}, but {label} counts from 1970: leave time.date out")
    return round(float(begin) * 1e6) * 1000 if is_epoch else start, since, rows


def _of_episodes(
    where: str, time: Time, table: NumberTable, issues: list[str]
) -> tuple[Stamps, NDArray[np.intp], Stamps]:
    """Stamps of a file of episodes, one after the other with pauses; each episode's time may begin anew."""
    number = table.values["episode"]
    bad = np.flatnonzero(~np.isfinite(number))
    if len(bad):
        raise BadInput(f"{where}: line {table.line[bad[0]]}: {table.labels['episode']} is missing")
    first = np.flatnonzero(np.diff(number, prepend=np.nan) != 0.0)
    bounds = list(zip(first.tolist(), [*first[1:].tolist(), len(number)], strict=True))
    long = [(begin, end) for begin, end in bounds if end - begin >= LEAST_ROWS]
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
    keep, begins, stamps = list[NDArray[np.intp]](), list[int](), list[Stamps]()
    for begin, end in long:
        cells = {name: values[begin:end] for name, values in table.values.items()}
        part = replace(table, values=cells, line=table.line[begin:end])
        start, since, rows = _piece(where, time, part, np.ones(end - begin, dtype=bool), issues)
        begins.append(int(stamps[-1][-1]) + PAUSE_NS if stamps else start)
        stamps.append(begins[-1] + since)
        keep.append(begin + rows)
    return np.concatenate(stamps), np.concatenate(keep), np.array(begins, np.int64)


def _even_grid(stamp_ns: Stamps, rate: float) -> Stamps:
    """Stamps at a rate [Hz] from the first to the last one given (M,) [ns]."""
    count = int((stamp_ns[-1] - stamp_ns[0]) * 1e-9 * rate + 1e-6) + 1
    return np.asarray(stamp_ns[0] + _grid(count, rate))


def _grid(count: int, rate: float) -> Stamps:
    return np.asarray(np.rint(np.arange(count) * (1e9 / rate)).astype(np.int64))


def _in_order(where: str, time: Time, table: NumberTable, issues: list[str]) -> NDArray[np.intp]:
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
    where: str, time: Time, table: NumberTable, keep: NDArray[np.intp], since: Stamps, issues: list[str]
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
