"""What docs/architecture.md says of the code is so."""

from __future__ import annotations

import re

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
        "Estimator.step_in_place",
        "process",
        "advance",
        "rk4_step_within",
        "read_bag",
        "check_recording",
        "diagnose",
        "prepare",
    }


def test_files_of_the_first_table_exist() -> None:
    table = pages.read(PAGE).split("## Where to change what")[1].split("\n## ")[0]
    named = re.findall(r"`((?:\w+/)+\w*(?:\.py)?)`", table)
    assert len(named) > 25
    for path in named:
        assert (ROOT / "pam_antagonist" / path).exists() or (ROOT / path).exists() or "NAME" in path, path


def test_every_folder_of_the_package_stands_in_the_table() -> None:
    there = {path.name for path in (ROOT / "pam_antagonist").iterdir() if (path / "__init__.py").is_file()}
    table = pages.read(PAGE).split("## What is where")[1].split("\n## ")[0]
    assert there <= set(re.findall(r"`([\w]+)/`", table))
    drawing = (ROOT / "docs" / "architecture.svg").read_text(encoding="utf-8")
    assert there == set(re.findall(r">(\w+)/<", drawing))


def test_pipeline_has_the_five_steps_in_this_order() -> None:
    source = (ROOT / "pam_antagonist" / "diagnosis" / "pipeline.py").read_text(encoding="utf-8")
    for function, steps in (
        ("diagnose", ("prepare", "describe")),
        ("verdicts", ("by_itself_or_in_turn", "search", "judge")),
    ):
        body = source.split(f"def {function}(")[1].split("\ndef ")[0]
        places = [re.search(rf"\b{step}\(", body).start() for step in steps]
        assert places == sorted(places)


def test_the_docstring_of_the_diagnosis_names_all_of_its_modules() -> None:
    folder = ROOT / "pam_antagonist" / "diagnosis"
    named = set(re.findall(r":mod:`(\w+)`", (folder / "__init__.py").read_text(encoding="utf-8")))
    assert named == {path.stem for path in folder.glob("*.py")} - {"__init__"}


def test_each_folder_of_the_table_says_where_to_begin() -> None:
    table = pages.read(PAGE).split("## What is where")[1].split("\n\n")[1]
    for row in table.splitlines()[2:]:
        first, _, begin = (cell.strip() for cell in row.strip("|").split("|"))
        assert not begin or begin.startswith("[`"), f"{first}: {begin}"
