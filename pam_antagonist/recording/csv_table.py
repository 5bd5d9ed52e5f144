"""The columns of a CSV file as numbers, with the line number of each row."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import array_files
from .csv_map import Layout, Name
from .csv_text import Line, Lines, check_file, labview, opened, other_delimiter, shown, split
from .notes import Issue

Floats = NDArray[np.float64]

MAX_ROWS = 2_000_000
"""Most rows that are imported: over half an hour at 1 kHz. Writing them as a bag takes about 4 GB of memory."""
_BLOCK = 10_000  # lines that are turned into numbers at once
_NO_VALUE = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--"})


@dataclass(frozen=True, eq=False)
class Table:
    """Numbers of a CSV file, N rows."""

    values: Mapping[str, Floats]  # Quantity -> cells (N,), NaN where a cell holds no value
    line: NDArray[np.int32]  # Line number of each row in the file (N,), counted from 1
    labels: Mapping[str, str]
    issues: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.line)


def read_table(
    path: Path, layout: Layout, columns: Mapping[str, Name], progress: Callable[[int], object] | None = None
) -> Table:
    """Read some columns of a CSV file. `columns`: Quantity -> name or number (from 1) of its column."""
    kind = array_files.kind_of(path)
    if kind:
        return _of_arrays(path, kind, layout, columns)
    size = check_file(path)
    layout = labview(path, layout)
    with opened(path, layout) as stream:
        lines = Lines(path, layout, stream)
        head = _head(path, layout, lines)
        index = {quantity: _find(path, layout, head, quantity, column) for quantity, column in columns.items()}
        reader = _Reader(path, layout, head, index)
        done = 0
        while block := list(itertools.islice(lines, _BLOCK)):
            reader.read(block, lines)
            # The position of the buffer may lead that of the decoder, by a block at most.
            now = stream.buffer.tell()
            _check_size(path, reader.rows, now, size)
            if progress is not None:
                progress(now - done)
            done = now
    if reader.rows == 0:
        raise BadInput(f"{path}: fewer than two rows of numbers in it")
    return reader.table()


def _of_arrays(path: Path, kind: str, layout: Layout, columns: Mapping[str, Name]) -> Table:
    """The table of a file that holds arrays; a row's line number is the number of the row."""
    values = array_files.read_columns(path, kind, columns, MAX_ROWS)
    for cells in values.values():
        for sentinel in layout.missing:
            if not isinstance(sentinel, str):
                cells[cells == sentinel] = np.nan
    rows = len(next(iter(values.values())))
    labels = {quantity: f"{quantity} (column {column!r})" for quantity, column in columns.items()}
    return Table(values, np.arange(1, rows + 1, dtype=np.int32), labels, ())


def _check_size(path: Path, rows: int, done: int, size: int) -> None:
    """Refuse a file that is too long, as soon as the rows so far show it."""
    if rows > MAX_ROWS:
        raise BadInput(f"{path}: more than {MAX_ROWS:,} rows, expected at most that many: cut the file into parts")
    if rows >= _BLOCK // 2 and rows * (size / done) > 1.2 * MAX_ROWS:
        raise BadInput(
            f"{path}: about {rows * (size / done):,.0f} rows ({size / 1e6:,.0f} MB), expected at most {MAX_ROWS:,}: "
            "cut the file into parts"
        )


@dataclass(frozen=True)
class _Head:
    """The header: names (None without one), number of columns, and the first row where it has been read already."""

    names: list[str] | None
    width: int
    first: Line | None = None


def _head(path: Path, layout: Layout, lines: Lines) -> _Head:
    lines.skip(layout.skip_lines)
    line = next(lines, None)
    if line is not None and re.fullmatch(r"sep=.\s*", line.text):
        # A line of Excel; the delimiter is taken from the map.
        line = next(lines, None)
    if line is None:
        raise BadInput(f"{path}: no rows in it, only empty lines and comments")
    cells = [cell.strip() for cell in split(path, layout, [line])[0]]
    if not layout.header:
        lines.skip(layout.skip_after_header)
        return _Head(None, len(cells), line)
    if layout.comment is None:
        # numpy.savetxt and others write the names as a comment.
        cells[0] = cells[0].lstrip("# ")
        cells = cells if cells[0] else cells[1:]
    while cells and not cells[-1]:
        cells.pop()
    if cells and all(_is_number(cell, layout) for cell in cells):
        raise BadInput(
            f"{path}: line {line.number} should name the columns and holds numbers only ({shown(','.join(cells))}); "
            "without names, give file.header: false; where they stand in a comment before, give file.comment: null"
        )
    lines.skip(layout.skip_after_header)
    return _Head(cells, len(cells))


