"""Nodes in simulated time whose /clock never comes, stops, is slow or set back: no old sample counts as a new one."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from sent import MS, Loop, measure, packed

from pam_antagonist.nodes.ages import PATIENCE_NS, Ages

SECOND = 10**9
SAFE = (5.5, 5.5)
LATE = 64


class Times:
    """The clocks of a node: /clock, which ticks as it is told, and the steady one."""

    def __init__(self, node: Any) -> None:
        self.node, self.steady, self.clock = node, 10**15, 0
        node.ages = Ages(node, lambda: self.steady)

    def tick(self, clock_ns: int) -> None:
        """What a message on /clock does."""
        from rclpy.clock_type import ClockType
        from rclpy.time import Time

        self.clock = clock_ns
        self.node.get_clock().set_ros_time_override(Time(nanoseconds=clock_ns, clock_type=ClockType.ROS_TIME))

    def run(self, seconds: float, rate: float = 0.0) -> None:
        """Let time pass; `rate`: of simulated to real time, 0: no tick comes."""
        for _ in range(round(seconds / 0.2)):
            self.steady += 200 * MS
            if rate:
                self.tick(self.clock + round(rate * 200 * MS))
            self.node._look_at_clock()


def ages() -> tuple[Ages, SimpleNamespace]:
    time = SimpleNamespace(simulated=True, clock=0, steady=0)
    time.now_ns = lambda: time.clock
    return Ages(time, lambda: time.steady), time


def test_a_silence_in_a_slow_simulation_is_simulated_time_and_ends_with_the_simulation() -> None:
    judge, time = ages()
    time.clock = 5 * SECOND
    heard = judge.now()
    time.clock, time.steady = time.clock + 3 * MS, 300 * MS  # a hundredth of real time
    assert judge.since(heard) == 3 * MS
    time.steady = PATIENCE_NS + 50 * MS
    assert judge.since(heard) == 50 * MS  # the ticks have ended
    time.clock -= 3 * SECOND
    assert judge.since(heard) == 50 * MS  # set back
    time.clock = 0
    assert judge.since(heard) == time.steady


def test_a_node_that_was_busy_for_long_does_not_take_the_clock_for_gone() -> None:
    judge, time = ages()
    time.steady = 60 * SECOND  # it was compiling
    judge.look()
    assert not judge.clock_fails and judge.of(0) == math.inf
    for _ in range(6):
        time.steady += 200 * MS
        judge.look()
    assert "no /clock has come" in judge.clock_fails


def nodes(new_node: Callable[..., Any], name: str, tmp_path: Any) -> list[Any]:
    from pam_antagonist.nodes.controller import ControllerNode
    from pam_antagonist.nodes.estimator import EstimatorNode
    from pam_antagonist.nodes.joints import JointsNode
    from pam_antagonist.nodes.monitor import MonitorNode
    from pam_antagonist.nodes.plant import PlantNode
    from pam_antagonist.nodes.recorder import RecorderNode, read_options

    kinds = {"controller": ControllerNode, "estimator": EstimatorNode, "plant": PlantNode, "monitor": MonitorNode}
    if name == "record":
        node = new_node(RecorderNode, read_options(["--out", str(tmp_path / "bag")]), use_sim_time=True)
    else:
        node = new_node({**kinds, "joints": JointsNode}[name], use_sim_time=True)
    return [node, *node.members]


@pytest.mark.ros
@pytest.mark.parametrize("name", ["controller", "estimator", "plant", "monitor", "record", "joints"])
def test_every_node_says_once_that_no_clock_comes_and_that_it_runs_again(
    new_node: Callable[..., Any], name: str, tmp_path: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    every = nodes(new_node, name, tmp_path)
    for node in every:
        node.trigger_activate()
        times = Times(node)
        capfd.readouterr()
        times.run(0.8)
        assert node.ages.health().level == 0 and capfd.readouterr().err == "", node.get_name()
        times.run(3.0)
        said = node.ages.health()
        assert said.level == 2 and "use_sim_time is true, but no /clock has come" in said.message
        assert "set use_sim_time to false" in said.message
        assert capfd.readouterr().err.count("no /clock has come") == 1, node.get_name()
        if name == "plant":
            assert "no /clock has come" in node.health(1)["sampling"].message
        times.tick(7 * SECOND)
        times.run(1.0, rate=1.0)
        assert node.ages.health().level == 0
        assert capfd.readouterr().err.count("the clock runs again") == 1
        times.run(3.0)
        assert "/clock has stood still for 3 s" in node.ages.health().message
        assert capfd.readouterr().err.count("stood still") == 1
    for node in every[1:]:
        node.close()
        node.destroy_node()


@pytest.mark.ros
def test_the_part_time_of_the_diagnostics_tells_it(new_node: Callable[..., Any]) -> None:
    from sent import Sent

    from pam_antagonist.nodes.estimator import EstimatorNode

    node = new_node(EstimatorNode, use_sim_time=True)
    sent = node._diagnostics._publisher.publish = Sent(None)
    Times(node).run(3.0)
    node._diagnose()
    part = next(status for status in sent[-1].status if status.name == "pam/estimator: time")
    assert part.level == b"\x02" and "no /clock has come" in part.message
    assert {item.key: item.value for item in part.values} == {"clock": "/clock", "now [s]": "0.000"}


@pytest.mark.ros
def test_an_estimator_takes_no_sample_for_young_by_a_clock_that_does_not_run(new_node: Callable[..., Any]) -> None:
    from pam_antagonist.nodes.estimator import EstimatorNode

    node = new_node(EstimatorNode, use_sim_time=True)
    node.keep(estimates=node._estimates)
    times = Times(node)
    at = 1_795_000_000 * SECOND

    def late(stamp: int) -> bool:
        measure(node, stamp)
        return bool(node.sent["estimates"][-1].flags & LATE)

    assert late(at), "no /clock has come, from the very first sample on"
    times.run(2.0)
    assert late(at + MS) and "no /clock has come" in node.health(SECOND)["samples"].message
    times.tick(at + 3 * MS)
    times.run(0.2, rate=0.0)
    assert not late(at + 2 * MS)
    times.run(2.0)
    assert late(at + 3 * MS), "it stands"
    times.tick(at + 5 * MS)
    times.run(0.2)
    assert not late(at + 4 * MS) and late(at + 60 * SECOND), "a stamp of another clock, far ahead"
    assert "60 s ahead of /clock" in node.ages.health().message


@pytest.mark.ros
@pytest.mark.parametrize("stood", [False, True])
def test_a_controller_is_safe_while_its_clock_does_not_run(
    new_node: Callable[..., Any], stood: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Old samples are no reason to move, and silence is noticed."""
    from pam_antagonist.nodes.controller import ControllerNode

    node = new_node(ControllerNode, use_sim_time=True)
    times = Times(node)
    begin = 1_795_000_000 * SECOND if stood else 0
    if stood:
        times.tick(begin + 20 * MS)
        times.run(0.2)
    loop = Loop(node)
    del node.now_ns  # as it is: that of /clock
    loop.now = 1_795_000_000 * SECOND
    loop.refer(0, 0.3)
    if stood:
        loop.run(3, angle=0.3)
        assert loop.run(angle=0.1) != SAFE, "it runs"
    else:
        assert loop.run(angle=0.1) == SAFE, "from the very first estimate on"
    times.run(2.0)
    for _ in range(5):
        assert loop.run(angle=0.1) == SAFE
    health = loop.health("commands")
    assert health.level == 2 and ("stood still" if stood else "no /clock has come") in health.message
    count = len(loop.commands)
    node._watch()
    assert len(loop.commands) == count
    times.steady += 25 * MS + (PATIENCE_NS if stood else 0)
    node._watch()
    assert len(loop.commands) == count + 1 and loop.voltages[-1] == SAFE
    times.run(0.2)
    assert loop.health("commands").message == "estimates have stopped: safe voltages"
    if stood:  # and goes on with the clock
        loop.now += 5 * SECOND
        times.tick(loop.now + MS)
        times.run(0.2)
        loop.run(60, angle=0.1)
        assert loop.run(angle=0.1) != SAFE


