"""Where a joint rests: stiffness ∂τ/∂ψ, the angle of rest, and the mechanical stop at ±25°.

The stop is an inelastic one, at which the joint stands until it is pulled away.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import transcription as paper
from states import random_states, steps

from pam_antagonist.model import drive, dynamics, equilibrium
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import load_rig

T = paper.CORRECTED


def test_torque_slope_is_the_derivative_of_the_torque(p):
    h = 1e-5
    for (angle, _, *pressures), _ in random_states(100, seed=15):
        quotient = (paper.torque(T, angle + h, *pressures) - paper.torque(T, angle - h, *pressures)) / (2 * h)
        slope = dynamics.torque_slope(np.array([angle, 0.0, *pressures]), p)
        assert slope == pytest.approx(quotient, rel=1e-8, abs=1e-7)


def test_the_joint_is_a_spring_that_stiffens_with_pressure(p):
    """∂τ/∂ψ is negative (τ pulls back), and larger in size at a higher mean pressure."""
    slopes = [dynamics.torque_slope(np.array([0.0, 0.0, P, P]), p) for P in (200e3, 450e3, 700e3)]
    assert 0.0 > slopes[0] > slopes[1] > slopes[2]
    assert slopes[1] == pytest.approx(-7.07, abs=0.01)


def test_rest_angle_balances_the_torques(p):
    for pressures in ((450e3, 450e3), (200e3, 700e3), (700e3, 200e3), (350e3, 420e3)):
        angle = equilibrium.rest_angle(*pressures, p)
        assert angle == pytest.approx(paper.rest(T, *pressures), abs=1e-12)
        assert paper.torque(T, angle, *pressures) == pytest.approx(T["k_s"] * angle, abs=1e-12)


def test_rest_angle_stays_within_the_stop(rig):
    narrow = rig.parameters(changes={"joint.stop": math.radians(10.0)})
    assert equilibrium.rest_angle(700e3, 200e3, narrow) == math.radians(10.0)
    assert equilibrium.rest_angle(200e3, 700e3, narrow) == -math.radians(10.0)


def test_a_stiff_joint_rests_inside_a_stop_that_the_muscles_alone_would_reach(rig):
    for pressures, side in (((700e3, 200e3), 1.0), ((200e3, 700e3), -1.0)):
        stiff = rig.parameters(changes={"joint.stiffness": 20.0, "joint.stop": math.radians(10.0)})
        angle = equilibrium.rest_angle(*pressures, stiff)
        assert 0.02 < side * angle < math.radians(9.0)
        assert angle == pytest.approx(paper.rest({**T, "k_s": 20.0}, *pressures), abs=1e-12)


STOP = math.radians(25.0)
PERIOD = 1e-3


@pytest.fixture(scope="module")
def printed():
    """The table as printed drives the joint beyond +25°; with the corrected sign the muscles do not get there."""
    return load_rig("shin2022_as_printed")


@pytest.fixture(scope="module")
def driven(printed):
    """3 s against the upper stop, 3 s towards the other side."""
    voltages = np.repeat([[8.0, 3.0], [3.0, 8.0]], 3000, axis=0)
    start = np.array([0.0, 0.0, 450e3, 450e3])
    states, torques, _ = drive.simulate(start, voltages, printed.parameters(), PERIOD, 1)
    return states, torques


def test_the_stop_is_what_holds_it(driven, printed):
    free = printed.parameters(changes={"joint.stop": math.inf})
    states = steps([0.0, 0.0, 450e3, 450e3], free, 3000, u=(8.0, 3.0))
    assert states[-1, 0] > STOP + math.radians(3.0)
    assert driven[0][2999, 0] == STOP


def test_the_angle_never_passes_the_stop_and_the_velocity_is_lost(driven):
    states, _ = driven
    assert np.max(np.abs(states[:, 0])) == STOP
    at = states[:, 0] == STOP
    assert at.sum() > 500
    assert np.all(states[at, 1] <= 0.0)
    arrival = int(np.argmax(at))
    assert states[arrival - 1, 1] > 0.01
    assert states[arrival + 1 : 2990, 1] == pytest.approx(0.0, abs=1e-12)


def test_it_leaves_the_stop_when_pulled_away(driven):
    states, torques = driven
    assert np.all(torques[2500:3000] > 0.0)
    assert states[-1, 0] < math.radians(5.0)


def test_both_ends(p_stop):
    for side in (1.0, -1.0):
        start = [side * math.radians(24.0), side * 30.0, 450e3, 450e3]
        states = steps(start, p_stop, 100)
        assert np.max(side * states[:, 0]) == STOP
        # inelastic: from the stop it falls back no faster than a joint released there
        at = int(np.argmax(side * states[:, 0]))
        assert states[at, 1] == 0.0
        released = steps([side * STOP, 0.0, *states[at, 2:]], p_stop, 100 - at)
        assert states[at:] == pytest.approx(released, rel=1e-12)


def test_pressures_at_the_stop_are_those_of_a_joint_locked_there(driven, printed):
    """A joint that stands does not change its volumes. (The torque that presses it on accelerates it in each stage of
    each step; were that movement let into equation (4), muscle 2 would settle 100 kPa too high.)"""
    states, torques = driven
    arrival = int(np.argmax(states[:, 0] == STOP))
    locked = printed.parameters("locked", STOP)
    voltages = np.full((3000 - arrival, 2), (8.0, 3.0))
    alone, torque_alone, _ = drive.simulate(states[arrival], voltages, locked, PERIOD, 1)
    assert states[arrival:3000, 2:] == pytest.approx(alone[:, 2:], rel=1e-12)
    assert torques[arrival:3000] == pytest.approx(torque_alone, rel=1e-9)


def test_a_joint_with_a_far_stop_rests_beyond_60_degrees():
    rig = load_rig("shin2022")
    joint = rig.joint.replaced(stop=math.radians(80.0), stiffness=0.0)
    p = rig.replaced(geometry=rig.geometry.replaced(radius=0.01), joint=joint).parameters()
    angle = equilibrium.rest_angle(700e3, 300e3, p)
    assert math.radians(65.0) < angle < math.radians(75.0)
    assert dynamics.torque(np.array([angle, 0.0, 700e3, 300e3]), p) == pytest.approx(0.0, abs=1e-9)


def test_a_sealed_joint_with_a_far_stop_starts_beyond_60_degrees():
    rig = load_rig("sealed_joint")
    p = rig.replaced(joint=rig.joint.replaced(stop=math.radians(80.0))).parameters()
    pressures = [equilibrium.closed_pressure(i, math.radians(70.0), p) for i in (0, 1)]
    assert equilibrium.start_angle(*pressures, p) == pytest.approx(math.radians(70.0))
    p[par.STOP] = math.inf
    assert equilibrium.start_angle(*pressures, p) == pytest.approx(math.radians(60.0))
