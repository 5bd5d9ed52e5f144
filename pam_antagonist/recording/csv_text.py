"""Lines of a CSV file without blank lines and comments, split into cells."""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, TextIO

from ..errors import BadInput
from .csv_map import Layout

_LONGEST_LINE = 1 << 20
_SNIFFED = 4096
_LONGEST_HEAD = 200  # lines of a LabVIEW header
_BINARY = {b"PK\x03\x04": "a zip file, such as of a spreadsheet program: save it as CSV there",
           b"\x1f\x8b": "packed with gzip: unpack it first", b"\x89MCAP": "a bag already"}  # fmt: skip


def check_file(path: Path) -> int:
    """Size of a file that looks like text [bytes]."""
    try:
        if not path.exists():
            raise BadInput(f"{path}: no such file")
        if not path.is_file():
            raise BadInput(f"{path}: not a file, expected a CSV file")
        with path.open("rb") as stream:
            start = stream.read(_SNIFFED)
        size = path.stat().st_size
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a name with a zero byte
        raise BadInput(f"{path!s}: no file can have this name: {error}") from None
    if size == 0:
        raise BadInput(f"{path}: is empty, expected a CSV file")
    for magic, what in _BINARY.items():
        if start.startswith(magic):
            raise BadInput(f"{path}: not a CSV file but {what}")
    if b"\0" in start and not start.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise BadInput(f"{path}: not a text file (it holds zero bytes), expected a CSV file")
    return size


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


class Line(NamedTuple):
    """A line of the file; ``number`` counts from 1, as editors do."""

    number: int
    text: str


class Lines:
    """The lines of a file without blank lines and comments."""

    def __init__(self, path: Path, layout: Layout, stream: TextIO) -> None:
        self._path, self._stream, self._layout = path, stream, layout
        self._number = 0
        self._blank = ' \t\r\n"' + layout.mark
        self.unterminated = False

    def __iter__(self) -> Iterator[Line]:
        return self

    def __next__(self) -> Line:
        comment = self._layout.comment
        while text := self._raw():
            if text.strip(self._blank) and not (comment and text.lstrip().startswith(comment)):
                return Line(self._number, text)
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


def split(path: Path, layout: Layout, lines: list[Line]) -> list[list[str]]:
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


def number(layout: Layout, cell: str) -> float | None:
    """The number in a cell; None where it holds none. An underscore is no part of a number in a file."""
    if "_" in cell or (layout.decimal == "," and "." in cell):
        return None
    try:
        return float(cell.replace(",", ".") if layout.decimal == "," else cell)
    except ValueError:
        return None


def shown(text: str) -> str:
    """Text of a file for a message: in one line, and shortened."""
    text = " ".join(text.split())
    return text if len(text) <= 60 else text[:57] + "..."