@pytest.mark.ros
def test_a_clock_that_is_set_back_gives_safe_voltages_until_samples_of_its_time_come(
    new_node: Callable[..., Any],
) -> None:
    from pam_antagonist.nodes.controller import ControllerNode

    node = new_node(ControllerNode, use_sim_time=True)
    times = Times(node)
    times.tick(100 * SECOND)
    times.run(0.2)
    loop = Loop(node)
    del node.now_ns
    loop.now = 100 * SECOND - 20 * MS
    loop.refer(0, 0.3)
    assert loop.run(5, angle=0.1) != SAFE
    times.tick(95 * SECOND)
    times.run(0.2)
    assert loop.run(angle=0.1) == SAFE, "a sample from before"
    assert "ahead of /clock" in loop.health("commands").message
    loop.now = 95 * SECOND - 20 * MS
    loop.run(3, angle=0.1)
    assert loop.voltages[-1] != SAFE and node.ages.health().level == 0


@pytest.mark.ros
def test_valves_refuse_commands_whose_age_is_not_known(new_node: Callable[..., Any]) -> None:
    from pam_antagonist.nodes.plant import PlantNode
    from pam_antagonist_msgs.msg import ValveCommand

    node = new_node(PlantNode, use_sim_time=True)
    node.trigger_activate()
    node.port.accept(packed(ValveCommand(voltage=[9.0, 1.0]), 5 * SECOND), MS)
    assert node.port.output(MS).voltage == SAFE and node.port.guard.counts.late == 1


