"""docs/effects.md says what the catalogue says."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.model.effects.page import page
from pam_antagonist.model.effects.registry import catalogue

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")


def test_what_a_sealed_joint_shows():
    paragraph = TEXT.split("**A sealed joint**")[1].split("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", paragraph)) == {name for name, item in CATALOGUE.items() if item.sealed.part}


def test_the_page_is_up_to_date():
    assert page(TEXT, CATALOGUE) == TEXT, "python -m pam_antagonist.model.effects.page --write docs/effects.md"


def test_a_page_without_its_marks_is_refused():
    with pytest.raises(BadInput, match="expected one part between <!-- begin effects -->"):
        page(TEXT.replace("<!-- begin effects -->", ""), CATALOGUE)


def test_a_loop_of_a_sealed_joint_names_parameters_of_its_effect() -> None:
    friction = CATALOGUE["friction"]
    assert friction.sealed.loop is not None
    wrong = replace(friction.sealed, loop=replace(friction.sealed.loop, sizes=("coulombs",)))
    with pytest.raises(BadInput, match=r"friction.*sealed\.loop.*coulomb"):
        catalogue([replace(friction, sealed=wrong)])
