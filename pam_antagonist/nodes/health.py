"""Health of a node for ``/diagnostics``: statistics, and publishers and subscribers that it is not connected to."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.exceptions import ParameterException
from rclpy.qos import (
    InvalidQoSProfileException,
    QoSCompatibility,
    QoSProfile,
    qos_check_compatible,
)
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos

if TYPE_CHECKING:
    from rclpy.node import Node


class Level(IntEnum):
    """The levels of ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Health:
    """The state of one part of a node."""

    level: Level
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Spread:
    """Median, 99th percentile and maximum of some values; NaN without values."""

    count: int
    median: float
    p99: float  # 99th percentile
    largest: float

    def as_values(self, name: str, unit: str, scale: float = 1.0) -> dict[str, str]:
        """Entries for ``Health.values``."""
        return {
            f"{name} median [{unit}]": f"{self.median / scale:.3f}",
            f"{name} 99th percentile [{unit}]": f"{self.p99 / scale:.3f}",
            f"{name} largest [{unit}]": f"{self.largest / scale:.3f}",
        }


class Window:
    """Collects values between two reports."""

    def __init__(self, limit: int = 20_000) -> None:
        self._values: list[float] = []
        self._limit = limit

    def add(self, value: float) -> None:
        """Add a value; values beyond the limit are left out."""
        if len(self._values) < self._limit:
            self._values.append(value)

    def take(self) -> Spread:
        """Statistics of the values since the last call."""
        values = sorted(self._values)
        self._values.clear()
        if not values:
            return Spread(0, math.nan, math.nan, math.nan)
        last = len(values) - 1
        return Spread(len(values), values[last // 2], values[math.ceil(0.99 * last)], values[last])


class Rate:
    """Rate of events [1/s]."""

    def __init__(self) -> None:
        self._count = 0
        self._since: int | None = None

    def take(self, count: int, now_ns: int) -> float:
        """Rate [1/s] since the last call; NaN at the first. `now_ns`: steady time [ns]."""
        if self._since is None or now_ns <= self._since:
            rate = math.nan
        else:
            rate = (count - self._count) / (now_ns - self._since) * 1e9
        self._count, self._since = count, now_ns
        return rate


class DiagnosticsPublisher:
    """Publishes the health of a node's parts."""

    def __init__(self, node: Node, hardware_id: str) -> None:
        self._node = node
        self._name = f"{node.get_namespace()}/{node.get_name()}".replace("//", "/").lstrip("/")
        self._hardware_id = hardware_id
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)

    def publish(self, parts: Mapping[str, Health]) -> None:
        """Publish one message with a status for each part, named "node: part"."""
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        for part, health in parts.items():
            message.status.append(
                DiagnosticStatus(
                    level=bytes([health.level]),
                    name=f"{self._name}: {part}",
                    message=health.message,
                    hardware_id=self._hardware_id,
                    values=[KeyValue(key=key, value=str(value)) for key, value in health.values.items()],
                )
            )
        self._publisher.publish(message)


OVERRIDES = QoSOverridingOptions.with_default_policies()
"""Policies that ``qos_overrides`` may change: reliability, history and depth. Durability is fixed, because an old
command must not reach the valves, and an old reference must not count as new."""

_FIXED = ("/diagnostics", "/rosout", "/parameter_events", "/clock")

QOS_ERRORS = (InvalidQosOverridesError, ParameterException, InvalidQoSProfileException, RuntimeError, ValueError)
"""Exceptions of rclpy for invalid overrides."""


def overridable(topic: str, profile: Any, options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """A copied profile and rclpy's options for a topic whose quality of service a user may change.

    `topic`: name of the topic; ``/diagnostics`` and the topics of ROS itself cannot be changed.
    """
    if topic in _FIXED or not isinstance(profile, QoSProfile):
        return profile, options
    return copy.copy(profile), {"qos_overriding_options": OVERRIDES, **options}


def refused(topic: str, error: Exception) -> Exception:
    """A ``BadInput`` for an invalid override; other errors are returned unchanged."""
    if type(error).__name__ == "RCLError" or (isinstance(error, RuntimeError) and "QoS override" not in str(error)):
        return error
    return BadInput(f"qos_overrides of {topic}: {error}; expected reliability, history or depth as in ROS 2")


@dataclass(frozen=True)
class _Entity:
    topic: str
    entity: Any
    profile: QoSProfile
    subscribes: bool


class Connections:
    """The publishers and subscriptions of a node, and their missing connections."""

    def __init__(self) -> None:
        self._entities: dict[int, _Entity] = {}

    def add(self, topic: str, entity: Any, profile: Any, subscribes: bool) -> None:
        """Watch a publisher or a subscription."""
        if isinstance(profile, QoSProfile):
            self._entities[id(entity)] = _Entity(topic, entity, profile, subscribes)

    def remove(self, entity: Any) -> None:
        """Stop watching an entity that is destroyed."""
        self._entities.pop(id(entity), None)

    def problems(self, node: Node) -> list[str]:
        """Nodes that are not connected because of quality of service, in words."""
        return [words for item in list(self._entities.values()) for words in self._of(node, item)]

    def _of(self, node: Node, item: _Entity) -> list[str]:
        if item.subscribes:
            if item.entity.get_publisher_count() >= node.count_publishers(item.topic):
                return []
            found = node.get_publishers_info_by_topic(item.topic)
        else:
            if item.entity.get_subscription_count() >= node.count_subscribers(item.topic):
                return []
            found = node.get_subscriptions_info_by_topic(item.topic)
        words = []
        for info in found:
            offered, asked = (info.qos_profile, item.profile) if item.subscribes else (item.profile, info.qos_profile)
            compatible, _ = qos_check_compatible(offered, asked)
            if compatible != QoSCompatibility.ERROR:
                continue
            role, side = ("publisher", "subscription") if item.subscribes else ("subscriber", "publisher")
            words.append(
                f"{role} {_who(info)} of {item.topic} is not connected: {_difference(offered, asked, item.topic, side)}"
            )
        return words

    def health(self, node: Node) -> Health:
        """Part ``connections`` for ``/diagnostics``."""
        problems = self.problems(node)
        values = {f"not connected, {k + 1}": words for k, words in enumerate(problems)}
        if problems:
            more = f", and {len(problems) - 1} more" if len(problems) > 1 else ""
            return Health(Level.ERROR, f"{problems[0]}{more}", values)
        return Health(Level.OK, "quality of service matches", values)


def _who(info: Any) -> str:
    """The node of an endpoint, whose name may come a moment after the endpoint."""
    if "_UNKNOWN_" in info.node_name:
        return "(of a node whose name has not come yet)"
    return f"{info.node_namespace}/{info.node_name}".replace("//", "/")


def _difference(offered: QoSProfile, asked: QoSProfile, topic: str, side: str) -> str:
    """The difference of two profiles, and how to correct it."""
    if offered.reliability != asked.reliability:
        pair = f"{offered.reliability.name} offered, {asked.reliability.name} asked for".lower().replace("_", " ")
        better = "best_effort" if side == "subscription" else "reliable"
        return f"{pair}; set qos_overrides.{topic}.{side}.reliability to {better}, or change the other side"
    if offered.durability != asked.durability:
        pair = f"{offered.durability.name} offered, {asked.durability.name} asked for".lower().replace("_", " ")
        return f"{pair}; change the other side"
    return "deadline or liveliness differ; change the other side"
