"""Recordings whose only fault is a calibration, and recordings with a fault of the joint beside one."""

from __future__ import annotations

import re
from dataclasses import fields, replace

import numpy as np
import pytest

from pam_antagonist import load_rig, simulate
from pam_antagonist.api.diagnose import DiagnoseResult
from pam_antagonist.diagnosis import Diagnosis, calibrations, diagnose
from pam_antagonist.diagnosis.calibrations import CalibrationHypothesis
from pam_antagonist.diagnosis.errors import RigErrors, errors_of
from pam_antagonist.diagnosis.hypotheses import Ranking, Work
from pam_antagonist.diagnosis.models import Model, recalibrated
from pam_antagonist.diagnosis.search import hypotheses, search
from pam_antagonist.diagnosis.sentences import change_in_words
from pam_antagonist.estimation.divergence import DIVERGED
from pam_antagonist.inference import calibration
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import make_trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.report.close_loop_findings import calibration_findings
from pam_antagonist.rig import Rig


def misread(recording: Recording, **wrong: float) -> Recording:
    """A recording as sensors and clocks would have made it that need these corrections."""
    undone = {name: 1.0 / value if name == "torque_scale" else -value for name, value in wrong.items()}
    if "torque_zero" in wrong:
        undone["torque_zero"] /= wrong.get("torque_scale", 1.0)
    return Corrections(**undone).applied(recording)


def result_of(found: Diagnosis, rig: Rig, typed: Corrections) -> DiagnoseResult:
    values = {item.name: getattr(found, item.name) for item in fields(Diagnosis)}
    return DiagnoseResult(**values, start=rig, hashes=("-",), seed=0, kept=1 / 3, typed=typed)


@pytest.fixture(scope="module")
def late(rig, recorded):
    recording = misread(recorded("none", joint="locked", seconds=22.0), delay_voltage=0.03)
    return diagnose([recording], rig, joint="locked", jobs=1, profiles=False)


def test_late_stamps_are_a_calibration_and_no_effect(late) -> None:
    assert (late.verdict, late.effects) == ("none", ())
    (found,) = late.calibrations
    assert found.name == "delay_voltage"
    assert found.value == pytest.approx(0.03, abs=1.5e-3)
    assert 1e-4 < found.std < 1.5e-3
    assert late.warnings == ()


def test_rows_that_a_delay_does_not_reach_are_in_no_error() -> None:
    """One of 20,000 simulated angles, the last, once made all errors infinite."""
    time = 1e-3 * np.arange(2000)
    exact = np.column_stack([np.sin(time), np.cos(time), 3e5 + 1e4 * time, 4e5 - 1e4 * time])
    shown = calibration.readings(exact, 1e-3, {"delay_angle": 0.02, "delay_pressure": -0.05})
    assert np.isnan(shown[-20:, 0]).all() and np.isnan(shown[:50, 2:]).all()
    found = errors_of(exact, shown, (0, 1))
    assert found.angle is not None and found.torque is not None and found.mean_rmse_pa is not None
    assert 0.0 < found.angle.rmse < np.degrees(0.02) and found.torque.rmse == 0.0
    assert found.rmse_pa == pytest.approx((500.0, 500.0)) and found.mean_rmse_pa == pytest.approx(0.0, abs=1e-6)


def test_an_infinite_error_is_no_number_in_a_sentence() -> None:
    exact = np.ones((100, 4))
    lost = errors_of(exact, np.where(np.arange(100)[:, None] > 90, DIVERGED, exact), (0, 1))
    now = errors_of(exact, 1.1 * exact, (0, 1))
    assert lost.angle is not None and lost.angle.rmse == lost.mean_rmse_pa == max(lost.rmse_pa) == np.inf
    before, after = RigErrors(lost), RigErrors(now)
    said = [before.in_words(after), *after.larger(before, 1.0), change_in_words(lost, now), change_in_words(now, lost)]
    assert len(said) == 6 and all("a model that diverges" in text for text in said)
    assert not re.search(r"\binf|\bnan|without bound|–", " ".join(said))
    assert max(before.deciding(after)) < 1e-6 and not before.larger(after, 1.0)


