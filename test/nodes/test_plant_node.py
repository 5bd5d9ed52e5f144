"""The plant node in the process of the tests: its clock, its joint, and who listens."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sent import MS, command, stamp_of

from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant

pytestmark = pytest.mark.ros

T0 = 1_795_000_000 * 10**9


@pytest.fixture
def make(new_node: Callable[..., Any]) -> Callable[..., Any]:
    from pam_antagonist.nodes.plant import PlantNode

    def factory(**parameters: Any) -> Any:
        node = new_node(PlantNode, **parameters)
        node.time = T0  # its clock stands still until it is moved
        node.now_ns = lambda: node.time
        node.trigger_activate()
        output = node._output
        node.keep(p1=output.pressures[0], p2=output.pressures[1], valves=output.valves, joint=output.joint)
        return node

    return factory


def tick(node: Any, milliseconds: float) -> None:
    """Let time pass and the timer fire."""
    node.time += round(milliseconds * MS)
    node._tick()


def test_messages_are_those_of_the_plant(make: Callable[..., Any]) -> None:
    node = make(seed=5, mismatch=0.02)
    twin = Plant(load_rig("shin2022"), seed=5, mismatch=0.02)
    for k in range(30):
        command(node, 6.0, 4.5, node.time)
        tick(node, 1.0)
        sample = twin.step((6.0, 4.5))
        assert node.sent["p1"][k].fluid_pressure == sample.pressure[0]
        assert node.sent["p2"][k].fluid_pressure == sample.pressure[1]
        assert tuple(node.sent["valves"][k].voltage) == tuple(sample.voltage) == (6.0, 4.5)
        assert node.sent["joint"][k].position[0] == sample.angle
        assert node.sent["joint"][k].effort[0] == sample.torque
    message = node.sent["p1"][0]
    assert message.variance == pytest.approx(load_rig("shin2022").sensors.pressure_std ** 2)


def test_uneven_ticks_do_not_move_the_stamps(make: Callable[..., Any]) -> None:
    """A timer that is late, and drops ticks: every sample is made up for, with the stamp that it was to have."""
    node = make()
    rng = np.random.default_rng(0)
    for pause in rng.uniform(0.2, 5.0, 200):
        tick(node, pause)
    stamps = [stamp_of(message) for message in node.sent["p1"]]
    assert np.all(np.diff(stamps) == MS)
    assert 0 <= node.time - stamps[-1] < MS


def test_a_stall_is_caught_up_with_in_portions(make: Callable[..., Any]) -> None:
    node = make()
    tick(node, 1.0)
    tick(node, 300.0)
    assert len(node.sent["p1"]) == 26  # then commands are looked at
    for _ in range(20):
        tick(node, 0.0)
    assert len(node.sent["p1"]) == 301
    assert np.all(np.diff([stamp_of(message) for message in node.sent["p1"]]) == MS)


@pytest.mark.parametrize("jump", [1500.0, -1500.0])
def test_a_jump_of_the_clock_is_not_caught_up_with(make: Callable[..., Any], jump: float) -> None:
    node = make()
    for _ in range(5):
        tick(node, 1.0)
    tick(node, jump)
    tick(node, 1.0)
    assert len(node.sent["p1"]) == 7
    assert stamp_of(node.sent["p1"][-1]) == node.time
    assert node.health(1)["sampling"].values["clock jumps"] == 1


def test_a_computer_that_is_too_slow_is_told_so_in_a_sentence(
    make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    node, begin = make(), T0
    monkeypatch.setattr("pam_antagonist.nodes.plant.time.monotonic_ns", lambda: node.time - begin)
    tick(node, 1.0)
    assert node.health(1)["sampling"].message == "running"
    for _ in range(20):
        tick(node, 60.0)  # of which 25 samples are made
    assert node.health(2)["sampling"].message.startswith(
        "this computer is too slow for 1000 samples a second: half of them come "
    )
    tick(node, 1500.0)
    said = node.health(3)["sampling"]
    assert said.level == 1 and "left out" in said.message and said.values["clock jumps"] == 0
    assert capfd.readouterr().err.count("this computer is too slow for 1000 samples a second") == 1
    for _ in range(5):
        tick(node, 1.0)
    assert node.health(4)["sampling"].message == "running"


def test_first_sample_waits_for_subscribers_and_gives_them_time(make: Callable[..., Any]) -> None:
    from sensor_msgs.msg import FluidPressure

    from pam_antagonist.nodes import qos

    node = make(wait_for_subscribers=1)
    tick(node, 1.0)
    assert node.sent["p1"] == []
    for topic in ("pressure_1", "pressure_2"):
        node.create_subscription(FluidPressure, topic, lambda message: None, qos.STREAM)
    tick(node, 1.0)
    tick(node, 1000.0)
    assert node.sent["p1"] == []  # valve_state has none yet
    from pam_antagonist_msgs.msg import ValveCommand

    node.create_subscription(ValveCommand, "valve_state", lambda message: None, qos.STREAM)
    for _ in range(299):
        tick(node, 1.0)
    assert node.sent["p1"] == []
    for _ in range(10):
        tick(node, 1.0)
    assert 5 <= len(node.sent["p1"]) <= 10


def test_it_is_pushed_while_it_runs_and_says_so(make: Callable[..., Any]) -> None:
    from rclpy.parameter import Parameter

    node = make(rig="shin2022_external_torque", noise=False)
    node.keep(pushed=node._pushed)
    pushed = node.sent["pushed"]
    moved = []
    for torque in (0.0, 1.0):
        (result,) = node.set_parameters([Parameter("push", value=torque)])
        assert result.successful
        for _ in range(200):
            node._sample(node.time)
            node.time += MS
        moved.append(node.sent["joint"][-1].position[0])
        assert pushed[-1].wrench.torque.z == torque and stamp_of(pushed[-1]) == stamp_of(node.sent["joint"][-1])
    assert abs(moved[0]) < math.radians(0.1) and moved[1] > math.radians(3.0)
    (result,) = node.set_parameters([Parameter("push", value=100.0)])
    assert not result.successful and "push" in result.reason


def test_of_a_rig_without_that_state_it_publishes_no_push(make: Callable[..., Any]) -> None:
    assert make()._pushed is None
