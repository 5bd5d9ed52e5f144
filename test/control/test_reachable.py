"""Pressures for a torque and a stiffness, and the set of angle and stiffness that a joint can have."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.control.command import Mode
from pam_antagonist.control.laws import Reachable
from pam_antagonist.control.stiffness import Box, set_pressures
from pam_antagonist.errors import BadInput
from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.rig import load_rig

P = load_rig("shin2022").parameters()
BOX = Box.of(P)


@pytest.fixture(scope="module")
def reach() -> Reachable:
    return Reachable(P, BOX)


def test_the_ends_are_where_the_joint_rests_at_the_extreme_pressures(reach):
    low = equilibrium.rest_angle(BOX.lowest, BOX.highest, P)
    high = equilibrium.rest_angle(BOX.highest, BOX.lowest, P)
    assert reach.angles == pytest.approx((low, high), abs=1e-4)


def test_a_joint_with_a_far_stop_reaches_beyond_60_degrees():
    p = load_rig("shin2022").parameters(changes={"joint.stop": math.radians(80.0), "geometry.radius": 0.01})
    high = equilibrium.rest_angle(BOX.highest, BOX.lowest, p)
    assert high > math.radians(65.0)
    assert Reachable(p, BOX).angles[1] == pytest.approx(high, abs=1e-4)


def test_no_pressures_in_the_box_rest_outside_of_the_set(reach):
    rng = np.random.default_rng(1)
    for _ in range(300):
        pressures = rng.uniform(BOX.lowest, BOX.highest, 2)
        angle = equilibrium.rest_angle(*pressures, P)
        x = np.array([angle, 0.0, *pressures])
        if min(dynamics.forces(x, P)) < BOX.least_force:
            continue
        found = reach.at_angle(angle)
        assert reach.angles[0] - 1e-6 <= angle <= reach.angles[1] + 1e-6
        assert found.softest - 1e-3 <= -dynamics.torque_slope(x, P) <= found.stiffest + 1e-3


def test_every_corner_of_the_set_is_reached_by_its_pressures(reach):
    for angle in np.linspace(*reach.angles, 7):
        found = reach.at_angle(float(angle))
        for stiffness in (found.softest, found.stiffest):
            pressures = reach.pressures(float(angle), stiffness)
            assert all(BOX.lowest - 1.0 <= pressure <= BOX.highest + 1.0 for pressure in pressures)
            assert equilibrium.rest_angle(*pressures, P) == pytest.approx(float(angle), abs=1e-5)


def test_a_reference_within_the_set_stays_as_it_is(reach):
    assert reach.nearest(Mode.ANGLE_STIFFNESS, 0.1, 6.0) == (0.1, 6.0, "")
    value, stiffness, words = reach.nearest(Mode.ANGLE, 0.1, math.nan)
    assert value == 0.1 and math.isnan(stiffness) and not words


@pytest.mark.parametrize(("value", "stiffness"), [(0.5, 6.0), (-0.5, 20.0), (0.0, 1.0), (0.2, 30.0)])
def test_a_reference_outside_becomes_the_nearest_and_says_so(reach, value, stiffness):
    angle, softness, words = reach.nearest(Mode.ANGLE_STIFFNESS, value, stiffness)
    assert angle == pytest.approx(min(max(value, reach.angles[0]), reach.angles[1]))
    found = reach.at_angle(angle)
    assert found.reached and softness in (stiffness, found.softest, found.stiffest)
    assert f"{value:.4g} rad with {stiffness:.4g} N m/rad is out of reach" in words
    assert reach.nearest(Mode.ANGLE_STIFFNESS, angle, softness)[2] == ""


def test_torques_are_those_of_the_extreme_pressures_at_the_angle(reach):
    for angle in (0.0, 0.2):
        low, high = reach.torques(angle)
        assert high == pytest.approx(dynamics.torque(np.array([angle, 0.0, BOX.highest, BOX.lowest]), P), abs=1e-5)
        assert low == pytest.approx(dynamics.torque(np.array([angle, 0.0, BOX.lowest, BOX.highest]), P), abs=1e-5)
        assert reach.nearest(Mode.TORQUE_STIFFNESS, 99.0, 6.0, angle)[0] == pytest.approx(high)


@pytest.mark.parametrize(("lowest", "margin"), [(50e3, 0.0), (700e3, 20e3), (200e3, -1.0), (math.nan, 0.0)])
def test_bounds_that_leave_nothing_are_refused(lowest, margin):
    with pytest.raises(BadInput, match="supply_margin .* expected pressures from"):
        Box.of(P, lowest, margin)


WIDE = Box(200e3, 690e3, 2.0)
RIG = load_rig("shin2022")


def parameters(**changes: float) -> np.ndarray:
    return RIG.parameters(changes={name.replace("__", "."): value for name, value in changes.items()})


def state(angle: float, *pressures: float) -> np.ndarray:
    return np.array([angle, 0.0, *(pressures or (4e5, 4e5))])


@pytest.mark.parametrize("slack", [0.0, 8.0])
def test_pressures_are_found_again_from_their_torque_and_stiffness(slack):
    """With a slack muscle's smooth cut the force map is not linear in the pressure any more."""
    p = parameters(effects__slack__width=slack) if slack else parameters()
    rng = np.random.default_rng(3)
    for _ in range(200):
        pressures = rng.uniform(230e3, 690e3, 2)
        x = state(rng.uniform(-0.35, 0.35), *pressures)
        if min(dynamics.forces(x, p)) < WIDE.least_force:
            continue
        torque, stiffness = dynamics.torque(x, p), -dynamics.torque_slope(x, p)
        softest, stiffest, missing = set_pressures(torque, stiffness, WIDE, x, p)
        assert softest <= stiffness + 1e-4 and stiffness <= stiffest + 1e-4 and abs(missing) < 1e-5
        assert dynamics.torque(x, p) == pytest.approx(torque, abs=1e-5)
        assert -dynamics.torque_slope(x, p) == pytest.approx(stiffness, abs=1e-4)
        if not slack:
            assert x[2:4] == pytest.approx(pressures, abs=5.0)


def test_a_free_stiffness_is_the_middle_of_what_the_torque_leaves():
    p, x = parameters(), state(-0.1)
    softest, stiffest, _ = set_pressures(0.0, math.nan, WIDE, x, p)
    assert -dynamics.torque_slope(x, p) == pytest.approx(0.5 * (softest + stiffest))


def test_no_muscle_falls_below_the_least_force_nor_a_pressure_below_the_lowest():
    p = parameters()
    for least in (2.0, 25.0):
        for angle in np.linspace(-0.3, 0.3, 13):
            x = state(float(angle))
            set_pressures(0.0, 0.1, Box(120e3, 690e3, least), x, p)
            assert min(dynamics.forces(x, p)) >= least - 1e-3
            assert min(x[2:4]) >= 120e3
