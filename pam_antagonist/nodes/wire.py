"""Fast serialisation of the 1 kHz messages.

To convert between message objects and bytes, rclpy handles every field in Python. This takes 6 to 9 µs for each
publisher and 9 to 16 µs for each subscriber of a sample, a third of the round trip from pressure to command. All these
messages have a fixed layout after their header. This module packs and unpacks them in one step (1 µs), and uses rclpy's
interface for serialised messages.

The layout is CDR (OMG DDS-XTypes, plain CDR version 1), which every ROS 2 middleware uses: four bytes for the encoding,
then the fields in order, each aligned to its size relative to the end of these four bytes.
"""

from __future__ import annotations

import importlib
import math
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

from pam_antagonist.nodes import qos
from pam_antagonist.nodes.pairing import ANGLE, PRESSURE_1, PRESSURE_2, VOLTAGES, WHOLE
from pam_antagonist.recording.topics import STATE_TOPICS, TOPICS

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from rclpy.node import Node
    from rclpy.subscription import Subscription

    from pam_antagonist.nodes.node import PamNode
    from pam_antagonist.rig import Rig

Body = Sequence[tuple[str, int]]
"""Layout after the header: formats of :mod:`struct`, each with the alignment of its first value."""

PRESSURE: Body = (("dd", 8),)
PRESSURE_ALONE: Body = (("d", 8),)
"""``sensor_msgs/FluidPressure``: pressure, variance."""

VALVES: Body = (("dd", 8),)
"""``pam_antagonist_msgs/ValveCommand``: voltage 1, voltage 2."""

SAMPLE: Body = (("9d", 8),)
"""``pam_antagonist_msgs/JointSample``: pressures, voltages, asked pressures, angle, torque, angle as an input."""

WRENCH: Body = (("6d", 8),)
"""``geometry_msgs/WrenchStamped``: force and torque, x, y and z each."""

ESTIMATE_VALUES, EXTERNAL_VALUES = 24, 5
"""Number of float64 values in a JointEstimate before subsystem and flags, and after them (external torque and its
covariance). The order is that of the message and of ``ESTIMATE_DTYPE``."""

ESTIMATE: Body = (("iI", 4), (f"{8 * ESTIMATE_VALUES}s", 8), ("BB", 1), (f"{8 * EXTERNAL_VALUES}s", 8))
"""``pam_antagonist_msgs/JointEstimate``: started (s, ns), the first values as raw memory, subsystem, flags, and the
external torque with its covariance as raw memory."""

_FOR_CONTROL, _EXTERNAL = "4d24xd24x3d40xd16x2d", "d24xd"
ESTIMATE_FOR_CONTROL: Body = (("8x", 4), (_FOR_CONTROL, 8), ("xB", 1), (_EXTERNAL, 8))
"""``pam_antagonist_msgs/JointEstimate``, only the values that a controller uses: angle, velocity, torque and their
variances, pressures, variances of their innovations, normalised innovation squared, flags, external torque and its
variance."""

_HEADER = "4siII"  # encoding, stamp, length of the frame's name
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_SECOND = 1_000_000_000


def joint_state(name: str, *given: str) -> tuple[Body, Callable[..., list[object]]]:
    """Layout of a ``sensor_msgs/JointState`` of one joint that has some of position, velocity and effort.

    Returns the body, and a function that inserts the given ones between the constant parts.
    """
    text = name.encode() + b"\0"
    constant: list[object] = [1, len(text), text]
    body = [("I", 4), (f"I{len(text)}s", 4)]
    places = []
    for field in ("position", "velocity", "effort"):
        there = field in given
        body += [("I", 4), ("d", 8)] if there else [("I", 4)]
        constant += [1, 0.0] if there else [0]
        places += [len(constant) - 1] if there else []

    def values(*numbers: float) -> list[object]:
        out = constant.copy()
        for place, number in zip(places, numbers, strict=True):
            out[place] = number
        return out

    return tuple(body), values


def position_in(data: bytes, joint: str) -> tuple[int, float]:
    """Stamp [ns] and position of one joint in a serialised ``sensor_msgs/JointState``.

    Returns the stamp [ns], and the position [rad]; NaN where the message has none for this joint.
    """
    order = "<" if data[1] & 1 else ">"
    number = struct.Struct(f"{order}I")

    def count(at: int) -> tuple[int, int]:
        at += -at % 4
        return int(number.unpack_from(data, at)[0]), at + 4

    second, nanosecond = struct.unpack_from(f"{order}iI", data, 4)
    size, at = count(12)
    many, at = count(at + size)
    names = []
    for _ in range(many):
        size, at = count(at)
        names.append(data[at : at + size - 1])
        at += size
    positions, at = count(at)
    at += -(at - 4) % 8
    index = 0 if positions == 1 else names.index(joint.encode()) if joint.encode() in names else positions
    stamp = second * _SECOND + nanosecond
    return stamp, struct.unpack_from(f"{order}d", data, at + 8 * index)[0] if index < positions else math.nan


