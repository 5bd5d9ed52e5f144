"""Content of a report as typed blocks and tables. The renderers :mod:`html` and :mod:`terminal` determine its look.

Every command builds one :class:`Document` from its typed result.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal, TypeAlias

from pam_antagonist import shown
from pam_antagonist.program import versions
from pam_antagonist.report.figure import Figure
from pam_antagonist.rig.units import readable
from pam_antagonist.strict_yaml import load_bounded

MISSING, number, percent = shown.MISSING, shown.number, shown.percent
_AFTER_NUMBER = re.compile(r"(?<=[0-9]) (?=(%|N|kPa|Pa|s|ms|min|h|V|Hz|mm|cm|kg|×)(\W|$|²|³))")
"""The space between a number and its unit."""


@dataclass(frozen=True)
class Table:
    """A table of text: the first column names the row, the others hold its values."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]  # each as long as the header; one with only its first cell is a heading
    caption: str = ""
    best: tuple[frozenset[int], ...] = ()  # for each row, the columns with the best value (bold in HTML)
    prose: bool = False  # whether the cells are left-aligned text instead of numbers
    last: int = 0  # rows that a terminal shows, the last ones; 0 for all
    legend: str = ""  # what its words mean, which a terminal shows as well

    def __post_init__(self) -> None:
        """Check the shape."""
        if any(len(row) != len(self.header) for row in self.rows):
            raise ValueError(f"every row needs {len(self.header)} cells")

    @property
    def marked(self) -> tuple[frozenset[int], ...]:
        """`best`, with an entry for each row."""
        return self.best or (frozenset(),) * len(self.rows)


class Comparison:
    """Builder of a table that compares columns and marks the best value of each row."""

    def __init__(self, *header: str) -> None:
        """Begin a table. `header`: column titles, the first one for the names of the rows."""
        self._header = header
        self._rows: list[tuple[str, ...]] = []
        self._best: list[frozenset[int]] = []

    def heading(self, name: str) -> None:
        """Add a heading for the rows below."""
        self.text(name, *[""] * (len(self._header) - 1))

    def text(self, *cells: str) -> None:
        """Add a row that is not compared."""
        self._rows.append(cells)
        self._best.append(frozenset())

    def values(
        self,
        name: str,
        values: Sequence[float | None],
        write: Callable[[float | None], str] = number,
        best: Callable[[Sequence[float]], float] | None = min,
    ) -> None:
        """Add a row of numbers; `best` picks the one that is marked (None: none is), unless all cells are equal."""
        cells = [write(value) for value in values]
        known = [value for value in values if value is not None and math.isfinite(value)]
        winner = write(best(known)) if known and best else ""
        marked = {place for place, cell in enumerate(cells, 1) if cell == winner}
        equal = len({cell for cell in cells if cell != MISSING}) < 2
        self._rows.append((name, *cells))
        self._best.append(frozenset() if equal else frozenset(marked))

    def pressures(self, name: str, values: Sequence[float | None]) -> None:
        """Add a row of pressures [Pa], all shown in kPa or all in Pa; the unit is added to the name."""
        unit = readable("Pa", min((abs(value) for value in values if value), default=math.inf))
        shown = [None if value is None else value * unit.scale for value in values]
        self.values(f"{name} [{unit.name}]", shown)

    def table(self, caption: str = "") -> Table:
        """The finished table."""
        return Table(self._header, tuple(self._rows), caption, tuple(self._best))


def sentence(text: str) -> str:
    """A sentence; the name of a value, a file, an effect or a recording keeps its first letter."""
    first = text.split(" ", 1)[0].rstrip(",")
    named = first.endswith(":") or any(sign in first for sign in "/_.")
    return f"{text[:1] if named else text[:1].upper()}{text[1:].rstrip('.')}."


def markdown(table: Table) -> list[str]:
    """A table as lines of Markdown."""

    def row(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.strip().replace("\\", "\\\\") for cell in cells) + " |"

    return [row(table.header), "|" + "---|" * len(table.header), *map(row, table.rows)]


def with_unit(text: str) -> str:
    """Text without line breaks between a number and its unit, or within a unit."""
    return _AFTER_NUMBER.sub("\u00a0", text.replace("N m", "N\u00a0m"))


@dataclass(frozen=True)
class Text:
    """A paragraph of plain text."""

    text: str
    kind: Literal["", "lede", "verdict"] = ""  # ``lede`` and ``verdict`` are the first two paragraphs of a document


@dataclass(frozen=True)
class Statement:
    """One statement that the numbers support."""

    status: Literal["good", "warn", "note"]  # ``good`` (as expected), ``warn`` (a problem) or ``note`` (information)
    text: str


good, warn, note = partial(Statement, "good"), partial(Statement, "warn"), partial(Statement, "note")
"""A finding of this status, from its text."""


@dataclass(frozen=True)
class Findings:
    """A list of findings, marked by symbol and colour."""

    items: tuple[Statement, ...]


@dataclass(frozen=True)
class Tile:
    """One important number in large letters."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Tiles:
    """A row of tiles."""

    items: tuple[Tile, ...]


@dataclass(frozen=True)
class Links:
    """Other files beside the page."""

    items: tuple[tuple[str, str], ...]  # what is there, and its path relative to the page


@dataclass(frozen=True)
class Definitions:
    """Terms and their meanings."""

    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Columns:
    """Two blocks side by side on a wide page, otherwise one after the other."""

    left: Block
    right: Block


@dataclass(frozen=True)
class Section:
    """A titled group of blocks."""

    title: str
    blocks: tuple[Block, ...]
    level: Literal[2, 3] = 3
    anchor: str = ""  # target of the navigation; without one the section is not in the navigation
    folded: bool = False
    brief: bool = False  # whether a terminal shows it as well


Block: TypeAlias = Text | Findings | Tiles | Links | Definitions | Table | Figure | Columns | Section


def in_first_lines(text: str | None) -> tuple[Text, ...]:
    """A sentence as a block of a report; empty without one."""
    return () if text is None else (Text(text),)


def figures_of(blocks: Sequence[Block]) -> Iterator[Figure]:
    """All figures in blocks, in their order."""
    for block in blocks:
        if isinstance(block, Figure):
            yield block
        elif isinstance(block, Section):
            yield from figures_of(block.blocks)
        elif isinstance(block, Columns):
            yield from figures_of((block.left, block.right))


def _software() -> str:
    return ", ".join(f"{name} {version}" for name, version in versions().items())


@dataclass(frozen=True)
class Document:
    """A report."""

    kicker: str
    title: str
    blocks: tuple[Block, ...]
    footer: str = field(default_factory=_software)


def words(page: str) -> tuple[tuple[str, str], ...]:
    """What the words of a page mean, from ``templates/words.yaml``."""
    text = (Path(__file__).parent / "templates" / "words.yaml").read_text(encoding="utf-8")
    return tuple(load_bounded(text)[page].items())


def page(
    kicker: str, title: str, blocks: Sequence[Block], words_of: str, provenance: Sequence[tuple[str, str]],
    lede: str = "", verdict: str = "",
) -> Document:  # fmt: skip
    """A report: its first sentences, blocks, and two folded sections. `words_of`: page of ``templates/words.yaml``."""
    first = (Text(lede, "lede"), Text(verdict, "verdict"))
    made = Table(("What", "Which"), tuple(provenance), prose=True)
    last = (
        Section("What the words mean", (Definitions(words(words_of)),), folded=True),
        Section("How this report was made", (made,), folded=True),
    )
    return Document(kicker, title, (*(text for text in first if text.text), *blocks, *last))
