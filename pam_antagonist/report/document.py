"""Content of a report as typed blocks. The renderers :mod:`html` and :mod:`terminal` determine its look.

Every command builds one :class:`Document` from its typed result.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal, TypeAlias

import yaml

from pam_antagonist.report.figure import Figure
from pam_antagonist.report.table import Table
from pam_antagonist.software import versions


@dataclass(frozen=True)
class Text:
    """A paragraph of plain text."""

    text: str
    kind: Literal["", "lede", "verdict"] = ""  # ``lede`` and ``verdict`` are the first two paragraphs of a document


@dataclass(frozen=True)
class Finding:
    """One statement that the numbers support."""

    status: Literal["good", "warn", "note"]  # ``good`` (as expected), ``warn`` (a problem) or ``note`` (information)
    text: str


good, warn, note = partial(Finding, "good"), partial(Finding, "warn"), partial(Finding, "note")
"""A finding of this status, from its text."""


@dataclass(frozen=True)
class Findings:
    """A list of findings, marked by symbol and colour."""

    items: tuple[Finding, ...]


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
    return tuple(yaml.safe_load(text)[page].items())


def background(meaning: str | Sequence[tuple[str, str]], provenance: Sequence[tuple[str, str]]) -> tuple[Section, ...]:
    """The two folded sections at the end of every report; the words are those of a page, or given themselves."""
    known = words(meaning) if isinstance(meaning, str) else tuple(meaning)
    return (
        Section("What the words mean", (Definitions(known),), folded=True),
        Section("How this report was made", (Table(("What", "Which"), tuple(provenance), prose=True),), folded=True),
    )
