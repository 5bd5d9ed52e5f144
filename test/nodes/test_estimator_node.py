"""The estimator node in the process of the tests: messages in, messages out, whatever is missing or wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sent import MS, Sent, asked, measure, packed, stamp_of

pytestmark = pytest.mark.ros


@pytest.fixture
def node(new_node: Callable[..., Any]) -> Any:
    from pam_antagonist.nodes.estimator import EstimatorNode

    node = new_node(EstimatorNode)
    node.keep(estimates=node._estimates)
    node.published = node.sent["estimates"]
    return node


def test_fresh_samples_are_estimated_in_order_and_old_ones_are_flagged_late(node: Any) -> None:
    begin = node.now_ns()
    node.now_ns = lambda: begin + 20 * MS  # a busy machine makes no sample late
    measure(node, begin, math.nan)
    assert node.published == [], "the first whole sample comes later"
    for k in range(1, 20):
        measure(node, begin + k * MS)
    assert [stamp_of(item) for item in node.published] == [begin + k * MS for k in range(1, 20)]
    assert all(math.isfinite(item.angle) and math.isfinite(item.torque) for item in node.published)
    assert all(item.header.frame_id == "joint" for item in node.published)
    assert node.published[-1].flags & 64 == 0
    node.now_ns = lambda: begin + 10**9
    measure(node, begin + 20 * MS)
    assert node.published[-1].flags & 64


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_pressure_that_is_no_number_is_left_out_and_flagged(node: Any, bad: float) -> None:
    begin = node.now_ns()
    for k in range(40):
        measure(
            node,
            begin + k * MS,
            bad if 10 <= k < 30 else 450e3,
            bad if 20 <= k < 30 else 450e3,
            (bad if 20 <= k < 30 else 5.5, 5.5),
        )
    flags = [item.flags & 7 for item in node.published]
    assert flags == [0] * 10 + [1] * 10 + [7] * 10 + [0] * 10
    assert all(math.isfinite(item.angle) for item in node.published)
    assert math.isnan(node.published[15].innovation[0]) and math.isfinite(node.published[15].innovation[1])
    assert math.isnan(node.published[25].nis)


def test_diagnostics_are_named_after_node_and_part_and_tell_what_was_lost(node: Any) -> None:
    sent = node._diagnostics._publisher.publish = Sent(None)
    node._diagnose()
    (message,) = sent
    parts = ["samples", "filter", "time", "connections", "lifecycle"]
    assert [status.name for status in message.status] == [f"pam/estimator: {part}" for part in parts]
    assert all(status.hardware_id == "joint" for status in message.status)
    assert message.status[0].level == b"\x01"  # nothing has come yet
    assert message.header.stamp.sec > 0
    begin = node.now_ns()
    for k in range(10):
        measure(node, begin + k * MS)
    measure(node, begin + 3 * MS, p2=None, voltage=None)
    health = node.health(1)
    assert health["samples"].values["estimates"] == 10
    assert health["samples"].values["messages too late for their sample"] == 1
    assert health["filter"].values["processed"] == 10


def test_a_topic_that_stays_away_is_waited_for_and_then_left_out(node: Any) -> None:
    begin = node.now_ns()
    node._pairing._clock = lambda: begin  # a busy machine takes longer than it waits
    for k in range(60):
        measure(node, begin + k * MS, p2=450e3 if k < 10 else None)
    waiting = node._pairing.expire()
    assert len(node.published) == 10 and waiting == []
    node._pairing._clock = lambda: begin + 10**9
    node._take(node._pairing.expire())
    assert [stamp_of(item) for item in node.published[10:]] == [begin + k * MS for k in range(10, 39)]
    assert all(item.flags & 2 for item in node.published[10:])
    assert node.health(1)["samples"].values["incomplete"] == 29


_SECOND = 10**9


def own_driver(node: Any, second: int, *, skip: str = "", **stamps: Any) -> Any:
    """A second of a driver of one's own at 100 Hz; what is said of it then.

    `skip`: a topic that it does not publish. `stamps`: of a topic [ns], by the stamp of the sample.
    """
    for k in range(100):
        at = _SECOND * (1000 + second) + 10 * MS * k
        for topic, given in (("p1", {"p1": 450e3}), ("p2", {"p2": 450e3}), ("voltage", {"voltage": (5.5, 5.5)})):
            if topic != skip:
                values = {"p1": None, "p2": None, "voltage": None, **given}
                measure(node, stamps.get(topic, lambda stamp: stamp)(at), **values)
    node._pairing._clock = lambda: _SECOND * (10**6 + second)
    node._take(node._pairing.expire())
    return node.health(_SECOND * second)["samples"]


CAUSES: dict[str, tuple[dict[str, Any], str]] = {
    "sent": (
        {"p2": lambda at: at + 40_000, "voltage": lambda at: at + 80_000},
        "messages come, but no stamp of theirs is the same: pressure_2 40 us after pressure_1 and valve_state 80 us "
        "after pressure_1; expected one and the same stamp on all messages of a sample",
    ),
    "one is apart": ({"voltage": lambda at: at - 3 * MS}, "valve_state 3 ms before pressure_1; expected one"),
    "two clocks": ({"p2": lambda at: at % (50 * _SECOND)}, "pressure_2 1e+03 s before pressure_1 (two clocks)"),
    "all 0": (
        dict.fromkeys(("p1", "p2", "voltage"), lambda at: 0),
        "no message of pressure_1, pressure_2 and valve_state carries a stamp (all are 0), expected the time",
    ),
    "one is 0": ({"voltage": lambda at: 0}, "no message of valve_state carries a stamp"),
    "one stands": ({"p1": lambda at: 7 * _SECOND}, "every message of pressure_1 has the stamp 7 s, expected the time"),
    "no valve_state": (
        {"skip": "voltage"},
        "messages of pressure_1 and pressure_2 come, but nobody publishes /pam/valve_state; the estimator needs "
        "valve_state too",
    ),
    "no pressures": (
        {"skip": "p1"},
        "messages of pressure_2 and valve_state come, but nobody publishes /pam/pressure_1",
    ),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_each_cause_of_no_samples_has_its_own_sentence_in_diagnostics_and_once_in_the_log(
    node: Any, cause: str, capfd: pytest.CaptureFixture[str]
) -> None:
    node.trigger_activate()
    capfd.readouterr()
    given, words = CAUSES[cause]
    for second in (-2, -1):  # until then nobody publishes, which is logged as a warning
        assert node.health(_SECOND * second)["samples"].level == 1
    for second in range(1, 4):
        said = own_driver(node, second, **given)
        assert said.level == 2 and words in said.message, said.message
    assert capfd.readouterr().err.count(words) == 1
    assert own_driver(node, 5).level < 2, "right stamps"


def test_nobody_publishes_is_said_and_so_are_values_that_are_no_numbers(
    node: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    node.trigger_activate()
    capfd.readouterr()
    for second in (1, 2):
        said = node.health(_SECOND * second)["samples"]
        assert said.level == 1
        assert said.message == "no samples: nobody publishes /pam/pressure_1, /pam/pressure_2 and /pam/valve_state"
    assert capfd.readouterr().err.count("nobody publishes") == 1
    begin = node.now_ns()
    for k in range(5):
        measure(node, begin + k * MS, p2=math.nan)
    said = node.health(3 * _SECOND)["samples"]
    assert said.level == 2
    assert said.message == "the filter has not started: the last sample has no number of pressure_2"
    measure(node, begin + 5 * MS, p1=450.0)
    assert "has not started: pressure 1 is 450, expected" in node.health(4 * _SECOND)["samples"].message


def test_a_topic_that_is_missing_in_many_samples_is_named(node: Any) -> None:
    node.trigger_activate()
    own_driver(node, 1)
    begin = 1002 * _SECOND
    node.now_ns = lambda: begin
    for k in range(100):
        measure(node, begin + 10 * MS * k, voltage=(5.5, 5.5) if k % 10 == 0 else None)
    said = node.health(2 * _SECOND)["samples"].message
    assert said.endswith("81 incomplete samples: 81 of the last 91 samples lack valve_state")


def test_two_publishers_of_a_topic_of_the_samples_or_of_the_estimates_are_named(node: Any) -> None:
    import time

    from rclpy.node import Node
    from sensor_msgs.msg import FluidPressure

    from pam_antagonist.nodes import qos
    from pam_antagonist_msgs.msg import JointEstimate

    node.trigger_activate()
    drivers = [Node(name, namespace="/pam") for name in ("plant", "my_driver")]
    try:
        for driver in drivers:
            driver.create_publisher(FluidPressure, "pressure_2", qos.STREAM)
        end = time.monotonic() + 10.0
        while node.count_publishers("/pam/pressure_2") < 2 and time.monotonic() < end:
            time.sleep(0.01)
        said = own_driver(node, 1)
        assert said.level == 2
        assert said.message.startswith("2 nodes publish /pam/pressure_2: /pam/my_driver and /pam/plant; expected one")
        assert not node._mixed, "one of them is silent, as one that was killed"
        begin = 1010 * _SECOND
        node.now_ns = lambda: begin
        for k in range(40):
            measure(node, begin + k * MS)
        assert not node.health(2 * _SECOND)["samples"].message.startswith("every") and node.published[-1].flags == 0
        for k in range(40, 80):
            measure(node, begin + k * MS)
            measure(node, begin + k * MS + 300_000, p1=300e3)
        assert node.health(4 * _SECOND)["samples"].message.startswith("every estimate is flagged LATE: 2 nodes publish")
        measure(node, begin + 80 * MS)
        assert node.published[-1].flags & JointEstimate.LATE
        for k in range(81, 120):
            measure(node, begin + k * MS)
        assert node.health(6 * _SECOND)["samples"].message.startswith("2 nodes publish /pam/pressure_2")
        measure(node, begin + 120 * MS)
        assert not node.published[-1].flags & JointEstimate.LATE, "the other one is silent again"
        drivers[0].create_publisher(JointEstimate, "joint_estimate", qos.STREAM)
        while node.count_publishers("/pam/joint_estimate") < 2 and time.monotonic() < end:
            time.sleep(0.01)
        assert "nodes publish /pam/joint_estimate: /pam/estimator and /pam/plant" in own_driver(node, 20).message
    finally:
        for driver in drivers:
            driver.destroy_node()


def test_an_encoder_is_used_and_a_bad_one_is_refused_with_the_correction(new_node: Callable[..., Any]) -> None:
    from sensor_msgs.msg import JointState

    from pam_antagonist.nodes.estimator import EstimatorNode
    from pam_antagonist.nodes.pairing import ANGLE

    node = new_node(EstimatorNode, rig="shin2022_external_torque", angle_sensor="encoder")
    node.keep(torques=node._external)
    begin = node.now_ns()
    for k in range(400):
        measure(node, begin + k * MS)
        angle = 1e-6 * k + (0.2 if k >= 200 else 0.0)
        node.take_message(ANGLE, packed(JointState(name=["joint"], position=[angle]), begin + k * MS))
        if k == 199:
            assert node.health(1)["encoder"].message == "used"
    torques = [message.wrench.torque.z for message in node.sent["torques"]]
    assert len(torques) == 400 and all(map(math.isfinite, torques))
    state = node.health(2)["encoder"]
    assert state.message.startswith("refused: the encoder jumped by +11.5°") and "~/reset" in state.message
    assert asked(node._reset)[0]
    assert node._estimator.encoder_complaint == ""


def test_a_checkpoint_is_published_once_a_second_and_when_the_state_is_set(node: Any) -> None:
    from pam_antagonist_msgs.msg import FilterCheckpoint

    sent = node._checkpoints = Sent(FilterCheckpoint)
    sent.publish = sent  # type: ignore[attr-defined]
    node._remember()
    assert sent == []  # the filter is not started
    begin = node.now_ns()
    for k in range(20):
        measure(node, begin + k * MS)
    node._remember()
    node._remember()  # nothing new
    (first,) = sent
    assert first.rig == "shin2022" and first.tuning == "default" and len(first.state) == 4
    assert stamp_of(first) == begin + 19 * MS and first.header.frame_id == "joint"
    assert asked(node._set_state, angle=0.1, velocity=0.0, pressure=[4e5, 4e5])[0]
    assert len(sent) == 2 and sent[1].state[0] == 0.1 and sent[1].started == sent[1].header.stamp


def test_a_message_holds_what_the_filter_remembers() -> None:
    from rclpy.serialization import serialize_message

    from pam_antagonist.estimation import Estimator
    from pam_antagonist.nodes.estimator import checkpoint_message
    from pam_antagonist.recording import signals
    from pam_antagonist.recording.cdr import Payloads, decode
    from pam_antagonist.recording.topics import TOPICS
    from pam_antagonist.rig import load_rig

    estimator, other = (Estimator(load_rig("shin2022")) for _ in range(2))
    stamps = 10**18 + MS * np.arange(200)
    pressure, voltage = np.full((200, 2), 450e3) + np.arange(200)[:, None] * 100.0, np.full((200, 2), 5.5)
    estimator.run(stamps[:100], pressure[:100], voltage[:100])
    data = Payloads.of([serialize_message(checkpoint_message(estimator.checkpoint(), "elbow"))])
    (recorded,) = signals.read_checkpoints(decode(data, TOPICS["filter_checkpoint"].type), np.arange(1))
    other.restore(recorded)
    whole, rest = (one.run(stamps[100:], pressure[100:], voltage[100:]) for one in (estimator, other))
    assert rest.rows.tobytes() == whole.rows.tobytes()


def test_a_computer_that_is_too_slow_is_told_so_in_a_sentence(node: Any) -> None:
    begin = node.now_ns()
    node.now_ns = lambda: begin + 300 * MS
    for k in range(100):
        measure(node, begin + k * MS)
    said = node.health(_SECOND)["samples"]
    assert said.level == 1
    words, todo = said.message.split(". ")
    assert words == "this computer is too slow for 1000 samples a second: half of them are 250 ms old or more"
    assert todo == "Set a longer sample_period in the rig file, or end other programs"
    node.now_ns = lambda: begin + 10 * _SECOND
    for k in range(100, 200):
        measure(node, begin + k * MS)
    said = node.health(2 * _SECOND)["samples"]
    assert said.message == "the samples are 9.85 s old: they are of a recording, or stamped by another clock"
