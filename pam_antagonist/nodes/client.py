"""Clients of a running pipeline: nodes of a command that read its latest messages and publish one topic."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
import rclpy
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from typing_extensions import override

from pam_antagonist.control.command import Mode
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.health import DiagnosticsPublisher, Health, Level
from pam_antagonist.nodes.spin import client_node
from pam_antagonist.nodes.wire import message_class, take
from pam_antagonist.recording.topics import COMMAND_TOPICS, DEFAULT_NAMESPACE, TOPICS
from pam_antagonist.safety.supervision import RETREAT, TICK, Lookout
from pam_antagonist_msgs.msg import JointReference

_SUBSCRIBERS = 2
"""Expected subscribers of a client's topic: the node that obeys, and the recorder."""
_PROGRESS_S = 0.2  # between two reports of progress
_PRESSURES = ("pressure_1", "pressure_2")
_FIELDS = {"valve": "voltage", "regulator": "pressure"}

Floats = NDArray[np.float64]
Command = Callable[[float, Floats, float], tuple[float, float] | None]
"""Voltages [V] for a time [s], measured pressures (2,) [Pa] and angle [rad]; None at the end."""
_Self = TypeVar("_Self", bound="PipelineClient")


class PipelineClient:
    """A node without an executor. It takes the latest messages on request, and needs no time in between.

    Use it as a context manager. Inside, SIGINT and SIGTERM raise a ``KeyboardInterrupt`` in the next method call, or at
    the end. Raised during a call into rclpy, it would be replaced by another exception.

    `subscribed`, `published`: logical names of topics. `profile`: quality of service of the published topic.
    """

    def __init__(self, name: str, subscribed: Sequence[str], published: str, profile: QoSProfile) -> None:
        self._node = client_node(name, DEFAULT_NAMESPACE)
        self._topic = TOPICS[published].relative
        self._publisher = self._node.create_publisher(message_class(published), self._topic, profile)
        self._topics = {
            topic: self._node.create_subscription(
                message_class(topic), TOPICS[topic].relative, lambda message: None, qos.GLANCE
            )
            for topic in subscribed
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
        for message, _ in take(self._topics[topic]):
            self._latest[topic] = message
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
            parts.append(f"no node subscribes to {self._topic}")
        return ", ".join(parts)

    def _publish(self, message: Any) -> None:
        """Publish a message, stamped now."""
        self._check()
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)


class ReferenceClient(PipelineClient):
    """Reads estimate, measurement and commands, and publishes references.

    `drive`: of the joint's rig: ``valve`` or ``regulator``.
    """

    def __init__(self, drive: str = "valve") -> None:
        subscribed = ("joint_estimate", "measured_joint_states", COMMAND_TOPICS[drive])
        super().__init__("watch", subscribed, "reference", qos.REFERENCE)
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
        """Push the simulated joint until the next call. `torque`: about +z [N m]."""
        self._check()
        self._plant.call_async(SetParameters.Request(parameters=[Parameter("push", value=torque).to_parameter_msg()]))

    def read(self, mode: Mode) -> tuple[float, float]:
        """Estimate and measurement now, [rad] or [N m]; NaN before the first message."""
        estimate, measured = self.latest("joint_estimate"), self.latest("measured_joint_states")
        ours, theirs = ("angle", "position") if mode.quantity is Mode.ANGLE else ("torque", "effort")
        return (
            math.nan if estimate is None else getattr(estimate, ours),
            math.nan if measured is None else getattr(measured, theirs)[0],
        )