def test_a_report_says_the_calibration_and_what_to_type(late, rig) -> None:
    report = result_of(late, rig, Corrections(delay_voltage=0.01, gauge=True))
    (entry,) = report.to_json()["calibration"]
    assert (entry["name"], entry["unit"]) == ("delay_voltage", "s")
    gauge, delay = report.corrections
    assert gauge == "--gauge"
    # What was typed already counts.
    assert float(delay.removeprefix("--delay-voltage ")) == pytest.approx(40.0, abs=1.5)
    shown = " ".join(report.summary().split())
    assert "the voltages are stamped" in shown and "ms too early" in shown
    assert delay in shown


def test_the_extended_rig_corrects_its_recordings(late, rig, tmp_path) -> None:
    result = result_of(late, rig, Corrections(delay_voltage=0.01, encoder_zero=0.2, gauge=True))
    extended = load_rig(result.save(tmp_path / "found", figures=False) / "rig_extended.yaml")
    # What was typed already counts; what it says of bags is no number of the rig.
    assert extended.calibration.delay_voltage == pytest.approx(0.04, abs=1.5e-3)
    assert (extended.calibration.encoder_zero, extended.calibration.torque_scale) == (0.2, 1.0)


def test_errors_are_those_of_the_calibrated_recording(late) -> None:
    configured, recalibrated = late.errors.as_configured, late.errors.recalibrated
    assert late.errors.extended == recalibrated
    assert recalibrated.rmse_pa[0] < 0.7 * configured.rmse_pa[0]
    (entry,) = late.by_recording
    assert all(np.isfinite(row.rms) for row in entry.residuals["recalibrated"])
    assert entry.ukf.recalibrated.torque.rmse < entry.ukf.as_configured.torque.rmse


def test_a_calibration_is_said_in_the_unit_that_is_typed() -> None:
    zero = calibrations.FoundCalibration("encoder_zero", np.radians(0.312), np.radians(0.021), "rad", 30.0, {})
    assert zero.in_words() == "the encoder reads 0.31 ± 0.02° too high"
    scale = calibrations.FoundCalibration("torque_scale", -0.03, 0.0012, "-", 30.0, {})
    assert scale.in_words() == "the torque meter reads 3.00 ± 0.12 % too little"
    late = calibrations.FoundCalibration("delay_angle", -0.03, 0.002, "s", 30.0, {})
    assert late.in_words() == "the angle is stamped 30 ± 2 ms too late"


def test_recordings_that_differ_in_a_calibration_are_told() -> None:
    apart = {"free": (0.30, 0.01), "locked": (0.20, 0.01)}
    found = calibrations.FoundCalibration("torque_zero", 0.25, 0.05, "N m", 30.0, apart)
    (text,) = calibrations.differences([found])
    assert "free: the torque meter reads 0.300 ± 0.010 N m too high" in text and "locked" in text
    assert not found.is_shared and "none is offered" in text
    shared = replace(found, by_recording={**apart, "locked": (0.29, 0.01)})
    assert shared.is_shared and calibrations.differences([shared]) == []


def test_a_calibration_that_recordings_do_not_share_is_not_offered_to_type(late, rig, tmp_path) -> None:
    apart = {"free": (0.030, 1e-3), "locked": (0.010, 1e-3)}
    (found,) = late.calibrations
    result = result_of(replace(late, calibrations=(replace(found, by_recording=apart),)), rig, Corrections())
    assert result.corrections == () and calibration_findings(result) == ()
    (entry,) = result.to_json()["calibration"]
    assert entry["shared"] is False and set(entry["recordings"]) == {"free", "locked"}
    extended = load_rig(result.save(tmp_path / "found", figures=False) / "rig_extended.yaml")
    assert extended.calibration.delay_voltage == 0.0


