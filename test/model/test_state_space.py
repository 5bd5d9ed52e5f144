"""Equation (11) as a whole: derivative, output, step and subsystem, against the transcription."""

from __future__ import annotations

import math

import numpy as np
import pytest
import transcription as paper
from states import CHOKED_ABOVE, CHOKED_BELOW, EDGE_PRESSURES, EDGE_VOLTAGES, random_states

from pam_antagonist.model import dynamics, integration

T = paper.CORRECTED
SCALE = [1e-12, 1e-9, 1e-3, 1e-3]
"""What counts as nothing in a rate [rad/s, rad/s², Pa/s, Pa/s]."""


def cases():
    yield from random_states(300, seed=10)
    for k, first in enumerate(EDGE_PRESSURES):
        for second in EDGE_PRESSURES:
            yield [0.05, 0.3 * (k % 3 - 1), first, second], [EDGE_VOLTAGES[k], EDGE_VOLTAGES[-1 - k]]
    yield from ((x, [5.0, 6.0]) for x in one_of_each_subsystem())


def one_of_each_subsystem():
    """At rest under the pressures, and fast: each of 3 x 3 flow regimes sticking and sliding."""
    for first in (150e3, 300e3, 600e3):
        for second in (150e3, 300e3, 600e3):
            angle = paper.rest(T, first, second)
            yield [angle, 0.0, first, second]
            yield [0.5 * angle, math.copysign(3.0, angle), first, second]


def agree(values, expected, scale):
    for value, wanted, nothing in zip(values, expected, scale, strict=True):
        assert value == pytest.approx(wanted, rel=1e-8, abs=nothing)


@pytest.mark.parametrize("locked", [False, True])
def test_derivative(p, p_locked, locked):
    dx = np.zeros(4)
    seen = set()
    for x, u in cases():
        dynamics.derivative(np.array(x), np.array(u), p_locked if locked else p, dx)
        agree(dx, paper.derivative(T, x, u, locked), SCALE)
        seen.add((paper.regime(T, x[2]), paper.regime(T, x[3]), paper.slides(T, x)))
    assert len(seen) == 18, "the states do not cover every subsystem"


@pytest.mark.parametrize("locked", [False, True])
def test_runge_kutta_step(p, p_locked, locked):
    result = np.zeros(4)
    for x, u in cases():
        before = np.array(x)
        integration.rk4_step(before, np.array(u), p_locked if locked else p, 1e-3, result)
        agree(result, paper.runge_kutta(T, x, u, 1e-3, locked), [1e-13, 1e-10, 1e-6, 1e-6])
        assert before.tolist() == x, "the state before the step was changed"


def test_subsystems_are_1_to_18_and_mean_what_they_say(p):
    """σ = 1 + 6 a + 2 b + c: regime of muscle 1, of muscle 2, sliding; all eighteen occur."""
    seen = set()
    for x in one_of_each_subsystem():
        expected = 1 + 6 * paper.regime(T, x[2]) + 2 * paper.regime(T, x[3]) + paper.slides(T, x)
        assert dynamics.subsystem(np.array(x), p) == expected
        seen.add(expected)
    assert seen == set(range(1, 19))


def test_flow_regimes_have_the_bounds_of_the_printed_conditions(p):
    """The conditions at m_in and m_out: P ≤ P_tank b and P_out ≤ P b with b = 0.528."""
    assert pytest.approx(375.1e3, abs=50.0) == CHOKED_BELOW
    assert pytest.approx(191.8e3, abs=50.0) == CHOKED_ABOVE
    for pressure, regime in ((191e3, 0), (192.5e3, 1), (374e3, 1), (376e3, 2)):
        x = np.array([0.0, 0.0, pressure, 150e3])
        assert (dynamics.subsystem(x, p) - 1) // 6 == regime


def test_locked_joint_counts_as_sticking(p_locked):
    x = np.array([0.0, 0.0, 700e3, 200e3])
    assert dynamics.subsystem(x, p_locked) % 2 == 1
