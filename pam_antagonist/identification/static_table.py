"""Static measurements of one muscle from a table: its force by length and pressure, its volume by length."""

from __future__ import annotations

import hashlib
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static_columns import Choice, candidates, column_of
from pam_antagonist.identification.static_regression import bands
from pam_antagonist.recording.csv_map import Delimiter, Layout
from pam_antagonist.recording.csv_table import Table, read_table
from pam_antagonist.recording.csv_text import Line, Lines, check_file, opened, split
from pam_antagonist.recording.units import UNITS
from pam_antagonist.recording.wrong_unit import Signal, check_pressures, pascal

_PEEKED = 50
_DELIMITERS: tuple[Delimiter, ...] = (";", "\t", "|", ",")
_ADVICE = {
    "skip_after_header": "a line of units? units belong into the columns' names",
    "decimal": "decimals after a comma need cells that are parted by a semicolon or a tab",
    "encoding": "save the file as UTF-8",
    "delimiter": "cells may be parted by a comma, semicolon, tab, | or spaces",
    "header": "the first line has to name the columns, with their units",
    "missing": "a cell without a value has to be empty",
}
"""Advice on a file, by the entry of a column map that would describe its format."""


def opening(path: Path) -> tuple[Layout, list[str]]:
    """The format of a file, and the names of its columns.

    Raises:
        BadInput: no text file, or nothing in it but comments.
    """
    check_file(path)
    layout = Layout(comment=None)
    start: list[Line] = []
    with opened(path, layout) as stream:
        lines = Lines(path, layout, stream)
        for line in lines:
            start.append(line)
            if not line.text.lstrip().startswith("#"):
                break
        after = "".join(line.text for line in itertools.islice(lines, _PEEKED))
    first = start[-1] if start else Line(0, "#")
    if first.text.lstrip().startswith("#"):
        raise BadInput(f"{path}: no rows in it, only comments")
    delimiter: Delimiter = next((mark for mark in _DELIMITERS if mark in first.text), "space")
    # Commas that do not separate cells may be decimal commas.
    comma = delimiter != "," and re.search(r"\d,\d", after) and not re.search(r"\d\.\d", after)
    layout = Layout(comment="#", delimiter=delimiter, decimal="," if comma else ".")
    names = _names(path, layout, first)
    if all(re.fullmatch(r"[-+.,\deE]+", name) for name in names) and len(start) > 1:
        # numpy.savetxt writes the names as a comment before the first row.
        head = start[-2]
        layout = layout.replaced(comment=None, skip_lines=head.number - 1)
        names = [name for name in (cell.lstrip("# ") for cell in _names(path, layout, head)) if name]
    return layout, names


def _names(path: Path, layout: Layout, line: Line) -> list[str]:
    return [cell.strip() for cell in split(path, layout, [line])[0]]


@contextmanager
def advised() -> Iterator[None]:
    """Replace the reader's advice, which is about column maps: tables have none.

    Raises:
        BadInput: the reader's error with advice for tables.
    """
    try:
        yield
    except BadInput as error:
        text = str(error)
        entry = re.search(rf"file\.({'|'.join(_ADVICE)})\b", text)
        cut = text.rfind("; ", 0, entry.start()) if entry else -1
        raise BadInput(f"{text[:cut]}; {_ADVICE[entry[1]]}" if entry and cut > 0 else text) from None


Floats = NDArray[np.float64]

_PLAUSIBLE = {"length": (0.02, 2.0), "volume": (1e-7, 1e-2), "force": (1.0, 2e4)}
"""Ranges that a rig may have, in SI units: of every length and volume, and of the largest force."""
_USUAL = {"length": 0.2, "volume": 5e-5, "force": 300.0}
_FEWEST_ROWS = 3


