"""A file with columns and a map of them -> one :class:`~pam_antagonist.recording.recording.Recording`."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import plausible
from .csv_map import CsvMap
from .csv_table import Table, read_table
from .csv_time import Stamps, even_grid, timing
from .notes import REGULATOR, SEALED, Issue
from .plausible import UNITS, Signal, unwrapped
from .recording import FurtherSignal, Recording
from .rows import resets
from .stamps import interpolate, judge_pairing
from .topics import ALSO

Floats = NDArray[np.float64]

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
    times = timing(where, mapping.time, table, own)
    issues += times.issues
    first = np.searchsorted(times.stamp_ns, [] if times.episode_ns is None else times.episode_ns)
    rate, stamp_ns, own = mapping.time.resample, times.stamp_ns, own[times.keep]
    moved = tuple(table.values) if rate is not None else apart
    signals = _signals(mapping, table, times.keep, issues)
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
        grid = stamp_ns[own] if rate is None else even_grid(stamp_ns, rate)
        columns = {
            name: _on_grid(mapping, name, grid, stamp_ns, values) if name in moved else values[own]
            for name, values in columns.items()
        }
        stamp_ns = grid
    recording = _recording(path, mapping, table, stamp_ns, columns, times.episode_ns, issues)
    jumped = resets(recording)
    if jumped is not None:
        issues.append(Issue(jumped.sentence, "jump", len(jumped.rows), jumped.times[0]))
    return _cut(where, replace(recording, issues=Issue.sorted(issues)), mapping)


def notes(path: str | Path, mapping: CsvMap) -> dict[str, str]:
    """Notes for a bag that is made of this file: its source, the sealed muscles, a missing regulator command.

    Returns name -> text, for :func:`~pam_antagonist.recording.notes.write_notes`.
    """
    path = Path(path)
    with path.open("rb") as stream:
        digest = hashlib.sha256()
        while block := stream.read(1 << 20):
            digest.update(block)
    found = {"pam_antagonist.source": path.name, "pam_antagonist.source_sha256": digest.hexdigest()}
    if mapping.sealed:
        found[SEALED] = " ".join(map(str, mapping.sealed))
    if mapping.drive == "regulator" and mapping.command_1 is None:
        found[REGULATOR] = "true"
    return found


def _apart(table: Table) -> tuple[str, ...]:
    """Columns whose cells mostly stand in rows without a first pressure: each row holds the cells of some topic."""
    there = {name: np.isfinite(cells) for name, cells in table.values.items() if name != "time"}
    if "time" not in table.values or "episode" in table.values or np.count_nonzero(there["pressure_1"]) < _FEWEST_ROWS:
        return ()
    shared = {name: np.count_nonzero(its & there["pressure_1"]) for name, its in there.items()}
    return tuple(name for name, its in there.items() if 2 * shared[name] < np.count_nonzero(its))


def _joined(table: Table) -> Table:
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


def _apart_issue(table: Table, apart: tuple[str, ...]) -> Issue:
    held = [table.labels[name] for name in apart if name in _COMMANDS]
    others = [table.labels[name] for name in apart if name not in _COMMANDS]
    text = f"the rows hold the cells of some columns each: samples are the rows with {table.labels['pressure_1']}"
    text += f"; {', '.join(others)} interpolated between rows with a value" if others else ""
    text += f"; {', '.join(held)} held between such rows" if held else ""
    return Issue(text, "resampled", len(table))


def _signals(mapping: CsvMap, table: Table, keep: NDArray[np.intp], issues: list[str]) -> dict[str, Signal]:
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
    table: Table,
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
