"""``benchmark --only interaction``, short."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from validation.benchmark import command as benchmark


@pytest.mark.ros
@pytest.mark.realtime
def test_everything_at_once_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy")
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")  # it takes a free one and leaves that behind
    out = tmp_path / "figures.json"
    assert benchmark.main(["--only", "interaction", "--duration", "3", "--json", str(out)]) == 0
    figures = json.loads(out.read_text())["figures"]
    assert set(figures) == {"interaction_round_trip", "interaction_lost"}
    assert figures["interaction_lost"]["value"] == 0.0
    parts = figures["interaction_round_trip"]["parts"]
    assert figures["interaction_round_trip"]["value"] == pytest.approx(parts["pipeline_ms"] / parts["passthrough_ms"])
    assert 0.0 < figures["interaction_round_trip"]["value"] < 3.0
