"""``benchmark --only joints`` on one joint."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from pam_antagonist.validation.benchmark import command as benchmark
from pam_antagonist.validation.benchmark import joints


@pytest.mark.ros
@pytest.mark.realtime
@pytest.mark.skipif(not os.environ.get("PAM_PROOF"), reason="a release measures it: PAM_PROOF=1 ./run test runs it")
def test_one_joint_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy")
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")  # it takes a free one and leaves that behind
    monkeypatch.setattr(joints, "JOINTS", 1)
    monkeypatch.setattr(joints, "PERIODS", (0.002,))
    assert benchmark.main(["--only", "joints", "--duration", "3", "--json", str(tmp_path / "joints.json")]) == 0
    figures = json.loads((tmp_path / "joints.json").read_text())["figures"]
    assert set(figures) == {"joints_lost_500_hz", "joints_memory"}
    assert figures["joints_lost_500_hz"]["value"] == 0.0
    assert figures["joints_lost_500_hz"]["parts"]["expected"] >= 1500.0
    assert 100.0 < figures["joints_memory"]["value"] < 300.0
