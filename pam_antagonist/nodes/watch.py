"""Looking at a running pipeline now and then, and giving it references."""

from __future__ import annotations

import math
import signal
from types import TracebackType
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from pam_antagonist.control import Mode
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.spin import tune_middleware
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE, TOPICS
from pam_antagonist_msgs.msg import JointEstimate, JointReference, ValveCommand

_LISTENERS = 2  # of the reference: controller and recorder


class Watch:
    """A node without an executor: it takes the latest message when asked, and costs nothing in between.

    Use it as a context manager. Inside, SIGINT and SIGTERM become a ``KeyboardInterrupt`` with the next call of a
    method, or at the end: one that came up in the middle of a call into rclpy would turn into something else there.

    Args:
        namespace: of the pipeline.
    """

    def __init__(self, namespace: str = DEFAULT_NAMESPACE) -> None:
        tune_middleware()
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("watch", namespace=namespace, context=self._context, start_parameter_services=False)
        self._reference = self._node.create_publisher(JointReference, TOPICS["reference"].relative, qos.REFERENCE)
        self._topics = {
            name: self._node.create_subscription(kind, TOPICS[name].relative, lambda message: None, qos.GLANCE)
            for name, kind in (
                ("joint_estimate", JointEstimate),
                ("measured_joint_states", JointState),
                ("valve_command", ValveCommand),
            )
        }
        self._latest: dict[str, Any] = {}

    def __enter__(self) -> Watch:
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
        """What does not deliver yet, in words; empty when everything does."""
        parts = [f"nothing on {TOPICS[name].relative}" for name in self._topics if self.latest(name) is None]
        if self._reference.get_subscription_count() < _LISTENERS:
            parts.append("nobody listens to reference")
        return ", ".join(parts)

    def send(self, mode: Mode, value: float) -> None:
        """Publish a reference [rad] or [N m], stamped now."""
        self._check()
        message = JointReference(mode=int(mode), value=value)
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._reference.publish(message)

    def look(self, mode: Mode) -> tuple[float, float]:
        """Estimate and measurement now, [rad] or [N m]; NaN where nothing has come."""
        estimate, measured = self.latest("joint_estimate"), self.latest("measured_joint_states")
        if mode is Mode.ANGLE:
            return (
                estimate.angle if estimate is not None else math.nan,
                measured.position[0] if measured is not None else math.nan,
            )
        return (
            estimate.torque if estimate is not None else math.nan,
            measured.effort[0] if measured is not None else math.nan,
        )
