"""Gains for a rig: the margins are kept, and the loop settles on the joint itself."""

from __future__ import annotations

import math

import pytest

from pam_antagonist.control.command import Mode
from pam_antagonist.control.pi import Gains, PiController
from pam_antagonist.design.loop_gains import loop_gains
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant

RIG = load_rig("shin2022")


@pytest.mark.parametrize("mode", ["angle", "torque"])
def test_margins_and_bandwidth_are_within_bounds(mode: str) -> None:
    found = loop_gains(RIG, mode)
    assert found.gain_margin >= 2.5 and found.phase_margin is not None and found.bandwidth is not None
    assert found.phase_margin >= math.radians(35.0) and 0.1 < found.bandwidth <= 2.0
    assert f"phase margin {math.degrees(found.phase_margin):.0f} deg" in found.in_words()


def test_a_loop_whose_gain_never_reaches_1_has_no_bandwidth() -> None:
    """A joint with hardly any lever: the largest gain that is tried leaves the torque as it is."""
    weak = RIG.unchecked(geometry=RIG.geometry.unchecked(radius=1e-9 * RIG.geometry.radius))
    found = loop_gains(weak, "torque")
    assert (found.bandwidth, found.phase_margin) == (None, None)
    assert "never reaches 1" in found.in_words()


def test_a_joint_with_more_gain_of_its_own_gets_less() -> None:
    radius = RIG.geometry.radius
    longer = RIG.replaced(geometry=RIG.geometry.replaced(radius=1.3 * radius))
    assert loop_gains(longer, "torque").proportional < loop_gains(RIG, "torque").proportional


def test_a_step_settles() -> None:
    found = loop_gains(RIG, "angle")
    gains = Gains(found.proportional, found.integral)
    controller = PiController({Mode.ANGLE: gains, Mode.TORQUE: gains}, sample_period=RIG.sample_period)
    plant, valves, wanted = Plant(RIG, seed=1, mismatch=0.02, noise=False), (5.5, 5.5), math.radians(10.0)
    course = []
    for _ in range(8000):
        course.append(float(plant.step(valves).angle))
        valves, _ = controller.step(Mode.ANGLE, wanted, course[-1])
    assert max(course) < 1.25 * wanted
    assert max(abs(value - wanted) for value in course[-500:]) < math.radians(0.5)


def test_friction_as_an_effect_is_left_out_as_well() -> None:
    """Else the linear model would be that of a wall, and the gains next to nothing."""
    rubbing = RIG.replaced(effects={"friction": {"coulomb": 0.04, "stribeck": 0.02, "velocity": 0.3}})
    assert loop_gains(rubbing, "angle").proportional == pytest.approx(loop_gains(RIG, "angle").proportional, rel=0.05)
