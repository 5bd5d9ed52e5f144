"""Pressures for a torque and a stiffness, against the model's own torque and stiffness."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.control.stiffness import Box, set_pressures
from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.rig import load_rig

BOX = Box(200e3, 690e3, 2.0)
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
        if min(dynamics.forces(x, p)) < BOX.least_force:
            continue
        torque, stiffness = dynamics.torque(x, p), -dynamics.torque_slope(x, p)
        softest, stiffest, missing = set_pressures(torque, stiffness, BOX, x, p)
        assert softest <= stiffness + 1e-4 and stiffness <= stiffest + 1e-4 and abs(missing) < 1e-5
        assert dynamics.torque(x, p) == pytest.approx(torque, abs=1e-5)
        assert -dynamics.torque_slope(x, p) == pytest.approx(stiffness, abs=1e-4)
        if not slack:
            assert x[2:4] == pytest.approx(pressures, abs=5.0)


def test_a_stiffness_out_of_reach_becomes_the_nearer_end_and_the_torque_stays():
    p = parameters()
    for stiffness, end in ((0.5, 0), (50.0, 1)):
        x = state(0.1)
        ends = set_pressures(0.3, stiffness, BOX, x, p)
        assert -dynamics.torque_slope(x, p) == pytest.approx(ends[end], abs=1e-6)
        assert dynamics.torque(x, p) == pytest.approx(0.3, abs=1e-6)


def test_a_free_stiffness_is_the_middle_of_what_the_torque_leaves():
    p, x = parameters(), state(-0.1)
    softest, stiffest, _ = set_pressures(0.0, math.nan, BOX, x, p)
    assert -dynamics.torque_slope(x, p) == pytest.approx(0.5 * (softest + stiffest))


def test_a_torque_out_of_reach_becomes_the_nearest_corner():
    p = parameters()
    for torque, corner in ((9.0, (690e3, 200e3)), (-9.0, (200e3, 690e3))):
        x = state(0.0)
        softest, stiffest, missing = set_pressures(torque, 6.0, BOX, x, p)
        assert x[2:4] == pytest.approx(corner) and softest == pytest.approx(stiffest)
        assert missing == pytest.approx(torque - dynamics.torque(x, p))


def test_no_muscle_falls_below_the_least_force_nor_a_pressure_below_the_lowest():
    p = parameters()
    for least in (2.0, 25.0):
        for angle in np.linspace(-0.3, 0.3, 13):
            x = state(float(angle))
            set_pressures(0.0, 0.1, Box(120e3, 690e3, least), x, p)
            assert min(dynamics.forces(x, p)) >= least - 1e-3
            assert min(x[2:4]) >= 120e3


def test_pressures_for_an_angle_of_rest_are_those_at_which_the_joint_rests_there():
    p = parameters()
    for angle in (-0.25, 0.0, 0.3):
        x = state(angle)
        set_pressures(dynamics.torque(x, p) - equilibrium.pull(x, p), 6.0, BOX, x, p)
        assert equilibrium.rest_angle(x[2], x[3], p) == pytest.approx(angle, abs=1e-6)
