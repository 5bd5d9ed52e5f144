"""What the tests of the documentation read: pages, code blocks, anchors and commands."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
_OUTSIDE = ("README", "CONTRIBUTING", "CHANGELOG", "examples/README")
PAGES = (*(ROOT / f"{page}.md" for page in _OUTSIDE), *sorted((ROOT / "docs").rglob("*.md")))
"""Every page that a reader sees."""
_FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"(?:^ {4}\S.*\n(?:\n*^ {4}.*\n)*)", re.MULTILINE)
_HEADING = re.compile(r"^#{1,6} +(.+?) *$", re.MULTILINE)
_LINK = re.compile(r"(?<!\\)\]\(([^)\s]+)\)")


class Block(NamedTuple):
    """A block of code.

    Attributes:
        language: of a fenced block; empty where none is named.
        text: its lines.
    """

    language: str
    text: str


def name(page: Path) -> str:
    """Path of a page from the repository's root."""
    return page.relative_to(ROOT).as_posix()


@cache
def read(page: Path) -> str:
    """Text of a page as the site has it, with what the code knows."""
    text = page.read_text(encoding="utf-8")
    return _generator()["whole"](text) if "<!-- generated: " in text else text


@cache
def _generator() -> dict[str, Any]:
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        return runpy.run_path(str(ROOT / "docs" / "generate.py"))
    finally:
        sys.path.remove(str(ROOT / "docs"))


def blocks(page: Path) -> list[Block]:
    """Fenced and indented blocks of code."""
    text = read(page)
    fenced = [Block(language, code) for language, code in _FENCE.findall(text)]
    return fenced + [Block("", code) for code in _INDENTED.findall(_FENCE.sub("", text))]


def prose(page: Path) -> str:
    """A page without its fenced blocks."""
    return _FENCE.sub("", read(page))


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as the hosting platform makes them."""
    found: set[str] = set()
    for heading in _HEADING.findall(prose(page)):
        text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        slug = re.sub(r"[^\w\- ]", "", text.replace("`", "")).replace(" ", "-")
        number = 0
        while (f"{slug}-{number}" if number else slug) in found:
            number += 1
        found.add(f"{slug}-{number}" if number else slug)
    return found


def links(page: Path) -> Iterator[str]:
    """Targets of the links and pictures of a page that lead to no other host."""
    for target in _LINK.findall(prose(page)):
        if not re.match(r"[a-z]+:", target):
            yield target


def commands(text: str) -> Iterator[list[str]]:
    """Words after ``./run`` of each command in a text: the command's name and its arguments."""
    joined = text.replace("\\\n", " ")
    for match in re.finditer(r"\./run ([^\n`|;&)]+)", joined):
        words = match[1].split("#")[0].split()
        if words and re.fullmatch(r"[a-z_]+", words[0]):
            yield words


def printed(script: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What a script prints in a folder. It runs in this process, which has loaded all that is slow to load."""
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("sys.argv", [str(script)])
        runpy.run_path(str(script), run_name="__main__")
    return capsys.readouterr().out
