"""Data of the live page of a running joint: its latest messages thirty times a second, and its nodes' reports.

The node has no executor. It takes the newest message of each topic for each frame. Without an open page it has no
subscriptions.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from pam_antagonist.control.command import Mode
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.health import Level
from pam_antagonist.nodes.processes import busy_domains
from pam_antagonist.nodes.references import ASKED, MODE, MODES, STIFFNESS
from pam_antagonist.nodes.spin import client_node, nothing_there
from pam_antagonist.nodes.wire import message_class, take
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE, TOPICS, normalize_namespace
from pam_antagonist.rig import RigIdentity
from pam_antagonist_msgs.msg import JointReference

FIELDS = (
    *("time", "angle", "angle_std", "torque", "torque_std", "nis", "flags", "pressure_1", "pressure_2"),
    *("voltage_1", "voltage_2", "encoder", "torque_meter", "reference_angle", "reference_torque"),
    *("stiffness", "reference_stiffness", "external_torque", "external_torque_std"),
)
"""Numbers of a frame, in this order; SI units, None where missing."""
_OF_ESTIMATE = ("angle", "torque", "nis", "flags", "stiffness", "external_torque")

_PROFILES = {
    **dict.fromkeys(("joint_estimate", "pressure_1", "pressure_2", "valve_state"), qos.GLANCE),
    **dict.fromkeys(("measured_joint_states", "reference"), qos.GLANCE),
    "rig": qos.LATCHED,
    "diagnostics": qos.DIAGNOSTICS,
}
_FRESH = 0.3
"""[s] Older values are not shown."""
_GONE = 3.0
"""[s] A node without diagnostics for this time is shown as silent."""
COMMANDS_AT_WORK = ("commission",)
"""Nodes of commands that report their progress; their silence means that they have ended, and is no fault."""
_ANSWER = 5.0
"""[s] Longest time for a service's answer."""


class _Call(NamedTuple):
    """A service call that waits for its answer."""

    name: str
    future: Any
    until: float


