"""The live part: what a pipeline around the virtual rig records, and how it is judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from validation.paper import live, online
from validation.paper.result import Context
from validation.paper.scenario import START
from validation.paper.seed_work import SeedWork

pytestmark = [pytest.mark.ros, pytest.mark.realtime, pytest.mark.slow]
SECONDS = 6.0


def test_the_live_estimate_is_the_replayed_one(scenario, tmp_path: Path) -> None:
    work = SeedWork(scenario, 0, seconds=SECONDS)
    context = Context(work, [], [0], False, True, None, tmp_path, print)
    recording = live.estimation(context, "free", online.LIVE_TUNING, SECONDS)
    assert recording.duration_s > SECONDS - 0.5
    # The profile was on the valves: the same steps as in the virtual rig's own recording.
    assert np.unique(recording.voltage[:, 0]) == pytest.approx(np.unique(work.voltage[:, 0]))
    assert recording.pressure[0] == pytest.approx(START, abs=5e3)
    run = online.judge(recording, work.rig.declared, "angle", "free")
    assert run.equal[0] == run.equal[1] > 1000 * (SECONDS - 1.0)
    assert 0.0 < np.median(run.step_ms) < 1.0
    assert np.median(run.pipeline_ms) > np.median(run.step_ms)
    assert not any(tmp_path.iterdir()), "bags are removed"