@lru_cache(maxsize=64)
def layout(body: Body, frame_bytes: int, order: str = "<") -> struct.Struct:
    """The whole message as one struct. `order`: of the bytes, ``<`` or ``>``."""
    text = f"{order}{_HEADER}{frame_bytes}s"
    for part, alignment in body:
        position = struct.calcsize(text) - 4
        text += f"{-position % alignment}x{part}"
    return struct.Struct(text)


def message_class(topic: str) -> Any:
    """The class of a topic's messages. `topic`: logical name."""
    return class_of(TOPICS[topic].type)


def class_of(kind: str) -> Any:
    """The class of a message type such as ``sensor_msgs/msg/FluidPressure``."""
    package, _, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


class Outgoing:
    """A publisher of a topic (logical name) that packs its messages."""

    def __init__(self, node: Node, topic: str, frame_id: str, body: Body) -> None:
        self.publisher = node.create_publisher(message_class(topic), TOPICS[topic].relative, qos.STREAM)
        self._publish = self.publisher.handle.publish_raw  # as rclpy's publish, without its type check
        self._frame = frame_id.encode() + b"\0"
        self._pack = layout(tuple(body), len(self._frame)).pack

    def bytes_of(self, stamp_ns: int, *values: object) -> bytes:
        """A message with this stamp [ns] and the values of its body."""
        second, nanosecond = divmod(stamp_ns, _SECOND)
        return self._pack(_LITTLE_ENDIAN, second, nanosecond, len(self._frame), self._frame, *values)

    def send(self, stamp_ns: int, *values: object) -> None:
        """Publish a message with this stamp [ns] and the values of its body."""
        self._publish(self.bytes_of(stamp_ns, *values))


class SampleOutput:
    """Publishes what the node that owns the valves measures: plant or bridge.

    `pressures`: whether they are measured. `variance`: of a pressure [Pa²]. `encoder`: whether its angle is published
    for the estimator as well. With the node's parameter ``samples: one`` a sample is one message, and the others come
    at ``topic_rate``.
    """

    def __init__(self, node: PamNode, rig: Rig, *, pressures: bool, variance: float, encoder: bool) -> None:
        name, frame = node.values["joint_name"], node.values["frame_id"]
        self._variance = variance
        self.pressures = tuple(
            Outgoing(node, f"pressure_{i}", f"muscle_{i}", PRESSURE) for i in ((1, 2) if pressures else ())
        )
        self.valves = Outgoing(node, STATE_TOPICS[rig.drive], f"{rig.drive}s", VALVES)
        body, self._position = joint_state(name, "position")
        self.encoder = Outgoing(node, "angle_sensor", frame, body) if encoder else None
        body, self._state = joint_state(name, "position", "effort")
        self.joint = Outgoing(node, "measured_joint_states", frame, body)
        self._partial = message_class("measured_joint_states")(name=[name])  # without one of the two channels
        self._partial.header.frame_id = frame
        self._one = Outgoing(node, "joint_sample", frame, SAMPLE) if node.values["samples"] == "one" else None
        self._regulated = rig.drive == "regulator"
        self._beside = Thinned(node.values["topic_rate"] if self._one is not None else 0.0)

    @property
    def counted(self) -> tuple[Outgoing, ...]:
        """The publishers of what a sample needs."""
        return (*self.pressures, self.valves) if self._one is None else (self._one,)

    def send(
        self,
        stamp_ns: int,
        pressure: Iterable[float],
        voltage: Iterable[float],
        angle: float | None,
        torque: float | None,
        encoder: float | None,
    ) -> None:
        """Publish a sample; None for a channel that is not there."""
        if self._one is not None:
            first, second = pressure if self.pressures else (math.nan, math.nan)
            drives = (math.nan, math.nan, *voltage) if self._regulated else (*voltage, math.nan, math.nan)
            used = encoder if self.encoder is not None else None
            read = (math.nan if value is None else value for value in (angle, torque, used))
            self._one.send(stamp_ns, first, second, *drives, *read)
            if not self._beside.is_due(stamp_ns):
                return
        for output, value in zip(self.pressures, pressure, strict=False):
            output.send(stamp_ns, value, self._variance)
        self.valves.send(stamp_ns, *voltage)
        if self.encoder is not None and encoder is not None:
            self.encoder.send(stamp_ns, *self._position(encoder))
        if angle is not None and torque is not None:
            self.joint.send(stamp_ns, *self._state(angle, torque))
        elif angle is not None or torque is not None:
            set_stamp(self._partial.header.stamp, stamp_ns)
            self._partial.position = [] if angle is None else [angle]
            self._partial.effort = [] if torque is None else [torque]
            self.joint.publisher.publish(self._partial)


