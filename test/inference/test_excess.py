"""How much of what is beyond noise is gone: by levels, which no single event decides, and by squares."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.diagnosis.models import share_of
from pam_antagonist.inference.likelihood import in_decibels, in_mean_squares

NOISE = np.array([0.01, 2.0])
SECOND = 50
"""Blocks."""


@pytest.fixture
def noise():
    """A minute of noise of unit size (B, C)."""
    return np.random.default_rng(1).normal(size=(60 * SECOND, 2))


def level(before: np.ndarray, after: np.ndarray) -> float:
    return share_of([in_decibels(before * NOISE, after * NOISE, NOISE, 50)])


def square(before: np.ndarray, after: np.ndarray) -> float:
    return share_of([in_mean_squares(before * NOISE, after * NOISE, NOISE)])


@pytest.mark.parametrize("share", [level, square])
def test_all_is_gone_at_the_noise_and_nothing_without_a_change(share, noise) -> None:
    assert share(8.0 * noise, noise) == pytest.approx(1.0, abs=0.02)
    assert share(8.0 * noise, 8.0 * noise) == 0.0
    assert share(8.0 * noise, 16.0 * noise) < -0.3
    assert share(noise, noise) == 0.0


@pytest.mark.parametrize("share", [level, square])
def test_where_there_is_nothing_to_judge_by_nothing_is_gone(share, noise) -> None:
    assert share(noise[:0], noise[:0]) == 0.0
    assert share(8.0 * noise[:30], noise[:30]) == pytest.approx(1.0, abs=0.1)


def test_what_was_there_is_told_in_decibels(noise) -> None:
    gone, there = in_decibels(8.0 * noise * NOISE, 4.0 * noise * NOISE, NOISE, 50)
    # 18.1 dB, less the 1.8 dB that noise itself may reach in a second, in 120 seconds of two channels.
    assert there / 120.0 == pytest.approx(16.3, abs=0.2)
    assert gone / 120.0 == pytest.approx(6.02, abs=0.02)


def test_a_law_of_another_form_explains_a_strong_effect_as_well_as_a_weak_one(noise) -> None:
    assert level(1000.0 * noise, 100.0 * noise) == pytest.approx(1.0)
    assert level(1000.0 * noise, 500.0 * noise) == pytest.approx(0.3, abs=0.01)


def test_one_event_decides_by_squares_and_not_by_levels(noise) -> None:
    before, after = 8.0 * noise, noise.copy()
    for residual in (before, after):
        residual[1000 : 1000 + 2 * SECOND] = 200.0 * noise[1000 : 1000 + 2 * SECOND]
    assert square(before, after) < 0.1
    assert level(before, after) > 0.9
    worse = noise.copy()
    worse[: 2 * SECOND] = 1e6
    assert level(8.0 * noise, worse) > 0.85
