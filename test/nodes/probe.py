"""What the tests listen with: every message of some topics with its time of reception, without an executor."""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import FluidPressure, JointState
from std_srvs.srv import Trigger

from pam_antagonist.nodes import qos
from pam_antagonist.nodes.processes import Processes
from pam_antagonist.nodes.spin import tune_middleware
from pam_antagonist.nodes.wire import take
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist_msgs.msg import JointEstimate, JointReference, PressureCommand, ValveCommand

SECOND = 10**9
_ANSWER = 20.0  # longest time for a service, which may have to compile [s]

TYPES = {
    "pressure_1": FluidPressure,
    "pressure_2": FluidPressure,
    "valve_state": ValveCommand,
    "valve_command": ValveCommand,
    "pressure_state": PressureCommand,
    "pressure_command": PressureCommand,
    "joint_estimate": JointEstimate,
    "joint_states": JointState,
    "measured_joint_states": JointState,
    "reference": JointReference,
    "diagnostics": DiagnosticArray,
}


def kill(processes: Processes, name: str) -> int:
    """Kill a process; the time right before that [ns]."""
    popen = processes.running.pop(name).popen
    now = time.time_ns()
    popen.kill()
    popen.wait()
    return now


@dataclass(frozen=True)
class Row:
    """A row of the device emulator's log."""

    time_ns: int
    event: str
    voltage: tuple[float, float]
    safe: bool


def read_log(path: Path) -> list[Row]:
    with path.open(newline="") as file:
        return [
            Row(
                int(row["time_ns"]),
                row["event"],
                (float(row["voltage_1"]), float(row["voltage_2"])),
                row["safe"] == "1",
            )
            for row in csv.DictReader(file)
            if row["safe"] is not None
        ]


class Probe:
    """Collects (time of reception [ns], message) of each topic that it was given; publishes to any.

    `profile`: quality of service, where it is to be that of another program.
    """

    def __init__(self, *topics: str, name: str = "probe", profile: QoSProfile | None = None) -> None:
        tune_middleware()
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(name, namespace="/pam", context=self._context, start_parameter_services=False)
        self.seen: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in topics}
        heard, self._profile = profile or qos.RECORD, profile
        self._subscriptions = {
            topic: self.node.create_subscription(TYPES[topic], TOPICS[topic].relative, lambda message: None, heard)
            for topic in topics
        }
        self._publishers: dict[str, Any] = {}
        self._caller: Node | None = None
        self._clients: dict[str, Any] = {}

    def __enter__(self) -> Probe:
        return self

    def __exit__(self, *_: object) -> None:
        if self._caller is not None:
            self._caller.destroy_node()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def collect(self) -> None:
        for topic, subscription in self._subscriptions.items():
            for message, info in take(subscription):
                self.seen[topic].append((info["received_timestamp"], message))

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

    def voltages(self, topic: str = "valve_state") -> list[tuple[float, float]]:
        """The voltages of each message of a topic so far."""
        self.collect()
        return [tuple(message.voltage) for _, message in self.seen[topic]]

    def voltage(self, topic: str = "valve_state") -> tuple[float, float]:
        """The voltages of a topic's last message."""
        self.collect()
        return tuple(self.seen[topic][-1][1].voltage)

    def statuses(self, part: str) -> list[Any]:
        """Each status of a part so far, such as ``pam/plant: safety``."""
        self.collect()
        return [one for _, message in self.seen["diagnostics"] for one in message.status if one.name == part]

    def publisher(self, topic: str) -> Any:
        if topic not in self._publishers:
            profile = self._profile or (qos.REFERENCE if topic == "reference" else qos.STREAM)
            self._publishers[topic] = self.node.create_publisher(TYPES[topic], TOPICS[topic].relative, profile)
        return self._publishers[topic]

    def matched(self, topic: str, count: int = 1) -> bool:
        return self.publisher(topic).get_subscription_count() >= count

    def follow(self, degrees: float, apart: float) -> None:
        """Wait until the loop follows a reference, with voltages that are so far apart, as no safe ones are [V]."""
        self.until(lambda: self.matched("reference"), 30.0, "a controller")

        def following() -> bool:
            self.refer(0, math.radians(degrees))
            return bool(self.seen["valve_state"]) and self.voltage()[0] - self.voltage()[1] > apart

        self.clear()
        self.until(following, 30.0, "voltages that follow the reference")

    def refer(self, mode: int, value: float) -> None:
        self.publisher("reference").publish(JointReference(mode=mode, value=value))

    def insist(self, mode: int, value: float) -> None:
        """Refer for half a second: where two processes have just met, a busy machine may lose a first message."""
        for _ in range(10):
            self.refer(mode, value)
            self.wait(0.05)

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        """The answer of a service below ``/pam``."""
        if self._caller is None:  # a node of its own: an executor would take the probe's messages
            options = {"context": self._context, "start_parameter_services": False}
            self._caller = Node("caller", namespace="/pam", **options)
            self._executor = SingleThreadedExecutor(context=self._context)
        if name not in self._clients:
            self._clients[name] = self._caller.create_client(kind, name)
        client = self._clients[name]
        assert client.wait_for_service(_ANSWER), f"there is no service {name}"
        future = client.call_async(kind.Request(**fields))
        self._executor.add_node(self._caller)
        try:
            self._executor.spin_until_future_complete(future, _ANSWER)
        finally:
            self._executor.remove_node(self._caller)
        assert future.done(), f"{name} does not answer"
        return future.result()

    def trigger(self, name: str) -> Any:
        """The answer of a service without a request."""
        return self.call(Trigger, name)

    def transition(self, node: str, label: str) -> bool:
        """Ask a node for a transition, as ``ros2 lifecycle set`` does; whether it came about."""
        request = Transition(label=label)
        return bool(self.call(ChangeState, f"{node}/change_state", transition=request).success)

    def state(self, node: str) -> str:
        """The state of a node's life cycle."""
        return str(self.call(GetState, f"{node}/get_state").current_state.label)

    def now_ns(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)
