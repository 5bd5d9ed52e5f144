"""Packed messages are what rclpy makes of message objects; unpacked ones hold their values."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from pam_antagonist.estimation import ESTIMATE_DTYPE
from pam_antagonist.nodes import wire

pytestmark = pytest.mark.ros

STAMP = 1_795_000_123 * 10**9 + 987_654_321
FRAMES = ["", "j", "ab", "abc", "abcd", "joint", "muscle_1", "a_long_frame_name/with_a_slash"]


@pytest.fixture
def node(ros: None) -> Iterator[Any]:
    import rclpy

    node = rclpy.create_node("wire")
    yield node
    node.destroy_node()


def header(message: Any, frame: str) -> Any:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(STAMP, 10**9)
    message.header.frame_id = frame
    return message


def estimate(frame: str) -> tuple[Any, np.void]:
    """A message with a different number in every field, and the row that holds the same."""
    from pam_antagonist_msgs.msg import JointEstimate

    row = np.zeros(1, ESTIMATE_DTYPE)
    numbers = row.view(np.float64).reshape(-1)
    numbers[:24] = np.arange(1.0, 25.0) / 7.0
    numbers[23] = math.nan
    row["subsystem"], row["flags"] = 17, 9
    numbers[26:] = np.arange(1.0, 6.0) / 11.0
    message = header(JointEstimate(), frame)
    message.started.sec, message.started.nanosec = 1_795_000_001, 5
    names = ESTIMATE_DTYPE.names or ()
    for name in names:
        value = row[name][0]
        if name in ("subsystem", "flags"):
            setattr(message, name, int(value))
        else:
            setattr(message, name, float(value) if np.ndim(value) == 0 else np.ravel(value))
    return message, row[0]


def assert_same(packed: bytes, message: Any) -> None:
    """Read by rclpy as the same; its own bytes have anything between the fields, and at times eight more at the end."""
    from rclpy.serialization import deserialize_message, serialize_message

    assert 0 <= len(serialize_message(message)) - len(packed) <= 8
    assert str(deserialize_message(packed, type(message))) == str(message)


@pytest.mark.parametrize("frame", FRAMES)
def test_packed_is_what_rclpy_serialises(node: Any, frame: str) -> None:
    from sensor_msgs.msg import FluidPressure, JointState

    from pam_antagonist_msgs.msg import ValveCommand

    pressure = header(FluidPressure(fluid_pressure=4.5e5, variance=4e5), frame)
    out = wire.Outgoing(node, "pressure_1", frame, wire.PRESSURE)
    assert_same(out.bytes_of(STAMP, 4.5e5, 4e5), pressure)

    valves = header(ValveCommand(voltage=[1.25, 9.5]), frame)
    out = wire.Outgoing(node, "valve_state", frame, wire.VALVES)
    assert_same(out.bytes_of(STAMP, 1.25, 9.5), valves)

    for velocity in (True, False):
        body, values = wire.joint_state("joint", "position", *(("velocity",) if velocity else ()), "effort")
        state = header(JointState(name=["joint"], position=[0.1], effort=[-2.0]), frame)
        if velocity:
            state.velocity = [3.0]
        out = wire.Outgoing(node, "joint_states", frame, body)
        numbers = values(0.1, 3.0, -2.0) if velocity else values(0.1, -2.0)
        assert_same(out.bytes_of(STAMP, *numbers), state)

    message, row = estimate(frame)
    out = wire.Outgoing(node, "joint_estimate", frame, wire.ESTIMATE)
    assert_same(out.bytes_of(STAMP, 1_795_000_001, 5, row.tobytes()[:192], 17, 9, row.tobytes()[-40:]), message)


@pytest.mark.parametrize("frame", FRAMES)
def test_unpacked_is_what_was_serialised(ros: None, frame: str) -> None:
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import FluidPressure

    from pam_antagonist_msgs.msg import ValveCommand

    pressure = serialize_message(header(FluidPressure(fluid_pressure=4.5e5, variance=4e5), frame))
    assert wire.Incoming(wire.PRESSURE)(pressure) == (STAMP, 4.5e5, 4e5)
    valves = serialize_message(header(ValveCommand(voltage=[1.25, 9.5]), frame))
    assert wire.Incoming(wire.VALVES)(valves) == (STAMP, 1.25, 9.5)
    message, row = estimate(frame)
    stamp, *taken = wire.Incoming(wire.ESTIMATE_FOR_CONTROL)(serialize_message(message))
    expected = [
        *(row[name] for name in ("angle", "velocity", "torque")), *np.diag(row["covariance"]), *row["pressure"],
        *np.diag(row["innovation_covariance"]), row["nis"], 9, row["external_torque"],
        row["external_torque_covariance"][3],
    ]  # fmt: skip
    assert stamp == STAMP
    np.testing.assert_array_equal(taken, expected)
    np.testing.assert_array_equal(wire.for_control(row.tobytes(), 9), expected)


def test_the_other_byte_order_is_understood() -> None:
    data = struct.pack(">4siII3sxdd", b"\x00\x00\x00\x00", 7, 8, 3, b"ab\0", 1.5, 2.5)
    assert wire.Incoming(wire.VALVES)(data) == (7 * 10**9 + 8, 1.5, 2.5)


def test_names_of_any_length_do_not_fill_the_memory() -> None:
    unpack = wire.Incoming(wire.VALVES)
    for length in range(1, 2000):
        data = wire.layout(wire.VALVES, length).pack(b"\x00\x01\x00\x00", 1, 2, length, b"x" * length, 3.0, 4.0)
        assert unpack(data) == (10**9 + 2, 3.0, 4.0)
    assert wire.layout.cache_info().currsize <= 64


@pytest.mark.parametrize("frame", FRAMES)
def test_an_encoder_s_message_is_packed_and_read(node: Any, frame: str) -> None:
    from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import JointState

    state = header(JointState(name=["joint"], position=[0.1]), frame)
    body, values = wire.joint_state("joint", "position")
    assert_same(wire.Outgoing(node, "angle_sensor", frame, body).bytes_of(STAMP, *values(0.1)), state)
    for message, expected in (
        (state, 0.1),
        (JointState(name=["a", "joint"], position=[0.3, 0.2], effort=[1.0, 2.0]), 0.2),
        (JointState(position=[0.4]), 0.4),
        (JointState(name=["a", "b"], position=[0.3, 0.2]), None),
        (JointState(name=["joint"], effort=[1.0]), None),
    ):
        stamp, angle = wire.position_in(serialize_message(header(message, frame)), "joint")
        assert stamp == STAMP and (math.isnan(angle) if expected is None else angle == expected)
    wrench = WrenchStamped(wrench=Wrench(torque=Vector3(z=1.5)))
    out = wire.Outgoing(node, "external_torque", frame, wire.WRENCH)
    assert_same(out.bytes_of(STAMP, 0.0, 0.0, 0.0, 0.0, 0.0, 1.5), header(wrench, frame))
