"""The monitor node: what it publishes after a search, what a disk without space changes, and how it starts again."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sent import MS

from pam_antagonist.diagnosis.monitor import Alarms

pytestmark = pytest.mark.ros

ONSET_NS = 1_000_000_000_000_000_000


def leak(evidence: float = 60.0) -> list[Any]:
    """Findings of a monitor whose muscle 1 leaks."""
    from pam_antagonist.diagnosis.monitor_blocks import Finding
    from pam_antagonist.diagnosis.monitor_responses import hypotheses
    from pam_antagonist.rig import load_rig

    by_path = {item.paths: item for item in hypotheses(load_rig("shin2022"), False)}
    paths = ("effects.leak.area_1", "effects.valve_offset.voltage_1", "effects.supply_droop.stiffness")
    first, other, third = (by_path[path,] for path in paths)
    return [
        Finding(first, evidence, 900.0, ONSET_NS, 2.0, 3.1e-9, 2e-10),
        Finding(other, evidence, 880.0, ONSET_NS, 2.0, 0.05, 0.01),
        Finding(third, evidence, 300.0, ONSET_NS, 2.0, 2e7, 8e6),
    ]


@pytest.fixture
def node(new_node: Callable[..., Any], tmp_path: Path) -> Any:
    from pam_antagonist.nodes.monitor import MonitorNode

    node = new_node(MonitorNode, folder=str(tmp_path / "found"), log_book=False)
    node.trigger_activate()
    node.heard = []
    node._health.publish = node.heard.append
    node._feed._parts.append((ONSET_NS + np.arange(60_000) * MS, np.full((60_000, 5), 4e5)))
    return node


def searched(node: Any) -> None:
    """Wait for the search."""
    node._look()
    assert node._search is not None
    while (done := node._search.poll()) is None:
        time.sleep(0.1)
    node._search = None
    node._conclude(*done)


@pytest.mark.slow(6)
def test_what_cannot_be_searched_for_is_a_suspicion_and_no_finding(node: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    # Beside other work a search at the lowest priority takes minutes to start.
    given: list[int] = []
    monkeypatch.setattr("os.sched_setscheduler", lambda pid, policy, parameters: given.append(policy))
    monkeypatch.setattr("os.setpriority", lambda *_: None)
    node._monitor.findings = leak()
    searched(node)  # valves that never move allow no search
    assert given == [os.SCHED_IDLE]
    assert node.heard == []
    said, message = node._suspicion, node.health(1)["joint"].message
    assert "leaks" not in message and dict(node.health(1)["joint"].values)["suspicion"] == said
    assert said.startswith("air leaks from muscle 1 since") and "0.0031 ± 0.0002 mm2" in said
    assert said.endswith("it cannot be told from valve_offset 1; only a suspicion: no search was possible")
    # no storm: quiet for a while
    node._monitor.findings = leak()
    node._look()
    assert node._search is None
    # the same node started anew knows nothing and has no search
    node.trigger_deactivate()
    node.trigger_activate()
    assert node._monitor.blocks.count == 0 and not node._monitor.findings


def test_a_search_that_finds_nothing_is_silent_and_the_next_one_comes_later(node: Any) -> None:
    node._suspect = leak()
    nothing = {"verdict": "none", "effects": [], "calibration": [], "ambiguous_with": []}
    node._conclude(nothing, "")
    assert node.heard == [] and node._suspicion == ""
    alarms = Alarms()
    assert alarms.due(leak(), ONSET_NS + 30 * 10**9, 0.0) and not alarms.due(leak(), ONSET_NS + 29 * 10**9, 0.0)
    alarms.concluded(leak(), nothing, 0.0)  # the next search comes after four minutes, one after a finding after two
    assert [alarms.due(leak(), ONSET_NS + 10**12, now) for now in (239.0, 240.0)] == [False, True]
    assert [alarms.due(leak(evidence), ONSET_NS + 10**12, 120.0) for evidence in (119.0, 120.0)] == [False, True]
    alarms.concluded(leak(), None, 240.0)
    assert [alarms.due(leak(), ONSET_NS + 10**12, now) for now in (359.0, 360.0)] == [False, True]
    size = {"area_1": {"value": 2.5e-9, "std": 1e-10, "unit": "m2"}}
    effects = [{"name": "leak", "muscle": 1, "parameters": size}]
    node._conclude({"verdict": "effect", "effects": effects, "calibration": [], "ambiguous_with": ["thermal"]}, "")
    (message,) = node.heard
    assert (message.name, message.muscle, message.size, message.ambiguous_with) == ("leak", 1, 2.5e-9, ["thermal"])
    assert message.since.sec == ONSET_NS // 10**9 and message.onset_std == 2.0
    assert node.health(1)["joint"].message == message.sentence and "0.0025 ± 0.0001 mm2" in message.sentence
    node._suspect = leak()
    node._conclude({"verdict": "unexplained", "effects": [], "calibration": [], "ambiguous_with": []}, "")
    assert len(node.heard) == 1 and node._suspicion.endswith("only a suspicion: the search says unexplained")
    assert node.health(1)["joint"].message == message.sentence  # what was found stays


def test_a_name_from_pressures_alone_needs_their_evidence() -> None:
    size = {"stiffness": {"value": 2e7, "std": 8e6, "unit": "Pa/kg"}}
    effects = [{"name": "supply_droop", "muscle": None, "parameters": size}]
    found = {"verdict": "effect", "effects": effects, "calibration": [], "ambiguous_with": []}
    alone, with_encoder = (Alarms(encoder).concluded(leak(), found, 0.0) for encoder in (False, True))
    assert alone is not None and with_encoder is not None
    assert with_encoder.confirmed and with_encoder.finding.watched.name == "supply_droop"
    assert not alone.confirmed and alone.finding.watched.name == "leak"
    assert alone.sentence.endswith("only a suspicion: the search says supply_droop, the evidence does not")


def test_a_clock_that_is_set_back_ends_the_search(node: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    node._monitor.findings = leak()
    node._look()
    assert node._search is not None
    monkeypatch.setattr(node._feed, "add", lambda _: (np.zeros(0, dtype=np.int64), np.zeros((0, 5)), True))
    node._poll()
    assert node._search is None and node._monitor.findings == [] and node._suspicion == ""


def test_no_space_for_the_buffer_is_a_warning(node: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    node._monitor.findings = leak()
    node._look()
    assert "No space left" in node._complaint
    assert node.heard == [] and node._suspicion.endswith("only a suspicion: no search was possible")


def test_search_keeps_the_buffer_as_a_bag_and_a_folder_that_cannot_be_written_is_no_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from pam_antagonist.cli import monitor
    from pam_antagonist.recording import read_bag

    stamps = ONSET_NS + np.arange(3000) * MS
    np.savez(tmp_path / "buffer.npz", stamps=stamps, rows=np.tile([4e5, 4e5, 5.0, 5.0, np.nan], (3000, 1)))
    order = {
        "buffer": str(tmp_path / "buffer.npz"), "rig": "shin2022", "begin_ns": int(stamps[500]), "namespace": "/left",
        "joint": "free", "lock_angle": 0.0, "log": False,
    }  # fmt: skip
    (tmp_path / "file").touch()
    for folder, kept in (("found", True), ("file/found", False)):
        (tmp_path / "order.json").write_text(json.dumps({**order, "folder": str(tmp_path / folder)}))
        assert monitor.search_as_ordered(str(tmp_path / "order.json")) == 2  # three seconds are too short
        assert ("the buffer is not kept" in capsys.readouterr().err) is not kept
    assert len(read_bag(tmp_path / "found" / "buffer", namespace="/left")) == 3000
