"""What hides: behind numbers of the rig file, where the joint seldom is, and in a friction that is no number."""

from __future__ import annotations

import pytest

from pam_antagonist import diagnose
from pam_antagonist.diagnosis.pipeline import IN_TURN
from validation.battery.carry import Joint, cases


@pytest.mark.slow(25)
def test_friction_is_named_where_forces_that_load_the_shaft_would_explain_as_much() -> None:
    """A seal that rubs one way only: half of it is friction, half a torque; both muscles may be stronger as well."""
    joint = Joint("lean", "single", (("lean", None),), ("seal's lip that leans",), 900, (9.0,), exact=True)
    found = diagnose([joint.recording(name, 30.0) for name in joint.given], "shin2022", jobs=1, profiles=False)
    assert found.verdict == "effect"
    assert {effect.name for effect in found.effects} == {"friction", "load_torque"}
    friction = found.rig_extended.friction
    assert friction.shaft == pytest.approx(0.2, rel=0.1)
    # Without them, recalibration makes a muscle stronger by more than the rig file allows.
    assert found.errors.extended.torque.rmse < 0.7 * found.errors.recalibrated.torque.rmse


@pytest.mark.thorough(75)
def test_friction_near_an_angle_gets_a_law_of_the_free_run() -> None:
    """Along the motion friction explains the sticking, but the model that gets the commands errs more with it."""
    form = "bearing that sticks near an angle"
    joint = Joint("stick", "single", (("stick", None),), (form,), 1734747564, (10.96,), exact=True)
    found = diagnose([joint.recording(name) for name in joint.given], "shin2022", jobs=1, profiles=False)
    law = found.effects[-1].law
    assert law is not None and (law.place, law.argument) == ("friction", "angle")
    assert found.errors.extended.angle.rmse < 0.5 * found.errors.recalibrated.angle.rmse


@pytest.mark.thorough(90)
def test_what_acts_where_the_joint_seldom_is_is_no_event() -> None:
    """A muscle whose ends bulge, when it is short: for twelve seconds."""
    joint = dict(cases(21, 28, 0, 0, 0))[27]
    found = diagnose([joint.recording(name) for name in joint.given], "shin2022", jobs=1, profiles=False)
    (effect,) = found.effects
    assert effect.law is not None and effect.law.at == "volume_2"
    assert effect.onset_s is None


@pytest.mark.thorough(60)
def test_what_only_the_end_shows_is_found_with_stretches_held_out_in_turn() -> None:
    """A muscle that hangs through where it is short, which it is in the last quarter of a minute."""
    joint = dict(cases(47, 28, 0, 0, 0))[4]
    found = diagnose([joint.recording(name) for name in joint.given], "shin2022", jobs=1, profiles=False)
    law = found.effects[-1].law
    assert law is not None and (law.at, law.argument) == ("force_2", "length")
    assert any(text.startswith("only the end") and text.endswith(IN_TURN) for text in found.warnings)
    assert found.errors.extended.angle.rmse < 0.03


@pytest.mark.thorough(90)
def test_what_changes_from_begin_to_end_is_found_with_stretches_held_out_in_turn() -> None:
    """A silencer that clogs: at the end of a minute it lets through less than any law from its begin says."""
    joint = dict(cases(47, 28, 0, 0, 0))[1]
    found = diagnose([joint.recording(name) for name in joint.given], "shin2022", jobs=1, profiles=False)
    laws = [one.law for one in found.effects if one.law is not None]
    assert laws and {law.muscle for law in laws} == {1}
    assert {law.place for law in laws} <= {"passage", "valve", "flow"}
    assert any(text.startswith("no law") and text.endswith(IN_TURN) for text in found.warnings)
