"""Whether the joint of a recording was free or locked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput, number
from pam_antagonist.recording import Recording

_STILL = math.radians(0.5)
"""[rad] The angle of a locked joint stays within this range; encoder noise alone reaches half of it."""
_MOVING = 50e3
"""[Pa] A change of the pressure difference by this much moves a free joint by several degrees."""
_ROUNDING = 1e-9
"""[rad] Largest change by rounding of the estimated angle of a locked joint."""
_GIVES_WAY = math.radians(2.0)
"""[rad] A lock may give way by this much; a free joint under changing pressures moves further."""
_BEFORE_STOP, _BEYOND_STOP = math.radians(1.0), math.radians(6.0)
"""[rad] A joint that stands so little before its stop, or so little beyond it, rests there. An encoder's zero that was
set by eye may be off by so much."""
_DECIMALS = 1
"""Decimals in degrees of a measured lock angle; further digits are encoder noise."""


@dataclass(frozen=True)
class JointCondition:
    """Whether the joint was free or locked."""

    condition: str  # ``free`` or ``locked``
    lock_angle: float  # angle of a locked joint [rad]
    # origin of the condition: ``command line``, ``measured angle``, ``recorded estimate``, ``stop`` (a joint that rests
    # there) or ``nothing``.
    source: str


def joint_condition(
    recording: Recording, joint: str = "auto", lock_angle: float | None = None, stop: float | None = None
) -> JointCondition:
    """Whether the joint was free or locked.

    The joint is locked if the measured angle stays while the pressures change enough to move a free joint. Without a
    measured angle, or with nearly constant pressures, the setting of the live filter decides if its estimate was
    recorded. Otherwise the joint is assumed free. A free joint may stay at its stop.

    `joint`: ``free`` or ``locked`` where it is known. `stop`: largest angle of the rig to both sides [rad].
    `lock_angle`: of a locked joint [rad]; default: that of the recorded estimate, else the median of the measured angle
    to 0.1°, else 0.
    """
    if joint not in ("free", "locked", "auto"):
        raise BadInput(f"joint {joint!r}: expected free, locked or auto")
    if lock_angle is not None and joint != "locked":
        raise BadInput(f"a lock angle was given and joint is {joint!r}: expected locked")
    condition, source = (joint, "command line") if joint != "auto" else _detected(recording)
    if (condition, source) == ("locked", "measured angle") and stop is not None:
        beyond = abs(float(np.median(_finite(recording.angle)))) - stop
        condition, source = ("free", "stop") if -_BEFORE_STOP < beyond < _BEYOND_STOP else (condition, source)
    if condition == "free":
        return JointCondition("free", 0.0, source)
    lock_angle = None if lock_angle is None else number("lock_angle", lock_angle)
    if lock_angle is None:
        lock_angle = _live_lock(recording)
    if lock_angle is None:
        angle = _finite(recording.angle)
        lock_angle = math.radians(round(math.degrees(float(np.median(angle))), _DECIMALS)) if angle.size else 0.0
    return JointCondition("locked", lock_angle, source)


def with_stops(recordings: Sequence[Recording], conditions: Sequence[JointCondition]) -> list[JointCondition]:
    """The conditions of recordings of one joint, some of which may stand at its stop all the time.

    A stop is an angle that the others never pass, and at which they stay while the pressures change. A recording whose
    torque was measured is one of a lock.
    """
    free = [
        np.column_stack([one.angle, one.pressure[:, 0] - one.pressure[:, 1]])
        for one, state in zip(recordings, conditions, strict=True)
        if state.condition == "free" and one.angle is not None
    ]
    angles, differences = np.concatenate([np.zeros((0, 2)), *free]).T

    def rests(recording: Recording, state: JointCondition) -> bool:
        if state.source != "measured angle" or _finite(recording.torque).size:
            return False
        apart = angles - state.lock_angle
        there, known = np.abs(apart) < _STILL, _finite(apart)
        if not there.any() or not (known.max() < 2.0 * _STILL or known.min() > -2.0 * _STILL):
            return False
        return range_of(differences[there]) >= _MOVING

    return [
        JointCondition("free", 0.0, "stop") if state.condition == "locked" and rests(recording, state) else state
        for recording, state in zip(recordings, conditions, strict=True)
    ]


def refuse_other_condition(recording: Recording, condition: str, name: str) -> None:
    """Refuse a recording whose measured angle contradicts what is said of the joint."""
    moved = range_of(recording.angle)
    said = f"its measured angle moves by {math.degrees(moved):.1f}°"
    if condition == "locked" and moved > _GIVES_WAY:
        found = f"the joint is declared locked, but {said}; expected a joint that stands still, or free"
    elif condition == "free" and _detected(recording) == ("locked", "measured angle"):
        found = f"the joint is declared free, but {said} only while the pressures change; expected locked"
    else:
        return
    raise BadInput(f"{name}: {found} (auto finds out which by itself)")


def _detected(recording: Recording) -> tuple[str, str]:
    angle = _finite(recording.angle)
    if angle.size:
        if range_of(angle) >= _STILL:
            return "free", "measured angle"
        if range_of(recording.pressure[:, 0] - recording.pressure[:, 1]) >= _MOVING:
            return "locked", "measured angle"
    if recording.estimate is not None and len(recording.estimate.angle):
        return ("free" if _live_lock(recording) is None else "locked"), "recorded estimate"
    return "free", "nothing"


def _live_lock(recording: Recording) -> float | None:
    """Lock angle of the live filter [rad]; None where its joint was free or no estimate was recorded."""
    estimate = recording.estimate
    locked = [item.identity.lock_angle for item in recording.checkpoints if item.identity.joint == "locked"]
    if locked and math.isfinite(locked[-1]):
        return locked[-1]
    if estimate is None or len(estimate.angle) == 0 or np.any(estimate.velocity) or np.ptp(estimate.angle) > _ROUNDING:
        return None
    # The first sample of the filter has the exact angle; later ones may be rounded by the mean of sigma points.
    exact = estimate.angle[estimate.stamp_ns == estimate.started_ns]
    return float(exact[0] if len(exact) else estimate.angle[0])


def _finite(values: NDArray[np.float64] | None) -> NDArray[np.float64]:
    return np.zeros(0) if values is None else values[np.isfinite(values)]


def ends_of(values: NDArray[np.float64] | None) -> tuple[float, float]:
    """Least and largest of 99 % of the values, which ignores single outliers; NaN for none."""
    known = _finite(values)
    low, high = np.quantile(known, [0.005, 0.995]).tolist() if known.size else (math.nan, math.nan)
    return low, high


def range_of(values: NDArray[np.float64] | None) -> float:
    """Range of 99 % of the values; 0 for none."""
    low, high = ends_of(values)
    return high - low if high >= low else 0.0
