"""Detects publishers and subscribers that a node's topics are not connected to.

ROS 2 does not report incompatible quality of service: a best-effort driver and a reliable subscriber find each other
and exchange nothing. So each node compares the number of publishers or subscribers of its topics with the number that
it is connected to. Only where they differ, it looks up their names.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import ParameterException
from rclpy.qos import InvalidQoSProfileException, QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.health import Health, Level

if TYPE_CHECKING:
    from rclpy.node import Node

OVERRIDES = QoSOverridingOptions.with_default_policies()
"""Policies that ``qos_overrides`` may change: reliability, history and depth. Durability is fixed, because an old
command must not reach the valves, and an old reference must not count as new."""

_FIXED = ("/diagnostics", "/rosout", "/parameter_events", "/clock")

QOS_ERRORS = (InvalidQosOverridesError, ParameterException, InvalidQoSProfileException, RuntimeError, ValueError)
"""Exceptions of rclpy for invalid overrides."""


def overridable(topic: str, profile: Any, options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """A copied profile and rclpy's options for a topic whose quality of service a user may change.

    Args:
        topic: name of the topic; ``/diagnostics`` and the topics of ROS itself cannot be changed.
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
