"""Which parameters a fit may move, and how far."""

from __future__ import annotations

import dataclasses

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.inference.expected import with_known_curves
from pam_antagonist.inference.free_parameters import base_directions, free_parameters, moved
from pam_antagonist.model import flow


def test_priors_and_bounds_are_those_of_the_rig_file(rig):
    own = rig.replaced(priors={"friction.shaft": 0.03}, bounds={"friction.shaft": (0.1, 0.25)})
    by_name = {item.name: item for item in free_parameters(own)}
    shaft = by_name["friction.shaft"]
    assert (shaft.start, shaft.prior_std, shaft.low, shaft.high) == (0.2, 0.03, 0.1, 0.25)
    area = by_name["valve_1.inflow_area"]
    assert area.prior_std == pytest.approx(0.05 * area.start)
    assert area.low < area.start < area.high


def test_what_can_be_measured_directly_is_kept_unless_it_is_freed(rig):
    names = {item.name for item in free_parameters(rig)}
    assert "geometry.radius" not in names and "atmosphere.pressure" not in names
    assert "atmosphere.pressure" in {item.name for item in free_parameters(rig, free=["atmosphere.pressure"])}
    fewer = {item.name for item in free_parameters(rig, frozen=["muscle_1.force"])}
    assert names - fewer == {f"muscle_1.force.{name}" for name in ("v1", "v2", "w1", "w2")}


def test_a_shift_of_a_curve_that_the_file_expects_is_a_base_parameter(rig, experiment_of, recorded) -> None:
    path, std = "effects.valve_offset.voltage_2", 0.4
    expecting = rig.replaced(priors={path: std})
    (item,) = [item for item in free_parameters(expecting) if item.name == path]
    assert (item.start, item.prior_std, item.low, item.high) == (0.0, std, -2.0, 2.0)
    (direction,) = [direction for direction in base_directions(expecting) if direction.name == path]
    assert direction.prior == std and direction.in_words(0.25) == "+0.25 V"
    # What is expected is no fault: it is not looked for among the effects.
    experiment = experiment_of(recorded(seconds=5.0), "locked")
    for own, among in ((rig, True), (expecting, False)):
        names = {candidate.effect for candidate in dataclasses.replace(experiment, rig=own).candidates({})}
        assert ("valve_offset" in names) is among


def test_a_curve_that_is_known_is_shifted_itself(rig) -> None:
    path = "effects.valve_offset.voltage_2"
    expecting = rig.replaced(priors={path: 0.4, "friction.shaft": 0.01})
    found = moved(expecting, {path: 0.3})
    known = with_known_curves(found, expecting)
    assert known.effects == {} and dict(known.priors) == {"friction.shaft": 0.01}
    p, q = found.parameters(), known.parameters()
    for voltage in (0.1, 4.9, 5.0, 6.4, 9.9):
        assert flow.open_rate(1, voltage, q) == pytest.approx(flow.open_rate(1, voltage, p), abs=1e-12)
        assert flow.open_rate(0, voltage, q) == flow.open_rate(0, voltage, p)
    # A shift that the file declares already stays the effect that it is.
    declared = rig.replaced(effects={"valve_offset": {"voltage_2": 0.1}}, priors={path: 0.4})
    assert with_known_curves(moved(declared, {path: 0.3}), declared).effects == {"valve_offset": {"voltage_2": 0.3}}


def test_a_name_that_is_none_is_refused_with_a_hint(rig):
    with pytest.raises(BadInput, match=r"did you mean 'friction\.shaft'"):
        free_parameters(rig, free=["friction.shft"])
