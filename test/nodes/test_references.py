"""References over DDS: four kinds of messages, one owner, a time-out, safe voltages where there is nothing usable."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from sent import MS, Loop, stamped

from pam_antagonist.control.command import Mode

pytestmark = pytest.mark.ros

SAFE = (5.5, 5.5)


@pytest.fixture
def make(controller: Callable[..., Loop]) -> Callable[..., Loop]:
    """A controller of left_elbow with parameters."""
    return partial(controller, joint_name="left_elbow", diagnostics_period=60.0)


@pytest.fixture
def planner(ros: None) -> Iterator[Any]:
    from probe import Probe

    with Probe(name="planner") as planner:
        yield planner.node


def talk(loop: Loop, publisher: Any, message: Any, heard: Callable[[], bool]) -> None:
    """Publish until the controller has what was meant."""
    end = time.monotonic() + 10.0
    while publisher.get_subscription_count() < 1:
        assert time.monotonic() < end, "the controller does not listen"
        time.sleep(0.005)
    publisher.publish(message)
    while not heard():
        assert time.monotonic() < end, "nothing was heard"
        loop.node.input.poll()
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
    make: Callable[..., Loop], planner: Any, source: str, message: Any, mode: int, value: float
) -> None:
    loop = make(reference_source=source, commands_index=1)
    publisher = planner.create_publisher(type(message()), source, 10)
    talk(loop, publisher, message(), lambda: loop.references.mode is not None)
    echoed: list[Any] = []
    loop.node.input._echo.publish = echoed.append
    state = {"angle": value} if mode == 0 else {"torque": value}
    assert loop.run(**state) == SAFE  # bumpless
    assert (int(loop.references.mode), loop.references.value) == (mode, value)
    error = {key: item - 0.05 for key, item in state.items()}
    assert loop.run(**error)[0] > 5.6
    # A bag has what was followed in the package's own message.
    assert [(item.mode, item.value) for item in echoed] == [(mode, value)]
    from pam_antagonist.nodes.health import publishers_of

    end = time.monotonic() + 5.0  # a name may come after its endpoint
    while "UNKNOWN" in "".join(publishers_of(loop.node, source)) and time.monotonic() < end:
        time.sleep(0.05)
    health = loop.health("reference")
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
    make: Callable[..., Loop], source: str, message: Any
) -> None:
    loop = make(reference_source=source)
    loop.node.input._accept(message())
    assert loop.references.mode is None and loop.run(angle=0.1) == SAFE
    loop.references.set(Mode.ANGLE, 0.2, 5)
    loop.node.input._accept(message())
    assert loop.references._heard_ns == 5 and not loop.references.complaint


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
    make: Callable[..., Loop], source: str, message: Any, words: str
) -> None:
    loop = make(reference_source=source)
    loop.node.input._accept(message())
    assert words in loop.references.complaint
    for _ in range(3):
        assert loop.run(angle=0.1) == SAFE
    health = loop.node.health(1)
    assert health["reference"].level == health["commands"].level == 2 and words in health["reference"].message


def test_a_trajectory_is_followed_in_time_with_feed_forward(make: Callable[..., Loop]) -> None:
    loop = make(reference_source="joint_trajectory", angle_velocity=2.0, angle_proportional=0.0, angle_integral=0.0)
    message = trajectory((0.0, [0.0, 0.0]), (0.1, [0.0, 0.1]))
    loop.node.input._accept(stamped(message, loop.now))
    values = []
    for _ in range(120):
        loop.run()
        values.append(loop.references.value)
    assert values[:99] == pytest.approx([k * 1e-3 for k in range(1, 100)])
    assert values[100:] == [0.1] * 20
    # 1 rad/s, 2 V s/rad: the first command starts bumplessly, so the feed-forward shows when it ends.
    first = [voltage for voltage, _ in loop.voltages]
    assert first[50] - first[110] == pytest.approx(2.0, abs=0.01)


def test_a_torque_that_nobody_repeats_ends_in_safe_voltages(make: Callable[..., Loop], planner: Any) -> None:
    from pam_antagonist_msgs.msg import JointReference

    loop = make(torque_reference_timeout=0.1)
    publisher = planner.create_publisher(JointReference, "reference", 10)
    talk(loop, publisher, JointReference(mode=1, value=1.0), lambda: loop.references.mode is not None)
    loop.run(torque=1.0)
    assert loop.run(torque=0.8)[0] > 6.0
    time.sleep(0.11)
    assert loop.run() == SAFE
    health = loop.node.health(1)
    assert health["reference"].message == "the reference timed out: safe voltages"
    assert health["commands"].level == 1 and "reference lost" in health["commands"].message
    talk(loop, publisher, JointReference(mode=1, value=1.0), lambda: not loop.references.lost)
    loop.run(torque=1.0)
    assert loop.run(torque=0.8)[0] > 6.0


def test_or_in_the_angle_that_was_estimated_then(make: Callable[..., Loop]) -> None:
    loop = make(torque_reference_timeout=0.1, reference_lost="hold")
    loop.references.set(Mode.TORQUE, 1.0, time.monotonic_ns() - 200 * MS)
    loop.run(angle=0.2)
    assert loop.references.value == 0.2
    assert loop.run(angle=0.1)[0] > 5.6  # back to the angle
    assert "is held" in loop.health("reference").message


def test_a_second_publisher_is_refused_and_named(make: Callable[..., Loop], planner: Any) -> None:
    from rclpy.node import Node

    from pam_antagonist_msgs.msg import JointReference

    loop = make()
    first = planner.create_publisher(JointReference, "reference", 10)
    for k in range(150):  # two publishers whose numbers are near cannot be told apart
        talk(loop, first, JointReference(mode=0, value=0.1), lambda k=k: loop.node.input._owner._last == k + 1)
    second = Node("teleop", namespace="/pam", context=planner.context)
    try:
        other = second.create_publisher(JointReference, "reference", 10)
        talk(loop, other, JointReference(mode=0, value=-0.3), lambda: loop.node.input._owner.refused == 1)
        assert loop.references._target == 0.1
        health = loop.health("reference")
        assert health.level == 2
        assert health.message == "1 references of a second publisher refused: /pam/planner, /pam/teleop"
        assert loop.health("reference").level == 1  # it is there, and silent
    finally:
        second.destroy_node()


@pytest.mark.parametrize(("mode", "value", "followed"), [(0, 0.5, 0.436333), (0, -20.0, -0.436333), (1, 3.3, 3.204112)])
def test_a_reference_out_of_range_is_limited_and_said(
    make: Callable[..., Loop], mode: int, value: float, followed: float
) -> None:
    loop = make()
    loop.refer(mode, value)
    loop.run(2)
    assert loop.references.value == pytest.approx(followed, rel=1e-5) and loop.voltages[-1] != SAFE
    health = loop.health("reference")
    assert health.level == 1 and "is limited to" in health.message and health.values["limited"] == 1


def test_the_slew_limit_begins_at_the_estimate(make: Callable[..., Loop]) -> None:
    loop = make(max_angle_rate=1.0)
    loop.refer(0, 0.3)
    values = []
    for _ in range(10):
        loop.run(angle=0.1)
        values.append(loop.references.value)
    assert values == pytest.approx([0.1 + k * 1e-3 for k in range(10)])
