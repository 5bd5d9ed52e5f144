"""The present reference of a joint: limits, time-out and slew (without ROS).

At each sample a reference passes these steps:

1. **Limits.** A value beyond the largest one is limited to it, and counted.
2. **Time-out.** A reference that is not repeated is lost after ``timeout``. A torque would then drive a free joint to
   its stop, so torques have a time-out unless it is switched off. An angle is safe to keep, so angles have no time-out
   unless it is switched on. A trajectory that is under way is not lost.
3. **Lost** means safe voltages, or, with ``hold``, the angle that was estimated at that moment.
4. **Slew.** The reference moves to its target no faster than ``slew``. It starts at the estimate if the controller did
   not track before, and when the quantity changes between torque and angle.

Modes with a stiffness follow the rules of their value's quantity, angle or torque.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pam_antagonist.control.command import Mode
from pam_antagonist.errors import BadInput

LOST = ("safe", "hold")
"""The choices of parameter ``reference_lost``."""

_LONGEST_STEP_NS = 20_000_000
"""[ns] A longer interval between two samples counts as this long for the slew, so that the reference does not jump."""


class Wanted(NamedTuple):
    """The reference at one sample."""

    mode: Mode | None  # None: none yet
    value: float  # angle [rad] or torque [N m]; NaN where the last reference cannot be used
    velocity: float = 0.0  # of the angle, for feed-forward [rad/s]; 0 where it is not known
    lost: bool = False  # whether it timed out and safe voltages must follow
    stiffness: float = math.nan  # −∂τ/∂ψ [N m/rad]; NaN: none given
    damping: float = math.nan  # [N m s/rad]; NaN: none given


@dataclass(frozen=True)
class Rules:
    """Rules for references, in rad or N m, by quantity (``Mode.ANGLE`` or ``Mode.TORQUE``)."""

    largest: Mapping[Mode, float]  # magnitude
    slew: Mapping[Mode, float]  # largest change in a second; 0: any
    timeout: Mapping[Mode, float]  # after which a reference that is not repeated is lost [s]; 0: never
    lost: str = "safe"  # ``safe`` or ``hold``


class Trajectory:
    """A reference that moves through points at given times.

    Between two points it is a cubic if the points have velocities, else a straight line. From the reference before the
    trajectory to the first point it is a straight line. After the last point it stays there. The points count from
    `start_ns` [ns]: times (N,) [s] from 0 on, values (N,) [rad] or [N m], and velocities (N,) [rad/s] or none.
    """

    def __init__(
        self,
        mode: Mode,
        start_ns: int,
        seconds: Sequence[float],
        values: Sequence[float],
        velocities: Sequence[float] = (),
    ) -> None:
        if not seconds or len(values) != len(seconds) or len(velocities) not in (0, len(seconds)):
            raise BadInput(
                f"trajectory of {len(seconds)} times, {len(values)} values, {len(velocities)} velocities: expected as "
                "many of each"
            )
        if not all(map(math.isfinite, (*seconds, *values, *velocities))):
            raise BadInput("trajectory with a value that is not finite")
        if seconds[0] < 0.0 or any(b <= a for a, b in zip(seconds, seconds[1:], strict=False)):
            raise BadInput("trajectory whose times do not increase from 0 on")
        self.mode = mode
        self._start_ns = start_ns
        self._seconds, self._values, self._velocities = list(seconds), list(values), list(velocities)
        self._first: float | None = None

    def over(self, stamp_ns: int) -> bool:
        """Whether the last point is passed at this stamp [ns]."""
        return (stamp_ns - self._start_ns) * 1e-9 >= self._seconds[-1]

    def at(self, stamp_ns: int, now: float) -> tuple[float, float]:
        """Value and its change in a second at a stamp [ns].

        `now`: present reference or estimate, used at the first call only [rad] or [N m].
        """
        time = (stamp_ns - self._start_ns) * 1e-9
        seconds, values, speeds = self._seconds, self._values, self._velocities
        if self._first is None:
            self._first = now
        if time >= seconds[-1]:
            return values[-1], 0.0
        if time < 0.0:
            return self._first, 0.0
        if time < seconds[0]:
            return _line(time, 0.0, seconds[0], self._first, values[0])
        k = bisect_right(seconds, time) - 1
        if not speeds:
            return _line(time, seconds[k], seconds[k + 1], values[k], values[k + 1])
        length = seconds[k + 1] - seconds[k]
        s = (time - seconds[k]) / length
        a, b, u, v = values[k], values[k + 1], speeds[k] * length, speeds[k + 1] * length
        value = a + s * (u + s * (3.0 * (b - a) - 2.0 * u - v + s * (2.0 * (a - b) + u + v)))
        change = u + s * (2.0 * (3.0 * (b - a) - 2.0 * u - v) + s * 3.0 * (2.0 * (a - b) + u + v))
        return value, change / length


def _line(time: float, begin: float, end: float, a: float, b: float) -> tuple[float, float]:
    slope = (b - a) / (end - begin)
    return a + slope * (time - begin), slope


Nearest = Callable[[Mode, float, float, float], tuple[float, float, str]]
"""From mode, value, stiffness and the estimated angle to the reachable value and stiffness, and a sentence on the
difference. It raises ``BadInput`` if the mode cannot be followed."""


class References:
    """Keeps the last reference, and applies the rules to it at each sample. Without `nearest`, all can be reached.

    After a reference that cannot be used, `complaint` says why; `limited` says how one was limited.
    """

    def __init__(self, rules: Rules, nearest: Nearest | None = None) -> None:
        self._rules, self._nearest = rules, nearest
        self._angle = 0.0
        self.limited_count = self.lost_count = 0
        self.forget()

    def forget(self) -> None:
        """Forget the last reference."""
        self.mode: Mode | None = None
        self.complaint = self.limited = ""
        self.lost = False
        self.value = math.nan
        self._target = math.nan
        self._velocity = 0.0
        self.stiffness = self._damping = math.nan
        self._trajectory: Trajectory | None = None
        self._heard_ns = 0
        self._stamp_ns: int | None = None
        self._tracked: Mode | None = None

    def not_tracking(self) -> None:
        """Note that the controller does not track now: the next reference starts at the estimate."""
        self._tracked = None

    def set(
        self,
        mode: Mode,
        value: float,
        now_ns: int,
        velocity: float = 0.0,
        stiffness: float = math.nan,
        damping: float = math.nan,
    ) -> None:
        """Take a reference, at a steady time [ns]. A value that is not finite cannot be used.

        `velocity`: of the angle, for feed-forward [rad/s]. `stiffness`: [N m/rad], for the modes that have one.
        `damping`: [N m s/rad], for ``Mode.IMPEDANCE``; NaN: none added to the joint's own.
        """
        if not math.isfinite(value):
            self.refuse(f"reference {value:g} {mode.unit}, expected a finite number", mode)
            return
        if mode.has_stiffness and not (math.isfinite(stiffness) and stiffness > 0.0):
            self.refuse(
                f"reference of mode {mode.name} has stiffness {stiffness:g} N m/rad, expected a number above 0 "
                f"(mode {mode.quantity.name} leaves the stiffness free)",
                mode,
            )
            return
        if mode is Mode.IMPEDANCE and not (math.isnan(damping) or 0.0 <= damping < math.inf):
            self.refuse(f"reference has damping {damping:g} N m s/rad, expected 0 or more, or NaN for none", mode)
            return
        if not mode.has_stiffness:
            stiffness = math.nan  # a message holds 0 where nobody has written one
        target, words = self._within(mode, value), self._limit_words(mode, value)
        if self._nearest is not None:
            try:
                target, stiffness, out_of_reach = self._nearest(mode, target, stiffness, self._angle)
            except BadInput as error:
                self.refuse(str(error), mode)
                return
            words = words or out_of_reach
        self._take(mode, now_ns)
        self.stiffness = stiffness
        if mode is Mode.IMPEDANCE:
            self._damping = 0.0 if math.isnan(damping) else damping
        self.limited = words
        self.limited_count += bool(words)
        self._target = target
        self._velocity = velocity if math.isfinite(velocity) and not words else 0.0

    def follow(self, trajectory: Trajectory, now_ns: int) -> None:
        """Take a trajectory in place of the present reference, at a steady time [ns]."""
        self._take(trajectory.mode, now_ns)
        self._trajectory = trajectory

    def cancel(self) -> None:
        """Stop a trajectory: the reference stays where it is now."""
        if self._trajectory is not None and self.mode is not None and math.isfinite(self.value):
            self._trajectory, self._target, self._velocity = None, self.value, 0.0

    def refuse(self, complaint: str, mode: Mode = Mode.ANGLE) -> None:
        """Note a reference that cannot be used, and why: safe voltages follow until a usable one comes.

        `mode` is used only if none has come before.
        """
        self.complaint, self.limited = complaint, ""
        self.mode = self.mode if self.mode is not None else mode
        self._trajectory = None
        self._target = math.nan

    def _take(self, mode: Mode, now_ns: int) -> None:
        self.mode, self._heard_ns = mode, now_ns
        self.complaint = self.limited = ""
        self.lost = False
        self._trajectory = None
        self.stiffness = self._damping = math.nan

    def _within(self, mode: Mode, value: float) -> float:
        largest = self._rules.largest[mode.quantity]
        return min(max(value, -largest), largest)

    def _limit_words(self, mode: Mode, value: float) -> str:
        largest = self._rules.largest[mode.quantity]
        if abs(value) <= largest:
            return ""
        return f"reference {value:g} {mode.unit} is limited to ±{largest:g} {mode.unit}"

    def at(self, stamp_ns: int, now_ns: int, angle: float, torque: float) -> Wanted:
        """The reference at the stamp of an estimate [ns], with its angle [rad] and torque [N m], and a steady time."""
        self._angle = angle if math.isfinite(angle) else self._angle
        if self.mode is None:
            return Wanted(None, math.nan)
        if self.complaint:
            self.value = math.nan
            return Wanted(self.mode, math.nan)
        estimate = torque if self.mode.quantity is Mode.TORQUE else angle
        begins = self._tracked is not self.mode.quantity or not math.isfinite(self.value)
        last = estimate if begins else self.value
        target, velocity = self._target, self._velocity
        if self._trajectory is not None:
            target, velocity = self._on_the_way(self._trajectory, stamp_ns, now_ns, last)
        timeout = self._rules.timeout[self.mode.quantity]
        if timeout > 0.0 and not self.lost and now_ns - self._heard_ns > timeout * 1e9:
            if self._rules.lost == "hold" and not math.isfinite(angle):
                return Wanted(self.mode, math.nan, lost=True)  # there is no angle to hold yet
            self.lost = True
            self.lost_count += 1
            if self._rules.lost == "hold":
                self.mode, begins, last = Mode.ANGLE, True, angle
                self.stiffness = self._damping = math.nan
                self._target = target = self._within(Mode.ANGLE, angle)
                self._velocity, self._trajectory = 0.0, None
        if self.lost and self._rules.lost == "safe":
            self.value = math.nan
            return Wanted(self.mode, math.nan, lost=True)
        if self.lost:
            velocity = 0.0
        self.value = self._slewed(self.mode, last, target, stamp_ns)
        self._tracked, self._stamp_ns = self.mode.quantity, stamp_ns
        velocity = velocity if self.value == target else 0.0
        return Wanted(self.mode, self.value, velocity, stiffness=self.stiffness, damping=self._damping)

    def _on_the_way(self, trajectory: Trajectory, stamp_ns: int, now_ns: int, last: float) -> tuple[float, float]:
        if not trajectory.over(stamp_ns):
            self._heard_ns = now_ns
        value, velocity = trajectory.at(stamp_ns, last)
        words = self._limit_words(trajectory.mode, value)
        if words and not self.limited:
            self.limited_count += 1
        self.limited = words
        return self._within(trajectory.mode, value), 0.0 if words else velocity

    def _slewed(self, mode: Mode, last: float, target: float, stamp_ns: int) -> float:
        slew = self._rules.slew[mode.quantity]
        if slew <= 0.0 or not math.isfinite(last):
            return target
        before = self._stamp_ns if self._stamp_ns is not None and self._tracked is mode.quantity else stamp_ns
        most = slew * min(max(stamp_ns - before, 0), _LONGEST_STEP_NS) * 1e-9
        return min(max(target, last - most), last + most)
