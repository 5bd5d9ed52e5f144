"""Joint stiffness ∂τ/∂ψ and the angle of rest."""

from __future__ import annotations

import math

import numpy as np
import pytest
import transcription as paper
from states import random_states

from pam_antagonist.model import dynamics, equilibrium

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