@pytest.mark.ros
def test_a_trajectory_without_a_stamp_waits_for_a_clock(new_node: Callable[..., Any]) -> None:
    """From a clock that has not come, it would begin in 1970 and be over at once."""
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    from pam_antagonist.nodes.controller import ControllerNode

    node = new_node(ControllerNode, use_sim_time=True, reference_source="joint_trajectory")
    point = JointTrajectoryPoint(positions=[0.3])
    point.time_from_start.sec = 2
    node.input.trajectory(JointTrajectory(joint_names=["joint"], points=[point]))
    assert "no stamp, and the node's clock does not run" in node.input.references.complaint
    times = Times(node)
    times.tick(5 * SECOND)
    times.run(0.2)
    node.input.trajectory(JointTrajectory(joint_names=["joint"], points=[point]))
    assert node.input.references.at(6 * SECOND, 0, 0.0, 0.0).value == pytest.approx(0.15)


@pytest.mark.ros
def test_an_estimator_whose_clock_stands_still_gives_up_waiting_for_a_topic(new_node: Callable[..., Any]) -> None:
    from pam_antagonist.nodes.estimator import EstimatorNode

    node = new_node(EstimatorNode, use_sim_time=True)
    steady = [0]
    node._pairing._clock = lambda: steady[0]
    for k in range(60):
        measure(node, SECOND + k * MS, p2=450e3 if k < 10 else None)
    steady[0] = SECOND
    node._take(node._pairing.expire())
    assert node._published == 39


@pytest.mark.ros
def test_use_sim_time_is_true_or_false_and_hardware_follows_no_simulation(
    new_node: Callable[..., Any], domain: None
) -> None:
    from rclpy.parameter import Parameter

    from pam_antagonist.errors import BadInput
    from pam_antagonist.nodes.bridge import BridgeNode
    from pam_antagonist.nodes.estimator import EstimatorNode

    with pytest.raises(
        BadInput, match="node estimator: .*'use_sim_time' to 'true' of type 'STRING', expecting type 'BOOL'"
    ):
        new_node(EstimatorNode, use_sim_time="true")
    bridge = new_node(BridgeNode, port="/no/such/port")
    (result,) = bridge.set_parameters([Parameter("use_sim_time", value=True)])
    assert not result.successful and "hardware does not follow simulated time" in result.reason
    assert not bridge.simulated
