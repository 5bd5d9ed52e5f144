"""Tables of text, and numbers with significant digits."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pam_antagonist import shown
from pam_antagonist.rig.units import readable

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


def markdown(table: Table) -> list[str]:
    """A table as lines of Markdown."""

    def row(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.strip().replace("\\", "\\\\") for cell in cells) + " |"

    return [row(table.header), "|" + "---|" * len(table.header), *map(row, table.rows)]


def with_unit(text: str) -> str:
    """Text without line breaks between a number and its unit, or within a unit."""
    return _AFTER_NUMBER.sub("\u00a0", text.replace("N m", "N\u00a0m"))