class Thinned:
    """Which samples are published at a lower rate [Hz]; 0: all."""

    def __init__(self, rate: float) -> None:
        self._period = round(_SECOND / rate) if rate else 0
        self._next = 0

    def is_due(self, stamp_ns: int) -> bool:
        """Whether a sample is one of them."""
        if self._period and -self._period <= stamp_ns - self._next < 0:
            return False
        self._next = stamp_ns - stamp_ns % self._period + self._period if self._period else 0
        return True


class Incoming:
    """Unpacks serialised messages."""

    def __init__(self, body: Body) -> None:
        self._body = tuple(body)

    def __call__(self, data: bytes) -> tuple[Any, ...]:
        """Stamp [ns] and the values of the body."""
        order = "<" if data[1] & 1 else ">"
        frame_bytes = int.from_bytes(data[12:16], "little" if order == "<" else "big")
        unpacked = layout(self._body, frame_bytes, order).unpack_from(data)
        return (unpacked[1] * _SECOND + unpacked[2], *unpacked[5:])


def sample_inputs(
    drive: str, joint: str, *, encoder: bool, pressures: bool = True, one: bool = False
) -> dict[int, tuple[str, Callable[[bytes], Sequence[Any]]]]:
    """Topics of a sample (logical names), and how their messages are unpacked, by their places in a :class:`Sample`.

    `drive`: of the rig. `joint`: name of the joint in topic ``angle_sensor``. `one`: whether a sample is one message.
    """
    if one:
        return {WHOLE: ("joint_sample", partial(_whole, Incoming(SAMPLE), drive == "regulator", pressures, encoder))}
    pressure = Incoming(PRESSURE_ALONE)
    return {
        **({PRESSURE_1: ("pressure_1", pressure), PRESSURE_2: ("pressure_2", pressure)} if pressures else {}),
        VOLTAGES: (STATE_TOPICS[drive], Incoming(VALVES)),
        **({ANGLE: ("angle_sensor", partial(position_in, joint=joint))} if encoder else {}),
    }


def _whole(unpack: Incoming, regulated: bool, pressures: bool, encoder: bool, data: bytes) -> Sequence[Any]:
    """Stamp [ns] and the values of a sample, without those that are no input."""
    stamp_ns, p1, p2, u1, u2, a1, a2, _, _, angle = unpack(data)
    first, second = (p1, p2) if pressures else (math.nan, math.nan)
    return (stamp_ns, first, second, *((a1, a2) if regulated else (u1, u2)), angle if encoder else math.nan)


def for_control(numbers: bytes, flags: int) -> tuple[float, ...]:
    """The values of :data:`ESTIMATE_FOR_CONTROL` without a message. `numbers`: memory of an ``ESTIMATE_DTYPE``."""
    first = struct.unpack_from(f"={_FOR_CONTROL}", numbers)
    return (*first, flags, *struct.unpack_from(f"={_EXTERNAL}", numbers, len(numbers) - 8 * EXTERNAL_VALUES))


def set_stamp(stamp: Time, time_ns: int) -> None:
    """Write a time [ns] into the stamp of a message object, where speed does not matter."""
    stamp.sec, stamp.nanosec = divmod(time_ns, _SECOND)


def take(subscription: Subscription) -> Iterator[tuple[Any, Mapping[str, Any]]]:
    """Messages of a subscription without an executor, oldest first, each with the middleware's information."""
    handle = subscription.handle
    with handle:
        while (taken := handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            yield taken


_MOST_NUMBER = 2**63  # a larger number means that the middleware gives none


def number_of(information: Mapping[str, Any]) -> int | None:
    """Number of a message at its publisher, from 1; None where the middleware gives none."""
    number: int | None = information.get("publication_sequence_number")
    return number if number is not None and 0 < number < _MOST_NUMBER else None


class Gaps:
    """Counts missing messages of one topic.

    The middleware numbers the messages of each publisher, but does not tell which publisher a message is from. So gaps
    are counted only while there is one publisher. Counting ends with a second one.

    `publishers`: returns the present number of publishers; called only at a gap.
    """

    def __init__(self, publishers: Callable[[], int]) -> None:
        self._publishers = publishers
        self._last: int | None = None
        self.missing = 0
        self.countable = True

    def add(self, number: int | None) -> None:
        """Take the :func:`number_of` a message, in the order of reception."""
        if number is None or not self.countable:
            return
        last, self._last = self._last, number
        if last is None or number == last + 1:
            return
        if self._publishers() > 1:
            self.countable = False
        elif number > last:  # otherwise the publisher restarted
            self.missing += number - last - 1
