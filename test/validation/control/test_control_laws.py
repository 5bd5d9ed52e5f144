"""``control_laws``: what it measures, on few joints, and what it refuses."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.rig import load_rig
from validation.control import trials
from validation.control.command import main

RIG = load_rig("shin2022")


def test_settling_and_overshoot_are_those_of_a_known_course() -> None:
    time = np.arange(5000) * 1e-3
    true = 1.0 - np.exp(-time / 0.5)
    settling, overshoot = trials.settling(true, 1.0, 1.0, 1e-3)
    assert settling == pytest.approx(0.5 * math.log(20.0), abs=2e-3) and overshoot == 0.0
    assert trials.settling(-1.2 * np.ones(10), -1.0, -1.0, 1e-3) == (math.inf, pytest.approx(0.2))


def test_angle_and_stiffness_of_one_joint_are_near_what_was_asked_for() -> None:
    """The median over many joints is the command's figure; one joint's own errors are a little larger."""
    found = trials.grid(RIG, 3)
    assert np.median([pair["angle_error_deg"] for pair in found]) < 1.0
    assert np.median([pair["estimate_error_deg"] for pair in found]) < 0.5
    assert np.median([pair["stiffness_error"] for pair in found]) < 0.05


def test_the_command_measures_limits_and_writes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "limits.json"
    arguments = ["--only", "limits", "--seeds", "1", "--references", "60", "--jobs", "1", "--json", str(file)]
    assert main(arguments) == 0
    assert "pressure beyond its limit" in capsys.readouterr().out
    (found,) = json.loads(file.read_text())["limits"]
    assert found["with"]["references"] == 60 and found["with"]["beyond"]["pressure"] == 0.0
    assert max(found["without"]["beyond"].values()) > 0.0
