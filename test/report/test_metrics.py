"""Figures of merit against values worked out by hand, and against the laws they claim."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from pam_antagonist.estimation import metrics
from pam_antagonist.rig import Reading

NAN = float("nan")


def test_paper_figures_by_hand() -> None:
    # 3-4-0-0: sum of squares 25, four samples.
    error = [3.0, -4.0, 0.0, 0.0]
    assert metrics.rmse(error) == 2.5
    assert metrics.max_error(error) == 4.0
    assert metrics.estimation_ratio(error, [-2.0, 5.0, 6.0, 0.0]) == 0.5


def test_what_was_not_measured_is_left_out() -> None:
    assert metrics.rmse([3.0, NAN, 3.0]) == 3.0
    assert metrics.max_error([NAN, -2.0, math.inf]) == 2.0
    assert metrics.estimation_ratio([1.0, NAN], [0.0, 4.0, NAN]) == 0.25


@pytest.mark.parametrize("empty", [[], [NAN, NAN]])
def test_nothing_gives_nan_and_not_zero(empty: list[float]) -> None:
    assert math.isnan(metrics.rmse(empty))
    assert math.isnan(metrics.max_error(empty))
    assert math.isnan(metrics.estimation_ratio(empty, [0.0, 1.0]))
    assert math.isnan(metrics.coverage(empty, empty, Reading(0.1)))


def test_delay_is_the_shift_that_fits_best() -> None:
    rng = np.random.default_rng(1)
    signal = np.repeat(rng.normal(size=20), 100)
    late = np.concatenate([np.zeros(30), signal[:-30]]) + 0.1 * rng.normal(size=2000)
    assert metrics.delay(signal, late, 1e-3) == pytest.approx(0.030)
    assert metrics.delay(signal, 0.5 * signal, 2e-3) == 0.0
    signal[5::7] = np.nan
    assert metrics.delay(signal, late, 1e-3) == pytest.approx(0.030)
    assert np.isnan(metrics.delay(np.zeros(50), np.ones(50), 1e-3))


def test_interval_counts_the_reference_sensors_noise_in() -> None:
    # A 3-4-5 triangle: the deviations add in squares.
    half = metrics.interval_half_width([9.0], Reading(4.0))
    assert half[0] == pytest.approx(1.959963984540054 * 5.0, rel=1e-12)


def test_coverage_of_an_honest_gaussian_estimate() -> None:
    rng = np.random.default_rng(1)
    variance = rng.uniform(0.5, 4.0, 200_000)
    error = rng.normal(0.0, np.sqrt(variance)) + rng.normal(0.0, 0.7, len(variance))
    assert metrics.coverage(error, variance, Reading(0.7)) == pytest.approx(0.95, abs=0.002)
    assert metrics.coverage(error, variance, Reading(0.7), level=0.5) == pytest.approx(0.5, abs=0.005)
    # Without the sensor's noise the same honest estimate would seem too sure of itself.
    assert metrics.coverage(error, variance) < 0.94


@pytest.mark.parametrize("std", [1e-9, 0.003, 0.1, 0.4, 2.0, 30.0])
def test_interval_with_a_converter_holds_the_share_that_it_claims(std: float) -> None:
    rng = np.random.default_rng(2)
    error = rng.normal(0.0, std, 400_000) + rng.uniform(-0.5, 0.5, 400_000)
    for level in (0.5, 0.95):
        assert metrics.coverage(error, np.full(len(error), std**2), Reading(0.0, 1.0), level) == pytest.approx(
            level, abs=0.002
        )


@pytest.mark.parametrize("dof", [1, 2, 4])
def test_chi_square_bounds_are_those_of_the_law(dof: int) -> None:
    assert metrics.chi_square_bounds(dof) == pytest.approx(stats.chi2.ppf([0.025, 0.975], dof), rel=1e-9)


def _innovations(count: int, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Innovations with covariance S, S itself (twice), and their NIS; `scale` makes the filter's S wrong."""
    rng = np.random.default_rng(3)
    s = np.array([[4.0, 1.5], [1.5, 2.0]])
    innovation = rng.multivariate_normal([0.0, 0.0], s, count)
    claimed = np.broadcast_to(s * scale, (count, 2, 2))
    nis = np.einsum("ki,kij,kj->k", innovation, np.linalg.inv(claimed), innovation)
    return innovation, claimed, nis


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_nis_of_a_filter_that_is_right_too_sure_or_too_cautious(scale: float) -> None:
    innovation, _, nis = _innovations(50_000, scale)
    found = metrics.nis_consistency(nis, innovation)
    assert found.mean == pytest.approx(2.0 / scale, rel=0.015) and found.samples == 50_000
    assert found.in_95 == pytest.approx(0.95, abs=0.005) if scale == 1.0 else found.in_95 < 0.9


def test_nis_where_a_pressure_is_missing_has_its_own_bounds() -> None:
    # 6.0 is beyond the bounds of one pressure (5.02), within those of two (7.38).
    innovation = np.array([[1.0, 1.0], [1.0, NAN], [NAN, NAN]])
    found = metrics.nis_consistency([6.0, 6.0, NAN], innovation)
    assert (found.mean, found.in_95, found.samples) == (6.0, 0.5, 2)


def test_normalised_innovations_are_unit_and_uncorrelated() -> None:
    innovation, covariance, nis = _innovations(50_000)
    innovation[7, 1] = NAN
    unit = metrics.normalised_innovation(innovation, covariance)
    assert np.isnan(unit[7]).all()
    unit, nis = np.delete(unit, 7, axis=0), np.delete(nis, 7)
    assert np.cov(unit.T) == pytest.approx(np.eye(2), abs=0.03)
    assert (unit**2).sum(axis=1) == pytest.approx(nis, rel=1e-9)


def test_autocorrelation_by_hand() -> None:
    gamma = metrics.autocorrelation(np.array([[1.0], [2.0], [NAN], [4.0], [3.0]]), 2)[:, 0, 0]
    # Lag 0: (1 + 4 + 16 + 9) / 4; lag 1: (2*1 + 3*4) / 2 pairs; lag 2: 4*2 alone (the others miss one).
    assert gamma == pytest.approx([7.5, 7.0, 8.0])


def test_whiteness_p_is_uniform_on_white_noise() -> None:
    rng = np.random.default_rng(11)
    mixing = np.array([[1.0, 0.5], [0.0, 2.0]])
    p = [metrics.whiteness_p(rng.normal(size=(600, 2)) @ mixing) for _ in range(300)]
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_whiteness_p_is_tiny_on_coloured_noise_and_on_an_offset() -> None:
    rng = np.random.default_rng(13)
    white = rng.normal(size=(5000, 2))
    coloured = white.copy()
    for k in range(1, len(coloured)):
        coloured[k] += 0.3 * coloured[k - 1]
    assert metrics.whiteness_p(coloured) < 1e-12
    assert metrics.largest_autocorrelation(coloured) == pytest.approx(0.3, abs=0.05)
    assert metrics.whiteness_p(white + 0.2) < 1e-12
    # A dependence of one column on the past of the other is memory too.
    crossed = white.copy()
    crossed[1:, 1] += 0.3 * white[:-1, 0]
    assert metrics.whiteness_p(crossed) < 1e-12


def test_whiteness_of_too_little_is_not_known() -> None:
    assert math.isnan(metrics.whiteness_p(np.random.default_rng(0).normal(size=(99, 2))))
    assert math.isnan(metrics.whiteness_p(np.zeros((500, 2))))
    assert math.isnan(metrics.largest_autocorrelation(np.full((5, 2), NAN)))
