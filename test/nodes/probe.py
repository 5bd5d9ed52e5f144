"""What the tests listen with: every message of some topics with its time of reception, without an executor."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import FluidPressure, JointState

from pam_antagonist.nodes import qos
from pam_antagonist.nodes.spin import tune_middleware
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist_msgs.msg import JointEstimate, JointReference, ValveCommand

TYPES = {
    "pressure_1": FluidPressure,
    "pressure_2": FluidPressure,
    "valve_state": ValveCommand,
    "valve_command": ValveCommand,
    "joint_estimate": JointEstimate,
    "joint_states": JointState,
    "measured_joint_states": JointState,
    "reference": JointReference,
}


class Probe:
    """Collects (time of reception [ns], message) of each topic that it was given; publishes to any."""

    def __init__(self, *topics: str) -> None:
        tune_middleware()
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("probe", namespace="/pam", context=self._context, start_parameter_services=False)
        self.seen: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in topics}
        self._subscriptions = {
            topic: self.node.create_subscription(TYPES[topic], TOPICS[topic].relative, lambda message: None, qos.RECORD)
            for topic in topics
        }
        self._publishers: dict[str, Any] = {}

    def __enter__(self) -> Probe:
        return self

    def __exit__(self, *_: object) -> None:
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def collect(self) -> None:
        for topic, subscription in self._subscriptions.items():
            with subscription.handle:
                while (taken := subscription.handle.take_message(subscription.msg_type, False)) is not None:
                    self.seen[topic].append((taken[1]["received_timestamp"], taken[0]))

    def clear(self) -> None:
        self.collect()
        for messages in self.seen.values():
            messages.clear()

    def until(self, condition: Callable[[], bool], limit: float = 15.0, what: str = "what was waited for") -> None:
        end = time.monotonic() + limit
        while True:
            self.collect()
            if condition():
                return
            assert time.monotonic() < end, f"{what} did not happen within {limit} s"
            time.sleep(0.005)

    def wait(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.collect()
            time.sleep(0.005)

    def publisher(self, topic: str) -> Any:
        if topic not in self._publishers:
            profile = qos.REFERENCE if topic == "reference" else qos.STREAM
            self._publishers[topic] = self.node.create_publisher(TYPES[topic], TOPICS[topic].relative, profile)
        return self._publishers[topic]

    def matched(self, topic: str, count: int = 1) -> bool:
        return self.publisher(topic).get_subscription_count() >= count

    def refer(self, mode: int, value: float) -> None:
        self.publisher("reference").publish(JointReference(mode=mode, value=value))

    def now_ns(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)
