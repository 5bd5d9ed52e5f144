"""The report of ``demo``: how the reference was followed, beside the replay of its recording."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist.api.simulate import simulate
from pam_antagonist.control.command import Mode
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import RecordedReference, Recording
from pam_antagonist.replays import replay
from pam_antagonist.report.demo import Demo
from pam_antagonist.rig import Rig, load_rig


@pytest.fixture
def recording(free: Recording) -> Recording:
    """Six seconds with the reference at 0, then at 2°."""
    stamps = free.stamp_ns[[0, 3000]]
    reference = RecordedReference(
        stamps, np.full(2, int(Mode.ANGLE), dtype=np.uint8), np.radians([0.0, 2.0]), *np.full((2, 2), np.nan)
    )
    return dataclasses.replace(free, reference=reference)


def test_the_report_holds_replay_and_control(
    rig: Rig, recording: Recording, tmp_path: Path, golden: Callable[[str, Any], None]
) -> None:
    demo = Demo.of(replay(recording, rig), Mode.ANGLE, 0.02, 7)
    demo.write(tmp_path, figures=False)
    written = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    golden("demo", written)
    assert recording.angle is not None
    error = np.where(np.arange(len(recording.angle)) < 3000, 0.0, 2.0) - np.degrees(recording.angle)
    tracking = written["demo"]["tracking"]
    assert tracking["rmse_deg"] == pytest.approx(float(np.sqrt(np.mean(error**2))))
    assert [step["reference_deg"] for step in tracking["steps"]] == pytest.approx([0.0, 2.0])
    assert written["ukf"]["angle"]["rmse_deg"] == demo.replay.report.ukf.angle.rmse
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>Sensor-less control, live</h1>" in page and "Worst steady-state error" in page
    shown = demo.summary()
    assert shown.startswith("The step did not settle within its time")
    assert "not judged: a stage of it is missing in the recording" in shown
    assert "in the 95 % interval" in shown


def test_a_stiffness_that_was_asked_for_is_judged_by_the_estimate(
    rig: Rig, recording: Recording, tmp_path: Path
) -> None:
    assert recording.reference is not None
    mode = np.full(2, int(Mode.ANGLE_STIFFNESS), dtype=np.uint8)
    stiffness = np.array([6.0, 7.0])
    asked = RecordedReference(
        recording.reference.stamp_ns, mode, recording.reference.value, stiffness, np.full(2, np.nan)
    )
    demo = Demo.of(replay(dataclasses.replace(recording, reference=asked), rig), Mode.ANGLE_STIFFNESS, 0.02, 7, "model")
    demo.write(tmp_path)
    written = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["demo"]["stiffness"]
    assert [step["reference"] for step in written["steps"]] == [6.0, 7.0]
    assert written["rmse"] > 0.0
    assert "Worst steady-state error of the stiffness" in demo.summary()


def test_a_joint_that_yields_is_judged_by_the_spring_and_damper_asked_for(tmp_path: Path) -> None:
    """A recording that does just that, but for the noise of the encoder."""
    rig, count, stiffness, damping = load_rig("shin2022_external_torque"), 3000, 6.0, 0.6
    made = simulate(rig, np.full((count, 2), 5.5), seed=1)
    time = 1e-3 * np.arange(1, count + 1)
    push, since = np.where(time > 1.0, 0.9, 0.0), np.maximum(time - 1.0, 0.0)
    angle = 0.9 / stiffness * (1.0 - np.exp(-since * stiffness / damping)) + 1e-3 * np.sin(50.0 * time)
    asked = RecordedReference(
        made.stamp_ns[[0]], np.array([Mode.IMPEDANCE], np.uint8), *np.array([[0.0], [stiffness], [damping]])
    )
    recording = dataclasses.replace(made, angle=angle, external_torque=push, reference=asked)
    demo = Demo.of(replay(recording, rig), Mode.IMPEDANCE, 0.0, 1, "model")
    demo.write(tmp_path)
    found = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["demo"]
    assert found["yielding"]["rmse_deg"] == pytest.approx(np.degrees(1e-3 / np.sqrt(2.0)), rel=0.05)
    assert found["yielding"]["within"] == 1.0
    assert [step["reference_deg"] for step in found["tracking"]["steps"]] == pytest.approx([0.0, np.degrees(0.15)])
    assert "that of spring and damper" in demo.summary()
    with pytest.raises(BadInput, match="external_torque"):
        Demo.of(replay(dataclasses.replace(recording, external_torque=None), rig), Mode.IMPEDANCE, 0.0, 1)


def test_a_stop_for_safety_is_the_first_line(rig: Rig, recording: Recording, tmp_path: Path) -> None:
    reason = "controller: the estimated angle is +0.574 rad, beyond 0.4538 rad (+32.9 deg; the limit is 26.0 deg)"
    demo = Demo.of(replay(recording, rig), Mode.ANGLE, 0.02, 7, stopped=reason)
    said = f"Stopped for safety by the {reason}"
    assert " ".join(demo.summary().split()).startswith(said)
    demo.write(tmp_path, figures=False)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    first = page.index("<p", page.index("<h1"))
    assert said in page[first : first + 300], "before all else"
    assert "followed steps" not in page
    assert json.loads((tmp_path / "report.json").read_text())["demo"]["stopped_for_safety"] == reason


def test_a_joint_without_commands_is_no_bad_controller(rig: Rig, recording: Recording) -> None:
    held = dataclasses.replace(recording, voltage=np.full_like(recording.voltage, 5.5))
    shown = Demo.of(replay(held, rig), Mode.ANGLE, 0.02, 7).summary()
    assert shown.startswith("The joint had no commands: in 100.0 % of the samples the valves had the safe commands.")


def test_a_computer_that_is_too_slow_is_told_so_in_a_sentence(rig: Rig, recording: Recording) -> None:
    from pam_antagonist.recording import Arrival
    from pam_antagonist.replays.accounting import STAGES

    def summary(missing: int) -> str:
        received = {stage: Arrival(recording.stamp_ns, recording.stamp_ns) for stage in STAGES}
        kept = np.delete(recording.stamp_ns, slice(100, 100 + missing))
        received["valve_command"] = Arrival(kept, kept)
        shown = Demo.of(
            replay(dataclasses.replace(recording, received_ns=received), rig), Mode.ANGLE, 0.02, 7
        ).summary()
        return " ".join(shown.split())

    assert "too slow" not in summary(200)
    said = "This computer is too slow for 1000 samples a second: 10.0 % of them were lost or came late (over 20 ms)"
    assert said in summary(600)


def test_without_a_reference_there_is_nothing_to_judge(rig: Rig, free: Recording) -> None:
    with pytest.raises(BadInput, match="no reference"):
        Demo.of(replay(free, rig), Mode.ANGLE, 0.0, 0)
