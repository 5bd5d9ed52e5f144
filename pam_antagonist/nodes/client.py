"""Clients of a running pipeline: nodes of a command that read its latest messages and publish one topic."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
import rclpy
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from pam_antagonist.control import Mode
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.spin import client_node
from pam_antagonist.recording.topics import COMMAND_TOPICS, DEFAULT_NAMESPACE, TOPICS
from pam_antagonist_msgs.msg import JointEstimate, JointReference, PressureCommand, ValveCommand

_SUBSCRIBERS = 2
"""Expected subscribers of a client's topic: the node that obeys, and the recorder."""
_TICK = 0.004  # between two commands [s]; the valves take the last one until then
_PROGRESS_PERIOD = 0.2  # between two reports of progress [s]
_ESTIMATE: Mapping[str, type] = {"joint_estimate": JointEstimate}
_Self = TypeVar("_Self", bound="PipelineClient")


class PipelineClient:
    """A node without an executor. It takes the latest messages on request, and needs no time in between.

    Use it as a context manager. Inside, SIGINT and SIGTERM raise a ``KeyboardInterrupt`` in the next method call, or at
    the end. Raised during a call into rclpy, it would be replaced by another exception.

    Args:
        published: logical name, message type and quality of service of the published topic.
    """

    def __init__(
        self, name: str, namespace: str, subscribed: Mapping[str, type], published: tuple[str, type, QoSProfile]
    ) -> None:
        self._node = client_node(name, namespace)
        self._published, kind, profile = published
        self._publisher = self._node.create_publisher(kind, TOPICS[self._published].relative, profile)
        self._topics = {
            topic: self._node.create_subscription(kind, TOPICS[topic].relative, lambda message: None, qos.GLANCE)
            for topic, kind in subscribed.items()
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
        rclpy.shutdown(context=self._node.context)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        if value is None:
            self._check()

    def latest(self, topic: str) -> Any:
        """The newest message of a topic (logical name); None before the first."""
        self._check()
        subscription = self._topics[topic]
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, False)
        if taken is not None:
            self._latest[topic] = taken[0]
        return self._latest.get(topic)

    @property
    def listeners(self) -> int:
        """Number of subscribers of the published topic."""
        self._check()
        return int(self._publisher.get_subscription_count())

    def missing(self) -> str:
        """Topics without messages or subscribers, in words; empty when the pipeline is complete."""
        parts = [f"no message on {TOPICS[topic].relative}" for topic in self._topics if self.latest(topic) is None]
        if self.listeners < _SUBSCRIBERS:
            parts.append(f"no node subscribes to {TOPICS[self._published].relative}")
        return ", ".join(parts)

    def _publish(self, message: Any) -> None:
        """Publish a message, stamped now."""
        self._check()
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)


class VoltageClient(PipelineClient):
    """Commands valve voltages in a pipeline that has no controller."""

    def __init__(
        self, namespace: str = DEFAULT_NAMESPACE, name: str = "drive", subscribed: Mapping[str, type] = _ESTIMATE
    ) -> None:
        super().__init__(name, namespace, subscribed, ("valve_command", ValveCommand, qos.COMMAND))

    def send(self, voltage: NDArray[np.float64]) -> None:
        """Command two voltages [V] now."""
        self._publish(ValveCommand(voltage=[float(value) for value in voltage]))

    def follow(
        self, voltage: NDArray[np.float64], period: float, check: Callable[[], None], progress: Callable[[float], None]
    ) -> None:
        """Command a profile in real time.

        Args:
            voltage: (N, 2) [V], one row for each period.
            period: [s].
            progress: called with the time since the start [s].
        """
        start, reported = time.monotonic(), 0.0
        while (elapsed := time.monotonic() - start) < len(voltage) * period:
            self.send(voltage[min(int(elapsed / period), len(voltage) - 1)])
            if elapsed - reported > _PROGRESS_PERIOD:
                check()
                progress(elapsed)
                reported = elapsed
            time.sleep(_TICK)


class ReferenceClient(PipelineClient):
    """Reads estimate, measurement and commands, and publishes references.

    Args:
        listening: False: only publish, so that the pipeline does not deliver messages to this node.
        drive: of the joint's rig: ``valve`` or ``regulator``.
    """

    def __init__(self, namespace: str = DEFAULT_NAMESPACE, listening: bool = True, drive: str = "valve") -> None:
        command = {"valve": ValveCommand, "regulator": PressureCommand}[drive]
        subscribed = {
            "joint_estimate": JointEstimate,
            "measured_joint_states": JointState,
            COMMAND_TOPICS[drive]: command,
        }
        subscribed = subscribed if listening else {}
        super().__init__("watch", namespace, subscribed, ("reference", JointReference, qos.REFERENCE))
        self._plant = self._node.create_client(SetParameters, "plant/set_parameters")

    def send(self, mode: Mode, value: float, stiffness: float = math.nan, damping: float = math.nan) -> None:
        """Publish a reference, stamped now.

        Args:
            value: [rad] or [N m].
            stiffness: [N m/rad], for the modes that have one; NaN: not given.
            damping: [N m s/rad], for ``Mode.IMPEDANCE``; NaN: none.
        """
        self._publish(JointReference(mode=int(mode), value=value, stiffness=stiffness, damping=damping))

    def may_push(self) -> bool:
        """Whether there is a simulated joint that can be pushed."""
        self._check()
        return bool(self._plant.service_is_ready())

    def push(self, torque: float) -> None:
        """Push the simulated joint until the next call.

        Args:
            torque: about +z [N m].
        """
        self._check()
        self._plant.call_async(SetParameters.Request(parameters=[Parameter("push", value=torque).to_parameter_msg()]))

    def read(self, mode: Mode) -> tuple[float, float]:
        """Estimate and measurement now, [rad] or [N m]; NaN before the first message."""
        estimate, measured = self.latest("joint_estimate"), self.latest("measured_joint_states")
        if mode.quantity is Mode.ANGLE:
            return (
                estimate.angle if estimate is not None else math.nan,
                measured.position[0] if measured is not None else math.nan,
            )
        return (
            estimate.torque if estimate is not None else math.nan,
            measured.effort[0] if measured is not None else math.nan,
        )
