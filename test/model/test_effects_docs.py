"""docs/effects.md says what the catalogue says."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.model.effects.hooks import HOOKS, QUANTITIES
from pam_antagonist.model.effects.page import hooks, page
from pam_antagonist.model.effects.registry import catalogue

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## `(\w+)`\n(.*?)(?=^## |^<!-- end)", TEXT, flags=re.MULTILINE | re.DOTALL))


def table(section: str, title: str) -> list[list[str]]:
    """Cells of the table whose first column has this title."""
    lines = section.splitlines()
    starts = [k for k, line in enumerate(lines) if line.startswith(f"| {title} |")]
    if not starts:
        return []
    rows = []
    for line in lines[starts[0] + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_a_section_for_each_effect_in_the_catalogue_s_order():
    assert list(SECTIONS) == list(CATALOGUE)


@pytest.mark.parametrize("name", CATALOGUE)
def test_words(name):
    effect, section = CATALOGUE[name], SECTIONS[name]
    assert effect.meaning in section
    assert f"*Signature* {effect.signature}" in section
    assert "```math" in section


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_number_and_every_state_is_there(name):
    effect, section = CATALOGUE[name], SECTIONS[name]
    shown = {word: row for row in table(section, "parameter") for word in re.findall(r"`(\w+)`", row[0])}
    numbers = () if effect.of_tables else effect.parameters
    assert list(shown) == [item.name for item in numbers]
    states = re.findall(r"`(\w+)`", " ".join(re.findall(r"^\*State\* ([^$\[]*)", section, re.MULTILINE)))
    assert states == [item.name for item in effect.states]
    for item in numbers:
        allowed = f"{item.low:g} to {item.high:g} {item.unit.replace('-', '')}".rstrip()
        assert shown[item.name][2:4] == [f"{item.neutral:g}", allowed]


def test_what_a_sealed_joint_shows():
    paragraph = TEXT.split("**A sealed joint**")[1].split("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", paragraph)) == {name for name, item in CATALOGUE.items() if item.sealed.part}


def test_the_page_is_up_to_date():
    assert page(TEXT, CATALOGUE) == TEXT, "python -m pam_antagonist.model.effects.page --write docs/effects.md"


def test_files_that_it_names_are_there():
    for name, section in SECTIONS.items():
        path = re.search(r"\]\(\.\./(pam_antagonist/model/effects/\w+\.py)\)", section).group(1)
        assert (ROOT / path).is_file(), name


def test_hooks_and_quantities_are_listed():
    text = hooks()
    assert all(f"| `{name}` |" in text for name in (*HOOKS, *QUANTITIES))


def test_a_page_without_its_marks_is_refused():
    with pytest.raises(BadInput, match="expected one part between <!-- begin effects -->"):
        page(TEXT.replace("<!-- begin effects -->", ""), CATALOGUE)


def test_a_loop_of_a_sealed_joint_names_parameters_of_its_effect() -> None:
    friction = CATALOGUE["friction"]
    assert friction.sealed.loop is not None
    wrong = replace(friction.sealed, loop=replace(friction.sealed.loop, sizes=("coulombs",)))
    with pytest.raises(BadInput, match=r"friction.*sealed\.loop.*coulomb"):
        catalogue([replace(friction, sealed=wrong)])
