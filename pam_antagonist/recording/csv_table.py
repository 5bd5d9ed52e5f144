"""The columns of a file as numbers, with the line number of each row.

The rows are split and checked here, and not by pandas: it fills the cells that a short row lacks without a word, takes
the rest of a file into one cell where a quotation mark is not closed, and tells no line numbers.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..numbers import number_of, plain
from .array_files import kind_of, listed, no_column, read_columns, shown
from .csv_map import Layout, Name
from .notes import Issue

Floats = NDArray[np.float64]

MAX_ROWS = 2_000_000
"""Most rows that are imported: over half an hour at 1 kHz. Writing them as a bag takes about 4 GB of memory."""
_BLOCK = 10_000  # lines that are turned into numbers at once
_LONGEST_LINE = 1 << 20
_SNIFFED = 4096
_LONGEST_HEAD = 200  # lines of a LabVIEW header
_BINARY = {b"PK\x03\x04": "a zip file, such as of a spreadsheet program: save it as CSV there",
           b"\x1f\x8b": "packed with gzip: unpack it first", b"\x89MCAP": "a bag already"}  # fmt: skip
_NO_VALUE = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "--", "---", "?"} | {
    f"#{error}" for error in ("n/a", "na", "div/0!", "value!", "num!", "ref!", "name?", "null!")  # of spreadsheets
})  # fmt: skip


@dataclass(frozen=True, eq=False)
class NumberTable:
    """Numbers of a file, N rows."""

    values: Mapping[str, Floats]  # quantity -> cells (N,), NaN where a cell holds no value
    line: NDArray[np.int32]  # line number of each row in the file (N,), counted from 1
    labels: Mapping[str, str]
    issues: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.line)


def read_table(
    path: Path, layout: Layout, columns: Mapping[str, Name], progress: Callable[[int], object] | None = None
) -> NumberTable:
    """Read some columns of a file. `columns`: quantity -> name or number (from 1) of its column."""
    kind = kind_of(path)
    if kind:  # a row's line number is the number of the row
        values = read_columns(path, kind, columns, MAX_ROWS)
        for cells in values.values():
            cells[np.isin(cells, [one for one in layout.missing if not isinstance(one, str)])] = np.nan
        rows = len(next(iter(values.values())))
        labels = {quantity: f"{quantity} (column {column!r})" for quantity, column in columns.items()}
        return NumberTable(values, np.arange(1, rows + 1, dtype=np.int32), labels, ())
    check_file(path)
    layout = labview(path, layout)
    with opened(path, layout) as stream:
        lines = TextLines(path, layout, stream)
        reader = _Reader(path, layout, lines)
        reader.find(columns)
        done = 0
        while block := list(itertools.islice(lines, _BLOCK)):
            reader.read(block)
            # The position of the buffer may lead that of the decoder, by a block at most.
            now = stream.buffer.tell()
            if reader.rows > MAX_ROWS:
                raise BadInput(
                    f"{path}: more than {MAX_ROWS:,} rows, expected at most that many: cut the file into parts"
                )
            if progress is not None:
                progress(now - done)
            done = now
    if reader.rows == 0:
        raise BadInput(f"{path}: fewer than two rows of numbers in it")
    return reader.table()


def check_file(path: Path) -> None:
    """Refuse a file that is not text."""
    try:
        if not path.exists():
            raise BadInput(f"{path}: no such file")
        if not path.is_file():
            raise BadInput(f"{path}: not a file, expected a CSV file")
        with path.open("rb") as stream:
            start = stream.read(_SNIFFED)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a name with a zero byte
        raise BadInput(f"{path!s}: no file can have this name: {error}") from None
    if not start:
        raise BadInput(f"{path}: is empty, expected a CSV file")
    for magic, what in _BINARY.items():
        if start.startswith(magic):
            raise BadInput(f"{path}: not a CSV file but {what}")
    if b"\0" in start and not start.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise BadInput(f"{path}: not a text file (it holds zero bytes), expected a CSV file")


@contextmanager
def opened(path: Path, layout: Layout) -> Iterator[TextIO]:
    """The file as text; a byte order mark overrides the declared encoding."""
    try:
        with path.open("rb") as raw:
            start = raw.read(4)
        encoding = layout.encoding
        if start.startswith((b"\xff\xfe", b"\xfe\xff")):
            encoding = "utf-16"
        elif start.startswith(b"\xef\xbb\xbf"):
            encoding = "utf-8-sig"
        with path.open(encoding=encoding) as stream:
            yield stream
    except LookupError:
        raise BadInput(f"{path}: file.encoding is {layout.encoding}, which is no encoding of text") from None
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror or error}") from None


def labview(path: Path, layout: Layout) -> Layout:
    """The layout that a LabVIEW measurement file declares in its header; that of the map for any other file.

    `layout`: of the map; kept where it skips lines, since it then knows the header.
    """
    if layout.skip_lines:
        return layout
    try:
        with opened(path, layout) as stream:
            head = list(itertools.islice(stream, _LONGEST_HEAD))
    except UnicodeError:
        return layout  # named with its line when the file is read
    if not head or not head[0].startswith("LabVIEW Measurement"):
        return layout
    declared = {name: text.strip() for name, _, text in (re.split(r"([\t,;])", line, maxsplit=1) for line in head
                                                         if re.search(r"[\t,;]", line))}  # fmt: skip
    ends = [number for number, line in enumerate(head, 1) if line.startswith("***End_of_Header***")][:2]
    if not ends:
        raise BadInput(f"{path}: a LabVIEW file without the line ***End_of_Header***; give file.skip_lines")
    delimiter = "tab" if declared.get("Separator", "Tab") == "Tab" else ","
    decimal = "," if declared.get("Decimal_Separator", ".").startswith(",") else "."
    return layout.replaced(delimiter=delimiter, decimal=decimal, skip_lines=ends[-1])


class TextLine(NamedTuple):
    """A line of the file; ``number`` counts from 1, as editors do."""

    number: int
    text: str


class TextLines:
    """The lines of a file without blank lines and comments."""

    def __init__(self, path: Path, layout: Layout, stream: TextIO) -> None:
        self._path, self._stream, self._layout = path, stream, layout
        self._number = 0
        self._blank = ' \t\r\n"' + layout.mark
        self.unterminated = False

    def __iter__(self) -> Iterator[TextLine]:
        return self

    def __next__(self) -> TextLine:
        comment = self._layout.comment
        while text := self._raw():
            if text.strip(self._blank) and not (comment and text.lstrip().startswith(comment)):
                return TextLine(self._number, text)
        raise StopIteration

    def skip(self, count: int) -> None:
        """Skip lines, blank ones and comments included."""
        for _ in range(count):
            self._raw()

    def _raw(self) -> str:
        try:
            text = self._stream.readline(_LONGEST_LINE)
        except UnicodeError:
            raise BadInput(
                f"{self._path}: in or after line {self._number + 1} a character is not {self._layout.encoding}; give "
                "file.encoding in the map, cp1252 for files of older Windows programs"
            ) from None
        self._number += 1
        if text:
            self.unterminated = not text.endswith("\n")
        if len(text) >= _LONGEST_LINE:
            raise BadInput(
                f"{self._path}: line {self._number} has over a million characters, expected a row of numbers"
            )
        if "\0" in text:
            raise BadInput(f"{self._path}: line {self._number} holds a zero byte, expected text")
        return text


def other_delimiter(layout: Layout, text: str) -> str:
    """Name of another delimiter that would split the text; "" where there is none."""
    words = {";": "';'", "\t": "tab", "|": "'|'", ",": "','", " ": "space"}
    return next((word for mark, word in words.items() if mark in text.strip() and mark != layout.mark), "")


def split(path: Path, layout: Layout, lines: list[TextLine]) -> list[list[str]]:
    """Cells of each line."""
    if layout.delimiter == "space":
        return [line.text.split() for line in lines]
    try:
        rows = list(csv.reader((line.text for line in lines), delimiter=layout.mark, skipinitialspace=True))
    except csv.Error as error:
        raise BadInput(f"{path}: between lines {lines[0].number} and {lines[-1].number}: {error}") from None
    if len(rows) != len(lines):
        odd = next((line for line in lines if line.text.count('"') % 2), lines[0])
        raise BadInput(f"{path}: line {odd.number} opens a quotation mark and does not close it: {shown(odd.text)}")
    return rows


@dataclass
class _Reader:
    """Reads the header, and turns blocks of lines into columns of numbers."""

    path: Path
    layout: Layout
    lines: TextLines
    names: list[str] | None = None  # of all columns; None without a header
    width: int = 0
    first: list[TextLine] = field(default_factory=list)  # the first row, where it has been read already
    index: dict[str, int] = field(default_factory=dict)
    rows: int = 0
    columns: dict[str, list[Floats]] = field(default_factory=dict)
    numbers: list[NDArray[np.int32]] = field(default_factory=list)
    issues: list[str] = field(default_factory=list)
    short: tuple[TextLine, list[str]] | None = None  # the first row with fewer cells than the header
    shorter: int = 0
    longer: int = 0
    # Whether a row is as long as the header, and whether one has numbers behind the last used column.
    full: bool = False
    numbers_behind: bool = False

    def __post_init__(self) -> None:
        path, layout = self.path, self.layout
        self.lines.skip(layout.skip_lines)
        line = next(self.lines, None)
        if line is not None and re.fullmatch(r"sep=.\s*", line.text):
            line = next(self.lines, None)  # a line of Excel; the delimiter is taken from the map
        if line is None:
            raise BadInput(f"{path}: no rows in it, only empty lines and comments")
        cells = [cell.strip() for cell in split(path, layout, [line])[0]]
        self.lines.skip(layout.skip_after_header)
        if not layout.header:
            self.width, self.first = len(cells), [line]
            return
        if layout.comment is None:
            # numpy.savetxt and others write the names as a comment.
            cells[0] = cells[0].lstrip("# ")
            cells = cells if cells[0] else cells[1:]
        while cells and not cells[-1]:
            cells.pop()
        if cells and all(self._number(cell) is not None for cell in cells):
            raise BadInput(
                f"{path}: line {line.number} should name the columns and holds numbers only ({shown(','.join(cells))}"
                "); without names, give file.header: false; where they stand in a comment before, give file.comment: "
                "null"
            )
        self.names, self.width = cells, len(cells)

    def find(self, columns: Mapping[str, Name]) -> None:
        """Find the columns, by name or number."""
        path, names, width = self.path, self.names, self.width
        known = f"{width} without names" if names is None else listed(names)
        start = names[0] if names else self.first[0].text if self.first else ""
        if width == 1 and (other := other_delimiter(self.layout, start)):
            raise BadInput(f"{path}: one column only ({shown(known)}): is the delimiter {other}? give file.delimiter")
        for quantity, column in columns.items():
            if isinstance(column, int):
                if column > width:
                    raise BadInput(f"{path}: {quantity} is column {column}, and the file has {width} ({known})")
                self.index[quantity] = column - 1
                continue
            assert names is not None  # a map without a header has numbers only
            name = column.strip()
            if (named := names.count(name)) > 1:
                raise BadInput(
                    f"{path}: {quantity}: {named} columns are named {column!r}, expected one; give its number"
                )
            if not named:
                raise no_column(path, quantity, column, names)
            self.index[quantity] = names.index(name)

    def read(self, block: list[TextLine]) -> None:
        """Add a block of lines."""
        block, self.first = self.first + block, []
        rows = self._checked(split(self.path, self.layout, block), block)
        block = block[: len(rows)]
        for quantity, index in self.index.items():
            numbers = self._numbers(quantity, [row[index] for row in rows], block)
            self.columns.setdefault(quantity, []).append(numbers)
        self.numbers.append(np.fromiter((line.number for line in block), np.int32, len(block)))
        self.rows += len(block)

    def table(self) -> NumberTable:
        """All rows that were read."""
        self._judge_ragged()
        values = {quantity: np.concatenate(parts) for quantity, parts in self.columns.items()}
        missing = [self._number(one) if isinstance(one, str) else float(one) for one in self.layout.missing]
        for cells in values.values():
            cells[np.isin(cells, [one for one in missing if one is not None])] = np.nan
        labels = {quantity: self._label(quantity) for quantity in self.index}
        return NumberTable(values, np.concatenate(self.numbers), labels, tuple(self.issues))

    def _number(self, cell: str) -> float | None:
        return number_of(cell, self.layout.decimal)

    def _label(self, quantity: str) -> str:
        column = self.index[quantity]
        name = f"column {column + 1}" if self.names is None else f"column {self.names[column]!r}"
        return f"{quantity} ({name})"

    def _checked(self, rows: list[list[str]], block: list[TextLine]) -> list[list[str]]:
        """Rows with all used columns, and no number behind the header's columns; one that is cut off is dropped."""
        width, needed = self.width, 1 + max(self.index.values())
        if set(map(len, rows)) == {width}:
            self._full(rows[0][needed:])
            return rows
        for place, row in enumerate(rows):
            last = place == len(rows) - 1 and place + self.rows > 0
            if len(row) < width and last and self.lines.unterminated:
                self.issues.append(Issue(f"line {block[place].number} is cut off: left out", "dropped", 1))
                return rows[:place]
            if len(row) < needed or any(self._number(cell) is not None for cell in row[width:]):
                raise self._ragged(block[place], row)
            if len(row) < width:
                self.short = self.short or (block[place], row)
                self.shorter += 1
            else:
                self._full(row[needed:width])
                self.longer += any(cell.strip() for cell in row[width:])
        return rows

    def _full(self, unused: list[str]) -> None:
        """Note a row as long as the header, with the cells behind the last used column."""
        self.full = True
        self.numbers_behind = self.numbers_behind or any(self._number(cell) is not None for cell in unused)

    def _ragged(self, line: TextLine, row: list[str]) -> BadInput:
        """The refusal of a row that is shorter or longer than the header."""
        other = other_delimiter(self.layout, line.text) if len(row) == 1 else ""
        hint = f"; is the delimiter {other}?" if other else ""
        if self.layout.delimiter == "," and len(row) == 2 * self.width:
            hint = "; commas stand before decimals and between cells: write the file with another delimiter"
        expected = f"{self.width} as in the {'first row' if self.names is None else 'header'}"
        return BadInput(
            f"{self.path}: line {line.number} has {len(row)} cells ({shown(line.text)}), expected {expected}{hint}"
        )

    def _judge_ragged(self) -> None:
        """Say that rows are ragged; refuse shorter ones if the missing cells may be others than the last.

        The last columns may be missing where they hold texts, such as comments, or are missing in most rows.
        """
        comment = self.names is not None and self.names[-1].strip().lower().startswith("comment")
        may_lack = self.full and (not self.numbers_behind or 2 * self.shorter >= self.rows)
        if self.short and not comment and not may_lack:
            raise self._ragged(*self.short)
        if self.shorter or self.longer:
            text = f"{self.shorter + self.longer} of {self.rows} rows have fewer or more cells than the header"
            self.issues.append(Issue(f"{text}, in columns that the map does not use", size=self.shorter + self.longer))

    def _numbers(self, quantity: str, cells: list[str], block: list[TextLine]) -> Floats:
        comma = self.layout.decimal == ","
        # float() reads 1_000 as a thousand; in a file it is more likely a mistake.
        if not any("_" in cell or (comma and "." in cell) for cell in cells):
            try:
                return np.array([float(cell.replace(",", ".")) for cell in cells] if comma else list(map(float, cells)))
            except ValueError:
                pass
        values = np.full(len(cells), np.nan)
        missing = {str(cell).strip().lower() for cell in self.layout.missing} | _NO_VALUE
        for place, cell in enumerate(cells):
            if plain(cell).strip().lower() in missing:
                continue
            value = self._number(cell)
            if value is None:
                hint = self._hint(cell, self.rows == 0 and place == 0)
                raise BadInput(
                    f"{self.path}: line {block[place].number}, {self._label(quantity)}: {shown(cell)!r} is not a "
                    f"number{hint}"
                )
            values[place] = value
        return values

    def _hint(self, cell: str, first: bool) -> str:
        other = other_delimiter(self.layout, cell)
        decimal = "," if self.layout.decimal == "." else "."
        if re.fullmatch(rf"[+-]?\d*\{decimal}\d+([eE][+-]?\d+)?", plain(cell).strip()):
            return f'; decimals after a {"comma" if decimal == "," else "point"}? give file.decimal: "{decimal}"'
        if re.fullmatch(r"[+-]?\d{1,3}([., ]\d{3})+([.,]\d*)?", plain(cell).strip()):
            return "; are the thousands set apart? write the numbers without that"
        unit = re.fullmatch(r"(.*\d)\s*([A-Za-zµμ°Ω%][\w/°%² ]*)", plain(cell).strip())
        if unit and self._number(unit[1]) is not None:
            return f"; is {unit[2]!r} a unit? leave it out of the cells"
        if re.search(r"\d[:/]\d|\d-\d+-\d", cell):
            return "; dates and times of day are not read: give time: {rate: ROWS_PER_SECOND} in place of the column"
        if other and other not in ("','", "space"):
            return f"; is the delimiter {other}?"
        if self.names is not None and cell.strip() in self.names:
            return "; the header again, as of several recordings in one file? cut it there"
        if first and self.names is not None:
            return "; a line of units? give file.skip_after_header: 1"
        return "; a cell that means no value can be listed under file.missing"
