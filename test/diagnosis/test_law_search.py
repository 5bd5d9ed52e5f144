"""The search for a law that nobody wrote: its place, what it depends on, a table; and none where nothing is wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pam_antagonist import load_rig, simulate
from pam_antagonist.diagnosis.law_search import LawSearch, Subject, law_search
from pam_antagonist.diagnosis.learned_law import refusal, stretches
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, with_law
from pam_antagonist.simulation.excitation import profile


def rig() -> Rig:
    return load_rig("shin2022").replaced(sample_period=0.004)


def found(law: Law | None) -> LawSearch:
    """What the search finds in 24 s of a free joint that has a law."""
    own = rig() if law is None else with_law(rig(), law)
    voltage = profile("steps", 24.0, 0.004, seed=5)
    recording = simulate(own, voltage, mismatch=0.01, seed=8)
    subject = Subject("free", stretches(recording), recording.sample_period_s, False, rig().parameters())
    return law_search([subject], rig())


@pytest.fixture(scope="module")
def exchange() -> LawSearch:
    flows = (-1.8e-6, -1.2e-6, 0.0, 1.2e-6, 1.8e-6)
    return found(Law("exchange", (-3e5, -1e5, 0.0, 1e5, 3e5), flows, None, "pressure_difference"))


def test_place_and_argument_of_a_law_that_is_in_no_catalogue_are_found(exchange: LawSearch) -> None:
    assert exchange.places[0].name == "exchange"
    assert exchange.found is not None
    law = exchange.found.law
    assert law is not None
    assert (law.place, law.argument, law.operator) == ("exchange", "pressure_difference", "none")
    assert law.value(1e5) == pytest.approx(1.2e-6, rel=0.3)


def test_the_simulation_with_the_law_leaves_little_but_noise(exchange: LawSearch) -> None:
    assert exchange.found is not None
    before, after = exchange.without.excess[0, :2], exchange.found.excess[0, :2]
    assert np.all(before > 4.0)
    assert np.all(after < 2.0)


def test_no_law_is_added_where_nothing_is_wrong() -> None:
    nothing = found(None)
    assert nothing.found is None
    assert nothing.gain < 40.0


def test_a_joint_without_a_measured_angle_or_air_that_flows_is_refused_in_a_sentence() -> None:
    recording = simulate(rig(), profile("steps", 2.0, 0.004, seed=1), seed=1)
    assert refusal([recording], rig()) == ""
    assert "the angle was measured" in refusal([dataclasses.replace(recording, angle=None)], rig())
    assert "moving valves" in refusal([recording], load_rig("sealed_joint"))
