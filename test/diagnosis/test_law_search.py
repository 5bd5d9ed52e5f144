"""The search for a law that nobody wrote: its place, what it depends on, a table; and none where nothing is wrong."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from pam_antagonist import load_rig, simulate
from pam_antagonist.diagnosis import Diagnosis
from pam_antagonist.diagnosis.errors import Errors, ModelErrors, RigErrors
from pam_antagonist.diagnosis.learned_law import Learned, effect_of, joined, learn, refusal
from pam_antagonist.diagnosis.result import RecordingEntry
from pam_antagonist.recording.joint import joint_condition
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, with_law
from pam_antagonist.simulation.excitation import profile


def rig() -> Rig:
    return load_rig("shin2022").replaced(sample_period=0.004)


def learned(law: Law | None) -> Learned:
    """What is learned from the first 24 s of a free joint that has a law."""
    own = rig() if law is None else with_law(rig(), law)
    recording = simulate(own, profile("steps", 36.0, 0.004, seed=5), mismatch=0.01, seed=8)
    return learn([(recording, joint_condition(recording))], rig(), 1.0 / 3.0, lambda text: None)


@pytest.fixture(scope="module")
def exchange() -> Learned:
    flows = (-1.8e-6, -1.2e-6, 0.0, 1.2e-6, 1.8e-6)
    return learned(Law("exchange", (-3e5, -1e5, 0.0, 1e5, 3e5), flows, None, "pressure_difference"))


def test_place_and_argument_of_a_law_that_is_in_no_catalogue_are_found(exchange: Learned) -> None:
    assert exchange.searches[0].places[0].name == "exchange"
    law = exchange.laws[0]
    assert (law.place, law.argument, law.operator) == ("exchange", "pressure_difference", "none")
    assert law.value(1e5) == pytest.approx(1.2e-6, rel=0.1)


def test_the_simulation_with_the_law_leaves_little_but_noise(exchange: Learned) -> None:
    assert exchange.searches[0].found is not None
    before, after = exchange.searches[0].without.excess[0, :2], exchange.searches[0].found.excess[0, :2]
    assert np.all(before > 20.0)
    assert np.all(after < 1.2)


def test_a_report_has_place_argument_and_table_of_a_law(exchange: Learned) -> None:
    entry = effect_of(exchange.laws[0], exchange.searches[0], ["free"]).to_json()
    assert (entry["name"], entry["place"], entry["arguments"]) == ("learned", "exchange", ["pressure_difference"])
    table = entry["law"]
    assert len(table["nodes"]) == len(table["values"]) == len(table["std"])
    assert table["unit"] == "kg/s"
    assert entry["like"] == []


def test_no_law_is_added_where_nothing_is_wrong() -> None:
    nothing = learned(None)
    assert nothing.laws == ()
    assert nothing.searches[0].gain < 40.0


def test_a_joint_without_a_measured_angle_or_air_that_flows_is_refused_in_a_sentence() -> None:
    recording = simulate(rig(), profile("steps", 2.0, 0.004, seed=1), seed=1)
    assert refusal([recording], rig()) == ""
    assert "the angle was measured" in refusal([dataclasses.replace(recording, angle=None)], rig())
    assert "moving valves" in refusal([recording], load_rig("sealed_joint"))


def diagnosed(pressure: float) -> Diagnosis:
    """What counts when diagnoses are joined: pressure errors [Pa] as configured, recalibrated and extended."""
    shares = dict(zip(("as_configured", "recalibrated", "extended"), (3.0, 2.0, 1.0), strict=True))
    each = {name: Errors(None, None, (share * pressure, share * pressure)) for name, share in shares.items()}
    errors = ModelErrors(**each)
    content: dict[str, Any] = {item.name: () for item in dataclasses.fields(Diagnosis)}
    content |= {"verdict": "unexplained", "sentence": "", "errors": errors}
    content["by_recording"] = (RecordingEntry("free", "free", None, "both", 16.0, errors, ukf=errors),)
    content["of_one_rig"] = {name: RigErrors(own, own) for name, own in each.items()}
    return Diagnosis(**content)


def test_errors_before_a_law_are_those_of_the_diagnosis_without_it(exchange: Learned) -> None:
    found = joined(diagnosed(1000.0), diagnosed(10.0), exchange)
    assert found.verdict == "effect"
    for errors in (found.errors, found.by_recording[0].errors, found.by_recording[0].ukf):
        assert errors is not None
        assert [own.rmse_pa[0] for own in errors.all] == [3000.0, 2000.0, 10.0]
    assert [own.model.rmse_pa[0] for own in found.of_one_rig.values()] == [3000.0, 2000.0, 10.0]


def test_a_law_by_which_no_held_out_error_falls_is_not_added(exchange: Learned) -> None:
    found = joined(diagnosed(1000.0), diagnosed(1000.0), exchange)
    assert (found.verdict, found.effects) == ("unexplained", ())
    assert "no held-out error falls by it" in found.sentence
