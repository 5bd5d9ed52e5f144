"""Whether the joint could move, from what the recording holds."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import load_rig, simulate
from pam_antagonist.cli import check
from pam_antagonist.cli import replay as replay_command
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.recording import RecordedEstimate, Recording, write_bag
from pam_antagonist.recording.joint import JointCondition, joint_condition, with_stops
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import write_rig


def _estimate(rig: Rig, recording: Recording, joint: str, angle: float = 0.0) -> RecordedEstimate:
    run = Estimator(rig, joint=joint, lock_angle=angle).run(recording.stamp_ns, recording.pressure, recording.voltage)
    return RecordedEstimate.from_rows(run.stamp_ns, run.started_ns, run.rows)


def test_a_joint_that_moves_is_free(free: Recording) -> None:
    assert joint_condition(free) == JointCondition("free", 0.0, "measured angle")


def test_a_joint_that_stays_while_the_pressures_change_is_locked(locked: Recording) -> None:
    # The encoder's noise alone spans a quarter of a degree.
    assert locked.angle is not None and math.degrees(np.ptp(locked.angle)) > 0.2
    assert joint_condition(locked) == JointCondition("locked", 0.0, "measured angle")


def test_the_lock_angle_is_measured_without_the_encoders_noise(locked: Recording) -> None:
    assert locked.angle is not None
    tilted = replace(locked, angle=locked.angle + math.radians(7.31))
    assert joint_condition(tilted).lock_angle == math.radians(7.3)


def test_a_wrong_sample_moves_no_joint(locked: Recording) -> None:
    assert locked.angle is not None
    angle = locked.angle.copy()
    angle[100] = 0.5
    assert joint_condition(replace(locked, angle=angle)).condition == "locked"


def test_a_joint_that_was_not_driven_tells_nothing(locked: Recording) -> None:
    quiet = replace(locked, pressure=np.full_like(locked.pressure, 450e3))
    assert joint_condition(quiet) == JointCondition("free", 0.0, "nothing")
    assert joint_condition(replace(locked, angle=None)).source == "nothing"


def test_without_a_measured_angle_the_live_filter_tells(rig: Rig, free: Recording, locked: Recording) -> None:
    held = replace(locked, angle=None, estimate=_estimate(rig, locked, "locked", 0.1))
    assert joint_condition(held) == JointCondition("locked", 0.1, "recorded estimate")
    moving = replace(free, angle=None, estimate=_estimate(rig, free, "free"))
    assert joint_condition(moving) == JointCondition("free", 0.0, "recorded estimate")


def test_the_live_filters_own_lock_angle_is_taken_to_the_last_bit(rig: Rig, locked: Recording) -> None:
    angle = 0.1234567890123
    assert locked.angle is not None
    tilted = replace(locked, angle=locked.angle + angle, estimate=_estimate(rig, locked, "locked", angle))
    assert joint_condition(tilted) == JointCondition("locked", angle, "measured angle")


def test_the_command_line_has_the_last_word(free: Recording) -> None:
    assert joint_condition(free, "locked", 0.05) == JointCondition("locked", 0.05, "command line")
    assert joint_condition(free, "free").source == "command line"


def test_contradictions_are_refused(free: Recording) -> None:
    with pytest.raises(BadInput, match="expected free, locked or auto"):
        joint_condition(free, "loose")
    with pytest.raises(BadInput, match="lock angle"):
        joint_condition(free, "auto", 0.1)


STOP = math.radians(20.0)


def test_a_joint_that_rests_at_its_stop_is_free(locked: Recording) -> None:
    assert locked.angle is not None
    for angle, condition in ((19.5, "free"), (-20.2, "free"), (24.0, "free"), (15.0, "locked"), (40.0, "locked")):
        there = replace(locked, angle=locked.angle + math.radians(angle))
        found = joint_condition(there, stop=STOP)
        assert found.condition == condition, angle
        assert found.source == ("stop" if condition == "free" else "measured angle")
        assert joint_condition(there).condition == "locked"
        assert joint_condition(there, "locked", stop=STOP).condition == "locked"


def test_where_the_other_recordings_rest_and_never_pass_is_a_stop(free: Recording, locked: Recording) -> None:
    assert free.angle is not None and locked.angle is not None
    end = float(np.quantile(free.angle, 0.5))
    stopped = replace(free, angle=np.minimum(free.angle, end))
    there = replace(locked, angle=locked.angle + end, torque=None)
    inside = replace(locked, torque=None)
    clamped = replace(locked, angle=locked.angle + end)
    every = [stopped, there, inside, clamped]
    found = with_stops(every, [joint_condition(one) for one in every])
    assert [state.condition for state in found] == ["free", "free", "locked", "locked"]
    assert found[1].source == "stop"


def test_a_trial_that_rests_at_the_stop_is_checked_and_replayed(tmp_path: Path) -> None:
    rig = load_rig("shin2022").with_value("joint.stop", 0.26)
    voltage, later = np.full((5000, 2), (10.0, 2.0)), np.arange(2000)
    voltage[3000:, 0] = 7.0 + 1.5 * np.sign(np.sin(2.0 * np.pi * later / 2000.0))
    voltage = np.vstack([voltage, voltage[3000:], voltage[3000:]])
    trial = simulate(rig, voltage, seed=1).slice(3.0, 9.0)
    write_bag(tmp_path / "trial", trial)
    write_rig(rig, tmp_path / "rig.yaml", [])
    words = [str(tmp_path / "trial"), "--rig", str(tmp_path / "rig.yaml")]
    assert check.main(words) == 0
    assert replay_command.main([*words, "--out", str(tmp_path / "out"), "--no-figures"]) == 0
    found = json.loads((tmp_path / "out" / "report.json").read_text())
    assert found["joint"]["condition"] == "free" and found["joint"]["source"] == "stop"
    assert found["ukf"]["angle"]["coverage95"] > 0.85
