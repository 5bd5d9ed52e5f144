"""Publisher of a node's health on ``/diagnostics``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from pam_antagonist.nodes import qos
from pam_antagonist.nodes.health import Health

if TYPE_CHECKING:
    from rclpy.node import Node


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
