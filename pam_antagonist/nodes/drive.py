"""Putting a profile of voltages on the valves of a running pipeline that has no controller."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.nodes import qos
from pam_antagonist.nodes.visitor import Visitor
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE
from pam_antagonist_msgs.msg import JointEstimate, ValveCommand

_TICK = 0.004  # between two commands [s]; the valves take the last one until then
_SIGN_OF_LIFE = 0.2  # between two reports of progress [s]


class Drive(Visitor):
    """Commands valve voltages by the clock.

    Args:
        namespace: of the pipeline.
    """

    def __init__(self, namespace: str = DEFAULT_NAMESPACE) -> None:
        says = ("valve_command", ValveCommand, qos.COMMAND)
        super().__init__("drive", namespace, {"joint_estimate": JointEstimate}, says)

    def send(self, voltage: NDArray[np.float64]) -> None:
        """Command two voltages [V] now."""
        self._say(ValveCommand(voltage=[float(value) for value in voltage]))

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
