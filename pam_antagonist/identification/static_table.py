"""Tables of a muscle that a bench holds still: its force by length and pressure, its volume by length.

Nothing is guessed: a column without a unit, and a pressure that is not said to be gauge or absolute, are refused.
"""

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
from pam_antagonist.identification.tobit import Bools, Floats
from pam_antagonist.recording.array_files import listed
from pam_antagonist.recording.csv_map import Delimiter, Layout
from pam_antagonist.recording.csv_table import NumberTable, TextLine, TextLines, check_file, opened, read_table, split
from pam_antagonist.recording.plausible import UNITS, Signal, canonical, judge_muscles

_WORDS = {
    "length": ("length", "l", "len"),
    "pressure": ("pressure", "p"),
    "force": ("force", "f"),
    "volume": ("volume", "v", "vol"),
}
QUANTITIES = tuple(_WORDS)
"""Quantities that a column may hold; ``_std`` behind a quantity means its standard deviation."""
_DEVIATION = ("std", "sigma", "sd")
_REFERENCES = {"gauge": "gauge", "g": "gauge", "rel": "gauge", "relative": "gauge",
               "absolute": "absolute", "abs": "absolute", "a": "absolute"}  # fmt: skip
_EXAMPLES = {"length": "length_mm", "pressure": "pressure_kPa_gauge", "force": "force_N", "volume": "volume_cm3",
             "force_std": "force_std_N", "volume_std": "volume_std_cm3"}  # fmt: skip
_PLAUSIBLE = {"length": (0.02, 2.0), "volume": (1e-7, 1e-2), "force": (1.0, 2e4)}
"""Ranges that a rig may have, in SI units: of every length and volume, and of the largest force."""
_USUAL = {"length": 0.2, "volume": 5e-5, "force": 300.0}
_FEWEST_ROWS = 3
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
"""Advice on a file, by the entry of a column map that would describe its format: tables have no map."""


@dataclass(frozen=True)
class Choice:
    """A column as the user named it."""

    column: str
    unit: str = ""
    reference: str = ""


@dataclass(frozen=True, eq=False)
class StaticTable:
    """Forces or volumes of a muscle that is held at a length, and for forces at a pressure; N rows."""

    name: str
    length: Floats  # (N,) [m]
    value: Floats  # forces (N,) [N] or volumes (N,) [m³]
    pressure: Floats  # absolute (N,) [Pa]; of volumes zeros
    group: NDArray[np.int64]  # number of the length that each row belongs to (N,), from the shortest on
    spread: Floats  # standard deviation of each value (N,) in its SI unit, ones where it was not given
    declared: bool
    # where a force is not above the limit (N,): the muscle is slack, and only that the map is not above the limit is
    # known.
    slack: Bools
    limit: float = 0.0  # [N] of the forces
    atmosphere: float = 0.0  # absolute pressure of the surroundings [Pa]
    sha256: str = ""
    issues: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.length)

    @property
    def lengths(self) -> int:
        """How many different lengths there are."""
        return int(self.group.max()) + 1 if len(self) else 0

    @property
    def aim(self) -> Floats:
        """What is known of each value (N,): the measured one, or of a slack muscle the limit that it is not above."""
        return np.where(self.slack, self.limit, self.value)

    def part(self, keep: Bools) -> StaticTable:
        """The rows of a mask (N,), lengths numbered anew."""
        names = ("length", "value", "pressure", "group", "spread", "slack")
        cut = replace(self, **{name: getattr(self, name)[keep] for name in names})
        return replace(cut, group=np.unique(cut.group, return_inverse=True)[1].reshape(-1))


def bands(values: Floats, most: int = 8) -> NDArray[np.int64]:
    """Group numbers (N,) of values, from the lowest on; values that were meant to be the same form a group.

    Values closer than 2 % of the range belong together. Where this chains different values (a sweep), the range is cut
    into ``most`` bands of equal width.
    """
    order = np.argsort(values, kind="stable")
    span = float(np.ptp(values))
    number = np.zeros(len(values), dtype=np.int64)
    if span == 0.0:
        return number
    number[order[1:]] = np.cumsum(np.diff(values[order]) > 0.02 * span)
    if max(np.ptp(values[number == group]) for group in range(number.max() + 1)) > 0.1 * span:
        number = np.minimum((values - values.min()) / span * most, most - 1).astype(np.int64)
        number = np.unique(number, return_inverse=True)[1].reshape(-1)
    return number


