"""Equations (2), (3), (6), (7): geometry, volume, contraction force."""

from __future__ import annotations

import math

import pytest
import transcription as paper
from states import random_states

from pam_antagonist.model import muscle

T = paper.CORRECTED


@pytest.mark.parametrize("i", [1, 2])
def test_length_and_its_rate(p, i):
    for (angle, velocity, *_), _ in random_states(50, seed=1):
        assert muscle.length(i - 1, math.sin(angle), p) == pytest.approx(paper.length(T, i, angle), rel=1e-14)
        rate = muscle.length_rate(i - 1, math.cos(angle), velocity, p)
        assert rate == pytest.approx(paper.length_rate(T, i, angle, velocity), rel=1e-14)


def test_muscle_1_shortens_where_the_angle_grows(p):
    """Muscle 1 pulls towards positive angles: it is the shorter one there."""
    assert muscle.length(0, math.sin(0.3), p) < T["L_0"] < muscle.length(1, math.sin(0.3), p)


@pytest.mark.parametrize("i", [1, 2])
def test_volume_and_its_slope(p, i):
    for (angle, *_), _ in random_states(50, seed=2):
        l_i = paper.length(T, i, angle)
        value, slope = muscle.volume(i - 1, l_i, p)
        # D_1 l^2, D_2 l and D_3 nearly cancel: 1e-3 m3 each, 4e-5 m3 left.
        assert value == pytest.approx(paper.volume(T, l_i), rel=1e-12)
        assert slope == pytest.approx(paper.volume_rate(T, l_i, 1.0), rel=1e-12)


def test_volume_stays_positive_where_the_parabola_does_not(p):
    """Sigma points may fall far outside the joint's range; a negative volume would turn the flow round."""
    assert paper.volume(T, 0.30) < 0.0
    assert muscle.volume(0, 0.30, p)[0] > 0.0


@pytest.mark.parametrize("i", [1, 2])
def test_force(p, i):
    for (angle, _, pressure, _), _ in random_states(50, seed=3):
        l_i = paper.length(T, i, angle)
        assert muscle.force(i - 1, l_i, pressure, p) == pytest.approx(
            paper.force(T, i, l_i, pressure), rel=1e-12, abs=1e-11
        )


@pytest.mark.parametrize("i", [1, 2])
def test_force_slope_with_length(p, i):
    """F is linear in l: the slope is a difference quotient over any distance."""
    for pressure in (150e3, 450e3, 700e3):
        quotient = (paper.force(T, i, 0.170, pressure) - paper.force(T, i, 0.160, pressure)) / 0.010
        assert muscle.force_length_slope(i - 1, 0.165, pressure, p) == pytest.approx(quotient, rel=1e-10)
