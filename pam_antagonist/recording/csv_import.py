"""A CSV file and a map of its columns -> one :class:`~pam_antagonist.recording.recording.Recording`."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import wrong_unit
from .csv_map import ALSO, CsvMap
from .csv_table import Table, read_table
from .csv_time import Stamps, even_grid, timing
from .notes import REGULATOR, SEALED, Issue
from .recording import Recording
from .resets import resets
from .signals import FurtherSignal
from .stamps import interpolate, judge_pairing
from .units import UNITS
from .wrong_unit import Signal

Floats = NDArray[np.float64]

_UNIT = {"pressure": "Pa", "angle": "rad", "temperature": "degC"}


def read_csv(path: str | Path, mapping: CsvMap, progress: Callable[[int], object] | None = None) -> Recording:
    """Read a recording from a CSV file.

    Values are converted to SI units and absolute pressures. A sealed chamber has the constant voltage of the map in
    every sample; :func:`notes` names the sealed muscles, the recording does not.

    Args:
        path: The file.
        mapping: What its columns are.
        progress: Called with the bytes that were read since the last call.

    Raises:
        BadInput: The file cannot be read as the map says, its times are no sample times, or values are implausible in
            their unit; with a hint where possible.
    """
    path = Path(path)
    where = str(path)
    table = read_table(path, mapping.file, mapping.columns(), progress)
    issues = list(table.issues)
    times = timing(where, mapping.time, table)
    issues += times.issues
    first = np.searchsorted(times.stamp_ns, [] if times.episode_ns is None else times.episode_ns)
    signals = _signals(mapping, table, times.keep, np.union1d([0], first).astype(np.intp), issues)
    _check(where, mapping, signals, issues)
    columns = {name: _si(mapping, name, signal) for name, signal in signals.items()}
    stamp_ns = times.stamp_ns
    rate = mapping.time.resample
    if rate is not None:
        grid = even_grid(stamp_ns, rate)
        columns = {name: _resampled(name, grid, stamp_ns, values) for name, values in columns.items()}
        issues.append(_resampling_issue(stamp_ns, rate))
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
        issues.append(jumped.sentence)
    return _cut(where, replace(recording, issues=Issue.sorted(issues)), mapping)


def _cut(where: str, recording: Recording, mapping: CsvMap) -> Recording:
    """The part that the map asks for."""
    begin, end = mapping.time.begin, mapping.time.end
    if begin == 0.0 and end is None:
        return recording
    try:
        return recording.slice(begin, float("inf") if end is None else end)
    except ValueError:
        raise BadInput(
            f"{where}: no row from time.begin {begin:g} to time.end {end}, the file has {recording.duration_s:.3f} s"
        ) from None


def notes(path: str | Path, mapping: CsvMap) -> dict[str, str]:
    """Notes for a bag that is made of this file: its source, the sealed muscles, a missing regulator command.

    Args:
        path: The CSV file.
        mapping: What its columns are.

    Returns:
        Name -> text, for :func:`~pam_antagonist.recording.notes.write_notes`.
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


def _held(values: Floats, first: NDArray[np.intp]) -> Floats:
    """Values that hold up to each row, from values that hold from their rows on; ``first`` rows keep their own."""
    out = np.concatenate((values[:1], values[:-1]))
    out[first] = values[first]
    return out


def _signals(
    mapping: CsvMap, table: Table, keep: NDArray[np.intp], first: NDArray[np.intp], issues: list[str]
) -> dict[str, Signal]:
    """Scaled numbers of every column, in its unit; NaN for what is not finite."""
    signals = {}
    for name, cells in table.values.items():
        if name in ("time", "episode"):
            continue
        entry = mapping.entry(name)
        values = cells[keep] * entry.scale + entry.offset
        infinite = np.isinf(values)
        if np.any(infinite):
            issues.append(f"{np.count_nonzero(infinite)} cells of {table.labels[name]} are infinite: left out")
            values[infinite] = np.nan
        if getattr(entry, "holds", "until_row") == "from_row":
            # A sample's voltage held before the sample; before the first row it is not known.
            values = _held(values, first)
        signals[name] = Signal(table.labels[name], values, entry.unit, getattr(entry, "reference", None) or "")
    return signals


def _check(where: str, mapping: CsvMap, signals: dict[str, Signal], issues: list[str]) -> None:
    """Refuse what is implausible in its unit."""
    wrong_unit.check_pressures(where, signals["pressure_1"], signals["pressure_2"], _atmosphere(mapping), issues)
    for number, valve in enumerate(mapping.valves, 1):
        name = f"valve_{number}"
        if valve.constant is not None:
            constant = Signal(f"{name} (constant)", np.array([valve.constant]), valve.unit)
            wrong_unit.check_voltage(where, constant, issues)
        else:
            wrong_unit.check_voltage(where, signals[name], issues)
    if "command_1" in signals:
        asked = (signals["command_1"], signals["command_2"])
        wrong_unit.check_pressures(where, *asked, _atmosphere(mapping), issues)
    if "angle" in signals:
        wrong_unit.check_angle(where, signals["angle"], issues)
    for name in ("torque", "external_torque"):
        if name in signals:
            wrong_unit.check_torque(where, signals[name], issues)


def _atmosphere(mapping: CsvMap) -> float:
    """Absolute pressure of the surroundings [Pa]."""
    atmosphere = mapping.atmosphere
    if atmosphere is None:
        return wrong_unit.STANDARD_ATMOSPHERE  # for plausibility only: no pressure in the map is gauge pressure
    return atmosphere.pressure * UNITS["pressure"][atmosphere.unit]


def _si(mapping: CsvMap, name: str, signal: Signal) -> Floats:
    """Values in SI units, pressures absolute."""
    if signal.reference:
        return wrong_unit.pascal(signal.values, signal.unit, signal.reference, _atmosphere(mapping))
    quantity = "voltage" if name.startswith("valve") else "angle" if name == "angle" else "torque"
    if name.startswith(ALSO):
        quantity = mapping.also[name[len(ALSO) :]].quantity
    return np.asarray(signal.values * UNITS[quantity][signal.unit])


def _constant(mapping: CsvMap, number: int, size: int) -> Floats:
    valve = mapping.valves[number - 1]
    assert valve.constant is not None  # the map has been checked: a valve is a column or constant
    return np.full(size, valve.constant * UNITS["voltage"][valve.unit])


def _resampled(name: str, grid: Stamps, stamp_ns: Stamps, values: Floats) -> Floats:
    """Values on the grid: linear between rows; a voltage or command is the next row's, which holds up to that row."""
    if name.startswith(("valve", "command")):
        return np.asarray(values[np.minimum(np.searchsorted(stamp_ns, grid, side="left"), len(values) - 1)])
    return interpolate(grid, stamp_ns, values)


def _resampling_issue(stamp_ns: Stamps, rate: float) -> str:
    before = 1e9 / float(np.median(np.diff(stamp_ns)))
    text = f"resampled from about {before:.4g} to {rate:g} Hz by interpolation; gaps of over five rows stay empty"
    return text + ("; there is no filter before it, so faster motion is aliased" if rate < 0.8 * before else "")


def _or_none(label: str, values: Floats, issues: list[str]) -> Floats | None:
    """The values, or None where all are missing; the issues count missing values."""
    missing = int(np.count_nonzero(np.isnan(values)))
    if missing == len(values):
        issues.append(f"{label} holds no value: left out")
        return None
    if missing:
        issues.append(f"{missing} of {len(values)} samples without {label}")
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