def read_force_map(
    path: Path,
    atmosphere: float,
    columns: Mapping[str, Choice] | None = None,
    reference: str = "",
    slack_below: float = 0.0,
) -> StaticTable:
    """Read a table of length, pressure and force.

    `atmosphere`: absolute pressure of the surroundings [Pa], which gauge pressures count from. `columns`: by quantity,
    those that the user named; the others are found by their names. `reference`: gauge or absolute, for a pressure whose
    column does not say it. `slack_below`: largest force [N] that is taken for a slack muscle or for no measurement.
    """
    table, labels = _read(path, ("length", "pressure", "force"), columns, reference, atmosphere)
    force = table.value
    for name, values in (("length", table.length), ("pressure", table.pressure)):
        if float(np.ptp(values)) == 0.0:
            raise BadInput(f"{path}: {labels[name]} is {values[0]:g} throughout, expected forces at several {name}s")
    if np.max(force) <= slack_below:
        sign = "; does a pull count as negative?" if np.min(force) < -1.0 else ""
        raise BadInput(f"{path}: {labels['force']} never exceeds {slack_below:g} N, expected a contraction force{sign}")
    issues = table.issues
    if np.min(force) < 0.0:
        issues += (
            f"{int(np.sum(force < 0.0))} forces are negative, down to {force.min():.3g} N: a muscle only pulls, so "
            "they are taken as slack; if the sensor's zero wanders, give --slack-below",
        )
    return replace(table, slack=force <= slack_below, limit=slack_below, issues=issues)


def read_volumes(path: Path, columns: Mapping[str, Choice] | None = None) -> StaticTable:
    """Read a table of length and volume.

    `columns`: by quantity, those that the user named; the others are found by their names.
    """
    table, labels = _read(path, ("length", "volume"), columns, "", 0.0)
    if table.lengths < 3:
        raise BadInput(
            f"{path}: {labels['length']} has {table.lengths} different values, expected at least 3, since the "
            "volume is a parabola in the length (equation (3))"
        )
    if np.ptp(table.value) == 0.0:
        raise BadInput(
            f"{path}: {labels['volume']} is the same throughout, expected volumes that change with the length"
        )
    return table


def _read(
    path: Path, wanted: Sequence[str], columns: Mapping[str, Choice] | None, reference: str, atmosphere: float
) -> tuple[StaticTable, dict[str, str]]:
    """The table in SI units, and the labels of its columns for messages."""
    given = columns or {}
    with _advised():
        layout, header = _opening(path)
    chosen = {name: _column_of(path, header, name, given.get(name), reference) for name in wanted}
    deviation = f"{wanted[-1]}_std"
    if _candidates(header, deviation) or deviation in given:
        chosen[deviation] = _column_of(path, header, deviation, given.get(deviation), "")
    with _advised():
        table = read_table(path, layout, {name: choice.column for name, choice in chosen.items()})
    issues = list(table.issues)
    cells = _complete(path, table, issues)
    rows = len(cells["length"])
    values = {"pressure": np.full(rows, atmosphere), deviation: np.ones(rows)}
    for name, choice in chosen.items():
        quantity = name.removesuffix("_std")
        signal = Signal(table.labels[name], quantity, cells[name], choice.unit, choice.reference, atmosphere, True)
        values[name] = signal.si()
        if name == "pressure":
            odd: list[str] = []
            judge_muscles(str(path), signal, signal, odd)
            issues += dict.fromkeys(odd)
        elif name == quantity:
            _check_range(path, signal, quantity)
    spread = values[deviation]
    if not np.all(spread > 0.0):
        raise BadInput(f"{path}: {table.labels[deviation]} goes down to {spread.min():g}, expected deviations above 0")
    found = StaticTable(
        path.name, values["length"], values[wanted[-1]], values["pressure"], bands(values["length"]), spread,
        deviation in chosen, np.zeros(rows, dtype=bool), atmosphere=atmosphere,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(), issues=tuple(issues),
    )  # fmt: skip
    return found, dict(table.labels)


def _complete(path: Path, table: NumberTable, issues: list[str]) -> dict[str, Floats]:
    """The columns without rows in which a value is missing."""
    good = np.all([np.isfinite(cells) for cells in table.values.values()], axis=0)
    missing = int(np.sum(~good))
    if missing:
        issues.append(
            f"{missing} of {len(good)} rows lack a value (the first in line {table.line[~good][0]}): left out"
        )
    if int(good.sum()) < _FEWEST_ROWS:
        raise BadInput(f"{path}: {int(good.sum())} complete rows, expected at least {_FEWEST_ROWS}")
    return {name: cells[good] for name, cells in table.values.items()}


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


