"""A client that commands a planned experiment, and returns to rest when a limit is exceeded."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import FluidPressure, JointState
from typing_extensions import override

from pam_antagonist.nodes.client import VoltageClient
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE
from pam_antagonist.safety.lookout import RETREAT, TICK, Lookout

Floats = NDArray[np.float64]

_PROGRESS_S = 0.2
_PRESSURES = ("pressure_1", "pressure_2")


class DriveClient(VoltageClient):
    """Commands valve voltages in a pipeline without a controller, and watches the sensors."""

    def __init__(self, namespace: str = DEFAULT_NAMESPACE) -> None:
        subscribed = {**dict.fromkeys(_PRESSURES, FluidPressure), "measured_joint_states": JointState}
        super().__init__(namespace, "excite", subscribed)

    def now_ns(self) -> int:
        """Time of the clock that stamps samples [ns]."""
        return int(self._node.get_clock().now().nanoseconds)

    @override
    def missing(self) -> str:
        """Topics without messages or subscribers, in words; an encoder is not required."""
        return ", ".join(part for part in super().missing().split(", ") if "joint_states" not in part)

    def seen(self) -> tuple[Floats, float]:
        """Measured pressures (2,) [Pa] and angle [rad] now; NaN before the first message."""
        messages = [self.latest(topic) for topic in _PRESSURES]
        pressures = np.array([math.nan if one is None else one.fluid_pressure for one in messages])
        joint = self.latest("measured_joint_states")
        return pressures, joint.position[0] if joint is not None and joint.position else math.nan

    def settle(self, rest: Floats, within: Callable[[Floats], bool], check: Callable[[], None], longest: float) -> None:
        """Hold the resting voltages until the pressures are in the range where a plan may begin.

        Args:
            rest: voltages (2,) [V].
            within: whether pressures (2,) [Pa] are in this range.
            longest: time after which the plan begins in any case [s].
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
        """Command a plan in real time; when a limit is exceeded, hold the resting voltages and end.

        Args:
            voltage: (N, 2) [V], one row for each period.
            period: [s].
            rest: resting voltages (2,) [V].
            broken: returns which limit the pressures (2,) [Pa] or the angle [rad] exceed, in words; empty for none.
            progress: called with the time since the last call [s].
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

    def explore(
        self,
        command: Callable[[float, Floats, float], tuple[float, float] | None],
        seconds: float,
        rest: Floats,
        broken: Callable[[Floats, float], str],
        check: Callable[[], None],
        progress: Callable[[float], None],
    ) -> str:
        """Command what follows from the measurements, in real time; at the end, the resting voltages.

        Args:
            command: returns the voltages [V] for the time [s], pressures (2,) [Pa] and angle [rad]; None at the end.
            seconds: length at most [s].
            rest: resting voltages (2,) [V].
            broken: as for :meth:`drive`.
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
                self._hold(rest, RETREAT)
                return f"after {elapsed:.1f} s {reason}"
            if elapsed - reported > _PROGRESS_S:
                check()
                progress(elapsed - reported)
                reported = elapsed
            time.sleep(TICK)
        self._hold(rest, _PROGRESS_S)
        return ""

    def _hold(self, voltage: Floats, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.send(voltage)
            time.sleep(TICK)
