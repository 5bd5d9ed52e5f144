"""``excite`` on a live simulated joint: a plan is driven and recorded, and ends at rest where a limit is reached."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.cli import excite
from pam_antagonist.cli.driving import PLAN_NOTE, Owner, drive
from pam_antagonist.design import Limits, designed
from pam_antagonist.recording import read_bag
from pam_antagonist.recording.notes import read_notes
from pam_antagonist.rig import load_rig

pytestmark = [pytest.mark.ros, pytest.mark.realtime]


def test_a_plan_is_driven_and_recorded_with_what_was_planned(tmp_path: Path, domain: None) -> None:
    out = tmp_path / "excited"
    assert excite.main(["--rig", "shin2022", "--out", str(out), "--duration", "6"]) == 0
    recording = read_bag(out / "bag")
    plan = json.loads(read_notes(out / "bag")[PLAN_NOTE])
    assert plan["duration_s"] == pytest.approx(6.0)
    assert recording.angle is not None and recording.torque is not None
    assert np.ptp(recording.voltage, axis=0).min() > 1.0
    assert np.ptp(recording.angle) > math.radians(2.0)
    low, high = plan["limits"]["pressure_pa"]
    assert low - 3e3 < recording.pressure.min() and recording.pressure.max() < high + 3e3


def test_it_ends_at_rest_where_a_limit_is_reached(tmp_path: Path, domain: None) -> None:
    rig = load_rig("shin2022")
    plan = designed(rig, Limits.of(rig), 8.0)
    # Somebody set the limit anew after the plan was made: what is measured decides.
    narrow = replace(plan, limits=replace(plan.limits, angle=math.radians(1.0)))
    driven = drive(Owner("plant", "shin2022"), narrow, tmp_path, rig)
    assert "beyond the limit of 1.0 deg" in driven.ended
    last = read_bag(tmp_path / "bag").voltage[-100:]
    assert np.allclose(last, plan.rest, atol=1e-6)
