"""Putting a profile of voltages on the valves of a running pipeline that has no controller."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from pam_antagonist.nodes import qos
from pam_antagonist.nodes.spin import tune_middleware
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE, TOPICS
from pam_antagonist_msgs.msg import JointEstimate, ValveCommand

_LISTENERS = 2  # of the commands: the plant or a driver, and the recorder
_TICK = 0.004  # between two commands [s]; the valves take the last one until then
_SIGN_OF_LIFE = 0.2  # between two reports of progress [s]


class Drive:
    """A node that commands valve voltages by the clock, to be used as a context manager.

    Args:
        namespace: of the pipeline.
    """

    def __init__(self, namespace: str = DEFAULT_NAMESPACE) -> None:
        tune_middleware()
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("drive", namespace=namespace, context=self._context, start_parameter_services=False)
        self._commands = self._node.create_publisher(ValveCommand, TOPICS["valve_command"].relative, qos.COMMAND)
        self._estimate = self._node.create_subscription(
            JointEstimate, TOPICS["joint_estimate"].relative, lambda message: None, qos.GLANCE
        )

    def __enter__(self) -> Drive:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def missing(self) -> str:
        """What does not deliver or listen yet, in words; empty when everything does."""
        parts = []
        with self._estimate.handle:
            if self._estimate.handle.take_message(self._estimate.msg_type, False) is None:
                parts.append(f"nothing on {TOPICS['joint_estimate'].relative}")
        if self._commands.get_subscription_count() < _LISTENERS:
            parts.append("nobody listens to valve_command")
        return ", ".join(parts)

    def send(self, voltage: NDArray[np.float64]) -> None:
        """Command two voltages [V] now."""
        message = ValveCommand(voltage=[float(value) for value in voltage])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._commands.publish(message)

    def follow(
        self, voltage: NDArray[np.float64], period: float, check: Callable[[], None], progress: Callable[[float], None]
    ) -> None:
        """Command a profile in real time.

        Args:
            voltage: (N, 2) [V], a row a period.
            period: [s].
            check: called often; it raises when there is no point in going on.
            progress: called with the time since the start [s].
        """
        start, told = time.monotonic(), 0.0
        while (elapsed := time.monotonic() - start) < len(voltage) * period:
            self.send(voltage[min(int(elapsed / period), len(voltage) - 1)])
            if elapsed - told > _SIGN_OF_LIFE:
                check()
                progress(elapsed)
                told = elapsed
            time.sleep(_TICK)
