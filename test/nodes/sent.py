"""What nodes in the process of the tests would send, as messages; without ROS until it is used."""

from __future__ import annotations

from typing import Any


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
