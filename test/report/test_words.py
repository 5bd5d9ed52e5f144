"""The sentences follow the numbers."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from pam_antagonist.report import replay_tables, words

NAN = float("nan")


@pytest.fixture
def report() -> dict[str, Any]:
    """An entry of report.json with round numbers."""
    return {
        "recording": {"name": "lab/first", "issues": []},
        "joint": {"condition": "free", "lock_angle_rad": None, "told_from": "measured angle"},
        "ukf": {
            "angle": {"rmse_deg": 0.5, "max_deg": 2.0, "q": 0.05, "coverage95": 0.97},
            "torque": {"rmse_nm": 0.1, "max_nm": 0.4, "q": 0.1, "coverage95": 0.95},
            "pressure": {"rmse_pa": [500.0, 600.0], "max_pa": [1000.0, 1000.0], "q": [0.1, 0.1]},
        },
        "model_alone": {
            "angle": {"rmse_deg": 1.0, "max_deg": 4.0, "q": 0.1},
            "torque": {"rmse_nm": 0.1, "max_nm": 0.4, "q": 0.1},
            "pressure": {"rmse_pa": [5000.0, 600.0], "max_pa": [1000.0, 1000.0], "q": [0.1, 0.1]},
        },
        "innovation": {"nis_mean": 2.0, "nis_in_95": 0.95, "whiteness_p": 0.3, "largest_correlation": 0.01},
        "estimator": {"counts": {"outliers": 0, "gaps": 0, "repaired": 0, "restarts": 0}},
        "live_equal": None,
        "live_without": None,
    }


def said(report: dict[str, Any], status: str) -> str:
    return " ".join(item.text for item in words.findings(report) if item.status == status)


def test_verdict(report: dict[str, Any]) -> None:
    known = "the angle is known to 0.50° and the torque to 0.10 N m (root mean square error)."
    assert words.verdict(report) == f"From the two pressures alone, {known}"


def test_a_locked_joints_angle_is_no_achievement(report: dict[str, Any]) -> None:
    report["joint"] = {"condition": "locked", "lock_angle_rad": 0.1, "told_from": "measured angle"}
    assert "the torque is known to 0.10 N m" in words.verdict(report)
    assert "The joint was locked at 5.7°" in words.verdict(report)
    assert "Angle: the filter" not in said(report, "good")
    assert [tile.label for tile in replay_tables.tiles(report)] == ["Torque error (RMS)", "Torque in the 95 % interval"]


def test_of_several_recordings_the_worst_is_named(report: dict[str, Any]) -> None:
    worse = copy.deepcopy(report)
    worse["recording"]["name"] = "lab/second"
    worse["ukf"]["angle"]["rmse_deg"] = 0.8
    text = words.overall_verdict([report, worse])
    assert "the angle is known to 0.80° (lab/second) and the torque to 0.10 N m (lab/first)" in text
    assert "the worst of 2 recordings" in text


@pytest.mark.parametrize(
    ("model", "status", "text"),
    [(1.0, "good", "2.0 × as much"), (0.51, "note", "changes little"), (0.25, "warn", "does not help")],
)
def test_filter_and_model(report: dict[str, Any], model: float, status: str, text: str) -> None:
    report["model_alone"]["angle"]["rmse_deg"] = model
    (finding,) = [item for item in words.findings(report) if item.text.startswith("Angle")]
    assert finding.status == status
    assert text in finding.text


def test_honesty(report: dict[str, Any]) -> None:
    assert "97.0 % of the measured angles and 95.0 % of the measured torques" in said(report, "good")
    report["ukf"]["torque"]["coverage95"] = 0.87
    assert "too sure of itself" in said(report, "warn")


@pytest.mark.parametrize(("mean", "status"), [(2.0, "good"), (0.1, "note"), (9.0, "warn")])
def test_surprise(report: dict[str, Any], mean: float, status: str) -> None:
    report["innovation"]["nis_mean"] = mean
    assert "surprise the filter" in said(report, status)


@pytest.mark.parametrize(
    ("p", "correlation", "text"),
    [
        (0.2, 0.01, "is white noise (p = 0.20)"),
        (0.0, -0.05, "nearly white: its memory is certain (p < 0.001) but faint"),
        (0.0, 0.4, "the model lacks something slow"),
        (0.0, -0.4, "follows the sensors too eagerly"),
    ],
)
def test_memory_that_is_certain_is_not_called_large(
    report: dict[str, Any], p: float, correlation: float, text: str
) -> None:
    report["innovation"].update(whiteness_p=p, largest_correlation=correlation)
    assert text in said(report, "good") + said(report, "note")


def test_what_is_not_known_is_not_said(report: dict[str, Any]) -> None:
    report["innovation"].update(nis_mean=NAN, whiteness_p=NAN, largest_correlation=NAN)
    text = " ".join(item.text for item in words.findings(report))
    assert "surprise" not in text
    assert "nan" not in text


def test_equality_with_the_live_estimate(report: dict[str, Any]) -> None:
    live = {"compared": 9, "equal": 9, "only_live": 0, "only_replay": 0, "first_difference_ns": None, "differing": {}}
    report["live_equal"], report["live_without"] = live, 0
    assert "bit for bit, in all 9 samples" in said(report, "good")
    report["live_equal"] = {**live, "equal": 7, "differing": {"torque": 2}}
    assert "in 7 of 9 samples (fields that differ: torque" in said(report, "warn")
    report["live_equal"] = {**live, "compared": 0, "equal": 0, "only_live": 4}
    assert "no sample in common" in said(report, "warn")
    report["live_without"] = 12
    assert "went without part of 12 samples" in said(report, "warn")


def test_remarks_on_the_recording(report: dict[str, Any]) -> None:
    report["recording"]["issues"] = ["37 samples without pressure_2"] + [f"remark {k}" for k in range(8)]
    report["estimator"]["counts"].update(outliers=3, gaps=1)
    assert "37 samples without pressure_2." in said(report, "warn")
    assert "3 more such remarks" in said(report, "warn")
    assert "3 samples with a pressure beyond the gate, which was left out and 1 gaps predicted over" in said(
        report, "note"
    )


def test_table_marks_the_better_one_only_where_it_can_be_seen(report: dict[str, Any]) -> None:
    table = replay_tables.errors_table(report)
    best = {row[0].strip(): columns for row, columns in zip(table.rows, table.best, strict=True)}
    assert best["RMSE 𝕀 [°]"] == {1}
    assert best["RMSE 𝕀 [N m]"] == set()
    report["model_alone"]["angle"]["q"] = NAN
    assert ("  𝕄 over measured range, ℚ", "5.0 %", "–") in replay_tables.errors_table(report).rows


def test_overview_has_a_row_for_each_recording(report: dict[str, Any]) -> None:
    silent = copy.deepcopy(report)
    silent["ukf"]["angle"] = silent["ukf"]["torque"] = None
    rows = replay_tables.overview([report, silent]).rows
    assert rows[0] == ("lab/first", "free", "0.500", "1.00", "97.0 %", "0.100", "0.100", "95.0 %")
    assert rows[1][2:] == ("–",) * 6