@dataclass(frozen=True, eq=False)
class _Rows:
    """What both kinds of table have.

    Attributes:
        name: of the file.
        sha256: of its bytes.
        issues: sentences about what was left out or is odd.
        length: (N,) [m].
        group: number of the length that each row belongs to (N,), from the shortest on.
        spread: standard deviation of each value (N,) in its SI unit, ones where it was not given.
        declared: whether the standard deviation was given.
    """

    name: str
    sha256: str
    issues: tuple[str, ...]
    length: Floats
    group: NDArray[np.int64]
    spread: Floats
    declared: bool

    def __len__(self) -> int:
        return len(self.length)

    @property
    def lengths(self) -> int:
        """How many different lengths there are."""
        return int(self.group.max()) + 1 if len(self) else 0


@dataclass(frozen=True, eq=False)
class ForceMap(_Rows):
    """Forces of a muscle held at a length and a pressure.

    Attributes:
        pressure: absolute (N,) [Pa].
        force: (N,) [N].
        limit: [N] Upper limit of the map where the muscle is slack; nothing else is known there.
        slack: where the force is not above the limit (N,).
        atmosphere: absolute pressure of the surroundings [Pa].
    """

    pressure: Floats
    force: Floats
    limit: float
    slack: NDArray[np.bool_]
    atmosphere: float

    def part(self, keep: NDArray[np.bool_]) -> ForceMap:
        """The rows of a mask (N,), lengths numbered anew."""
        names = ("length", "group", "spread", "pressure", "force", "slack")
        cut = replace(self, **{name: getattr(self, name)[keep] for name in names})
        return replace(cut, group=np.unique(cut.group, return_inverse=True)[1].reshape(-1))


@dataclass(frozen=True, eq=False)
class VolumeTable(_Rows):
    """Volumes of a muscle held at a length.

    Attributes:
        volume: (N,) [m³].
    """

    volume: Floats


def read_force_map(
    path: Path,
    atmosphere: float,
    columns: Mapping[str, Choice] | None = None,
    reference: str = "",
    slack_below: float = 0.0,
) -> ForceMap:
    """Read a table of length, pressure and force.

    Args:
        path: the CSV file.
        atmosphere: absolute pressure of the surroundings [Pa], which gauge pressures count from.
        columns: by quantity, those that the user named; the others are found by their names.
        reference: gauge or absolute, for a pressure whose column does not say it.
        slack_below: largest force [N] that is taken for a slack muscle or for no measurement.

    Raises:
        BadInput: no such column, no unit, values that cannot be in their unit, or too little in the table.
    """
    values, labels, issues, declared = _read(path, ("length", "pressure", "force"), columns, reference, atmosphere)
    length, pressure, force = values["length"], values["pressure"], values["force"]
    for name, what in (("length", "lengths"), ("pressure", "pressures")):
        if float(np.ptp(values[name])) == 0.0:
            raise BadInput(
                f"{path}: {labels[name]} is {values[name][0]:g} throughout, expected forces at several {what}"
            )
    if np.max(force) <= slack_below:
        sign = "; does a pull count as negative?" if np.min(force) < -1.0 else ""
        raise BadInput(f"{path}: {labels['force']} never exceeds {slack_below:g} N, expected a contraction force{sign}")
    slack = force <= slack_below
    if np.min(force) < 0.0:
        issues.append(
            f"{int(np.sum(force < 0.0))} forces are negative, down to {force.min():.3g} N: a muscle only pulls, so "
            "they are taken as slack; if the sensor's zero wanders, give --slack-below"
        )
    group = bands(length)
    return ForceMap(
        path.name, _sha256(path), tuple(issues), length, group, values["spread"], declared,
        pressure, force, slack_below, slack, atmosphere,
    )  # fmt: skip


def read_volumes(path: Path, columns: Mapping[str, Choice] | None = None) -> VolumeTable:
    """Read a table of length and volume.

    Args:
        path: the CSV file.
        columns: by quantity, those that the user named; the others are found by their names.

    Raises:
        BadInput: as :func:`read_force_map`.
    """
    values, labels, issues, declared = _read(path, ("length", "volume"), columns, "", 0.0)
    group = bands(values["length"])
    if group.max() < 2:
        raise BadInput(
            f"{path}: {labels['length']} has {int(group.max()) + 1} different values, expected at least 3, since the "
            "volume is a parabola in the length (equation (3))"
        )
    if np.ptp(values["volume"]) == 0.0:
        raise BadInput(
            f"{path}: {labels['volume']} is the same throughout, expected volumes that change with the length"
        )
    return VolumeTable(
        path.name, _sha256(path), tuple(issues), values["length"], group, values["spread"], declared, values["volume"]
    )


