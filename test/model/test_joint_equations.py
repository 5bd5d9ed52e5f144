"""Equations (8), (9), (10): torque, friction, acceleration."""

from __future__ import annotations

import math

import pytest
import transcription as paper
from states import EDGE_PRESSURES, random_states

from pam_antagonist.model import joint

T = paper.CORRECTED


def forces(x):
    return [paper.force(T, i, paper.length(T, i, x[0]), x[1 + i]) for i in (1, 2)]


def test_muscle_torque(p):
    for x, _ in random_states(50, seed=7):
        value = joint.muscle_torque(math.cos(x[0]), *forces(x), p)
        assert value == pytest.approx(paper.torque(T, x[0], x[2], x[3]), rel=1e-12, abs=1e-14)


def test_coulomb_torque(p):
    states = [x for x, _ in random_states(100, seed=8)]
    states += [[0.1, 0.0, a, b] for a in EDGE_PRESSURES for b in EDGE_PRESSURES]
    for x in states:
        f_1, f_2 = forces(x)
        expected = paper.shaft_friction(T, f_1, f_2) + paper.muscle_friction(T, x[2], x[3])
        assert joint.coulomb_torque(f_1, f_2, x[2], x[3], p) == pytest.approx(expected, rel=1e-12)


def test_friction_and_acceleration_sliding_and_sticking(p):
    seen = {False: 0, True: 0}
    for x, _ in random_states(400, seed=9):
        tau, coulomb, t_0 = paper.balance(T, x)
        expected, slides = paper.friction(T, x[1], t_0, coulomb)
        value, flag = joint.friction_torque(x[1], t_0, coulomb, p)
        assert (value, bool(flag)) == (pytest.approx(expected, rel=1e-12, abs=1e-14), slides)
        value, flag = joint.acceleration(x[0], x[1], tau, coulomb, p)
        assert (value, bool(flag)) == (pytest.approx((t_0 - expected) / T["J"], rel=1e-9, abs=1e-9), slides)
        seen[slides] += 1
    assert min(seen.values()) > 20, f"the states do not cover both cases: {seen}"
