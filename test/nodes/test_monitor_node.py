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
    from pam_antagonist.diagnosis.monitor_blocks import MonitorFinding
    from pam_antagonist.diagnosis.monitor_responses import hypotheses
    from pam_antagonist.rig import load_rig

    by_path = {item.paths: item for item in hypotheses(load_rig("shin2022"), False)}
    paths = ("effects.leak.area_1", "effects.valve_offset.voltage_1", "effects.supply_droop.stiffness")
    first, other, third = (by_path[path,] for path in paths)
    return [
        MonitorFinding(first, evidence, 900.0, ONSET_NS, 2.0, 3.1e-9, 2e-10),
        MonitorFinding(other, evidence, 880.0, ONSET_NS, 2.0, 0.05, 0.01),
        MonitorFinding(third, evidence, 300.0, ONSET_NS, 2.0, 2e7, 8e6),
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
def test_what_cannot_be_searched_for_is_a_suspicion_and_no_finding(
    node: Any, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    # Beside other work a search at the lowest priority takes minutes to start.
    given: list[int] = []
    monkeypatch.setattr("os.sched_setscheduler", lambda pid, policy, parameters: given.append(policy))
    monkeypatch.setattr("os.setpriority", lambda *_: None)
    node._monitor.findings = leak()
    searched(node)  # valves that never move allow no search
    assert given == [os.SCHED_IDLE]
    assert node.heard == []
    said, health = node._suspicion, node.health(1)["joint"]
    assert "leaks" not in health.message  # no samples, which comes first
    assert dict(health.values)["suspicion"] == said
    assert capfd.readouterr().err.count(said) == 1, "in the log"
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


def fed(node: Any, samples: int = 100) -> None:
    """Samples at rest."""
    stamps = node._feed.newest_ns + MS * np.arange(1, samples + 1)
    place = {0: (4e5,), 1: (4e5,), 2: (5.5, 5.5)}
    node._topics = {}
    node._samples += samples
    for stamp in stamps:
        for topic, values in place.items():
            node._feed.pairing.add(topic, int(stamp), *values)


@pytest.mark.parametrize("guessed", [True, False])
def test_without_an_encoder_it_says_at_the_start_what_it_cannot_do(
    new_node: Callable[..., Any], tmp_path: Path, guessed: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    from pam_antagonist.nodes.monitor import MonitorNode

    rig = "shin2022"
    if guessed:
        from pam_antagonist.cli import new_rig

        rig = str(tmp_path / "rig.yaml")
        answers = "--radius 20mm --muscle dmsp-20 --nominal-length 0.3m --length 285mm --supply 6bar --valve MPYE-5-M5"
        assert new_rig.main(["--out", rig, *answers.split(), *"--inertia 0.002 --mass 0.5kg --stop none".split()]) == 0
    node = new_node(MonitorNode, rig=rig, folder=str(tmp_path / "found"), log_book=False)
    node.trigger_activate()
    said = capfd.readouterr().err
    assert said.count("without an encoder (angle_sensor: none)") == 1
    assert ("no search is possible" in said) is guessed and "stay suspicions" in said
    assert dict(node.health(1)["joint"].values)["cannot"].startswith("without an encoder")
    if not guessed:
        return
    node._feed._parts.append((ONSET_NS + np.arange(60_000) * MS, np.full((60_000, 5), 4e5)))
    node._monitor.findings = leak()
    node._look()
    assert node._search is None
    assert node._suspicion.startswith("air leaks from muscle 1 since")
    assert node._suspicion in capfd.readouterr().err
    fed(node)
    health = node.health(2 * 10**9)["joint"]
    assert health.message == node._suspicion and health.level == 0
    assert not (tmp_path / "found").exists(), "no folder without a search"


def test_with_an_encoder_there_is_nothing_to_say(
    new_node: Callable[..., Any], capfd: pytest.CaptureFixture[str]
) -> None:
    from pam_antagonist.nodes.monitor import MonitorNode

    new_node(MonitorNode, rig="shin2022_external_torque", angle_sensor="encoder").trigger_activate()
    assert "without an encoder" not in capfd.readouterr().err


def test_a_monitor_says_why_no_samples_come(node: Any, capfd: pytest.CaptureFixture[str]) -> None:
    for second in (1, 2):
        said = node.health(second * 10**9)["joint"]
        assert said.message == "no samples: nobody publishes /pam/pressure_1, /pam/pressure_2 and /pam/valve_state"
        assert said.level == 1
    for k in range(100):
        node._feed.pairing.add(0, ONSET_NS + k * MS, 4e5)
        node._feed.pairing.add(1, ONSET_NS + k * MS + 5000, 4e5)
        node._feed.pairing.add(2, ONSET_NS + k * MS, 5.5, 5.5)
    said = node.health(3 * 10**9)["joint"]
    assert said.level == 2 and "pressure_2 5 us after pressure_1; expected one" in said.message


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
