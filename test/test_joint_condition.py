"""Whether the joint could move, from what the recording holds."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.recording import RecordedEstimate, Recording
from pam_antagonist.recording.joint import JointCondition, joint_condition
from pam_antagonist.rig import Rig

Changed = Callable[..., Recording]


def _estimate(rig: Rig, recording: Recording, joint: str, angle: float = 0.0) -> RecordedEstimate:
    run = Estimator(rig, joint=joint, lock_angle=angle).run(recording.stamp_ns, recording.pressure, recording.voltage)
    return RecordedEstimate.from_rows(run.stamp_ns, run.started_ns, run.rows)


def test_a_joint_that_moves_is_free(free: Recording) -> None:
    assert joint_condition(free) == JointCondition("free", 0.0, "measured angle")


def test_a_joint_that_stays_while_the_pressures_change_is_locked(locked: Recording) -> None:
    # The encoder's noise alone spans a quarter of a degree.
    assert locked.angle is not None and math.degrees(np.ptp(locked.angle)) > 0.2
    assert joint_condition(locked) == JointCondition("locked", 0.0, "measured angle")


def test_the_lock_angle_is_measured_without_the_encoders_noise(locked: Recording, changed: Changed) -> None:
    assert locked.angle is not None
    tilted = changed(locked, angle=locked.angle + math.radians(7.31))
    assert joint_condition(tilted).lock_angle == math.radians(7.3)


def test_a_wrong_sample_moves_no_joint(locked: Recording, changed: Changed) -> None:
    assert locked.angle is not None
    angle = locked.angle.copy()
    angle[100] = 0.5
    assert joint_condition(changed(locked, angle=angle)).condition == "locked"


def test_a_joint_that_was_not_driven_tells_nothing(locked: Recording, changed: Changed) -> None:
    quiet = changed(locked, pressure=np.full_like(locked.pressure, 450e3))
    assert joint_condition(quiet) == JointCondition("free", 0.0, "nothing")
    assert joint_condition(changed(locked, angle=None)).source == "nothing"


def test_without_a_measured_angle_the_live_filter_tells(
    rig: Rig, free: Recording, locked: Recording, changed: Changed
) -> None:
    held = changed(locked, angle=None, estimate=_estimate(rig, locked, "locked", 0.1))
    assert joint_condition(held) == JointCondition("locked", 0.1, "recorded estimate")
    moving = changed(free, angle=None, estimate=_estimate(rig, free, "free"))
    assert joint_condition(moving) == JointCondition("free", 0.0, "recorded estimate")


def test_the_live_filters_own_lock_angle_is_taken_to_the_last_bit(
    rig: Rig, locked: Recording, changed: Changed
) -> None:
    angle = 0.1234567890123
    assert locked.angle is not None
    tilted = changed(locked, angle=locked.angle + angle, estimate=_estimate(rig, locked, "locked", angle))
    assert joint_condition(tilted) == JointCondition("locked", angle, "measured angle")


def test_the_command_line_has_the_last_word(free: Recording) -> None:
    assert joint_condition(free, "locked", 0.05) == JointCondition("locked", 0.05, "command line")
    assert joint_condition(free, "free").source == "command line"


def test_contradictions_are_refused(free: Recording) -> None:
    with pytest.raises(BadInput, match="expected free, locked or auto"):
        joint_condition(free, "loose")
    with pytest.raises(BadInput, match="lock angle"):
        joint_condition(free, "auto", 0.1)


def test_a_condition_cannot_be_changed(free: Recording) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        joint_condition(free).condition = "locked"  # type: ignore[misc]
