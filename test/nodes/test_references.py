"""References over DDS: four kinds of messages, one owner, a time-out, safe voltages where there is nothing usable."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import sent
from sent import MS, refer, stamped

from pam_antagonist.control.command import Mode

pytestmark = pytest.mark.ros

SAFE = (5.5, 5.5)


@pytest.fixture
def make(new_node: Callable[..., Any]) -> Callable[..., Any]:
    """A controller of left_elbow with parameters, and what it publishes."""
    from pam_antagonist.nodes.controller import ControllerNode

    def factory(**parameters: Any) -> Any:
        node = new_node(ControllerNode, **{"joint_name": "left_elbow", "diagnostics_period": 60.0, **parameters})
        node.trigger_activate()
        node.published = []
        node._output._publish = lambda data: node.published.append(node._valves(data)[1:])
        return node

    return factory


@pytest.fixture
def planner(ros: None) -> Iterator[Any]:
    import rclpy
    from rclpy.node import Node

    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = Node("planner", namespace="/pam", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


def estimate(node: Any, angle: float = 0.0, torque: float = 0.0, after: int = MS) -> tuple[float, float]:
    """One estimate; the command that answers it [V]."""
    node.stamp = getattr(node, "stamp", node.now_ns() + 10**9) + after  # ahead of the clock: never late
    sent.estimate(node, node.stamp, angle=angle, torque=torque)
    return node.published[-1]


def talk(node: Any, publisher: Any, message: Any, heard: Callable[[], bool]) -> None:
    """Publish until the node has what was meant."""
    end = time.monotonic() + 10.0
    while publisher.get_subscription_count() < 1:
        assert time.monotonic() < end, "the controller does not listen"
        time.sleep(0.005)
    publisher.publish(message)
    while not heard():
        assert time.monotonic() < end, "nothing was heard"
        node.input.poll()
        time.sleep(0.002)


def joint_state(names: list[str], **fields: list[float]) -> Any:
    from sensor_msgs.msg import JointState

    return JointState(name=names, **fields)


def trajectory(*points: tuple[float, list[float]], names: tuple[str, ...] = ("wrist", "left_elbow")) -> Any:
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    message = JointTrajectory(joint_names=list(names))
    for seconds, positions in points:
        point = JointTrajectoryPoint(positions=positions)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(seconds * 1e9), 10**9)
        message.points.append(point)
    return message


def array(*data: float) -> Any:
    from std_msgs.msg import Float64MultiArray

    return Float64MultiArray(data=list(data))


@pytest.mark.parametrize(
    ("source", "message", "mode", "value"),
    [
        ("joint_command", lambda: joint_state(["wrist", "left_elbow"], position=[0.3, 0.1]), 0, 0.1),
        ("joint_command", lambda: joint_state(["left_elbow"], effort=[0.7]), 1, 0.7),
        ("joint_command", lambda: joint_state(["left_elbow"], position=[math.nan], effort=[0.7]), 1, 0.7),
        ("commands", lambda: array(0.9, 0.2), 0, 0.2),
        ("joint_trajectory", lambda: trajectory((0.0, [0.9, -0.15])), 0, -0.15),
    ],
)
def test_standard_messages_are_references(
    make: Any, planner: Any, source: str, message: Any, mode: int, value: float
) -> None:
    node = make(reference_source=source, commands_index=1)
    publisher = planner.create_publisher(type(message()), source, 10)
    talk(node, publisher, message(), lambda: node._references.mode is not None)
    echoed: list[Any] = []
    node.input._echo.publish = echoed.append
    state = {"angle": value} if mode == 0 else {"torque": value}
    assert estimate(node, **state) == SAFE  # bumpless
    assert (int(node._references.mode), node._references.value) == (mode, value)
    error = {key: item - 0.05 for key, item in state.items()}
    assert estimate(node, **error)[0] > 5.6
    # A bag has what was followed in the package's own message.
    assert [(item.mode, item.value) for item in echoed] == [(mode, value)]
    health = node.health(1)["reference"]
    assert health.level == 0 and health.values["publishers"] == "/pam/planner"
    assert health.values["source"].startswith(f"/pam/{source} (")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("joint_command", lambda: joint_state(["wrist"], position=[0.3])),
        ("joint_command", lambda: joint_state(["left_elbow"], position=[math.nan], effort=[math.nan])),
        ("joint_command", lambda: joint_state(["left_elbow"], velocity=[0.1])),
        ("commands", lambda: array(math.nan)),
        ("joint_trajectory", lambda: trajectory((1.0, [0.1]), names=("wrist",))),
    ],
)
def test_what_does_not_ask_this_joint_changes_nothing_and_refreshes_nothing(
    make: Any, source: str, message: Any
) -> None:
    node = make(reference_source=source)
    node.input._accept(message())
    assert node._references.mode is None and estimate(node, angle=0.1) == SAFE
    node._references.set(Mode.ANGLE, 0.2, 5)
    node.input._accept(message())
    assert node._references._heard_ns == 5 and not node._references.complaint


@pytest.mark.parametrize(
    ("source", "message", "words"),
    [
        ("joint_command", lambda: joint_state(["a", "left_elbow"], position=[0.3]), "2 names and 1 of position"),
        ("joint_command", lambda: joint_state(["left_elbow"], position=[math.inf]), "finite"),
        ("commands", array, "0 numbers"),
        ("joint_trajectory", lambda: trajectory((1.0, [0.1])), "do not all have positions of this joint"),
        ("joint_trajectory", lambda: trajectory((1.0, [0.1, 0.1]), (1.0, [0.1, 0.1])), "times do not increase"),
        ("joint_trajectory", lambda: trajectory((1.0, [])), "neither positions nor efforts"),
    ],
)
def test_what_asks_this_joint_and_cannot_be_used_gives_safe_voltages(
    make: Any, source: str, message: Any, words: str
) -> None:
    node = make(reference_source=source)
    node.input._accept(message())
    assert words in node._references.complaint
    for _ in range(3):
        assert estimate(node, angle=0.1) == SAFE
    health = node.health(1)
    assert health["reference"].level == health["commands"].level == 2 and words in health["reference"].message


def test_a_trajectory_is_followed_in_time_with_feed_forward(make: Any) -> None:
    node = make(reference_source="joint_trajectory", angle_velocity=2.0, angle_proportional=0.0, angle_integral=0.0)
    node.stamp = node.now_ns() + 10**9
    message = trajectory((0.0, [0.0, 0.0]), (0.1, [0.0, 0.1]))
    node.input._accept(stamped(message, node.stamp))
    values = []
    for _ in range(120):
        estimate(node)
        values.append(node._references.value)
    assert values[:99] == pytest.approx([k * 1e-3 for k in range(1, 100)])
    assert values[100:] == [0.1] * 20
    # 1 rad/s, 2 V s/rad: the first command starts bumplessly, so the feed-forward shows when it ends.
    first = [voltage for voltage, _ in node.published]
    assert first[50] - first[110] == pytest.approx(2.0, abs=0.01)


def test_a_torque_that_nobody_repeats_ends_in_safe_voltages(make: Any, planner: Any) -> None:
    from pam_antagonist_msgs.msg import JointReference

    node = make(torque_reference_timeout=0.1)
    publisher = planner.create_publisher(JointReference, "reference", 10)
    talk(node, publisher, JointReference(mode=1, value=1.0), lambda: node._references.mode is not None)
    estimate(node, torque=1.0)
    assert estimate(node, torque=0.8)[0] > 6.0
    time.sleep(0.11)
    assert estimate(node) == SAFE
    health = node.health(1)
    assert health["reference"].message == "the reference timed out: safe voltages"
    assert health["commands"].level == 1 and "reference lost" in health["commands"].message
    talk(node, publisher, JointReference(mode=1, value=1.0), lambda: not node._references.lost)
    estimate(node, torque=1.0)
    assert estimate(node, torque=0.8)[0] > 6.0


def test_or_in_the_angle_that_was_estimated_then(make: Any) -> None:
    node = make(torque_reference_timeout=0.1, reference_lost="hold")
    node._references.set(Mode.TORQUE, 1.0, time.monotonic_ns() - 200 * MS)
    estimate(node, angle=0.2)
    assert node._references.value == 0.2
    assert estimate(node, angle=0.1)[0] > 5.6  # back to the angle
    assert "is held" in node.health(1)["reference"].message


def test_a_second_publisher_is_refused_and_named(make: Any, planner: Any) -> None:
    import rclpy
    from rclpy.node import Node

    from pam_antagonist_msgs.msg import JointReference

    node = make()
    first = planner.create_publisher(JointReference, "reference", 10)
    for k in range(150):  # two publishers whose numbers are near cannot be told apart
        talk(node, first, JointReference(mode=0, value=0.1), lambda k=k: node.input._owner._last == k + 1)
    second = Node("teleop", namespace="/pam", context=planner.context)
    try:
        other = second.create_publisher(JointReference, "reference", 10)
        talk(node, other, JointReference(mode=0, value=-0.3), lambda: node.input._owner.refused == 1)
        assert node._references._target == 0.1
        health = node.health(1)["reference"]
        assert health.level == 2
        assert health.message == "1 references of a second publisher refused: /pam/planner, /pam/teleop"
        assert node.health(2)["reference"].level == 1  # it is there, and silent
    finally:
        second.destroy_node()
    assert rclpy.ok()


@pytest.mark.parametrize(("mode", "value", "followed"), [(0, 0.5, 0.436333), (0, -20.0, -0.436333), (1, 3.3, 3.204112)])
def test_a_reference_out_of_range_is_limited_and_said(make: Any, mode: int, value: float, followed: float) -> None:
    node = make()
    refer(node, mode, value)
    estimate(node)
    estimate(node)
    assert node._references.value == pytest.approx(followed, rel=1e-5) and node.published[-1] != SAFE
    health = node.health(1)["reference"]
    assert health.level == 1 and "is limited to" in health.message and health.values["limited"] == 1


def test_the_slew_limit_begins_at_the_estimate(make: Any) -> None:
    node = make(max_angle_rate=1.0)
    refer(node, 0, 0.3)
    values = []
    for _ in range(10):
        estimate(node, angle=0.1)
        values.append(node._references.value)
    assert values == pytest.approx([0.1 + k * 1e-3 for k in range(10)])
