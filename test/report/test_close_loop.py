"""The report of ``close_loop``: typed numbers of a diagnosis, and what they say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pam_antagonist.diagnosis.errors import Errors, ModelErrors, RigErrors, Sliding
from pam_antagonist.diagnosis.hypotheses import TriedCandidate
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.diagnosis.remaining import RemainingResidual, SumOfTerms, Surroundings
from pam_antagonist.diagnosis.residual_statistics import Relation, ResidualRow
from pam_antagonist.diagnosis.result import Ambiguity, FoundEffect, PartVerdict, RecordingEntry, Size
from pam_antagonist.diagnosis.rig_choice import RigChoice
from pam_antagonist.estimation.metrics import ChannelErrors
from pam_antagonist.report.close_loop import DiagnoseResult, errors_table, ranking_table, sizes_table
from pam_antagonist.report.close_loop_findings import findings, left
from pam_antagonist.report.document import Findings, Section, Table
from pam_antagonist.report.terminal import render
from pam_antagonist.rig import Rig
from pam_antagonist.strict_json import plain


def errors(angle: float | None, torque: float, sliding: Sliding | None = None) -> Errors:
    """Errors of a model."""
    return Errors(
        None if angle is None else ChannelErrors("deg", angle, 2.0 * angle, 0.1),
        ChannelErrors("nm", torque, 2.0 * torque, 0.2),
        (1000.0, 2000.0),
        sliding=sliding,
    )


def keys(angle: float, torque: float, **more: float) -> dict[str, Any]:
    """The same in ``report.json``."""
    return {
        "angle": {"rmse_deg": angle, "max_deg": 2.0 * angle, "q": 0.1},
        "torque": {"rmse_nm": torque, "max_nm": 2.0 * torque, "q": 0.2, **more},
        "pressure": {"rmse_pa": [1000.0, 2000.0]},
    }


MODELS = ModelErrors(errors(0.4, 0.3), errors(0.2, 0.2), errors(0.1, 0.1))
ROW = ResidualRow(
    "mass_flow_1", "equation", "mg/s", 2.0, 1.0, 0.75, 0.1, 100.0, 0.5, {"angle": Relation(0.2, 0.4, 4.0, 2.0, 0.01)}
)
RECORDING = RecordingEntry(
    "lab/free", "free", None, "both", 40.0, MODELS, {"recalibrated": (ROW,), "extended": (ROW,)}, sha256="0" * 64
)


@pytest.fixture
def found(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> DiagnoseResult:
    """A leak that nothing else could be."""
    monkeypatch.setattr(DiagnoseResult, "choice", RigChoice((), None, ""))
    return DiagnoseResult(
        verdict="effect",
        sentence="Air leaks.",
        effects=(FoundEffect("leak", 1, {"area_1": Size(1e-9, 1e-11, "m2")}, 180.0, 0.9, ("lab/free",)),),
        calibrations=(),
        ambiguous_with=(),
        experiment={},
        ambiguities=(),
        ranking=(),
        share=0.9,
        parts=(PartVerdict("joint", "effect", 0.9),),
        errors=MODELS,
        of_one_rig={},
        by_recording=(RECORDING,),
        reference=None,
        remaining=(),
        unseen=(),
        warnings=(),
        profiles=(),
        rig_recalibrated=rig,
        rig_extended=rig,
        own=(),
        base_friction_removed=False,
        recalibrated=Model((), ()),
        extended=Model((), ()),
        compared=(),
        seconds={},
        notes=(),
        held=(),
        decided=None,
        start=rig,
        hashes=("a" * 64,),
        seed=0,
        kept=1.0 / 3.0,
    )


def test_residuals_of_two_diagnoses_are_compared_whatever_their_order(found: DiagnoseResult) -> None:
    filtered = replace(ROW, channel="pressure_1", kind="innovation", rms=3.0)
    of_both = {"recalibrated": (filtered, replace(ROW, rms=5.0)), "extended": (ROW, filtered)}
    lacking = {"recalibrated": (replace(ROW, rms=5.0),), "extended": (ROW, filtered)}
    rows, files = [], {name: RigErrors(getattr(MODELS, name)) for name in ("as_configured", "recalibrated", "extended")}
    for residuals in (of_both, lacking):
        shown = replace(found, of_one_rig=files, by_recording=(replace(RECORDING, residuals=residuals),))
        blocks = shown.document(figures=False).blocks
        section = next(one for one in blocks if isinstance(one, Section) and one.title == "Statistics of the residuals")
        table = next(block for block in section.blocks if isinstance(block, Table))
        rows.append({row[0].split(",")[0].strip(): row[1:3] for row in table.rows})
    assert rows[0]["mass flow 1"] == rows[1]["mass flow 1"] == ("5.0", "2.0")
    assert (rows[0]["pressure 1"], rows[1]["pressure 1"]) == (("3.0", "3.0"), ("–", "3.0"))


def said(found: DiagnoseResult, status: str) -> str:
    return " ".join(item.text for item in findings(found) if item.status == status)


def test_the_best_model_is_marked_and_what_was_not_measured_is_said(found: DiagnoseResult) -> None:
    table = errors_table(found)
    best = dict(zip((row[0].strip() for row in table.rows), table.marked, strict=True))
    assert best["angle RMSE [°]"] == {3} and best["pressure 1 RMSE [kPa]"] == set()
    blind = ModelErrors(*(replace(values, angle=None) for values in MODELS.all))
    assert ("  angle", "not measured", "–", "–") in errors_table(replace(found, errors=blind)).rows


def test_a_driven_joint_shows_where_it_slides(found: DiagnoseResult) -> None:
    sizes = {"as_configured": 0.04, "recalibrated": 0.4, "extended": 0.09}
    sliding = ModelErrors(*(errors(0.1, 0.2, Sliding(size, 0.3, 0.4)) for size in sizes.values()))
    entry = replace(RECORDING, joint="driven", errors=sliding, sweeps={"fitted": 3, "held_out": 1})
    driven = replace(found, errors=sliding, by_recording=(entry,))
    assert plain(driven.errors) == {
        name: keys(0.1, 0.2, rmse_sliding_nm=size, rmse_sticking_nm=0.3, sliding_share=0.4)
        for name, size in sizes.items()
    }
    assert plain(entry)["sweeps"] == {"fitted": 3, "held_out": 1}
    assert "torque while it slides, RMSE [N m]" in [row[0].strip() for row in errors_table(driven).rows]
    assert "the rig as configured has the smaller error (0.040 N m, extended 0.090 N m)" in said(driven, "note")
    assert "the smaller error" not in said(found, "note")


def test_a_clear_effect_is_good_and_an_ambiguous_one_a_warning(found: DiagnoseResult) -> None:
    assert "No other candidate" in said(found, "good")
    rival = Ambiguity(
        "leak", "thermal", 0.3, (0.055, 0.049), "kPa", 60.0, "in the mean of the pressures", ambiguous=True
    )
    unclear = replace(found, ambiguous_with=("thermal",), experiment={"thermal": "record again"}, ambiguities=(rival,))
    warning = said(unclear, "warn")
    assert warning.startswith("Thermal would explain the data as well as leak: ")
    assert "leak leaves 0.055 kPa, thermal 0.049 kPa (RMS; evidence 0.3)" in warning
    assert warning.endswith("To distinguish them: record again.")
    assert "No other candidate" not in said(unclear, "good")
    refuted = replace(found, ambiguities=(replace(rival, ambiguous=False, evidence=20.0),))
    assert "Thermal explains the data less well than leak: " in said(refuted, "good")


def test_a_part_that_is_not_explained_is_a_warning(found: DiagnoseResult) -> None:
    parts = (PartVerdict("pressures", "unexplained", 0.0), PartVerdict("torque", "effect", 0.9))
    assert "The residual of the pressures is above noise" in said(replace(found, parts=parts), "warn")


def test_what_is_left_is_a_table_of_all_recordings_without_shares_that_are_nothing() -> None:
    around = Surroundings(np.zeros((5, 2)), None, np.arange(5.0))
    form = SumOfTerms((), 0.0, float("nan"))
    one, other = (
        RemainingResidual(name, "torque", "N m", 3.0, {"pressure": share}, {"below 0.1 Hz": 1.0}, 2.0, form,
                          np.zeros(5), around)
        for name, share in (("lab/free", 0.4), ("lab/locked", 0.001))
    )  # fmt: skip
    said, depends, power = left([one, other], with_figures=False)
    assert isinstance(said, Findings) and isinstance(depends, Table) and isinstance(power, Table)
    assert depends.rows == (("lab/free: torque", "40.0 %"), ("lab/locked: torque", "0.1 %"))
    assert [block for block in left([other], with_figures=False) if isinstance(block, Table)] == [
        Table(power.header, (("lab/locked: torque", "100.0 %"),), power.caption)
    ]


def test_names_of_parameters_and_of_the_evidence_have_their_meaning_beside_them(found: DiagnoseResult) -> None:
    creep = FoundEffect("creep", 1, {"share_1": Size(0.05, 0.01, "-")}, 20.0, 0.5, ("lab/free",))
    law = FoundEffect("learned", None, {"at 100 kPa": Size(0.05, 0.01, "N m")}, 20.0, 0.5, ("lab/free",))
    rows = sizes_table((creep, law)).rows
    assert rows[0] == ("creep, muscle 1: share_1 [-]", "0.0500", "0.010",
                       "share of a change of force that comes late of muscle 1")  # fmt: skip
    assert rows[1][-1] == "value of the law"
    candidate = TriedCandidate("leak", 1, 9.0, 20.0, 20.0, (0.5, 0.5))
    shown = render((ranking_table(replace(found, ranking=(candidate,))),))
    assert "Evidence: twice the gain in log-likelihood" in shown and "Held-out share" in shown


def test_names_of_recordings_keep_their_first_letter(found: DiagnoseResult) -> None:
    shown = findings(replace(found, warnings=("lab/free: too short", "the noise is large")))
    assert [item.text for item in shown if item.status == "warn"] == ["lab/free: too short.", "The noise is large."]