@pytest.fixture(scope="module")
def meter(rig) -> Ranking:
    """A torque meter that shows half of the torque in one of two recordings, which was never in a fit before."""
    slow = rig.replaced(sample_period=4e-3)
    made = [simulate(slow, duration=20.0, joint="locked", seed=seed, mismatch=0.0) for seed in (3, 4)]
    trials = [make_trial(one, slow, "locked", 0.0, name) for one, name in
              ((misread(made[0], torque_scale=0.5), "half"), (made[1], "whole"))]  # fmt: skip
    return search(
        recalibrated([ValveDriven(slow, one, 3325) for one in trials]), Work(), (CalibrationHypothesis(),), most=1
    )


def test_a_scale_that_one_recording_shows_and_another_rules_out_is_no_calibration(meter: Ranking) -> None:
    assert calibrations.calibrations_of(meter.model) == () and calibrations.found(meter) == ()
    (text,) = calibrations.differences((), meter)
    assert re.search(r"half: the torque meter reads 50.* % too little; whole: the torque meter reads 0.* %", text)


@pytest.mark.parametrize(("zero", "names"), [(0.0, ()), (0.3, ("encoder_zero",))])
def test_a_zero_to_which_the_base_parameters_have_bent_is_found(rig, zero, names) -> None:
    """At 250 Hz a zero of 0.3° hides: the recalibrated model is at the noise of every sensor all the same."""
    exact = simulate(rig.replaced(sample_period=4e-3), duration=40.0, seed=3, mismatch=0.01)
    trial = make_trial(misread(exact, encoder_zero=np.radians(zero)), rig, "free", 0.0, "free")
    experiments = (ValveDriven(rig, trial, len(trial) * 2 // 3 // 25 * 25),)
    base = recalibrated(experiments)
    assert base.is_at_noise
    chosen = search(base, Work(), hypotheses())
    assert calibrations.calibrations_of(chosen.model) == names
    if names:
        (found,) = calibrations.found(chosen)
        assert np.degrees(found.value) == pytest.approx(zero, abs=0.06)
        assert abs(np.degrees(found.value) - zero) < 2.0 * np.degrees(found.std) < 0.2
        # Beside what else is found, it may turn out to be nothing.
        (fitted,) = chosen.model.fits
        nothing = Point(fitted.point.theta, {"calibration.encoder_zero": 1e-5})
        assert calibrations.found(chosen, Model(experiments, (replace(fitted, point=nothing),))) == ()


@pytest.mark.slow(5)
@pytest.mark.parametrize(
    "wrong",
    [pytest.param({"encoder_zero": np.radians(2.0)}, marks=pytest.mark.thorough(8)), {"delay_pressure": 0.05}],
)
def test_a_calibration_is_found_however_large_it_is(rig, recorded, wrong) -> None:
    """Base parameters bend so far to it that a fit from there does not come back; pressures begin in motion."""
    trial = make_trial(
        misread(recorded("none", joint="free", seconds=30.0, seed=2408002887), **wrong), rig, "free", 0.0, "free"
    )
    experiments = (ValveDriven(rig, trial, len(trial) * 2 // 3 // 100 * 100),)
    base = recalibrated(experiments)
    assert not base.is_at_noise
    chosen = search(base, Work(), hypotheses(), most=1)
    assert chosen.model.is_at_noise
    (found,) = calibrations.found(chosen)
    assert {found.name: found.value} == {name: pytest.approx(value, rel=0.06) for name, value in wrong.items()}


@pytest.mark.slow(5)
def test_an_effect_and_a_calibration_beside_it_are_both_named(rig, recorded) -> None:
    recording = misread(recorded("leak", 1, "seeping", 15.0, seconds=22.0), delay_voltage=0.03)
    found = diagnose([recording], rig, joint="locked", jobs=1, profiles=False, estimator=False)
    assert found.verdict == "effect"
    assert [effect.name for effect in found.effects] == ["leak"]
    assert [item.name for item in found.calibrations] == ["delay_voltage"]
    assert found.calibrations[0].value == pytest.approx(0.03, abs=2e-3)