class PipelineWatch:
    """The newest state of a joint, for a page.

    Args:
        joint_name: name of the joint in ``measured/joint_states``; None: the first.
        commands: whether :meth:`command` may be called.

    Attributes:
        absent: what :meth:`look` said last.
    """

    def __init__(
        self, namespace: str = DEFAULT_NAMESPACE, joint_name: str | None = None, commands: bool = False
    ) -> None:
        self.namespace = normalize_namespace(namespace)
        self._node = client_node("live_page", self.namespace)
        self._context = self._node.context
        self._joint_name = joint_name
        self._topics: dict[str, Any] = {}
        self._latest: dict[str, tuple[float, Any]] = {}
        self._statuses: dict[str, tuple[float, Any]] = {}
        self._rig: RigIdentity | None = None
        self._begin = time.monotonic()
        self.absent = ""
        self._caller: Node | None = None
        self._reference: Any = None
        self._calls: list[_Call] = []
        self._answers: list[str] = []
        if commands:
            self._caller = Node(
                "live_page_commands", namespace=self.namespace, context=self._context, start_parameter_services=False
            )
            self._executor = SingleThreadedExecutor(context=self._context)
            self._executor.add_node(self._caller)
            self._enable = self._caller.create_client(SetBool, "controller/enable")
            self._clear = {
                name: self._caller.create_client(Trigger, f"{name}/clear_stop")
                for name in ("plant", "bridge", "controller")
            }

    def listen(self, wanted: bool) -> None:
        """Subscribe, or unsubscribe while no page is open."""
        if wanted and not self._topics:
            for name, profile in _PROFILES.items():
                self._topics[name] = self._node.create_subscription(
                    message_class(name), TOPICS[name].relative, lambda message: None, profile
                )
        elif not wanted:
            for subscription in self._topics.values():
                self._node.destroy_subscription(subscription)
            self._topics, self._latest, self._statuses = {}, {}, {}

    def close(self) -> None:
        """End the node."""
        if self._caller is not None:
            self._executor.shutdown()
            self._caller.destroy_node()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    # ---------------------------------------------------------------- what is shown

    def look(self) -> str:
        """Look for the joint in the ROS graph: what to try where it is not there, in words; empty where it is."""
        topics = [TOPICS[name].relative for name in ("joint_estimate", "pressure_1", "valve_state", "pressure_state")]
        if any(self._node.count_publishers(self._node.resolve_topic_name(topic)) for topic in topics):
            self.absent = ""
        else:
            ends = tuple(f"/{topic}" for topic in topics)
            seen = [name for name, _ in self._node.get_topic_names_and_types() if name.endswith(ends)]
            there = {name.rpartition("/")[0] for name in seen if self._node.count_publishers(name)}
            self.absent = nothing_there(self.namespace, sorted(there), busy_domains())
        return self.absent

    def frame(self) -> list[float | None]:
        """The newest numbers, as :data:`FIELDS` names them."""
        now = time.monotonic()
        self._take(now)
        values: dict[str, float] = {"time": now - self._begin}
        estimate = self._fresh("joint_estimate", now)
        if estimate is not None:
            values |= {name: getattr(estimate, name) for name in _OF_ESTIMATE}
            variances = {name: estimate.covariance[place] for name, place in (("angle_std", 0), ("torque_std", 8))}
            variances["external_torque_std"] = estimate.external_torque_covariance[3]
            values |= {
                name: math.sqrt(max(float(variance), 0.0)) for name, variance in variances.items()
            }  # NaN stays NaN
        for name in ("pressure_1", "pressure_2"):
            message = self._fresh(name, now)
            values |= {} if message is None else {name: message.fluid_pressure}
        valves = self._fresh("valve_state", now)
        if valves is not None:
            values["voltage_1"], values["voltage_2"] = map(float, valves.voltage)
        values |= self._measured(self._fresh("measured_joint_states", now))
        values |= self._referred(now)
        return [_number(values.get(name)) for name in FIELDS]

    def report(self) -> dict[str, Any]:
        """Slow data: the rig's limits, the nodes' reports, answers to commands."""
        now = time.monotonic()
        answers, self._answers = self._answers, []
        facts = {} if self._rig is None else dict(self._rig.facts)
        statuses, steps = [], []
        for name, (heard, status) in sorted(self._statuses.items()):
            silent, of_command = now - heard > _GONE, name.partition(":")[0] in COMMANDS_AT_WORK
            if of_command and silent:
                continue
            if of_command:
                steps.append(status.message)
            statuses.append(
                {
                    "name": name,
                    "level": int(Level.STALE) if silent else int.from_bytes(status.level, "little"),
                    "text": f"silent for {now - heard:.0f} s" if silent else status.message,
                    "values": {item.key: item.value for item in status.values},
                }
            )
        return {
            "namespace": self.namespace or "/",
            "rig": None if self._rig is None else self._rig.name,
            "limits": {
                "pressure": [facts.get("atmosphere.pressure"), facts.get("supply.pressure")],
                "voltage": [facts.get("valves.voltage_min"), facts.get("valves.voltage_max")],
                "angle": facts.get("joint.stop"),
            },
            "statuses": statuses,
            "at": steps,
            "absent": self.absent,
            "answers": answers,
        }

    def _take(self, now: float) -> None:
        for name, subscription in self._topics.items():
            for message, _ in take(subscription):
                self._heard(name, message, now)
        if self._caller is not None:
            self._answer(now)

    def _heard(self, name: str, message: Any, now: float) -> None:
        if name == "diagnostics":
            own = f"{self.namespace.lstrip('/')}/" if self.namespace else ""
            for status in message.status:
                node, _, part = status.name.removeprefix(own).partition(": ")
                if status.name.startswith(own) and part and "/" not in node:
                    self._statuses[f"{node}: {part}"] = now, status
        elif name == "rig":
            try:
                self._rig = RigIdentity.read(message.data)
            except BadInput:
                return  # the controller reports it
        else:
            self._latest[name] = now, message

    def _fresh(self, name: str, now: float) -> Any:
        heard, message = self._latest.get(name, (-math.inf, None))
        return message if now - heard <= _FRESH else None

    def _measured(self, message: Any) -> dict[str, float]:
        """Readings of encoder and torque meter of this joint."""
        if message is None:
            return {}
        names = list(message.name)
        place = 0 if self._joint_name is None else names.index(self._joint_name) if self._joint_name in names else None
        if place is None:
            return {}
        parts = (("encoder", message.position), ("torque_meter", message.effort))
        return {name: values[place] for name, values in parts if len(values) > place}

    def _referred(self, now: float) -> dict[str, float]:
        """The reference, from the last message or from the controller's diagnostics."""
        _, message = self._latest.get("reference", (now, None))
        heard, status = self._statuses.get("controller: reference", (-math.inf, None))
        if now - heard > _GONE:
            return {}
        values = {item.key: item.value for item in status.values}
        mode = Mode.__members__.get(values.get(MODE, "").upper())
        value, stiffness = _float(values.get(ASKED)), _float(values.get(STIFFNESS))
        if message is not None and values.get(MODE) != "none":
            mode = next((each for each in Mode if each == message.mode), None)
            value, stiffness = message.value, message.stiffness
        if mode is None:
            return {}
        asked = {"reference_stiffness": stiffness} if mode.has_stiffness else {}
        return {f"reference_{mode.quantity.name.lower()}": value, **asked}

    # ---------------------------------------------------------------- what is commanded

    def command(self, order: Mapping[str, Any]) -> None:
        """Carry out a command of a page, such as ``{"do": "reference", "mode": "angle", "value": 0.1}``.

        Args:
            order: ``do`` is ``reference``, ``enable`` (with ``value``) or ``clear_stop``.
        """
        if self._caller is None:
            raise BadInput("read-only: start watch with --allow-commands")
        what, value = order.get("do"), order.get("value")
        if what == "reference":
            mode = MODES.get(str(order.get("mode")))
            if mode is None or isinstance(value, bool) or not isinstance(value, (int, float)):
                raise BadInput("reference: expected a mode, angle or torque, and a number")
            if not math.isfinite(value):
                raise BadInput("reference: expected a finite number")
            if self._reference is None:  # not before: the controller reports a second publisher
                topic = TOPICS["reference"].relative
                self._reference = self._node.create_publisher(JointReference, topic, qos.REFERENCE)
            message = JointReference(mode=int(mode), value=float(value))
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._reference.publish(message)
        elif what == "enable":
            if not isinstance(value, bool):
                raise BadInput("enable: expected true or false")
            self._call(f"controller: {'enable' if value else 'disable'}", self._enable, SetBool.Request(data=value))
        elif what == "clear_stop":
            for name, client in self._clear.items():
                if client.service_is_ready():
                    self._call(f"{name}: clear_stop", client, Trigger.Request())
        else:
            raise BadInput("expected reference, enable or clear_stop")

    def _call(self, name: str, client: Any, request: Any) -> None:
        if not client.service_is_ready():
            raise BadInput(f"{name}: the node is not there")
        self._calls.append(_Call(name, client.call_async(request), time.monotonic() + _ANSWER))

    def _answer(self, now: float) -> None:
        if self._calls:
            self._executor.spin_once(timeout_sec=0.0)
        waiting = []
        for call in self._calls:
            if call.future.done():
                self._answers.append(f"{call.name}: {call.future.result().message}")
            elif now > call.until:
                self._answers.append(f"{call.name}: no answer")
            else:
                waiting.append(call)
        self._calls = waiting


def _number(value: float | None) -> float | None:
    """A number for JSON, rounded to the digits that a page shows; None where not finite."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.7g}")


def _float(text: Any) -> float:
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan
