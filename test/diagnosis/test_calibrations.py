"""Recordings whose only fault is a calibration, and recordings with a fault of the joint beside one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist.diagnosis import diagnose
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.report import close_loop, terminal
from pam_antagonist.report.close_loop_document import summary


def misread(recording: Recording, **wrong: float) -> Recording:
    """A recording as sensors and clocks would have made it that need these corrections."""
    undone = {name: 1.0 / value if name == "torque_scale" else -value for name, value in wrong.items()}
    if "torque_zero" in wrong:
        undone["torque_zero"] /= wrong.get("torque_scale", 1.0)
    return Corrections(**undone).applied(recording)


@pytest.fixture(scope="module")
def late(rig, recorded):
    recording = misread(recorded("none", joint="locked", seconds=24.0), delay_voltage=0.03)
    return diagnose([recording], rig, joint="locked", jobs=1, profiles=False)


def test_late_stamps_are_a_calibration_and_no_effect(late) -> None:
    assert (late.verdict, late.effects) == ("none", ())
    (found,) = late.calibrations
    assert found.name == "delay_voltage"
    assert found.value == pytest.approx(0.03, abs=1.5e-3)
    assert 1e-4 < found.std < 1.5e-3
    assert late.warnings == ()


def test_a_report_says_the_calibration_and_what_to_type(late, rig) -> None:
    report = close_loop.report(late, rig, ["-"], 0, 1 / 3, Corrections(delay_voltage=0.01, gauge=True))
    (entry,) = report.calibration
    assert (entry.name, entry.unit) == ("delay_voltage", "s")
    gauge, delay = report.corrections
    assert gauge == "--gauge"
    # What was typed already counts.
    assert float(delay.removeprefix("--delay-voltage ")) == pytest.approx(40.0, abs=1.5)
    shown = " ".join(terminal.render(summary(report)).split())
    assert "the voltages are stamped" in shown and "ms too early" in shown
    assert delay in shown


def test_errors_are_those_of_the_calibrated_recording(late) -> None:
    configured, recalibrated = late.errors.as_configured, late.errors.recalibrated
    assert late.errors.extended == recalibrated
    assert recalibrated.rmse_pa[0] < 0.7 * configured.rmse_pa[0]
    (entry,) = late.by_recording
    assert all(np.isfinite(row.rms) for row in entry.residuals["recalibrated"])
    assert entry.ukf.recalibrated.torque.rmse < entry.ukf.as_configured.torque.rmse


def test_the_zero_of_an_encoder_is_no_effect(rig, recorded) -> None:
    recording = misread(recorded("none", joint="free", seconds=30.0, seed=12), encoder_zero=np.radians(1.0))
    found = diagnose([recording], rig, jobs=1, profiles=False, estimator=False)
    assert found.verdict == "none"
    assert [item.name for item in found.calibrations] == ["encoder_zero"]
    assert np.degrees(found.calibrations[0].value) == pytest.approx(1.0, abs=0.1)
    assert "the encoder reads" in found.sentence


def test_an_effect_and_a_calibration_beside_it_are_both_named(rig, recorded) -> None:
    recording = misread(recorded("leak", 1, "seeping", 15.0), delay_voltage=0.03)
    found = diagnose([replace(recording)], rig, joint="locked", jobs=1, profiles=False, estimator=False)
    assert found.verdict == "effect"
    assert [effect.name for effect in found.effects] == ["leak"]
    assert [item.name for item in found.calibrations] == ["delay_voltage"]
    assert found.calibrations[0].value == pytest.approx(0.03, abs=2e-3)
