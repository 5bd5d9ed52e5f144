"""Documents on a terminal: aligned tables, wrapped sentences, a mark before each finding."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import replace

from pam_antagonist.report.document import Block, Columns, Document, Findings, Section, Table, Text, with_unit

WIDTH = 100
_MARKS = {"good": "✓", "warn": "!", "note": " "}


def summary(document: Document) -> str:
    """What of a document is no lede, no figure and in no section of the page alone; findings come last."""
    blocks = [block for block in _plain(document.blocks) if not (isinstance(block, Text) and block.kind == "lede")]
    return render(sorted(blocks, key=lambda block: isinstance(block, Findings)))


def _plain(blocks: Sequence[Block]) -> Iterator[Block]:
    for block in blocks:
        match block:
            case Section(brief=True):
                inner = tuple(_plain(block.blocks))
                yield replace(block, blocks=tuple(one for one in inner if not isinstance(one, Findings)))
                yield from (one for one in inner if isinstance(one, Findings))
            case Columns():
                yield from _plain((block.left, block.right))
            case Text() | Findings() | Table():
                yield block


def render(blocks: Sequence[Block]) -> str:
    """Text of blocks with empty lines between them; blocks that only a page can show are left out."""
    parts = [_block(block) for block in blocks]
    return "\n\n".join(part for part in parts if part)


def _block(block: Block) -> str:
    match block:
        case Text():
            return _wrapped(block.text)
        case Findings():
            return "\n".join(marked(item.text, _MARKS[item.status]) for item in block.items)
        case Table():
            return table(block)
        case Section():
            return f"{block.title}\n{inner}" if (inner := render(block.blocks)) else ""
    return ""


def marked(text: str, mark: str) -> str:
    """A wrapped sentence after a mark of one character."""
    return _wrapped(text, f"{mark} ", "  ")


def _wrapped(text: str, first: str = "", others: str = "") -> str:
    """A wrapped paragraph, without line breaks between a number and its unit, or within a name."""
    lines = textwrap.wrap(
        with_unit(text), WIDTH, initial_indent=first, subsequent_indent=others, break_on_hyphens=False
    )
    return "\n".join(lines).replace("\u00a0", " ")


def table(content: Table, indent: str = "  ") -> str:
    """A table: first column left, the others right (text left), two spaces between; empty without rows."""
    if not content.rows:
        return ""
    lines = [content.header, *content.rows[-content.last :]]
    widths = [max(len(line[column]) for line in lines) for column in range(len(content.header))]

    def line(cells: Sequence[str]) -> str:
        first = cells[0].ljust(widths[0])
        align = str.ljust if content.prose else str.rjust
        rest = [align(cell, width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
        return (indent + "  ".join([first, *rest])).rstrip()

    legend = [_wrapped(content.legend, indent, indent)] if content.legend else []
    return "\n".join([*(line(cells) for cells in lines), *legend])
