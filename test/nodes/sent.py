"""What nodes in the process of the tests are given, and what they would send; without ROS until it is used."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from pam_antagonist.errors import BadInput

MS = 1_000_000


class Sent(list):
    """Messages of a topic, as objects."""

    def __init__(self, kind: Any) -> None:
        self.kind = kind

    def __call__(self, data: Any) -> None:
        from rclpy.serialization import deserialize_message

        self.append(deserialize_message(data, self.kind) if isinstance(data, bytes) else data)


def stamp_of(message: Any) -> int:
    """The time in a message's header [ns]."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def stamped(message: Any, stamp_ns: int) -> Any:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return message


def packed(message: Any, stamp_ns: int = 0) -> bytes:
    """A message with this stamp, serialised."""
    from rclpy.serialization import serialize_message

    return bytes(serialize_message(stamped(message, stamp_ns)))


def asked(answer: Callable[[Any], str], **request: Any) -> tuple[bool, str]:
    """What a service of a node answers: success and message."""
    try:
        return True, answer(SimpleNamespace(**request))
    except BadInput as error:
        return False, str(error)


def command(node: Any, first: float, second: float, now_ns: int) -> None:
    """A command to the node that owns the valves [V]."""
    from pam_antagonist_msgs.msg import ValveCommand

    node.port.accept(packed(ValveCommand(voltage=[first, second])), now_ns)


def refer(node: Any, mode: int, value: float, stiffness: float = float("nan"), damping: float = float("nan")) -> None:
    """A reference of a controller."""
    from pam_antagonist_msgs.msg import JointReference

    node.input.reference(JointReference(mode=mode, value=value, stiffness=stiffness, damping=damping))


def estimate(node: Any, stamp_ns: int, pressure: float = 450e3, variance: float = 0.0, **fields: Any) -> None:
    """An estimate for a controller."""
    from pam_antagonist_msgs.msg import JointEstimate

    message = JointEstimate(pressure=[pressure, pressure], **fields)
    message.covariance[0] = variance
    message.header.frame_id = "somewhere_else"
    node.take_message(packed(message, stamp_ns))


def measure(
    node: Any, stamp_ns: int, p1: float | None = 450e3, p2: float | None = 450e3, voltage: Any = (5.5, 5.5)
) -> None:
    """A sample for an estimator: one message of each topic that is given a value."""
    from sensor_msgs.msg import FluidPressure

    from pam_antagonist.nodes.pairing import PRESSURE_1, PRESSURE_2, VALVES
    from pam_antagonist_msgs.msg import ValveCommand

    for place, value in ((PRESSURE_1, p1), (PRESSURE_2, p2)):
        if value is not None:
            node.take_message(place, packed(FluidPressure(fluid_pressure=value), stamp_ns))
    if voltage is not None:
        node.take_message(VALVES, packed(ValveCommand(voltage=voltage), stamp_ns))
