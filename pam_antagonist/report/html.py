"""A self-contained page: one file that says the same in ten years, on a laptop without a network.

A page is a list of blocks. Each block is a small frozen object that knows its own HTML; what a report says is put
together elsewhere (:mod:`pam_antagonist.report.replay_page`). The style sheet, the script and, where there are
figures, plotly's library are written into the file, once. A content security policy keeps a browser from loading
anything else.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any, Literal, Protocol

from pam_antagonist.errors import BadInput
from pam_antagonist.report import strict_json
from pam_antagonist.report._script import SCRIPT
from pam_antagonist.report.style import CSS
from pam_antagonist.report.table import Table

_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"


def _text(text: str) -> str:
    """Text as HTML; a number is not torn from its unit at the end of a line."""
    return escape(text).replace(" %", "\u00a0%").replace(" N m", "\u00a0N\u00a0m")


class Block(Protocol):
    """A part of a page."""

    def html(self, serial: Iterator[int]) -> str:
        """Its HTML; `serial` gives numbers for identifiers that are unique in the page."""
        ...


@dataclass(frozen=True)
class Text:
    """A paragraph of plain text."""

    text: str
    kind: Literal["", "lede", "verdict"] = ""

    def html(self, serial: Iterator[int]) -> str:
        """The paragraph."""
        attribute = f' class="{self.kind}"' if self.kind else ""
        return f"<p{attribute}>{_text(self.text)}</p>"


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

    def html(self, serial: Iterator[int]) -> str:
        """The list."""
        sign = {"good": ("✓", "good"), "warn": ("!", "attention"), "note": ("i", "note")}
        rows = [
            f'<li><span class="mark {item.status}" role="img" aria-label="{sign[item.status][1]}">'
            f"{sign[item.status][0]}</span><span>{_text(item.text)}</span></li>"
            for item in self.items
        ]
        return f'<ul class="findings">{"".join(rows)}</ul>' if rows else ""


@dataclass(frozen=True)
class Tile:
    """One number that matters, large."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Tiles:
    """A row of tiles."""

    items: tuple[Tile, ...]

    def html(self, serial: Iterator[int]) -> str:
        """The row."""
        cells = [
            f'<div class="tile"><div class="label">{_text(item.label)}</div>'
            f'<div class="value">{_text(item.value)}</div><div class="note">{_text(item.note)}</div></div>'
            for item in self.items
        ]
        return f'<div class="tiles">{"".join(cells)}</div>' if cells else ""


@dataclass(frozen=True)
class TableBlock:
    """A table; `prose` sets its cells as text, to the left."""

    table: Table
    prose: bool = False

    def html(self, serial: Iterator[int]) -> str:
        """The table, which scrolls sideways by itself where the page is too narrow for it."""
        kind = ' class="text"' if self.prose else ""
        head = "".join(f'<th scope="col"{kind}>{escape(title)}</th>' for title in self.table.header)
        best = self.table.best or (frozenset[int](),) * len(self.table.rows)
        body = []
        for row, marked in zip(self.table.rows, best, strict=True):
            if not any(row[1:]):
                body.append(f'<tr class="group"><th scope="colgroup" colspan="{len(row)}">{escape(row[0])}</th></tr>')
                continue
            cells = [
                f"<td{kind}>{_text(cell)}</td>" if column not in marked else f'<td class="best">{_text(cell)}</td>'
                for column, cell in enumerate(row)
            ]
            body.append(f"<tr>{''.join(cells)}</tr>")
        # Not a <caption>: that would be as wide as the table, and scroll with it.
        caption = f'<p class="about">{_text(self.table.caption)}</p>' if self.table.caption else ""
        label = f' aria-label="{escape(self.table.caption)}"' if self.table.caption else ""
        rows = "".join(body)
        table = f"<table{label}><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
        return f'{caption}<div class="scroll">{table}</div>'


