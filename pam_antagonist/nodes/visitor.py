"""A node of a command that looks in on a running pipeline and has one thing to say to it."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from types import TracebackType
from typing import Any, TypeVar

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from pam_antagonist.nodes import qos
from pam_antagonist.nodes.spin import tune_middleware
from pam_antagonist.recording.topics import TOPICS

_LISTENERS = 2
"""Of what it says: the node that obeys, and the recorder."""
_Self = TypeVar("_Self", bound="Visitor")


class Visitor:
    """A node without an executor: it takes the latest message when asked, and costs nothing in between.

    Use it as a context manager. Inside, SIGINT and SIGTERM become a ``KeyboardInterrupt`` with the next call of a
    method, or at the end: one that came up in the middle of a call into rclpy would turn into something else there.

    Args:
        name: of the node.
        namespace: of the pipeline.
        hears: types of messages by topic (logical name).
        says: topic (logical name), type of message and quality of service of what it publishes.
    """

    def __init__(
        self, name: str, namespace: str, hears: Mapping[str, type], says: tuple[str, type, QoSProfile]
    ) -> None:
        tune_middleware()
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node(name, namespace=namespace, context=self._context, start_parameter_services=False)
        self._spoken, kind, profile = says
        self._publisher = self._node.create_publisher(kind, TOPICS[self._spoken].relative, profile)
        self._topics = {
            topic: self._node.create_subscription(heard, TOPICS[topic].relative, lambda message: None, qos.GLANCE)
            for topic, heard in hears.items()
        }
        self._latest: dict[str, Any] = {}

    def __enter__(self: _Self) -> _Self:
        self._interrupted = False
        self._handlers = {number: signal.signal(number, self._interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def _interrupt(self, number: int, frame: object) -> None:
        self._interrupted = True

    def _check(self) -> None:
        if self._interrupted:
            self._interrupted = False
            raise KeyboardInterrupt

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        if value is None:
            self._check()

    def latest(self, topic: str) -> Any:
        """The newest message of a topic (logical name), None if none has come."""
        self._check()
        subscription = self._topics[topic]
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, False)
        if taken is not None:
            self._latest[topic] = taken[0]
        return self._latest.get(topic)

    def missing(self) -> str:
        """What does not deliver or listen yet, in words; empty when everything does."""
        parts = [f"nothing on {TOPICS[topic].relative}" for topic in self._topics if self.latest(topic) is None]
        if self._publisher.get_subscription_count() < _LISTENERS:
            parts.append(f"nobody listens to {TOPICS[self._spoken].relative}")
        return ", ".join(parts)

    def _say(self, message: Any) -> None:
        """Publish a message, stamped now."""
        self._check()
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
