"""An effect that numbers of the rig file can imitate, if they leave what the file allows."""

from __future__ import annotations

import pytest

from pam_antagonist import diagnose
from validation.battery.carry import Joint


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
