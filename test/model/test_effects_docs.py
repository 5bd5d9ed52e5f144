"""docs/effects.md says what the catalogue says."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import CATALOGUE, AddedState, EffectParameter
from pam_antagonist.model.effects.page import page
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
    assert f"*Source* {effect.source}." in section
    assert f"*Signature* {effect.signature}" in section
    assert "```math" in section


@pytest.mark.parametrize("name", CATALOGUE)
def test_parameters(name):
    def row(item: EffectParameter) -> list[str]:
        numbers = [f"{value:g}" for value in (item.neutral, item.low, item.high)]
        return [f"`{item.name}`", item.unit, *numbers, item.meaning]

    shown = [[cells[0], *cells[2:]] for cells in table(SECTIONS[name], "parameter")]
    assert shown == ([] if CATALOGUE[name].of_tables else [row(item) for item in CATALOGUE[name].parameters])


@pytest.mark.parametrize("name", CATALOGUE)
def test_states(name):
    def row(state: AddedState) -> list[str]:
        noise = f"`{state.noise}`" if isinstance(state.noise, str) else f"{state.noise:g}"
        switches = " or ".join(f"`{name}`" for name in (state.switch, *state.further))
        return [f"`{state.name}`", state.unit, switches, f"{state.initial_std:g}", noise]

    shown = [[cells[0], *cells[2:]] for cells in table(SECTIONS[name], "added state")]
    assert shown == [row(state) for state in CATALOGUE[name].states]
    assert bool(shown) != ("No added state." in SECTIONS[name])


def test_the_page_is_up_to_date():
    assert page(TEXT, CATALOGUE) == TEXT, "python -m pam_antagonist.model.effects.page --write docs/effects.md"


def test_files_that_it_names_are_there():
    for name, section in SECTIONS.items():
        path = re.search(r"\]\(\.\./(pam_antagonist/model/effects/\w+\.py)\)", section).group(1)
        assert (ROOT / path).is_file(), name


def test_a_page_without_its_marks_is_refused():
    with pytest.raises(BadInput, match="expected one part between <!-- begin hooks -->"):
        page(TEXT.replace("<!-- begin hooks -->", ""), CATALOGUE)


def test_a_loop_of_a_sealed_joint_names_parameters_of_its_effect() -> None:
    friction = CATALOGUE["friction"]
    assert friction.sealed.loop is not None
    wrong = replace(friction.sealed, loop=replace(friction.sealed.loop, sizes=("coulombs",)))
    with pytest.raises(BadInput, match=r"friction.*sealed\.loop.*coulomb"):
        catalogue([replace(friction, sealed=wrong)])
