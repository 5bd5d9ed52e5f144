"""One rig for all recordings: what they say together."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.diagnosis.agreement import combined

PRIOR = np.array([1e4, 400.0])  # precisions: 1 % and 5 %


def posterior(precision: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value and covariance of one recording: a measurement of that precision, and the prior."""
    covariance = np.linalg.inv(precision + np.diag(PRIOR))
    return covariance @ precision @ value, covariance


def test_recordings_that_agree_are_not_pulled_back_to_the_rig_file() -> None:
    sure = np.diag([1e8, 1e8])
    found, covariance = posterior(sure, np.array([0.034, -0.12]))
    assert combined([found, found], [covariance, covariance], PRIOR) == pytest.approx([0.034, -0.12], rel=1e-3)


def test_a_recording_that_does_not_see_a_number_has_no_say_in_it() -> None:
    sees, blind = (posterior(np.diag([1e6, known]), np.array([0.01, 0.1])) for known in (1e7, 1e-3))
    both = combined(*zip(sees, blind, strict=True), PRIOR)
    assert both[1] == pytest.approx(sees[0][1], rel=0.01)


def test_a_number_that_follows_others_says_nothing_of_how_far_recordings_scatter() -> None:
    sure, covariance = posterior(np.diag([1e6, 1e7]), np.array([0.01, 0.1]))
    turned = np.array([[1e7, 2e4], [2e4, 45.0]])
    follows, wide = posterior(turned, np.array([0.011, -0.2]))
    both = combined([sure, follows], [covariance, wide], PRIOR)
    assert both[1] == pytest.approx(0.1, rel=0.05)


def test_the_prior_counts_once_where_recordings_say_little() -> None:
    weak = np.array([[3e4, 1e3], [1e3, 600.0]])
    value = np.array([0.01, 0.1])
    found, covariance = posterior(weak, value)
    exact = np.linalg.solve(2.0 * weak + np.diag(PRIOR), 2.0 * weak @ value)
    assert combined([found, found], [covariance, covariance], PRIOR) == pytest.approx(exact)


def test_recordings_that_differ_by_more_than_their_errors_count_alike() -> None:
    rough, fine = (
        posterior(np.diag([1e8, known]), np.array([0.0, there])) for known, there in ((1e6, 0.0), (1e9, 0.1))
    )
    assert combined(*zip(rough, fine, strict=True), PRIOR)[1] == pytest.approx(0.05, abs=0.025)
    assert combined(*zip(fine, rough, strict=True), PRIOR)[1] == pytest.approx(
        combined(*zip(rough, fine, strict=True), PRIOR)[1]
    )
