"""The README is short, and its figures are those that the first hour shows."""

from __future__ import annotations

import re

import pages

TEXT = pages.read(pages.ROOT / "README.md")
FIRST_HOUR = pages.read(pages.ROOT / "docs" / "tutorials" / "first_hour.md")


def test_it_has_at_most_120_lines() -> None:
    assert len(TEXT.splitlines()) <= 120


def test_its_parts_stand_in_the_order_in_which_a_stranger_asks() -> None:
    assert re.findall(r"^## (.*)", TEXT, re.MULTILINE) == [
        "On a measured joint",
        "What you need",
        "Install",
        "Replay a recording",
        "Your rig in five steps",
        "Python",
        "What it is not, and where it is weak",
        "Documentation",
        "Citation",
    ]
    assert TEXT.index("demo.gif") < TEXT.index("## ")


def test_figures_of_the_shipped_recordings_are_those_of_the_first_hour() -> None:
    section = TEXT.split("## Replay a recording")[1].split("\n## ")[0]
    numbers = re.findall(r"\b\d+\.\d+\b", section)
    assert len(numbers) > 10
    assert not [number for number in numbers if number not in FIRST_HOUR]


def test_the_moving_picture_is_small() -> None:
    assert (pages.ROOT / "docs" / "demo.gif").stat().st_size < 1.5e6