class DriveClient(PipelineClient):
    """Commands valves or regulators in a pipeline without a controller, and watches the sensors.

    `drive`: of the joint's rig: ``valve`` or ``regulator``. `also`: topics (logical names) that have to have messages
    before the pipeline is complete.
    """

    def __init__(self, drive: str = "valve", also: Sequence[str] = ()) -> None:
        topic = COMMAND_TOPICS[drive]
        self._field, self._message = _FIELDS[drive], message_class(topic)
        super().__init__("excite", (*_PRESSURES, "measured_joint_states", *also), topic, qos.COMMAND)

    def now_ns(self) -> int:
        """Time of the clock that stamps samples [ns]."""
        return int(self._node.get_clock().now().nanoseconds)

    @override
    def missing(self) -> str:
        return ", ".join(part for part in super().missing().split(", ") if "joint_states" not in part)

    def send(self, voltage: Floats) -> None:
        """Command two voltages [V], or pressures [Pa], now."""
        self._publish(self._message(**{self._field: [float(value) for value in voltage]}))

    def seen(self) -> tuple[Floats, float]:
        """Measured pressures (2,) [Pa] and angle [rad] now; NaN before the first message."""
        messages = [self.latest(topic) for topic in _PRESSURES]
        pressures = np.array([math.nan if one is None else one.fluid_pressure for one in messages])
        joint = self.latest("measured_joint_states")
        return pressures, joint.position[0] if joint is not None and joint.position else math.nan

    def settle(self, rest: Floats, within: Callable[[Floats], bool], check: Callable[[], None], longest: float) -> None:
        """Hold the resting voltages (2,) [V] until the pressures are in the range where a plan may begin.

        `within`: whether pressures (2,) [Pa] are in this range. `longest`: time after which the plan begins anyway [s].
        """
        end = time.monotonic() + longest
        while time.monotonic() < end and not within(self.seen()[0]):
            check()
            self.hold(rest)

    def follow(
        self,
        command: Command,
        seconds: float,
        rest: Floats,
        broken: Callable[[Floats, float], str],
        check: Callable[[], None],
        progress: Callable[[float], None],
    ) -> str:
        """Command voltages in real time; when a limit is exceeded, hold the resting voltages, end and say why.

        Args:
            command: gives the voltages.
            seconds: length at most [s].
            rest: resting voltages (2,) [V].
            broken: which limit pressures (2,) [Pa] or angle [rad] exceed, in words; empty for none.
            progress: called with the time since the last call [s].
        """
        begin, reported, lookout = time.monotonic(), 0.0, Lookout()
        while (elapsed := time.monotonic() - begin) < seconds:
            pressures, angle = self.seen()
            voltage = command(elapsed, pressures, angle)
            if voltage is None:
                break
            self.send(np.array(voltage))
            if reason := lookout.ends(broken(pressures, angle)):
                self.hold(rest, RETREAT)
                return f"after {elapsed:.1f} s {reason}"
            if elapsed - reported > _PROGRESS_S:
                check()
                progress(elapsed - reported)
                reported = elapsed
            time.sleep(TICK)
        progress(elapsed - reported)
        return ""

    def hold(self, voltage: Floats, seconds: float = _PROGRESS_S) -> None:
        """Command voltages (2,) [V] for a time [s]."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.send(voltage)
            time.sleep(TICK)


STATUS = "step"
"""Name of the only part that a command reports."""
_PERIOD = 0.5


class Announcer:
    """A node that reports every half second what a command does, and its progress. Use it as a context manager.

    The node commands nothing and has no subscriptions.
    """

    def __init__(self, name: str) -> None:
        self._node = client_node(name, DEFAULT_NAMESPACE)
        self._publisher = DiagnosticsPublisher(self._node, DEFAULT_NAMESPACE)
        self._step: tuple[str, float, float | None] | None = None  # text, when it began, how long it takes [s]
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._go_on, daemon=True)

    def __enter__(self) -> Announcer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._node.destroy_node()
        rclpy.shutdown(context=self._node.context)

    def say(self, text: str, seconds: float | None = None) -> None:
        """Begin a step of the command. `seconds`: its duration [s]; None: not known."""
        self._step = text, time.monotonic(), seconds

    def _go_on(self) -> None:
        while not self._ended.wait(_PERIOD):
            if self._step is not None:
                text, begun, seconds = self._step
                passed = time.monotonic() - begun
                so_far = f"{passed:.0f} s" if seconds is None else f"{min(passed, seconds):.0f} of {seconds:.0f} s"
                self._publisher.publish({STATUS: Health(Level.OK, f"{text}, {so_far}")})
