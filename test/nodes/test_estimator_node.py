"""The estimator node in the process of the tests: messages in, messages out, whatever is missing or wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from sent import stamp_of

pytestmark = pytest.mark.ros

MS = 1_000_000


@pytest.fixture
def node(new_node: Callable[..., Any]) -> Any:
    from pam_antagonist.nodes.estimator import EstimatorNode

    node = new_node(EstimatorNode)
    node.keep(estimates=node._estimates)
    node.published = node.sent["estimates"]
    return node


def send(node: Any, stamp_ns: int, p1: float | None, p2: float | None, voltage: tuple[float, float] | None) -> None:
    """One message of each topic that is given a value."""
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import FluidPressure

    from pam_antagonist.nodes.wire import set_stamp
    from pam_antagonist_msgs.msg import ValveCommand

    for value, callback in ((p1, node._on_pressure_1), (p2, node._on_pressure_2)):
        if value is not None:
            message = FluidPressure(fluid_pressure=value)
            set_stamp(message.header.stamp, stamp_ns)
            callback(serialize_message(message))
    if voltage is not None:
        command = ValveCommand(voltage=voltage)
        set_stamp(command.header.stamp, stamp_ns)
        node._on_valves(serialize_message(command))


def test_fresh_samples_are_estimated_in_order_and_not_late(node: Any) -> None:
    begin = node.now_ns()
    for k in range(20):
        send(node, begin + k * MS, 450e3, 450e3, (5.5, 5.5))
    assert [stamp_of(item) for item in node.published] == [begin + k * MS for k in range(20)]
    assert all(math.isfinite(item.angle) and math.isfinite(item.torque) for item in node.published)
    assert all(item.header.frame_id == "joint" for item in node.published)
    assert node.published[-1].flags & 64 == 0


def test_old_samples_are_flagged_late(node: Any) -> None:
    begin = node.now_ns() - 10**9
    for k in range(5):
        send(node, begin + k * MS, 450e3, 450e3, (5.5, 5.5))
    assert len(node.published) == 5
    assert all(item.flags & 64 for item in node.published)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_pressure_that_is_no_number_is_left_out_and_flagged(node: Any, bad: float) -> None:
    begin = node.now_ns()
    for k in range(10):
        send(node, begin + k * MS, 450e3, 450e3, (5.5, 5.5))
    for k in range(10, 20):
        send(node, begin + k * MS, bad, 450e3, (5.5, 5.5))
    for k in range(20, 30):
        send(node, begin + k * MS, bad, bad, (bad, 5.5))
    for k in range(30, 40):
        send(node, begin + k * MS, 450e3, 450e3, (5.5, 5.5))
    flags = [item.flags & 7 for item in node.published]
    assert flags == [0] * 10 + [1] * 10 + [7] * 10 + [0] * 10
    assert all(math.isfinite(item.angle) for item in node.published)
    assert math.isnan(node.published[15].innovation[0]) and math.isfinite(node.published[15].innovation[1])
    assert math.isnan(node.published[25].nis)


def test_nothing_is_published_before_the_first_whole_sample(node: Any) -> None:
    begin = node.now_ns()
    send(node, begin, math.nan, 450e3, (5.5, 5.5))
    assert node.published == []
    send(node, begin + MS, 450e3, 450e3, (5.5, 5.5))
    assert [stamp_of(item) for item in node.published] == [begin + MS]


def test_diagnostics_tell_what_was_lost(node: Any) -> None:
    begin = node.now_ns()
    for k in range(10):
        send(node, begin + k * MS, 450e3, 450e3, (5.5, 5.5))
    send(node, begin + 3 * MS, 450e3, None, None)
    health = node.health(1)
    assert set(health) == {"samples", "filter"}
    assert health["samples"].values["estimates"] == 10
    assert health["samples"].values["messages too late for their sample"] == 1
    assert health["filter"].values["processed"] == 10


def test_diagnostics_are_named_after_node_and_part(node: Any) -> None:
    sent: list[Any] = []
    node._diagnostics._publisher.publish = sent.append
    node._diagnose()
    (message,) = sent
    parts = ["samples", "filter", "connections", "lifecycle"]
    assert [status.name for status in message.status] == [f"pam/estimator: {part}" for part in parts]
    assert all(status.hardware_id == "joint" for status in message.status)
    assert message.status[0].level == b"\x01"  # nothing has come yet
    assert message.header.stamp.sec > 0


def test_a_topic_that_stays_away_is_waited_for_and_then_left_out(node: Any) -> None:
    begin = node.now_ns()
    for k in range(10):
        send(node, begin + k * MS, 450e3, 450e3, (5.5, 5.5))
    for k in range(10, 60):
        send(node, begin + k * MS, 450e3, None, (5.5, 5.5))
    waiting = node._pairing.expire()
    assert len(node.published) == 10 and waiting == []
    node._pairing._clock = lambda: begin + 10**9
    node._take(node._pairing.expire())
    assert [stamp_of(item) for item in node.published[10:]] == [begin + k * MS for k in range(10, 39)]
    assert all(item.flags & 2 for item in node.published[10:])
    assert node.health(1)["samples"].values["incomplete"] == 29


@pytest.fixture
def seeing(new_node: Callable[..., Any]) -> Any:
    """A node that uses an encoder, and the torques from outside that it publishes."""
    from pam_antagonist.nodes.estimator import EstimatorNode

    node = new_node(EstimatorNode, rig="shin2022_external_torque", angle_sensor="encoder")
    node.keep(torques=node._external)
    return node


def test_an_encoder_is_used_and_a_bad_one_is_refused_with_the_correction(seeing: Any) -> None:
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import JointState

    from pam_antagonist.nodes.wire import set_stamp

    begin = seeing.now_ns()
    for k in range(400):
        send(seeing, begin + k * MS, 450e3, 450e3, (5.5, 5.5))
        message = JointState(name=["joint"], position=[1e-6 * k + (0.2 if k >= 200 else 0.0)])
        set_stamp(message.header.stamp, begin + k * MS)
        seeing._on_angle(serialize_message(message))
        if k == 199:
            assert seeing.health(1)["encoder"].message == "used"
    torques = [message.wrench.torque.z for message in seeing.sent["torques"]]
    assert len(torques) == 400 and all(map(math.isfinite, torques))
    state = seeing.health(2)["encoder"]
    assert state.message.startswith("refused: the encoder jumped by +11.5°") and "~/reset" in state.message
    seeing._on_reset(None, type("Response", (), {})())
    assert seeing._estimator.encoder_complaint == ""
