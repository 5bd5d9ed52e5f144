"""The sentences follow the numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pam_antagonist.estimation import Counts
from pam_antagonist.estimation.metrics import (
    ChannelErrors,
    FilterErrors,
    ModelAloneErrors,
    PressureErrors,
    channel_errors,
)
from pam_antagonist.replays.live import LiveComparison
from pam_antagonist.replays.result import FilterFacts, Innovation, JointFacts, RecordingFacts, ReplayReport, Timing
from pam_antagonist.report.replay import errors_table, findings, tiles, verdict

NAN = float("nan")
ANGLE, TORQUE = ChannelErrors("deg", 0.5, 2.0, 0.05, 0.97), ChannelErrors("nm", 0.1, 0.4, 0.1, 0.95)
WORSE, SAME = ChannelErrors("deg", 1.0, 4.0, 0.1), ChannelErrors("nm", 0.1, 0.4, 0.1)


@pytest.fixture
def report() -> ReplayReport:
    """A report with round numbers."""
    return ReplayReport(
        samples=1000,
        duration_s=1.0,
        realtime_factor=10.0,
        ukf=FilterErrors(ANGLE, TORQUE, PressureErrors((500.0, 600.0), (1000.0, 1000.0), (0.1, 0.1)), None),
        model_alone=ModelAloneErrors(WORSE, SAME, PressureErrors((5000.0, 600.0), (1000.0, 1000.0), (0.1, 0.1))),
        innovation=Innovation(2.0, 0.95, 0.3, 0.01, 1000),
        recording=RecordingFacts("lab/first", "0" * 64, {}, 0, (), {}),
        joint=JointFacts("free", None, "measured angle"),
        estimator=FilterFacts((0,), Counts(1000, 0, 0, 0, 0, 0, 0, 0, 0)),
        live_equal=None,
        live_without=None,
        timing=Timing(0.0, 0.1, 0.0, 0.1),
    )


def changed(report: ReplayReport, part: str, **values: Any) -> ReplayReport:
    """The report with other values in one of its parts."""
    return replace(report, **{part: replace(getattr(report, part), **values)})


def said(report: ReplayReport, status: str) -> str:
    """All that is said with this status, or one of several."""
    return " ".join(item.text for item in findings(report) if item.status in status.split())


def test_verdict(report: ReplayReport) -> None:
    known = "the estimator gives the angle to within 0.50° and the torque to within 0.10 N m (root mean square error)."
    assert verdict([report]) == f"From the two pressures alone, {known}"


def test_an_interval_ten_times_the_error_is_called_wide(report: ReplayReport) -> None:
    def with_angle(coverage: float, width: float) -> ReplayReport:
        return changed(report, "ukf", angle=replace(ANGLE, coverage95=coverage, width=width))

    wide = with_angle(1.0, 10.0 * 1.96)
    assert "larger than needed" in said(wide, "note") and "that of the angle 10 times" in said(wide, "note")
    assert "honest" not in said(wide, "good")
    for right in (with_angle(0.96, 1.96), with_angle(1.0, 2.5)):  # 2.5: a constant error that stays inside
        assert "honest" in said(right, "good") and "larger than needed" not in said(right, "note")


def test_a_locked_joints_angle_is_no_achievement(report: ReplayReport) -> None:
    locked = replace(report, joint=JointFacts("locked", 0.1, "measured angle"))
    assert "the torque to within 0.10 N m" in verdict([locked])
    assert "The joint was locked at 5.7°" in verdict([locked])
    assert "Angle: the filter" not in said(locked, "good")
    assert [tile.label for tile in tiles(locked)] == ["Torque error (RMS)", "Torque in the 95 % interval"]


def covered(coverage: float, independent: float) -> ChannelErrors:
    return replace(TORQUE, coverage95=coverage, independent=independent)


@pytest.mark.parametrize(
    ("part", "values", "status", "text"),
    [
        ("model_alone", {"angle": replace(WORSE, rmse=1.0)}, "good", "2.0 × as much"),
        ("model_alone", {"angle": replace(WORSE, rmse=0.51)}, "note", "changes little"),
        ("model_alone", {"angle": replace(WORSE, rmse=0.25)}, "warn", "does not help"),
        ("ukf", {}, "good", "97.0 % of the measured angles and 95.0 % of the measured torques"),
        ("ukf", {"torque": replace(TORQUE, coverage95=0.87)}, "warn", "covariance is too small for the torque:"),
        ("ukf", {"external_torque": covered(0.88, 400.0)}, "warn", "covariance is too small for the external torque"),
        ("ukf", {"external_torque": covered(0.67, 40.0)}, "warn", "67.0 % of the measured external torques"),
        ("ukf", {"external_torque": covered(0.88, 12.0)}, "note", "Too few independent errors to judge"),
        ("ukf", {"external_torque": covered(0.93, 4000.0)}, "good", "covariance is honest"),
        ("innovation", {"nis_mean": 2.0}, "good", "as large as the filter expects"),
        ("innovation", {"nis_mean": 0.1}, "note", "smaller than the filter expects"),
        ("innovation", {"nis_mean": 9.0}, "warn", "larger than the filter expects"),
        ("innovation", {"whiteness_p": 0.2, "largest_correlation": 0.01}, "good note", "are white noise (p = 0.20)"),
        ("innovation", {"whiteness_p": 0.0, "largest_correlation": -0.05}, "good note",
         "nearly white: their autocorrelation is significant (p < 0.001) but small"),
        ("innovation", {"whiteness_p": 0.0, "largest_correlation": 0.4}, "good note", "the model lacks a slow effect"),
        ("innovation", {"whiteness_p": 0.0, "largest_correlation": -0.4}, "good note",
         "follows the sensors' noise too closely"),
    ],
)  # fmt: skip
def test_each_number_has_its_sentence(
    report: ReplayReport, part: str, values: dict[str, Any], status: str, text: str
) -> None:
    assert text in said(changed(report, part, **values), status)


def test_values_in_an_interval_count_once_for_as_long_as_they_stay_there() -> None:
    """An error that leaves its interval every ten seconds for two is no thousand independent ones."""
    time = np.arange(0.0, 100.0, 0.01)
    error = np.where(time % 10.0 < 2.0, 3.0, 0.1)
    found = channel_errors(np.zeros_like(error), error, "nm", np.ones_like(error))
    assert found is not None and found.coverage95 == pytest.approx(0.8, abs=0.01)
    assert found.independent is not None and found.independent < 100.0
    white = channel_errors(np.zeros_like(error), np.random.default_rng(1).standard_normal(len(error)), "nm",
                           np.ones_like(error))  # fmt: skip
    assert white is not None and white.independent is not None and white.independent > 0.8 * len(error)


def test_equality_with_the_live_estimate(report: ReplayReport) -> None:
    live = LiveComparison(9, 9, 0, 0, None, {})
    report = replace(report, live_equal=live, live_without=0)
    assert "bit for bit, in all 9 samples" in said(report, "good")

    def differs(**values: Any) -> str:
        return said(replace(report, live_equal=replace(live, **values)), "warn")

    assert "in 7 of 9 samples (fields that differ: torque" in differs(equal=7, differing={"torque": 2})
    assert "no sample in common" in differs(compared=0, equal=0, only_live=4)
    assert "missed part of 12 samples" in said(replace(report, live_without=12), "warn")


def test_no_symbol_of_the_paper_stands_in_a_table(report: ReplayReport) -> None:
    assert not set("𝕀𝕄ℚ") & set("".join(cell for row in errors_table(report).rows for cell in row))


def test_table_marks_the_better_one_only_where_it_can_be_seen(report: ReplayReport) -> None:
    table = errors_table(report)
    best = {row[0].strip(): columns for row, columns in zip(table.rows, table.best, strict=True)}
    assert best["RMSE [°]"] == {1}
    assert best["RMSE [N m]"] == set()
    report = changed(report, "model_alone", angle=replace(WORSE, ratio=NAN))
    assert ("  largest error over measured range", "5.0 %", "–") in errors_table(report).rows


def test_a_model_that_diverged_has_no_error_that_is_a_number(report: ReplayReport) -> None:
    measured, value = np.linspace(0.0, 1.0, 9), np.array([*np.linspace(0.0, 1.0, 8), np.inf])
    lost = channel_errors(measured, value, "deg")
    assert lost is not None and lost.rmse == lost.largest == np.inf
    value[-1] = np.nan  # as where a delay reaches beyond the recording: no value, and no error either
    apart = channel_errors(measured, value, "deg")
    assert apart is not None and np.isfinite([apart.rmse, apart.largest]).all()
    assert channel_errors(measured, np.full(9, np.nan), "deg") is None
    now = changed(report, "model_alone", angle=lost)
    assert "The model alone diverges: this rig file does not describe the joint." in said(now, "warn")
    assert "×" not in said(now, "warn")
    assert tiles(now)[0].note == "model alone diverges"


def test_an_error_that_is_the_same_at_each_sample_is_a_zero(report: ReplayReport) -> None:
    off = replace(ANGLE, rmse=10.0, coverage95=0.0, mean=-9.99)
    now = changed(report, "ukf", angle=off)
    assert "The encoder seems to read 10.0° too high. To correct that, type --encoder-zero 9.99." in said(now, "warn")
    assert "covariance is too small" not in said(now, "warn") and "honest" in said(now, "good")
    varies = changed(report, "ukf", angle=replace(off, mean=-5.0))
    assert "covariance is too small" in said(varies, "warn") and "zero" not in said(varies, "warn")


def test_a_filter_is_not_judged_by_a_few_samples(report: ReplayReport) -> None:
    short = replace(report, samples=3, duration_s=0.002)
    assert said(short, "warn") == "0.002 s is too short to judge the filter by; expected 1 s or more."
    assert not said(short, "good") and said(report, "good")


def test_remarks_on_the_recording(report: ReplayReport) -> None:
    issues = ("37 samples without pressure_2", *(f"remark {k}" for k in range(8)))
    report = changed(report, "recording", issues=issues)
    report = changed(report, "estimator", counts=replace(report.estimator.counts, outliers=3, gaps=1))
    assert "37 samples without pressure_2." in said(report, "warn")
    assert "3 more such remarks" in said(report, "warn")
    met = "3 samples with a pressure outside the gate, which it left out and 1 gaps, which it bridged by prediction"
    assert met in said(report, "note")
