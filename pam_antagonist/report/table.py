"""Tables for the terminal: aligned plain text, numbers with the digits that mean something."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

MISSING = "–"
"""What stands where nothing was recorded."""


def number(value: float | None, digits: int = 3) -> str:
    """A number with `digits` significant digits and no exponent where it can be avoided; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    magnitude = math.floor(math.log10(abs(value)))
    if not -5 <= magnitude < 9:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(digits - 1 - magnitude, 0)}f}"


def percent(value: float | None) -> str:
    """A share as a percentage; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return MISSING
    return f"{100.0 * value:.1f} %"


@dataclass(frozen=True)
class Table:
    """A table of text: the first column names the row, the others hold its values.

    Attributes:
        header: column titles.
        rows: cells, each row as long as the header.
        caption: what the table shows, in one sentence.
        best: for each row, the columns whose value is the best one (drawn bold in HTML).
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    best: tuple[frozenset[int], ...] = ()

    def __post_init__(self) -> None:
        """Check the shape."""
        if any(len(row) != len(self.header) for row in self.rows):
            raise ValueError(f"every row needs {len(self.header)} cells")

    def text(self, indent: str = "  ") -> str:
        """The table for a terminal: first column left, the others right, two spaces between."""
        lines = [self.header, *self.rows]
        widths = [max(len(line[column]) for line in lines) for column in range(len(self.header))]

        def line(cells: Sequence[str]) -> str:
            first = cells[0].ljust(widths[0])
            rest = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
            return (indent + "  ".join([first, *rest])).rstrip()

        return "\n".join(line(cells) for cells in lines)
