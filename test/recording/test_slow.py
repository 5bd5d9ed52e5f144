"""A sensor that is slower than the log is told from a coarse converter and from a pressure at rest."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.recording.rows import reading_times, repeated

RNG = np.random.default_rng(4)
MOVING = 3e5 + np.cumsum(RNG.normal(0.0, 2e3, (600, 2)), axis=0)


def held(every: int) -> np.ndarray:
    return MOVING[(np.arange(600) // every) * every]


@pytest.mark.parametrize("every", [2, 3, 4])
def test_rows_between_the_readings_of_a_slow_sensor_are_found(every: int) -> None:
    assert np.array_equal(repeated(held(every), 0.02), np.arange(600) % every > 0)


def test_a_coarse_converter_is_not_slow() -> None:
    assert not repeated(np.round(MOVING / 4e3) * 4e3, 0.02).any()


def test_a_pressure_at_rest_is_measured() -> None:
    resting = held(2)
    resting[200:500] = resting[200]
    found = repeated(resting, 0.02)
    assert found[1:200:2].all()
    assert not found[210:495].any()
    assert not repeated(np.full((600, 2), 3e5), 0.02).any()


def test_at_a_kilohertz_repeats_are_steps_of_a_converter() -> None:
    assert not repeated(held(2), 0.001).any()


def logged(taken: np.ndarray, period: float) -> np.ndarray:
    """Times of the rows of a log, with some jitter, that show these readings first."""
    return np.ceil(taken / period) * period + RNG.uniform(0.0, 2e-4, len(taken))


def test_readings_get_their_own_times_back_but_for_a_constant() -> None:
    taken = 0.0303 * np.arange(1500) + 0.004
    shown = logged(taken, 0.02)
    assert np.std(shown - taken) > 5e-3
    assert np.std(reading_times(shown, 0.02) - taken) < 3e-4


def test_a_sensor_without_a_period_keeps_the_times_of_the_log() -> None:
    shown = logged(np.cumsum(RNG.uniform(0.02, 0.045, 1500)), 0.02)
    assert np.array_equal(reading_times(shown, 0.02), shown)
    assert np.array_equal(reading_times(shown[:20], 0.02), shown[:20])