@dataclass(frozen=True)
class Figure:
    """A plot.

    Attributes:
        title: what it shows.
        about: how to read it, one or two sentences.
        plot: plotly's ``data`` and ``layout``, as plain values.
        link: figures of the same name share their time axis.
    """

    title: str
    about: str
    plot: dict[str, Any]
    link: str

    def html(self, serial: Iterator[int]) -> str:
        """The figure and its data, which a script draws when it comes into sight."""
        name = f"figure-{next(serial)}"
        # "</script>" inside a string would end the element.
        data = strict_json.dumps(self.plot, indent=None).replace("<", "\\u003c")
        height = int(self.plot["layout"]["height"])
        return (
            f'<figure><figcaption>{escape(self.title)}</figcaption><p class="about">{_text(self.about)}</p>'
            f'<div class="plot" id="{name}" data-link="{escape(self.link)}" role="img" '
            f'aria-label="{escape(self.title)}" style="height:{height}px"></div>'
            f'<script type="application/json" id="{name}-data">{data}</script></figure>'
        )


@dataclass(frozen=True)
class Columns:
    """Two blocks beside each other where the page is wide enough, else one after the other."""

    left: Block
    right: Block

    def html(self, serial: Iterator[int]) -> str:
        """Both."""
        return f'<div class="columns"><div>{self.left.html(serial)}</div><div>{self.right.html(serial)}</div></div>'


@dataclass(frozen=True)
class Definitions:
    """Words and what they mean."""

    items: tuple[tuple[str, str], ...]

    def html(self, serial: Iterator[int]) -> str:
        """The list."""
        rows = "".join(f"<dt>{escape(word)}</dt><dd>{_text(meaning)}</dd>" for word, meaning in self.items)
        return f"<dl>{rows}</dl>"


@dataclass(frozen=True)
class Section:
    """A titled group of blocks; the page's navigation finds it by its `anchor`, `folded` hides it until opened."""

    title: str
    blocks: tuple[Block, ...]
    level: Literal[2, 3] = 3
    anchor: str = ""
    folded: bool = False

    def html(self, serial: Iterator[int]) -> str:
        """Title and content."""
        content = "\n".join(block.html(serial) for block in self.blocks)
        name = f' id="{escape(self.anchor)}"' if self.anchor else ""
        if self.folded:
            return f"<details{name}><summary>{escape(self.title)}</summary>{content}</details>"
        return f"<section{name}><h{self.level}>{escape(self.title)}</h{self.level}>{content}</section>"


@dataclass(frozen=True)
class Page:
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
    footer: str = ""
    language: str = field(default="en")

    def render(self) -> str:
        """The whole file.

        Raises:
            BadInput: the page has figures and plotly is not installed.
        """
        serial = itertools.count(1)
        content = "\n".join(block.html(serial) for block in self.blocks)
        anchors = [block for block in self.blocks if isinstance(block, Section) and block.anchor]
        links = "".join(f'<a href="#{escape(block.anchor)}">{escape(block.title)}</a>' for block in anchors)
        scripts = f"<script>{_plotly()}</script>\n<script>{SCRIPT}</script>" if 'class="plot"' in content else ""
        return (
            f'<!DOCTYPE html>\n<html lang="{self.language}">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{escape(self.title)} · {escape(self.kicker)}</title>\n<style>{CSS}</style>\n</head>\n"
            "<body>\n<main>\n"
            f'<p class="kicker">{escape(self.kicker)}</p>\n<h1>{escape(self.title)}</h1>\n'
            + (f'<nav aria-label="Sections">{links}</nav>\n' if len(anchors) > 1 else "")
            + f"{content}\n<footer>{escape(self.footer)}</footer>\n</main>\n{scripts}\n</body>\n</html>\n"
        )


def blocks(*parts: Block | Sequence[Block] | None) -> tuple[Block, ...]:
    """Blocks in a row, without those that are None."""
    out: list[Block] = []
    for part in parts:
        if part is None:
            continue
        if isinstance(part, list | tuple):
            out.extend(part)
        else:
            out.append(part)  # type: ignore[arg-type]
    return tuple(out)


def _plotly() -> str:
    """plotly's library as text, read from the installed package."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise BadInput(
            "plotly is not installed: install python3-plotly (or plotly by pip), or give --no-figures"
        ) from None
    return str(get_plotlyjs()).replace("</script", "<\\/script")
