"""A client that commands a planned experiment and retreats when a limit is reached."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import FluidPressure, JointState
from typing_extensions import override

from pam_antagonist.nodes import qos
from pam_antagonist.nodes.client import PipelineClient
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE
from pam_antagonist.safety.lookout import RETREAT, TICK, Lookout
from pam_antagonist_msgs.msg import ValveCommand

Floats = NDArray[np.float64]

_PROGRESS_S = 0.2
_PRESSURES = ("pressure_1", "pressure_2")


class DriveClient(PipelineClient):
    """Commands valve voltages in a pipeline without a controller, and watches what the sensors show meanwhile.

    Args:
        namespace: of the pipeline.
    """

    def __init__(self, namespace: str = DEFAULT_NAMESPACE) -> None:
        subscribed = {**dict.fromkeys(_PRESSURES, FluidPressure), "measured_joint_states": JointState}
        super().__init__("excite", namespace, subscribed, ("valve_command", ValveCommand, qos.COMMAND))

    def send(self, voltage: Floats) -> None:
        """Command two voltages [V] now."""
        self._publish(ValveCommand(voltage=[float(value) for value in voltage]))

    def now_ns(self) -> int:
        """Time by the clock that stamps samples [ns]."""
        return int(self._node.get_clock().now().nanoseconds)

    @override
    def missing(self) -> str:
        """What does not deliver or listen yet; a joint without an encoder is complete."""
        return ", ".join(part for part in super().missing().split(", ") if "joint_states" not in part)

    def seen(self) -> tuple[Floats, float]:
        """Measured pressures (2,) [Pa] and angle [rad] now; NaN where nothing has come."""
        messages = [self.latest(topic) for topic in _PRESSURES]
        pressures = np.array([math.nan if one is None else one.fluid_pressure for one in messages])
        joint = self.latest("measured_joint_states")
        return pressures, joint.position[0] if joint is not None and joint.position else math.nan

    def settle(self, rest: Floats, within: Callable[[Floats], bool], check: Callable[[], None], longest: float) -> None:
        """Hold the resting voltages until the pressures are where a plan may begin.

        Args:
            rest: voltages (2,) [V].
            within: whether pressures (2,) [Pa] are there.
            check: called often; it raises when there is no point in going on.
            longest: time after which the plan begins all the same [s].
        """
        end = time.monotonic() + longest
        while time.monotonic() < end and not within(self.seen()[0]):
            check()
            self._hold(rest, _PROGRESS_S)

    def drive(
        self,
        voltage: Floats,
        period: float,
        rest: Floats,
        broken: Callable[[Floats, float], str],
        check: Callable[[], None],
        progress: Callable[[float], None],
    ) -> str:
        """Command a plan in real time; where a limit is reached, rest and end.

        Args:
            voltage: (N, 2) [V], a row a period.
            period: [s].
            rest: voltages of a retreat (2,) [V].
            broken: says in words which limit pressures (2,) [Pa] and angle [rad] break; empty for none.
            check: called often; it raises when there is no point in going on.
            progress: takes how many seconds more are done.

        Returns:
            Why it ended early, in words; empty where it did not.
        """
        begin, reported, lookout = time.monotonic(), 0.0, Lookout()
        while (elapsed := time.monotonic() - begin) < len(voltage) * period:
            self.send(voltage[min(int(elapsed / period), len(voltage) - 1)])
            if reason := lookout.ends(broken(*self.seen())):
                self._hold(rest, RETREAT)
                return f"after {elapsed:.1f} s {reason}"
            if elapsed - reported > _PROGRESS_S:
                check()
                progress(elapsed - reported)
                reported = elapsed
            time.sleep(TICK)
        progress(elapsed - reported)
        return ""

    def _hold(self, voltage: Floats, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.send(voltage)
            time.sleep(TICK)
