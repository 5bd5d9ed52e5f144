"""What the nodes have in common."""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from pam_antagonist.nodes.diagnostics import DiagnosticsPublisher
from pam_antagonist.nodes.health import Health
from pam_antagonist.nodes.parameters import DIAGNOSTICS_PERIOD, Parameter, declare
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE

JOINT_NAME = "joint"

SHARED_PARAMETERS = ("rig", "joint", "lock_angle", "frame_id", "safe_voltage", "tuning", "max_age")
"""Parameters that a file for a whole pipeline may give to every node, whether it has them or not."""


class PamNode(Node):  # type: ignore[misc]
    """A node with checked parameters and diagnostics.

    Timers run on the steady clock, so that a jump of the system clock cannot stop them; whatever is compared with a
    stamp is read from the node's clock, which follows ``use_sim_time``.

    Args:
        name: of the node.
        table: its parameters.

    Attributes:
        values: the parameters.
        finished: set by a node that has nothing left to do.

    Raises:
        BadInput: a parameter that cannot be used.
    """

    finished = False

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        super().__init__(name, namespace=DEFAULT_NAMESPACE)
        self.values: dict[str, Any] = declare(self, (*table, DIAGNOSTICS_PERIOD), SHARED_PARAMETERS)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._ros_clock = self.get_clock()

    def start_diagnostics(self, hardware_id: str) -> None:
        """Send :meth:`health` from now on."""
        self._diagnostics = DiagnosticsPublisher(self, hardware_id)
        self.steady_timer(self.values["diagnostics_period"], self._diagnose)

    def steady_timer(self, period: float, callback: Any) -> Any:
        """A timer [s] on the steady clock."""
        return self.create_timer(period, callback, clock=self._steady)

    def now_ns(self) -> int:
        """Time of the node's clock [ns]."""
        return int(self._ros_clock.now().nanoseconds)

    def health(self, steady_ns: int) -> Mapping[str, Health]:
        """The state of each part; called once every ``diagnostics_period``.

        Args:
            steady_ns: steady time [ns].
        """
        raise NotImplementedError

    def activate(self) -> None:
        """Begin: subscriptions and timers. Called when everything that takes time is done, right before spinning.

        What is subscribed to earlier piles up until then, and comes late.
        """

    def close(self) -> None:
        """Last messages, while there still is a context to send them. Called once, before the node is destroyed."""

    def _diagnose(self) -> None:
        self._diagnostics.publish(self.health(time.monotonic_ns()))
        # The automatic collection is off, and what existed before the first sample is out of its sight (see spin.py):
        # what is left to look through takes microseconds.
        gc.collect()
