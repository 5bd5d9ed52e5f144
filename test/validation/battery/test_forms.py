"""Each form is another law than the catalogue's of that effect, and still an example of it."""

from __future__ import annotations

import os

import pytest

from validation.battery.forms import SINGLE, Form
from validation.battery.remainders import group_of, known, remainder, with_law

ONE_AN_EFFECT = list({form.effect: form for form in reversed(with_law())}.values())


def of_the_excess(form: Form) -> float:
    """Share of what the base parameters leave that the law leaves as well."""
    return known()[form.name].law / known()[form.name].base


@pytest.mark.parametrize("form", with_law(), ids=lambda form: form.name)
def test_the_catalogue_explains_most_of_it_and_not_all(form: Form) -> None:
    # Of what base parameters leave; a form of which the law takes nothing away is in no catalogue.
    # The leak's exponent takes in capillaries and cracks as well as orifices.
    least = 0.0 if form.effect == "leak" else 0.003
    # The furthest one is a bottle without compressor, with 0.80; the bound was 0.8 before that was measured anew.
    assert least < of_the_excess(form) < 0.85


@pytest.mark.slow
@pytest.mark.parametrize(
    # PAM_ALL_FORMS=1 takes them all, which is some minutes more.
    "form",
    with_law() if os.environ.get("PAM_ALL_FORMS") else ONE_AN_EFFECT[:2],
    ids=lambda form: form.name,
)
def test_remainders_are_those_of_the_package(form: Form) -> None:
    now, then = remainder(form), known()[form.name]
    assert now.before == pytest.approx(then.before, rel=0.05)
    assert now.share == pytest.approx(then.share, rel=0.3, abs=0.01)


def test_forms_of_a_case_count_by_the_least_remainder() -> None:
    groups = {form.name: group_of([form.name]) for form in SINGLE}
    assert set(groups.values()) == {"other", "near", "variation", "no law"}
    other = next(name for name, group in groups.items() if group == "other")
    variation = next(name for name, group in groups.items() if group == "variation")
    assert group_of([other, variation]) == "variation"
    assert group_of(["pushes"]) == group_of([other, "pushes"]) == group_of([]) == "no law"
