"""What nodes in the process of the tests are given, and what they would send; without ROS until it is used."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
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


def refer(node: Any, mode: int, value: float, stiffness: float = math.nan, damping: float = math.nan) -> None:
    """A reference of a controller."""
    from pam_antagonist_msgs.msg import JointReference

    node.input.reference(JointReference(mode=mode, value=value, stiffness=stiffness, damping=damping))


class Loop:
    """A controller whose estimates are a millisecond apart, each of this moment: never late on a busy machine."""

    def __init__(self, node: Any) -> None:
        self.node, self.references, self.refer = node, node._references, partial(refer, node)
        self.now = node.now_ns()
        node.now_ns = lambda: self.now
        node.trigger_activate()
        node.keep(commands=node._output)

    @property
    def commands(self) -> list[tuple[int, tuple[float, float]]]:
        """Stamp and voltages of each command so far."""
        return [(stamp_of(message), tuple(message.voltage)) for message in self.node.sent["commands"]]

    @property
    def voltages(self) -> list[tuple[float, float]]:
        """Voltages of each command so far."""
        return [voltage for _, voltage in self.commands]

    def run(self, count: int = 1, variance: float = 0.0, **fields: Any) -> tuple[float, float]:
        """Give it estimates; the last command [V]."""
        from pam_antagonist_msgs.msg import JointEstimate

        message = JointEstimate(**{"pressure": [450e3, 450e3], **fields})
        message.covariance[0] = variance
        message.header.frame_id = "somewhere_else"
        for _ in range(count):
            self.now += MS
            self.node.take_message(packed(message, self.now))
        return tuple(self.node.sent["commands"][-1].voltage)

    def silent(self, milliseconds: float) -> None:
        """Let time pass since the last estimate."""
        heard = self.node._heard
        self.node._heard = heard._replace(steady_ns=heard.steady_ns - round(milliseconds * MS))

    def choose(self, **values: Any) -> tuple[bool, str]:
        """Set parameters; whether it was done, and why not."""
        from rclpy.parameter import Parameter

        result = self.node.set_parameters_atomically([Parameter(name, value=value) for name, value in values.items()])
        return result.successful, result.reason

    def health(self, part: str) -> Any:
        """What it says about one of its parts."""
        return self.node.health(self.now)[part]


def measure(
    node: Any, stamp_ns: int, p1: float | None = 450e3, p2: float | None = 450e3, voltage: Any = (5.5, 5.5)
) -> None:
    """A sample for an estimator: one message of each topic that is given a value."""
    from sensor_msgs.msg import FluidPressure

    from pam_antagonist.nodes.pairing import PRESSURE_1, PRESSURE_2, VOLTAGES
    from pam_antagonist_msgs.msg import ValveCommand

    for place, value in ((PRESSURE_1, p1), (PRESSURE_2, p2)):
        if value is not None:
            node.take_message(place, packed(FluidPressure(fluid_pressure=value), stamp_ns))
    if voltage is not None:
        node.take_message(VOLTAGES, packed(ValveCommand(voltage=voltage), stamp_ns))