def _read(
    path: Path, wanted: Sequence[str], columns: Mapping[str, Choice] | None, reference: str, atmosphere: float
) -> tuple[dict[str, Floats], dict[str, str], list[str], bool]:
    """Columns in SI units (the last one's standard deviation as ``spread``), labels, issues, whether that was given."""
    with advised():
        layout, header = opening(path)
    chosen = {name: column_of(path, header, name, (columns or {}).get(name), reference) for name in wanted}
    deviation = f"{wanted[-1]}_std"
    if candidates(header, deviation) or deviation in (columns or {}):
        chosen[deviation] = column_of(path, header, deviation, (columns or {}).get(deviation), "")
    with advised():
        table = read_table(path, layout, {name: choice.column for name, choice in chosen.items()})
    issues = list(table.issues)
    table = _complete(path, table, issues)
    signals = {
        name: Signal(table.labels[name], table.values[name], choice.unit, choice.reference)
        for name, choice in chosen.items()
    }
    values: dict[str, Floats] = {}
    for name, signal in signals.items():
        if name == "pressure":
            odd: list[str] = []
            check_pressures(str(path), signal, signal, atmosphere, odd)
            issues += dict.fromkeys(odd)
            values[name] = pascal(signal.values, signal.unit, signal.reference, atmosphere)
            continue
        quantity = name.removesuffix("_std")
        values[name] = signal.values * UNITS[quantity][signal.unit]
        if name == quantity:
            _check_range(path, signal, quantity)
    spread = values.pop(deviation, None)
    if spread is not None and not np.all(spread > 0.0):
        raise BadInput(f"{path}: {table.labels[deviation]} goes down to {spread.min():g}, expected deviations above 0")
    values["spread"] = np.ones(len(table)) if spread is None else spread
    return values, dict(table.labels), issues, spread is not None


def _complete(path: Path, table: Table, issues: list[str]) -> Table:
    """The rows in which no value is missing."""
    good = np.all([np.isfinite(cells) for cells in table.values.values()], axis=0)
    missing = int(np.sum(~good))
    if missing:
        issues.append(
            f"{missing} of {len(good)} rows lack a value (the first in line {table.line[~good][0]}): left out"
        )
    if int(good.sum()) < _FEWEST_ROWS:
        raise BadInput(f"{path}: {int(good.sum())} complete rows, expected at least {_FEWEST_ROWS}")
    return replace(table, values={name: cells[good] for name, cells in table.values.items()}, line=table.line[good])


def _check_range(path: Path, signal: Signal, quantity: str) -> None:
    """Refuse values that no muscle has, and name the unit in which they would be plausible."""
    low, high = _PLAUSIBLE[quantity]

    def fits(unit: str) -> bool:
        values = np.abs(signal.values) * UNITS[quantity][unit]
        least = values.max() if quantity == "force" else values.min()
        return bool(low <= least and values.max() <= high)

    if fits(signal.unit) and (quantity == "force" or signal.values.min() > 0.0):
        return
    top = float(np.max(np.abs(signal.values)))
    others = [unit for unit in UNITS[quantity] if unit != signal.unit and fits(unit)]
    others.sort(key=lambda unit: abs(math.log(top * UNITS[quantity][unit] / _USUAL[quantity])))
    hint = f"; {top:.3g} looks like {others[0]}" if others else ""
    si = {"length": "m", "volume": "m3", "force": "N"}[quantity]
    what = "a largest force of" if quantity == "force" else f"{quantity}s of a muscle,"
    raise BadInput(f"{path}: {signal.label} goes from {signal.span}, expected {what} {low:g} to {high:g} {si}{hint}")


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
