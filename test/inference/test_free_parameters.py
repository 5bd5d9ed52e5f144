"""Which parameters a fit may move, and how far."""

from __future__ import annotations

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import free_parameters


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


def test_a_name_that_is_none_is_refused_with_a_hint(rig):
    with pytest.raises(BadInput, match=r"did you mean 'friction\.shaft'"):
        free_parameters(rig, free=["friction.shft"])
