"""``benchmark --only watch``, short."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from pam_antagonist.validation.benchmark import command as benchmark


@pytest.mark.ros
@pytest.mark.realtime
@pytest.mark.skipif(not os.environ.get("PAM_PROOF"), reason="a release measures it: PAM_PROOF=1 ./run test runs it")
def test_a_page_is_measured_while_it_shows_the_joint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy")
    pytest.importorskip("tornado")
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")  # it takes a free one and leaves that behind
    assert benchmark.main(["--only", "watch", "--duration", "6", "--json", str(tmp_path / "watch.json")]) == 0
    figures = json.loads((tmp_path / "watch.json").read_text())["figures"]
    assert set(figures) == {"watch_round_trip", "watch_processor", "watch_lost"}
    parts = figures["watch_processor"]["parts"]
    assert parts["frames_a_second"] > 25.0
    assert parts["nobody_looks_percent"] < figures["watch_processor"]["value"] < 20.0
    trips = figures["watch_round_trip"]["parts"]
    assert 0.0 < trips["with_ms"] <= trips["with_p99_ms"] and 0.0 < trips["without_ms"] <= trips["without_p99_ms"]
    assert figures["watch_round_trip"]["value"] == pytest.approx(trips["with_ms"] / trips["without_ms"])
    assert figures["watch_lost"]["value"] == 0.0
