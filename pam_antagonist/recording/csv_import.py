"""A CSV file and a map of its columns -> one :class:`~pam_antagonist.recording.recording.Recording`."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import plausible
from .csv_map import ALSO, CsvMap
from .csv_table import Table, read_table
from .csv_time import Stamps, even_grid, timing
from .notes import REGULATOR, SEALED, Issue
from .plausible import NO_VALUE, Signal, unwrapped
from .recording import Recording
from .rows import resets
from .signals import FurtherSignal
from .stamps import interpolate, judge_pairing
from .units import UNITS

Floats = NDArray[np.float64]

_FEWEST_ROWS = 3  # with a first pressure, to have intervals between them
_UNIT = {"pressure": "Pa", "angle": "rad", "temperature": "degC"}


def read_csv(path: str | Path, mapping: CsvMap, progress: Callable[[int], object] | None = None) -> Recording:
    """Read a recording from a CSV file.

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
    signals = _signals(mapping, table, times.keep, np.union1d([0], first).astype(np.intp), issues, moved)
    _check(where, mapping, signals, issues)
    columns = {name: _si(mapping, name, signal) for name, signal in signals.items()}
    if apart:
        issues.append(_apart_issue(table, apart))
    if rate is not None:
        issues.append(_resampling_issue(stamp_ns[own], rate))
    if moved:
        grid = stamp_ns[own] if rate is None else even_grid(stamp_ns, rate)
        columns = {
            name: _resampled(mapping, name, grid, stamp_ns, values) if name in moved else values[own]
            for name, values in columns.items()
        }
        stamp_ns = grid
    # A joint with regulators has no voltages. Without commands in the file a placeholder is written.
    drive = "valve" if mapping.command_1 is None else "regulator"
    name = {"valve": "valve", "regulator": "command"}[drive]
    voltage = [
        columns[f"{name}_{n}"] if f"{name}_{n}" in columns else _constant(mapping, n, len(stamp_ns)) for n in (1, 2)
    ]
    measured = {name: _or_none(table.labels[name], columns[name], issues) for name in mapping.measured()}
    recording = Recording(
        path=path,
        stamp_ns=stamp_ns,
        pressure=np.column_stack([columns["pressure_1"], columns["pressure_2"]]),
        voltage=np.column_stack(voltage),
        angle=measured.get("angle"),
        torque=measured.get("torque"),
        external_torque=measured.get("external_torque"),
        signals={
            name: FurtherSignal(columns[f"{ALSO}{name}"], _UNIT[entry.quantity]) for name, entry in mapping.also.items()
        },
        episode_ns=times.episode_ns,
        drive=drive,
    )
    _judge_missing(where, recording, table, issues)
    jumped = resets(recording)
    if jumped is not None:
        issues.append(Issue(jumped.sentence, "jump", len(jumped.rows), jumped.times[0]))
    return _cut(where, replace(recording, issues=Issue.sorted(issues)), mapping)


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


def notes(path: str | Path, mapping: CsvMap) -> dict[str, str]:
    """Notes for a bag that is made of this file: its source, the sealed muscles, a missing regulator command.

    Returns name -> text, for :func:`~pam_antagonist.recording.notes.write_notes`.
    """
    path = Path(path)
    digest = hashlib.sha256()
    with path.open("rb") as stream:
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
    held = [table.labels[name] for name in apart if name.startswith(("valve", "command"))]
    others = [table.labels[name] for name in apart if not name.startswith(("valve", "command"))]
    text = f"the rows hold the cells of some columns each: samples are the rows with {table.labels['pressure_1']}"
    text += f"; {', '.join(others)} interpolated between rows with a value" if others else ""
    text += f"; {', '.join(held)} held between such rows" if held else ""
    return Issue(text, "resampled", len(table))


def _held(values: Floats, first: NDArray[np.intp]) -> Floats:
    """Values that hold up to each row, from values that hold from their rows on; ``first`` rows keep their own."""
    out = np.concatenate((values[:1], values[:-1]))
    out[first] = values[first]
    return out


def _signals(
    mapping: CsvMap,
    table: Table,
    keep: NDArray[np.intp],
    first: NDArray[np.intp],
    issues: list[str],
    moved: tuple[str, ...],
) -> dict[str, Signal]:
    """Scaled numbers of every column, in its unit; NaN for what is not finite. Columns of ``moved`` are held later."""
    signals = {}
    for name, cells in table.values.items():
        if name in ("time", "episode"):
            continue
        entry = mapping.entry(name)
        values = cells[keep] * entry.scale + entry.offset
        infinite = np.abs(values) >= NO_VALUE
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
        if name not in moved and getattr(entry, "holds", "until_row") == "from_row":
            # A sample's voltage held before the sample; before the first row it is not known.
            values = _held(values, first)
        signals[name] = Signal(table.labels[name], values, entry.unit, getattr(entry, "reference", None) or "")
    return signals


