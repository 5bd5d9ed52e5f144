"""Health of a node for ``/diagnostics``: statistics, and publishers and subscribers that it is not connected to."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription

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


def judged(values: Mapping[str, object], well: str, *cases: tuple[object, Level, str]) -> Health:
    """The health of a part by the first of the cases that holds; without one all is ``well``."""
    level, message = next(((level, words) for holds, level, words in cases if holds), (Level.OK, well))
    return Health(level, message, values)


def too_slow(rate: float, what: str) -> str:
    """What is said where a computer does not keep up. `rate`: samples a second. `what`: shows it, in words."""
    return (
        f"this computer is too slow for {rate:g} samples a second: {what}. Set a longer sample_period in the rig file, "
        "or end other programs"
    )


class Spread(NamedTuple):
    """Statistics of some values; NaN without values."""

    size: int
    median: float
    p99: float  # 99th percentile
    largest: float

    def as_values(self, name: str, unit: str, scale: float = 1.0) -> dict[str, str]:
        """Entries for ``Health.values``."""
        words = ("median", "99th percentile", "largest")
        return {f"{name} {word} [{unit}]": f"{value / scale:.3f}" for word, value in zip(words, self[1:], strict=True)}


class Window:
    """Collects values between two reports; those beyond the first 20,000 are left out."""

    def __init__(self) -> None:
        self._values: list[float] = []

    def add(self, value: float) -> None:
        """Add a value."""
        if len(self._values) < 20_000:
            self._values.append(value)

    def take(self) -> Spread:
        """Statistics of the values since the last call."""
        values = sorted(self._values)
        self._values.clear()
        last = len(values) - 1
        if last < 0:
            return Spread(0, math.nan, math.nan, math.nan)
        return Spread(len(values), values[last // 2], values[math.ceil(0.99 * last)], values[last])


class Rate:
    """Rate of events [1/s]."""

    def __init__(self) -> None:
        self._count = 0
        self._since: int | None = None

    def take(self, count: int, now_ns: int) -> float:
        """Rate [1/s] since the last call; NaN at the first. `now_ns`: steady time [ns]."""
        rate = math.nan
        if self._since is not None and now_ns > self._since:
            rate = (count - self._count) / (now_ns - self._since) * 1e9
        self._count, self._since = count, now_ns
        return rate


class Rises:
    """By how much counters have risen since the last report.

    `first`: what the first values are compared with; None: with themselves, for counters that began before.
    """

    def __init__(self, first: float | None = 0) -> None:
        self._first = first
        self._before: dict[str, float] = {}

    def take(self, **counters: float) -> dict[str, float]:
        """The rise of each counter."""
        before = counters if self._first is None else dict.fromkeys(counters, self._first)
        before, self._before = before | self._before, counters
        return {name: value - before[name] for name, value in counters.items()}


class DiagnosticsPublisher:
    """Publishes the health of a node's parts."""

    def __init__(self, node: Node, hardware_id: str) -> None:
        self._node = node
        self._name = full_name(node.get_namespace(), node.get_name()).lstrip("/")
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


def full_name(namespace: str, name: str) -> str:
    """Name of a node with its namespace."""
    return f"{namespace}/{name}".replace("//", "/")


def publishers_of(node: Node, topic: str) -> list[str]:
    """Full names of the nodes that publish a topic, sorted."""
    found = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    return sorted(full_name(info.node_namespace, info.node_name) for info in found)


def connections(node: Node, entities: Iterable[Any]) -> Health:
    """Part ``connections``: nodes that quality of service keeps from the node's publishers and subscriptions."""
    problems = [words for entity in entities for words in _unconnected(node, entity)]
    more = f", and {len(problems) - 1} more" if len(problems) > 1 else ""
    values = {f"not connected, {k + 1}": words for k, words in enumerate(problems)}
    return judged(values, "quality of service matches", (problems, Level.ERROR, f"{''.join(problems[:1])}{more}"))


def _unconnected(node: Node, entity: Any) -> Iterator[str]:
    topic, subscribes = entity.topic_name, isinstance(entity, Subscription)
    if subscribes:
        if entity.get_publisher_count() >= node.count_publishers(topic):
            return
        found, words = node.get_publishers_info_by_topic(topic), ("publisher", "subscription")
    else:
        if entity.get_subscription_count() >= node.count_subscribers(topic):
            return
        found, words = node.get_subscriptions_info_by_topic(topic), ("subscriber", "publisher")
    for info in found:
        here, there = entity.qos_profile, info.qos_profile
        offered, asked = (there, here) if subscribes else (here, there)
        compatible, _ = qos_check_compatible(offered, asked)
        if compatible == QoSCompatibility.ERROR:
            difference = _difference(offered, asked, topic, words[1])
            yield f"{words[0]} {_who(info)} of {topic} is not connected: {difference}"


def _who(info: Any) -> str:
    """The node of an endpoint, whose name may come a moment after the endpoint."""
    if "_UNKNOWN_" in info.node_name:
        return "(of a node whose name has not come yet)"
    return full_name(info.node_namespace, info.node_name)


def _difference(offered: QoSProfile, asked: QoSProfile, topic: str, side: str) -> str:
    """The difference of two profiles, and how to correct it."""
    for policy in ("reliability", "durability"):
        one, other = getattr(offered, policy).name, getattr(asked, policy).name
        if one != other:
            pair = f"{one} offered, {other} asked for".lower().replace("_", " ")
            if policy == "durability":
                return f"{pair}; change the other side"
            better = "best_effort" if side == "subscription" else "reliable"
            return f"{pair}; set qos_overrides.{topic}.{side}.reliability to {better}, or change the other side"
    return "deadline or liveliness differ; change the other side"
