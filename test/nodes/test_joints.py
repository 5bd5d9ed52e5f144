"""Several joints in one process: linked nodes, their parameters and stops, one bag, and its replay joint by joint."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sent
from sent import MS, asked

from pam_antagonist.cli import replay
from pam_antagonist.nodes.processes import Processes
from pam_antagonist.paths import config_dir
from pam_antagonist.recording import SeveralJoints, read_bag

SAFE = (5.5, 5.5)
ROBOT = config_dir() / "robot.yaml"


# ------------------------------------------------------------------------------------------------ linked nodes


@pytest.fixture
def joint(ros: None) -> Iterator[Any]:
    from rclpy.parameter import Parameter

    from pam_antagonist.nodes.joints import make_joint

    made = make_joint("/arm/elbow", parameter_overrides=[Parameter("joint_name", value="elbow")])
    for node in made.nodes:
        node.start()
    yield made
    for node in made.nodes:
        node.destroy_node()


def run(joint: Any, samples: int, begin: int | None = None) -> int:
    """Let the plant make samples; the time behind them [ns]."""
    plant = joint.source
    at = plant.now_ns() if begin is None else begin
    for k in range(samples):
        plant._now = at + k * MS
        for node in joint.nodes:
            node.now_ns = lambda now=at + k * MS: now
        plant._sample(at + k * MS)
    return at + samples * MS


def refer(joint: Any, degrees: float) -> None:
    sent.refer(joint.controller, 0, math.radians(degrees))


@pytest.mark.ros
def test_a_sample_reaches_the_valves_within_the_process(joint: Any) -> None:
    refer(joint, 10.0)
    at = run(joint, 600)
    assert joint.estimator._published == joint.controller._commands == 600
    assert joint.source.port.guard.counts.commands == 600
    assert joint.source.port.guard.authority.refused == 0
    voltage = joint.source.port.output(at).voltage
    assert voltage[0] > SAFE[0] + 0.1 and voltage[1] < SAFE[1] - 0.1
    # Nobody listens to what goes from node to node already.
    topics = [name for node in joint.nodes for name in (item.topic_name for item in node._collected.values())]
    assert "/arm/elbow/valve_command" not in topics
    own = [item.topic_name for node in joint.nodes for item in node.subscriptions]
    assert not any(name.endswith(("pressure_1", "valve_command", "joint_estimate")) for name in own)


@pytest.mark.ros
def test_an_inactive_node_of_a_chain_leads_to_safe_voltages(joint: Any) -> None:
    refer(joint, 10.0)
    for node in (joint.estimator, joint.controller):
        at = run(joint, 300)
        assert joint.source.port.output(at).voltage != SAFE
        node.trigger_deactivate()
        at = run(joint, 30, at)
        assert joint.source.port.output(at).voltage == SAFE  # silence for longer than command_timeout
        node.trigger_activate()
        joint.controller.stopped = ""
        refer(joint, 10.0)


@pytest.mark.ros
def test_stop_and_clear_of_one_joint(joint: Any) -> None:
    refer(joint, 10.0)
    at = run(joint, 300)
    assert asked(joint.source.port._stop) == (True, "stopped")
    assert joint.source.port.output(at).voltage == SAFE
    at = run(joint, 30, at)
    assert joint.source.port.output(at).voltage == SAFE  # commands do not end it
    assert joint.source.health(1)["safety"].message.startswith("stopped: on request")
    assert asked(joint.source.port._clear)[0]
    at = run(joint, 30, at)
    assert joint.source.port.output(at).voltage != SAFE


@pytest.mark.ros
def test_another_commander_of_a_linked_joint_is_named_and_not_obeyed(joint: Any) -> None:
    import time

    from rclpy.node import Node

    from pam_antagonist.nodes import qos
    from pam_antagonist_msgs.msg import ValveCommand

    other = Node("other", namespace="/arm/elbow")
    publisher = other.create_publisher(ValveCommand, "valve_command", qos.STREAM)
    try:
        end = time.monotonic() + 10.0
        while joint.source.count_publishers("/arm/elbow/valve_command") < 2 and time.monotonic() < end:
            time.sleep(0.02)
        publisher.publish(ValveCommand(voltage=[9.0, 1.0]))
        time.sleep(0.2)
        at = run(joint, 5)
        assert joint.source.port.output(at).voltage == SAFE
        health = joint.source.port.health(1)["commands"]
        assert health.level == 2 and "/arm/elbow/other" in health.message
    finally:
        other.destroy_node()


@pytest.mark.ros
@pytest.mark.parametrize("source", ["bridge", "none"])
def test_stop_all_reaches_bridges_and_controllers_of_valves_that_are_owned_elsewhere(ros: None, source: str) -> None:
    from pam_antagonist.nodes.joints import JointsNode

    given = ["--ros-args", "--params-file", str(ROBOT), "-p", f"source:={source}", "-p", "port:=/no/such/port"]
    node = JointsNode(cli_args=given, use_global_arguments=False)
    try:
        done, said = asked(node._stop_all)
        assert done and said.startswith("stopped: /left/elbow, /left/wrist")
        for joint in node.joints:
            if source == "bridge":
                assert joint.source is not None and joint.source.port.guard.stopped == "stop_all"
                assert joint.source.port.output(1).voltage == SAFE
            else:
                assert joint.source is None and joint.controller.stopped == "stop_all"
        assert ("of /left/elbow, /left/wrist the controller" in said) == (source == "none")
        health = node.health(1)["joints"]
        assert health.level == 2 and health.message == "stopped: /left/elbow, /left/wrist"
    finally:
        for one in (*node.members, node):
            one.destroy_node()


# ------------------------------------------------------------------------------------------------ arguments


@pytest.mark.ros
def test_sections_of_a_joint_win_over_those_of_all_and_the_command_line_over_both(ros: None) -> None:
    from pam_antagonist.nodes.joints import JointsNode

    given = ["--ros-args", "--params-file", str(ROBOT), "-p", "max_slew:=1000.0"]
    node = JointsNode(cli_args=given, use_global_arguments=False)
    try:
        elbow, wrist = node.joints
        assert (elbow.namespace, wrist.namespace) == ("/left/elbow", "/left/wrist")
        assert [joint.controller.values["joint_name"] for joint in node.joints] == ["left_elbow", "left_wrist"]
        assert [joint.source.values["seed"] for joint in node.joints] == [1, 2]
        assert {joint.source.values["mismatch"] for joint in node.joints} == {0.01}
        assert {joint.source.values["max_slew"] for joint in node.joints} == {1000.0}
        assert len(node.members) == 6
    finally:
        for one in (*node.members, node):
            one.destroy_node()


# ------------------------------------------------------------------------------------------------ the process


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory, module_domain: None) -> Iterator[tuple[Processes, Any, Path]]:
    from probe import Probe

    folder = tmp_path_factory.mktemp("robot")
    with Processes(folder) as processes, Probe("diagnostics") as probe:
        chosen = ["--namespace", "/left/elbow/", "--namespace", "left/wrist"]
        processes.start("record", ["--out", str(folder / "bag"), *chosen])
        probe.until(lambda: probe.node.count_subscribers("/left/wrist/pressure_1") == 1, 60.0, "a recorder")
        processes.start("joints", ["--ros-args", "--params-file", str(ROBOT), "-p", "diagnostics_period:=0.2"])
        yield processes, probe, folder


@pytest.mark.ros
@pytest.mark.realtime
def test_stop_all_stops_every_joint_and_each_is_cleared_by_itself(robot: tuple[Processes, Any, Path]) -> None:
    processes, probe, _ = robot

    def words(name: str) -> str:
        processes.check()
        return probe.statuses(name)[-1].message if probe.statuses(name) else ""

    probe.until(lambda: words("joints: joints") == "2 joints are active", 60.0, "the joints")
    probe.until(lambda: bool(words("left/elbow/controller: commands") and words("left/wrist/plant: safety")), 10.0)
    for name, joint in (("left/elbow/controller: commands", "left_elbow"), ("left/wrist/plant: safety", "left_wrist")):
        assert probe.statuses(name)[-1].hardware_id == joint
    answer = probe.trigger("/joints/stop_all")
    assert answer.success and answer.message == "stopped: /left/elbow, /left/wrist"
    probe.clear()
    probe.until(lambda: "left/elbow, /left/wrist" in words("joints: joints"), 10.0, "the stop in the diagnostics")
    assert probe.trigger("/left/elbow/plant/clear_stop").success
    probe.clear()
    probe.until(lambda: words("joints: joints") == "stopped: /left/wrist", 10.0, "the clear in the diagnostics")
    assert probe.trigger("/left/wrist/plant/clear_stop").success
    probe.wait(1.0)


@pytest.mark.slow(4)
@pytest.mark.ros
@pytest.mark.realtime
def test_one_bag_holds_every_joint_and_is_replayed_joint_by_joint(
    robot: tuple[Processes, Any, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    processes, _, folder = robot
    assert processes.stop("joints", "record") == {"joints": 0, "record": 0}
    log = (folder / "joints.log").read_text()
    assert "Traceback" not in log and "[left.elbow.controller]: active" in log
    with pytest.raises(SeveralJoints, match="choose one with --namespace") as found:
        read_bag(folder / "bag")
    assert found.value.namespaces == ["/left/elbow", "/left/wrist"]
    one = read_bag(folder / "bag", namespace="/left/elbow")
    assert one.namespace == "/left/elbow" and len(one) > 500
    assert replay.main([str(folder / "bag"), "--rig", "shin2022", "--out", str(folder / "out"), "--no-figures"]) == 0
    report = json.loads((folder / "out" / "report.json").read_text())
    text = json.dumps(report)
    assert "bag /left/elbow" in text and "bag /left/wrist" in text
    said = capsys.readouterr().out
    assert "/left/elbow" in said and "/left/wrist" in said
    save = ["--out", str(folder / "other"), "--save", str(folder / "e.csv")]
    assert replay.main([str(folder / "bag"), "--rig", "shin2022", *save]) == 2
    assert "choose one with --namespace" in capsys.readouterr().err
    shutil.rmtree(folder / "bag")