def _check(where: str, mapping: CsvMap, signals: dict[str, Signal], issues: list[str]) -> None:
    """Refuse what is implausible in its unit."""
    plausible.judge_pressures(where, signals["pressure_1"], signals["pressure_2"], _atmosphere(mapping), issues)
    for number, valve in enumerate(mapping.valves, 1):
        name = f"valve_{number}"
        if valve.constant is not None:
            constant = Signal(f"{name} (constant)", np.array([valve.constant]), valve.unit)
            plausible.judge_voltage(where, constant, issues)
        else:
            plausible.judge_voltage(where, signals[name], issues)
    if "command_1" in signals:
        asked = (signals["command_1"], signals["command_2"])
        plausible.judge_pressures(where, *asked, _atmosphere(mapping), issues)
    if "angle" in signals:
        plausible.judge_angle(where, signals["angle"], issues)
    for name in ("torque", "external_torque"):
        if name in signals:
            plausible.judge_torque(where, signals[name], issues)


def _atmosphere(mapping: CsvMap) -> float:
    """Absolute pressure of the surroundings [Pa]."""
    atmosphere = mapping.atmosphere
    if atmosphere is None:
        return plausible.STANDARD_ATMOSPHERE  # for plausibility only: no pressure in the map is gauge pressure
    return atmosphere.pressure * UNITS["pressure"][atmosphere.unit]


def _si(mapping: CsvMap, name: str, signal: Signal) -> Floats:
    """Values in SI units, pressures absolute."""
    if signal.reference:
        return plausible.pascal(signal.values, signal.unit, signal.reference, _atmosphere(mapping))
    quantity = "voltage" if name.startswith("valve") else "angle" if name == "angle" else "torque"
    if name.startswith(ALSO):
        quantity = mapping.also[name[len(ALSO) :]].quantity
    return np.asarray(signal.values * UNITS[quantity][signal.unit])


def _constant(mapping: CsvMap, number: int, size: int) -> Floats:
    valve = mapping.valves[number - 1]
    assert valve.constant is not None  # the map has been checked: a valve is a column or constant
    return np.full(size, valve.constant * UNITS["voltage"][valve.unit])


def _resampled(mapping: CsvMap, name: str, grid: Stamps, stamp_ns: Stamps, values: Floats) -> Floats:
    """Values on the grid: measured ones linear between rows with a value; voltages and commands held."""
    if not name.startswith(("valve", "command")):
        return interpolate(grid, stamp_ns, values)
    there = np.isfinite(values)
    if not np.any(there):
        return np.full(len(grid), np.nan)
    # A row's value held up to that row, or from then on.
    back = getattr(mapping.entry(name), "holds", "until_row") == "from_row"
    rows = np.searchsorted(stamp_ns[there], grid, side="left") - int(back)
    return np.asarray(values[there][np.clip(rows, 0, np.count_nonzero(there) - 1)])


def _resampling_issue(stamp_ns: Stamps, rate: float) -> str:
    before = 1e9 / float(np.median(np.diff(stamp_ns)))
    text = f"resampled from about {before:.4g} to {rate:g} Hz by interpolation; gaps of over five rows stay empty"
    return text + ("; there is no filter before it, so faster motion is aliased" if rate < 0.8 * before else "")


def _or_none(label: str, values: Floats, issues: list[str]) -> Floats | None:
    """The values, or None where all are missing; the issues count missing values."""
    missing = int(np.count_nonzero(np.isnan(values)))
    if missing == len(values):
        issues.append(Issue(f"{label} holds no value: left out", "missing", missing))
        return None
    if missing:
        issues.append(Issue(f"{missing} of {len(values)} samples without {label}", "missing", missing))
    return values


def _judge_missing(where: str, recording: Recording, table: Table, issues: list[str]) -> None:
    """Report missing values; refuse a recording that could not be read back from a bag."""
    present: dict[str, NDArray[np.bool_]] = {
        table.labels["pressure_1"]: np.isfinite(recording.pressure[:, 0]),
        table.labels["pressure_2"]: np.isfinite(recording.pressure[:, 1]),
    }
    valves = [label for name, label in table.labels.items() if name.startswith(("valve", "command"))]
    if valves:
        present[" and ".join(valves)] = np.asarray(np.isfinite(recording.voltage).all(axis=1))
    judge_pairing(where, recording.stamp_ns, present, issues, recording.episode_ns)
    for label, there in present.items():
        if not np.any(there):
            raise BadInput(f"{where}: {label} holds no value in {len(there)} samples")
