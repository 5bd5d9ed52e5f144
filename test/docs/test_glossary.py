"""The glossary's words are the code's: every name that it cites exists."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import pages
import pytest

TEXT = pages.read(pages.ROOT / "docs" / "reference" / "glossary.md")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in TEXT.splitlines()
    if line.startswith("|") and not line.startswith(("|---", "| term"))
]
WORDS = (
    "residual", "excess over noise", "evidence", "held-out", "free parameter", "free direction", "direction",
    "disturbance torque", "ambiguity", "detected", "threshold", "prior", "likelihood", "innovation",
)  # fmt: skip
REPLACED = re.compile(
    r"\b(foretold|knobs?|laps|visitors?|at_itself|made_ready|unclean|beyond (the )?noise)\b", re.IGNORECASE
)


def resolved(name: str) -> Any:
    """What a dotted name stands for: a module, or something in one."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            if not hasattr(found, part) and part in _fields(found):
                return found
            found = getattr(found, part)
        return found
    raise AttributeError(name)


def _fields(kind: Any) -> set[str]:
    """Names that a dataclass, a named tuple or a model of pydantic declares."""
    return {name for base in getattr(kind, "__mro__", ()) for name in getattr(base, "__annotations__", {})}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_names_in_the_code_exist(row: list[str]) -> None:
    term, meaning, code = row
    assert term and meaning
    (name,) = re.findall(r"`([^`]+)`", code)
    resolved(name)


def test_the_standard_words_are_in_it() -> None:
    terms = {term for row in ROWS for term in row[0].split(", ")}
    assert terms >= set(WORDS)


def test_no_term_stands_twice() -> None:
    terms = [row[0] for row in ROWS]
    assert len(terms) == len(set(terms))


@pytest.mark.parametrize("page", pages.PAGES, ids=pages.name)
def test_pages_use_no_word_that_it_replaces(page: Path) -> None:
    assert not REPLACED.findall(pages.prose(page))
