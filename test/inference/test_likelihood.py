"""Likelihood, correlation length, the linear problem, and how much of what is beyond noise is gone."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.diagnosis.models import share_of
from pam_antagonist.inference.likelihood import (
    BLOCKS_PER_ERROR,
    LinearProblem,
    Scale,
    correlation_length,
    in_decibels,
    in_mean_squares,
)


def test_white_residuals_are_worth_their_number() -> None:
    lengths = [correlation_length(np.random.default_rng(seed).standard_normal(2000)) for seed in range(8)]
    assert np.mean(lengths) == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("memory", [0.5, 0.9])
def test_correlated_residuals_are_worth_less(memory: float) -> None:
    """A first-order process has (1 + φ)/(1 − φ) samples per independent value."""
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(20000)
    series = np.zeros(20000)
    for k in range(1, 20000):
        series[k] = memory * series[k - 1] + noise[k]
    assert correlation_length(series) == pytest.approx((1 + memory) / (1 - memory), rel=0.2)


def test_an_offset_is_no_independent_evidence() -> None:
    assert correlation_length(np.ones(500)) == pytest.approx(50.0)


def test_noise_bounds_the_variance() -> None:
    scale = Scale(np.array([2.0]), np.array([1.0]))
    quiet, loud = np.full((100, 1), 0.1), np.full((100, 1), 6.0)
    assert scale.variances(quiet)[0] == 4.0
    assert scale.variances(loud)[0] == 36.0
    assert scale.misfits(loud)[0] > scale.misfits(quiet)[0]


def test_a_channel_at_its_noise_counts_as_white() -> None:
    drift = np.linspace(-0.5, 0.5, 1000)[:, None]
    assert Scale.of(drift, np.array([1.0])).length[0] == 1.0
    assert Scale.of(drift, np.array([0.01])).length[0] > BLOCKS_PER_ERROR


def _problem(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    base, effect = rng.standard_normal((4000, 2, 3)), rng.standard_normal((4000, 2, 2))
    # A residual falls by what its unknowns explain.
    residual = -(base @ np.array([0.3, -0.2, 0.1]) + effect @ np.array([1.5, -0.7]))
    return residual + 0.01 * rng.standard_normal(residual.shape), base, effect


def test_solve_recovers_what_is_there() -> None:
    residual, base, effect = _problem(np.random.default_rng(1))
    scale = Scale.of(residual, np.array([0.01, 0.01]))
    step = LinearProblem.of(residual, base, effect).solved(scale, np.full(3, 1e-3), np.zeros(3))
    np.testing.assert_allclose(step.theta, [0.3, -0.2, 0.1], atol=2e-3)
    np.testing.assert_allclose(step.effect, [1.5, -0.7], atol=2e-3)
    assert np.sqrt(np.mean(step.residual**2)) == pytest.approx(0.01, rel=0.05)


def test_what_has_no_influence_stays() -> None:
    residual, base, effect = _problem(np.random.default_rng(2))
    effect[:, :, 1] = 0.0
    scale = Scale.of(residual, np.array([0.01, 0.01]))
    step = LinearProblem.of(residual, base, effect).solved(scale, np.full(3, 1e-3), np.zeros(3))
    assert step.effect[1] == 0.0
    assert np.all(np.isfinite(step.covariance))


def test_what_is_held_stays() -> None:
    residual, base, effect = _problem(np.random.default_rng(2))
    scale = Scale.of(residual, np.array([0.01, 0.01]))
    assert (
        LinearProblem.of(residual, base, effect).solved(scale, np.full(3, 1e-3), np.zeros(3), held=[0]).effect[0] == 0.0
    )


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
