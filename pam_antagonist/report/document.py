"""What a report says, as typed blocks. How it looks is for the renderers: :mod:`html` and :mod:`terminal`.

Every command builds one :class:`Document` from its typed result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from pam_antagonist.report.figure import Figure
from pam_antagonist.report.table import Table
from pam_antagonist.software import versions


@dataclass(frozen=True)
class Text:
    """A paragraph of plain text.

    Attributes:
        text: the paragraph.
        kind: a document begins with its lede and its verdict.
    """

    text: str
    kind: Literal["", "lede", "verdict"] = ""


@dataclass(frozen=True)
class Finding:
    """One statement that the numbers support.

    Attributes:
        status: ``good`` (as it should be), ``warn`` (look here) or ``note`` (worth knowing).
        text: the sentence.
    """

    status: Literal["good", "warn", "note"]
    text: str


@dataclass(frozen=True)
class Findings:
    """A list of findings, marked by sign as well as by colour."""

    items: tuple[Finding, ...]


@dataclass(frozen=True)
class Tile:
    """One number that matters, large.

    Attributes:
        label: what it is.
        value: with its unit.
        note: a few words below it.
    """

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Tiles:
    """A row of tiles."""

    items: tuple[Tile, ...]


@dataclass(frozen=True)
class Definitions:
    """Terms and what they mean."""

    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Columns:
    """Two blocks beside each other where the page is wide enough, else one after the other.

    Attributes:
        left: the first block.
        right: the second one.
    """

    left: Block
    right: Block


@dataclass(frozen=True)
class Section:
    """A titled group of blocks.

    Attributes:
        title: its heading.
        blocks: its content.
        level: of the heading.
        anchor: where the navigation finds it; without one it is not in the navigation.
        folded: whether it stays closed until a reader opens it.
    """

    title: str
    blocks: tuple[Block, ...]
    level: Literal[2, 3] = 3
    anchor: str = ""
    folded: bool = False


Block: TypeAlias = Text | Findings | Tiles | Definitions | Table | Figure | Columns | Section


def _software() -> str:
    return ", ".join(f"{name} {version}" for name, version in versions().items())


@dataclass(frozen=True)
class Document:
    """A report.

    Attributes:
        kicker: what kind of report this is.
        title: what it is about.
        blocks: its content.
        footer: how it was made.
    """

    kicker: str
    title: str
    blocks: tuple[Block, ...]
    footer: str = field(default_factory=_software)


def background(definitions: Sequence[tuple[str, str]], provenance: Sequence[tuple[str, str]]) -> tuple[Section, ...]:
    """The two folded sections that end every report.

    Args:
        definitions: terms and what they mean.
        provenance: what the result was made from: name and value.
    """
    return (
        Section("What the words mean", (Definitions(tuple(definitions)),), folded=True),
        Section("How this report was made", (Table(("What", "Which"), tuple(provenance), prose=True),), folded=True),
    )
