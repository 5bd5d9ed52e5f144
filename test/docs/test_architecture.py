"""What pages say is so: docs/architecture.md of the code, the glossary of names, the README in short."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path
from typing import Any

import pages
import pytest

ROOT = pages.ROOT
PAGE = ROOT / "docs" / "architecture.md"
TEXT = " ".join(pages.read(PAGE).split())
NAMED = re.findall(r"`([\w.]+)`,? (?:in )?\(?\[`[^`]+`\]\(([^)]+\.py)\)", TEXT)
"""Names that stand before a link to the file that defines them."""


@pytest.mark.parametrize(("name", "file"), NAMED, ids=[name for name, _ in NAMED])
def test_a_name_before_a_file_is_defined_in_it(name: str, file: str) -> None:
    source = (PAGE.parent / file).read_text(encoding="utf-8")
    last = name.rsplit(".", 1)[-1]
    assert re.search(rf"^\s*(?:def|class) {last}\b|^{last}\b.*=", source, re.MULTILINE), f"{file} defines no {last}"


def test_it_names_the_steps_of_both_ways() -> None:
    names = {name for name, _ in NAMED}
    assert names >= {
        "Estimator.step_in_place", "process", "advance", "rk4_step_within", "read_bag", "check_recording", "diagnose",
        "prepare",
    }  # fmt: skip


def test_files_of_the_first_table_exist() -> None:
    table = pages.read(PAGE).split("## Where to change what")[1].split("\n## ")[0]
    named = re.findall(r"`((?:\w+/)+\w*(?:\.py)?)`", table)
    assert len(named) > 25
    for path in named:
        assert (ROOT / "pam_antagonist" / path).exists() or (ROOT / path).exists() or "NAME" in path, path


def named_in(word: str) -> list[str]:
    """Files of the package whose code has a string, docstrings left out."""
    out = []
    for path in sorted((ROOT / "pam_antagonist").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if word not in text:
            continue
        tree = ast.parse(text)
        said = {
            id(node.body[0].value) for node in ast.walk(tree)
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and isinstance(node.body[0], ast.Expr)
        }  # fmt: skip
        if any(isinstance(node, ast.Constant) and node.value == word and id(node) not in said
               for node in ast.walk(tree)):  # fmt: skip
            out.append(path.name)
    return out


@pytest.mark.parametrize(
    ("word", "files"),
    [
        ("hildebrandt", ["force_forms.py", "muscle.py"]), ("exchange", ["places.py"]), ("doubtless", []),
        ("unexplained", ["verdicts.py"]), ("warm_up", ["registry.py", "warm_up.py"]),
    ],
    ids=["a force law", "a place", "nothing", "a verdict", "an effect"],
)  # fmt: skip
def test_what_is_added_has_its_name_where_the_first_table_says(word: str, files: list[str]) -> None:
    assert named_in(word) == files


def test_every_folder_of_the_package_stands_in_the_table() -> None:
    there = {path.name for path in (ROOT / "pam_antagonist").iterdir() if (path / "__init__.py").is_file()}
    table = pages.read(PAGE).split("## What is where")[1].split("\n## ")[0]
    assert there <= set(re.findall(r"`([\w]+)/`", table))
    drawing = (ROOT / "docs" / "architecture.svg").read_text(encoding="utf-8")
    assert there == set(re.findall(r">(\w+)/<", drawing))


def test_the_docstring_of_the_diagnosis_names_all_of_its_modules() -> None:
    folder = ROOT / "pam_antagonist" / "diagnosis"
    named = set(re.findall(r":mod:`(\w+)`", (folder / "__init__.py").read_text(encoding="utf-8")))
    assert named == {path.stem for path in folder.glob("*.py")} - {"__init__"}


GLOSSARY = pages.read(pages.ROOT / "docs" / "reference" / "glossary.md")
TERMS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in GLOSSARY.splitlines()
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


@pytest.mark.parametrize("row", TERMS, ids=lambda row: row[0])
def test_names_in_the_code_exist(row: list[str]) -> None:
    term, meaning, code = row
    assert term and meaning
    (name,) = re.findall(r"`([^`]+)`", code)
    resolved(name)


def test_the_standard_words_are_in_it() -> None:
    terms = {term for row in TERMS for term in row[0].split(", ")}
    assert terms >= set(WORDS)


def test_no_term_stands_twice() -> None:
    terms = [row[0] for row in TERMS]
    assert len(terms) == len(set(terms))


@pytest.mark.parametrize("page", pages.PAGES, ids=pages.name)
def test_pages_use_no_word_that_it_replaces(page: Path) -> None:
    assert not REPLACED.findall(pages.prose(page))


README = pages.read(pages.ROOT / "README.md")
FIRST_HOUR = pages.read(pages.ROOT / "docs" / "tutorials" / "first_hour.md")


def test_it_has_at_most_120_lines() -> None:
    assert len(README.splitlines()) <= 120


def test_its_parts_stand_in_the_order_in_which_a_stranger_asks() -> None:
    assert re.findall(r"^## (.*)", README, re.MULTILINE) == [
        "On a measured joint", "What you need", "Install", "Replay a recording", "Your rig in five steps", "Python",
        "What it is not, and where it is weak", "Documentation", "Citation",
    ]  # fmt: skip
    assert README.index("demo.gif") < README.index("## ")


def test_figures_of_the_shipped_recordings_are_those_of_the_first_hour() -> None:
    section = README.split("## Replay a recording")[1].split("\n## ")[0]
    numbers = re.findall(r"\b\d+\.\d+\b", section)
    assert len(numbers) > 10
    assert not [number for number in numbers if number not in FIRST_HOUR]


def test_the_moving_picture_is_small() -> None:
    assert (pages.ROOT / "docs" / "demo.gif").stat().st_size < 1.5e6
