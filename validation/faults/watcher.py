"""The runner's own ears and mouth in a pipeline: diagnostics, references, services, and a second commander."""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from pam_antagonist.control.command import Mode
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.processes import ProcessFailed
from pam_antagonist.nodes.spin import tune_middleware
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist_msgs.msg import JointReference, ValveCommand
from validation.faults.fault import Status

_ANSWER = 10.0  # longest time for a service [s]


class Watcher:
    """A node beside a pipeline. It takes what has come when it is asked, and costs nothing in between.

    Attributes:
        statuses: every status on ``/diagnostics`` of a node in the namespace so far, without the namespace.
    """

    def __init__(self, namespace: str, domain: int) -> None:
        tune_middleware()
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO, domain_id=domain)
        options: dict[str, Any] = {"context": self._context, "start_parameter_services": False}
        self._node = Node("fault_watcher", namespace=namespace, **options)
        self._caller = Node("fault_caller", namespace=namespace, **options)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._caller)
        self._prefix = f"{namespace.strip('/')}/"
        self.statuses: list[Status] = []
        self._diagnostics = self._node.create_subscription(DiagnosticArray, "/diagnostics", _nothing, qos.RECORD)
        self._reference = self._node.create_publisher(JointReference, TOPICS["reference"].relative, qos.REFERENCE)
        self._clients: dict[str, Any] = {}

    def __enter__(self) -> Watcher:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown()
        self._caller.destroy_node()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def collect(self) -> None:
        """Take what has come."""
        for message, received_ns in _taken(self._diagnostics):
            for status in message.status:
                if status.name.startswith(self._prefix):
                    part = status.name.removeprefix(self._prefix)
                    values = {item.key: item.value for item in status.values}
                    self.statuses.append(Status(received_ns, part, status.level[0], status.message, values))

    def latest(self, part: str) -> Status | None:
        """The newest status of a part; None if there is none."""
        return next((status for status in reversed(self.statuses) if status.part == part), None)

    def refer(self, angle: float) -> None:
        """Publish a reference [rad]."""
        self._reference.publish(JointReference(mode=int(Mode.ANGLE), value=angle))

    def listeners(self) -> int:
        """How many listen to the reference."""
        return int(self._reference.get_subscription_count())

    def clear(self, node: str) -> tuple[bool, str]:
        """Ask a node to clear its stop; whether it did, and what it says."""
        name = f"{node}/clear_stop"
        if name not in self._clients:
            self._clients[name] = self._caller.create_client(Trigger, name)
        client = self._clients[name]
        if client.wait_for_service(_ANSWER):
            future = client.call_async(Trigger.Request())
            self._executor.spin_until_future_complete(future, _ANSWER)
            if future.done():
                return bool(future.result().success), str(future.result().message)
        raise ProcessFailed(f"{name} does not answer")

    def intrude(self, seconds: float, voltage: Sequence[float]) -> None:
        """Command the valves beside the controller, 500 times a second [V], for a time [s]."""
        publisher = self._node.create_publisher(ValveCommand, TOPICS["valve_command"].relative, qos.COMMAND)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            publisher.publish(ValveCommand(voltage=list(voltage)))
            time.sleep(0.002)
        self._node.destroy_publisher(publisher)


def _taken(subscription: Any) -> list[tuple[Any, int]]:
    """Messages with the time of their reception [ns since 1970], oldest first."""
    messages = []
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, False)) is not None:
            messages.append((taken[0], taken[1]["received_timestamp"]))
    return messages


def _nothing(_message: object) -> None:
    """Nobody is woken up."""
