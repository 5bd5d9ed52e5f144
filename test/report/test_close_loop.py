"""The report of ``close_loop``: typed numbers of a diagnosis, and what they say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from pam_antagonist.diagnosis.result import Ambiguity
from pam_antagonist.report.close_loop import CloseLoopReport, Effect, Part, RecordingEntry, Settings, Size
from pam_antagonist.report.close_loop_document import errors_table, summary
from pam_antagonist.report.close_loop_errors import ModelErrors
from pam_antagonist.report.close_loop_findings import findings
from pam_antagonist.report.document import Findings
from pam_antagonist.strict_json import plain


def errors(angle: float | None, torque: float, **more: float) -> dict[str, Any]:
    """Errors of a model as a diagnosis has them."""
    return {
        "angle": None if angle is None else {"rmse_deg": angle, "max_deg": 2.0 * angle, "q": 0.1},
        "torque": {"rmse_nm": torque, "max_nm": 2.0 * torque, "q": 0.2, **more},
        "pressure": {"rmse_pa": [1000.0, 2000.0]},
    }


MODELS = {"as_configured": errors(0.4, 0.3), "recalibrated": errors(0.2, 0.2), "extended": errors(0.1, 0.1)}
ROW = {
    "channel": "mass_flow_1", "kind": "equation", "unit": "mg/s", "rms": 2.0, "noise": 1.0, "above_noise": 0.75,
    "memory_s": 0.1, "independent": 100.0, "whiteness_p": 0.5,
    "relations": {"angle": {"lag_s": 0.2, "correlation": 0.4, "z": 4.0, "limit": 2.0, "p": 0.01}},
}  # fmt: skip
RECORDING = {
    "recording": "lab/free", "joint": "free", "lock_angle_rad": None, "role": "both", "held_out_from_s": 40.0,
    "errors": MODELS, "residuals": {"recalibrated": [ROW], "extended": [ROW]},
}  # fmt: skip


@pytest.fixture
def report() -> CloseLoopReport:
    """A leak that nothing else could be."""
    return CloseLoopReport(
        verdict="effect",
        sentence="Air leaks.",
        effects=(Effect("leak", 1, {"area_1": Size(1e-9, 1e-11, "m2")}, 180.0, 0.9, ("lab/free",)),),
        ambiguous_with=(),
        experiments={},
        ambiguities=(),
        share_explained=0.9,
        parts=(Part("joint", "effect", 0.9),),
        reference=None,
        base_friction_removed=False,
        errors=ModelErrors.of(MODELS),
        recordings=(RecordingEntry.of(RECORDING, "0" * 64),),
        ranking=(),
        profiles=(),
        remaining=(),
        left=(),
        unseen=(),
        warnings=(),
        settings=Settings("rig", "a paper", 0, 1.0 / 3.0, 6.0, 0.05, 0.12, 0.4),
        timing={},
        software={},
    )


def said(report: CloseLoopReport, status: str) -> str:
    return " ".join(item.text for item in findings(report) if item.status == status)


def test_a_diagnosis_keeps_its_keys(report: CloseLoopReport) -> None:
    written = plain(report)
    assert written["errors"] == MODELS
    assert written["recordings"] == [{**RECORDING, "sha256": "0" * 64}]
    assert written["effects"][0]["parameters"] == {"area_1": {"value": 1e-9, "std": 1e-11, "unit": "m2"}}


def test_a_recording_that_was_fitted_to_its_end_has_no_errors() -> None:
    entry = {**RECORDING, "role": "fitted", "held_out_from_s": None, "errors": None}
    del entry["residuals"]
    assert plain(RecordingEntry.of(entry, "1" * 64)) == {**entry, "sha256": "1" * 64}


def test_the_best_model_is_marked_and_what_was_not_measured_is_said(report: CloseLoopReport) -> None:
    table = errors_table(report)
    best = dict(zip((row[0].strip() for row in table.rows), table.marked, strict=True))
    assert best["angle RMSE [°]"] == {3} and best["pressure 1 RMSE [kPa]"] == set()
    blind = {name: {**values, "angle": None} for name, values in MODELS.items()}
    assert ("  angle", "not measured", "–", "–") in errors_table(replace(report, errors=ModelErrors.of(blind))).rows


def test_a_driven_joint_shows_where_it_slides(report: CloseLoopReport) -> None:
    sliding = {
        name: errors(0.1, 0.2, rmse_sliding_nm=size, rmse_sticking_nm=0.3, sliding_share=0.4)
        for name, size in (("as_configured", 0.04), ("recalibrated", 0.4), ("extended", 0.09))
    }
    entry = {**RECORDING, "joint": "driven", "errors": sliding, "sweeps": {"fitted": 3, "held_out": 1}}
    driven = replace(report, errors=ModelErrors.of(sliding), recordings=(RecordingEntry.of(entry, "0" * 64),))
    assert plain(driven.errors) == sliding
    assert "torque while it slides, RMSE [N m]" in [row[0].strip() for row in errors_table(driven).rows]
    assert "the rig as configured has the smaller error (0.040 N m, extended 0.090 N m)" in said(driven, "note")
    assert "the smaller error" not in said(report, "note")


def test_a_clear_effect_is_good_and_an_ambiguous_one_a_warning(report: CloseLoopReport) -> None:
    assert "No other candidate" in said(report, "good")
    rival = Ambiguity(
        "leak", "thermal", 0.3, (0.055, 0.049), "kPa", 60.0, "in the mean of the pressures", ambiguous=True
    )
    unclear = replace(
        report, ambiguous_with=("thermal",), experiments={"thermal": "record again"}, ambiguities=(rival,)
    )
    warning = said(unclear, "warn")
    assert warning.startswith("Thermal would explain the data as well as leak.")
    assert "leak leaves 0.055 and thermal 0.049 kPa (ΔBIC 0.3)" in warning
    assert warning.endswith("To distinguish them: record again.")
    assert "No other candidate" not in said(unclear, "good")
    refuted = replace(report, ambiguities=(replace(rival, ambiguous=False, evidence=20.0),))
    assert "Thermal explains the data less well than leak." in said(refuted, "good")


def test_a_part_that_is_not_explained_is_a_warning(report: CloseLoopReport) -> None:
    parts = (Part("pressures", "unexplained", 0.0), Part("torque", "effect", 0.9))
    assert "The residual of the pressures is above noise" in said(replace(report, parts=parts), "warn")


def test_names_of_recordings_keep_their_first_letter(report: CloseLoopReport) -> None:
    shown = summary(replace(report, warnings=("lab/free: too short", "the noise is large")))
    (warnings,) = [block for block in shown if isinstance(block, Findings)]
    assert [item.text for item in warnings.items] == ["lab/free: too short.", "The noise is large."]