def _opening(path: Path) -> tuple[Layout, list[str]]:
    """The format of a file, and the names of its columns."""
    check_file(path)
    layout = Layout(comment=None)
    start: list[TextLine] = []
    with opened(path, layout) as stream:
        lines = TextLines(path, layout, stream)
        for line in lines:
            start.append(line)
            if not line.text.lstrip().startswith("#"):
                break
        after = "".join(line.text for line in itertools.islice(lines, _PEEKED))
    first = start[-1] if start else TextLine(0, "#")
    if first.text.lstrip().startswith("#"):
        raise BadInput(f"{path}: no rows in it, only comments")
    delimiter: Delimiter = next((mark for mark in _DELIMITERS if mark in first.text), "space")
    # Commas that do not separate cells may be decimal commas.
    comma = delimiter != "," and re.search(r"\d,\d", after) and not re.search(r"\d\.\d", after)
    layout = Layout(comment="#", delimiter=delimiter, decimal="," if comma else ".")

    def names(line: TextLine) -> list[str]:
        return [cell.strip() for cell in split(path, layout, [line])[0]]

    found = names(first)
    if all(re.fullmatch(r"[-+.,\deE]+", name) for name in found) and len(start) > 1:
        # numpy.savetxt writes the names as a comment before the first row.
        head = start[-2]
        layout = layout.replaced(comment=None, skip_lines=head.number - 1)
        found = [name for name in (cell.lstrip("# ") for cell in names(head)) if name]
    return layout, found


@contextmanager
def _advised() -> Iterator[None]:
    """Replace the reader's advice, which is about column maps."""
    try:
        yield
    except BadInput as error:
        text = str(error)
        entry = re.search(rf"file\.({'|'.join(_ADVICE)})\b", text)
        cut = text.rfind("; ", 0, entry.start()) if entry else -1
        raise BadInput(f"{text[:cut]}; {_ADVICE[entry[1]]}" if entry and cut > 0 else text) from None


def _column_of(path: Path, header: Sequence[str], quantity: str, given: Choice | None, reference: str) -> Choice:
    """Column, unit and reference of a quantity, complete."""
    base = quantity.removesuffix("_std")
    where = f"{path}: {quantity}"
    if given is None:
        found = _candidates(header, quantity)
        if len(found) != 1:
            what = f"{len(found)} columns are called so" if found else "no column is called so"
            raise BadInput(
                f"{where}: {what} among {listed(header)}, expected one such as {_EXAMPLES[quantity]}; else give "
                f'--column "{quantity}=NAME:UNIT"'
            )
        given = Choice(found[0])
    tokens = _tokens(given.column)
    unit, stated = given.unit, given.reference
    if not unit:
        in_name = [pair for token in tokens if (pair := _unit(base, token))]
        if len(in_name) != 1:
            raise BadInput(
                f"{where}: column {given.column!r} does not tell its unit, expected one of {', '.join(UNITS[base])} in "
                f'its name ({_EXAMPLES[quantity]}); else give --column "{quantity}={given.column}:UNIT"'
            )
        unit = in_name[0][0]
        stated = stated or in_name[0][1]
    unit = canonical(f"{where}: column {given.column!r}", base, unit)
    if quantity != "pressure":
        return Choice(given.column, unit)
    named = {_REFERENCES[token.lower()] for token in tokens if token.lower() in _REFERENCES}
    references = (named | {stated, reference}) - {""}
    if len(references) != 1:
        what = (
            "is said to be gauge and absolute"
            if references
            else "does not tell whether it is gauge or absolute pressure"
        )
        raise BadInput(
            f"{where}: column {given.column!r} {what}, expected one of them, in its name (pressure_{unit}_gauge) or by "
            "--pressure gauge|absolute"
        )
    return Choice(given.column, unit, references.pop())


def _tokens(name: str) -> list[str]:
    return [token for token in re.split(r"[\s_\[\](){},/;:]+", name) if token]


def _candidates(header: Sequence[str], quantity: str) -> list[str]:
    """Columns whose first word is a name of the quantity, or of its standard deviation (``force_std``)."""
    base, _, deviation = quantity.partition("_")
    out = []
    for name in header:
        words = [token.lower() for token in _tokens(name)]
        if words and words[0] in _WORDS[base] and any(word in _DEVIATION for word in words[1:]) == bool(deviation):
            out.append(name)
    return out


def _unit(quantity: str, token: str) -> tuple[str, str] | None:
    """The unit that a word of a column's name states, with the reference of barg or psia; None if it is no unit."""
    for text, reference in ((token, ""), (token[:-1], {"g": "gauge", "a": "absolute"}.get(token[-1:], "-"))):
        if reference == "-" or (reference and quantity != "pressure"):
            continue
        try:
            return canonical("", quantity, text.replace("^", "")), reference
        except BadInput:
            continue
    return None
