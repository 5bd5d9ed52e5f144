"""Tracking error and steady-state performance against numbers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.control.tracking import held, tracking

PERIOD = 1_000_000


def stamps(seconds: float) -> np.ndarray:
    return np.arange(round(seconds * 1000), dtype=np.int64) * PERIOD + 10**18


def test_performance_is_the_paper_s_example() -> None:
    """A worst steady-state error of 2.1° with references of ±20°: 94.75 %."""
    time = stamps(20.0)
    reference = np.where(np.arange(len(time)) < 10_000, 20.0, -20.0)
    measured = reference - np.where(np.arange(len(time)) < 10_000, 1.0, -2.1)
    result = tracking(time, reference, measured)
    assert result.range == 40.0
    assert result.worst_steady_error == pytest.approx(2.1)
    assert result.performance == pytest.approx(0.9475)
    assert [step.reference for step in result.steps] == [20.0, -20.0]
    assert [step.steady_error for step in result.steps] == pytest.approx([1.0, 2.1])


def test_transients_count_for_the_rmse_but_not_as_steady() -> None:
    time = stamps(5.0)
    reference = np.full(len(time), 10.0)
    measured = reference.copy()
    measured[:3900] = 0.0  # 3.9 of 5 s: the last fifth starts at 4 s
    result = tracking(time, reference, measured)
    assert result.worst_steady_error == 0.0
    assert result.largest == 10.0
    assert result.rmse == pytest.approx(10.0 * math.sqrt(0.78))
    assert math.isnan(result.performance)  # one reference has no range
    measured[4100] = 7.0
    assert tracking(time, reference, measured).worst_steady_error == 3.0


def test_a_step_has_settled_from_when_the_error_stays_small() -> None:
    time = stamps(9.0)
    reference = np.repeat([0.0, 10.0, 0.0], 3000)
    measured = reference.copy()
    measured[3000:4000] = 0.0
    measured[4500] = 10.6  # out of the band of 5 % of 10 once more, 1.5 s after the step
    measured[6000:] = 1.0  # never within the band again
    _, up, down = tracking(time, reference, measured).steps
    assert up.settling_s == pytest.approx(1.501)
    assert math.isnan(down.settling_s)


def test_short_steps_have_no_steady_part() -> None:
    time = stamps(4.0)
    reference = np.where(np.arange(len(time)) % 2000 < 1000, 5.0, -5.0)
    result = tracking(time, reference, np.zeros(len(time)))
    assert len(result.steps) == 4
    assert math.isnan(result.worst_steady_error) and math.isnan(result.performance)


def test_what_is_missing_is_left_out() -> None:
    time = stamps(6.0)
    reference = np.full(len(time), 1.0)
    reference[:1000] = np.nan
    measured = np.full(len(time), 0.5)
    measured[-10:] = np.nan
    result = tracking(time, reference, measured)
    assert result.rmse == pytest.approx(0.5)
    assert result.steps[0].length_s == pytest.approx(4.989)
    with pytest.raises(ValueError, match="no sample"):
        tracking(time, np.full(len(time), np.nan), measured)


def test_reference_is_held_until_the_next() -> None:
    time = np.array([0, 1, 2, 3, 4], dtype=np.int64)
    out = held(time, np.array([1, 3, 3]), np.array([5.0, 6.0, 7.0]))
    assert np.isnan(out[0])
    assert list(out[1:]) == [5.0, 5.0, 7.0, 7.0]
    assert np.isnan(held(time, np.array([], dtype=np.int64), np.array([]))).all()