def _find(path: Path, layout: Layout, head: _Head, quantity: str, column: Name) -> int:
    """Index of a column."""
    names, width = head.names, head.width
    known = f"{width} without names" if names is None else array_files.listed(names)
    if width == 1 and (other := other_delimiter(layout, names[0] if names else head.first.text if head.first else "")):
        raise BadInput(f"{path}: one column only ({shown(known)}): is the delimiter {other}? give file.delimiter")
    if isinstance(column, int):
        if column > width:
            raise BadInput(f"{path}: {quantity} is column {column}, and the file has {width} ({known})")
        return column - 1
    assert names is not None  # a map without a header has numbers only
    if (named := names.count(column.strip())) > 1:
        raise BadInput(f"{path}: {quantity}: {named} columns are named {column!r}, expected one; give its number")
    if column.strip() in names:
        return names.index(column.strip())
    raise array_files.no_column(path, quantity, column, names)


@dataclass
class _Reader:
    """Turns blocks of lines into columns of numbers."""

    path: Path
    layout: Layout
    head: _Head
    index: Mapping[str, int]
    rows: int = 0
    columns: dict[str, list[Floats]] = field(default_factory=dict)
    numbers: list[NDArray[np.int32]] = field(default_factory=list)
    issues: list[str] = field(default_factory=list)
    short: tuple[Line, list[str]] | None = None  # the first row with fewer cells than the header
    shorter: int = 0
    longer: int = 0
    full: bool = False
    numbers_behind: bool = False

    def read(self, block: list[Line], lines: Lines) -> None:
        """Add a block; ``lines`` only tells whether the file ended without a line break."""
        if self.head.first is not None and self.rows == 0:
            block = [self.head.first, *block]
        rows = self._checked(split(self.path, self.layout, block), block, lines.unterminated)
        block = block[: len(rows)]
        # float() reads 1_000 as a thousand; in a file it is more likely a mistake.
        plain = not any("_" in line.text for line in block)
        for quantity, index in self.index.items():
            cells = [row[index] for row in rows]
            self.columns.setdefault(quantity, []).append(self._numbers(quantity, cells, block, plain))
        self.numbers.append(np.fromiter((line.number for line in block), np.int32, len(block)))
        self.rows += len(block)

    def table(self) -> Table:
        """All rows that were read."""
        self._judge_ragged()
        values = {quantity: np.concatenate(parts) for quantity, parts in self.columns.items()}
        for sentinel in self.layout.missing:
            if not isinstance(sentinel, str) or _is_number(sentinel, self.layout):
                number = _number(sentinel, self.layout) if isinstance(sentinel, str) else float(sentinel)
                for cells in values.values():
                    cells[cells == number] = np.nan
        labels = {quantity: self._label(quantity) for quantity in self.index}
        return Table(values, np.concatenate(self.numbers), labels, tuple(self.issues))

    def _label(self, quantity: str) -> str:
        column = self.index[quantity]
        name = f"column {column + 1}" if self.head.names is None else f"column {self.head.names[column]!r}"
        return f"{quantity} ({name})"

    def _checked(self, rows: list[list[str]], block: list[Line], cut_off: bool) -> list[list[str]]:
        """Rows with all used columns, and no number behind the header's columns; one that is cut off is dropped."""
        width, needed = self.head.width, 1 + max(self.index.values())
        if set(map(len, rows)) == {width}:
            self._full(rows[0][needed:])
            return rows
        for number, row in enumerate(rows):
            if len(row) < width and cut_off and number == len(rows) - 1 and number + self.rows > 0:
                self.issues.append(Issue(f"line {block[number].number} is cut off: left out", "dropped", 1))
                return rows[:number]
            if len(row) < needed or any(_is_number(cell, self.layout) for cell in row[width:]):
                raise self._ragged(block[number], row)
            if len(row) < width:
                self.short = self.short or (block[number], row)
                self.shorter += 1
            else:
                self._full(row[needed:width])
                self.longer += any(cell.strip() for cell in row[width:])
        return rows

    def _full(self, unused: list[str]) -> None:
        """Note a row as long as the header, with the cells behind the last used column."""
        self.full = True
        self.numbers_behind = self.numbers_behind or any(_is_number(cell, self.layout) for cell in unused)

    def _ragged(self, line: Line, row: list[str]) -> BadInput:
        """The refusal of a row that is shorter or longer than the header."""
        width = self.head.width
        other = other_delimiter(self.layout, line.text) if len(row) == 1 else ""
        hint = f"; is the delimiter {other}?" if other else ""
        if self.layout.delimiter == "," and len(row) == 2 * width:
            hint = "; commas stand before decimals and between cells: write the file with another delimiter"
        expected = f"{width} as in the {'first row' if self.head.names is None else 'header'}"
        return BadInput(
            f"{self.path}: line {line.number} has {len(row)} cells ({shown(line.text)}), expected {expected}{hint}"
        )

    def _judge_ragged(self) -> None:
        """Say that rows are ragged; refuse shorter ones if the missing cells may be others than the last.

        The last columns may be missing where they hold texts, such as comments, or are missing in most rows.
        """
        names = self.head.names
        comment = names is not None and names[-1].strip().lower().startswith("comment")
        if (
            self.short
            and not comment
            and not (self.full and (not self.numbers_behind or 2 * self.shorter >= self.rows))
        ):
            raise self._ragged(*self.short)
        if self.shorter or self.longer:
            text = f"{self.shorter + self.longer} of {self.rows} rows have fewer or more cells than the header"
            self.issues.append(Issue(f"{text}, in columns that the map does not use", size=self.shorter + self.longer))

    def _numbers(self, quantity: str, cells: list[str], block: list[Line], plain: bool) -> Floats:
        if self.layout.decimal == ",":
            plain = plain and not any("." in cell for cell in cells)
            quick = [cell.replace(",", ".") for cell in cells]
        else:
            quick = cells
        if plain:
            try:
                return np.array(list(map(float, quick)))
            except ValueError:
                pass
        values = np.empty(len(cells))
        missing = {str(cell).strip().lower() for cell in self.layout.missing} | _NO_VALUE
        for number, cell in enumerate(cells):
            if cell.strip().lower() in missing:
                values[number] = np.nan
            elif _is_number(cell, self.layout):
                values[number] = _number(cell, self.layout)
            else:
                first = self.rows == 0 and number == 0
                raise BadInput(
                    f"{self.path}: line {block[number].number}, {self._label(quantity)}: {shown(cell)!r} is not a "
                    f"number{self._hint(cell, first)}"
                )
        return values

    def _hint(self, cell: str, first: bool) -> str:
        other = other_delimiter(self.layout, cell)
        decimal = "," if self.layout.decimal == "." else "."
        if re.fullmatch(rf"\s*[+-]?\d*\{decimal}\d+([eE][+-]?\d+)?\s*", cell):
            return f'; decimals after a {"comma" if decimal == "," else "point"}? give file.decimal: "{decimal}"'
        if re.search(r"\d[:/]\d|\d-\d+-\d", cell):
            return "; dates and times of day are not read: give time: {rate: ROWS_PER_SECOND} in place of the column"
        if other and other not in ("','", "space"):
            return f"; is the delimiter {other}?"
        if self.head.names is not None and cell.strip() in self.head.names:
            return "; the header again, as of several recordings in one file? cut it there"
        if first and self.head.names is not None:
            return "; a line of units? give file.skip_after_header: 1"
        return "; a cell that means no value can be listed under file.missing"


def _is_number(cell: str, layout: Layout) -> bool:
    try:
        _number(cell, layout)
    except ValueError:
        return False
    return True


def _number(cell: str, layout: Layout) -> float:
    if "_" in cell or (layout.decimal == "," and "." in cell):
        raise ValueError(cell)
    return float(cell.replace(",", ".") if layout.decimal == "," else cell)
