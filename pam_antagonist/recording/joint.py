"""Whether the joint of a recording could move."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording

_STILL = math.radians(0.5)
"""[rad] A joint is held whose angle stays within this range; encoder noise alone reaches half of it."""
_MOVING = 50e3
"""[Pa] Change of the pressure difference that would certainly have moved a free joint, by degrees."""
_ROUNDING = 1e-9
"""[rad] Most that rounding moves the angle of a filter whose joint is locked."""
_DECIMALS = 1
"""A measured lock angle is rounded to 0.1 deg: nobody locks a joint at the mean of the encoder's noise."""


@dataclass(frozen=True)
class JointCondition:
    """Whether the joint could move.

    Attributes:
        condition: ``free`` or ``locked``.
        lock_angle: where a locked joint was held [rad].
        source: where that is from: ``command line``, ``measured angle``, ``recorded estimate`` or ``nothing``.
    """

    condition: str
    lock_angle: float
    source: str


def joint_condition(recording: Recording, joint: str = "auto", lock_angle: float | None = None) -> JointCondition:
    """Whether the joint was free or locked.

    A joint is locked whose measured angle stays while the pressures change enough to move it. Where that does
    not show (no angle was measured, or the pressures hardly change), the setting of the live filter decides, if its
    estimate was recorded; else the joint is taken for free.

    Args:
        recording: the recording.
        joint: ``free`` or ``locked`` where it is known, ``auto`` to detect it.
        lock_angle: angle of a locked joint [rad]; default: that of the recorded estimate, else the median of the
            measured angle to 0.1°, else 0.

    Raises:
        BadInput: a condition that does not exist, or a lock angle for a joint that is not said to be locked.
    """
    if joint not in ("free", "locked", "auto"):
        raise BadInput(f"joint {joint!r}: expected free, locked or auto")
    if lock_angle is not None and joint != "locked":
        raise BadInput(f"a lock angle was given and joint is {joint!r}: expected locked")
    condition, source = (joint, "command line") if joint != "auto" else _detected(recording)
    if condition == "free":
        return JointCondition("free", 0.0, source)
    if lock_angle is None:
        lock_angle = _live_lock(recording)
    if lock_angle is None:
        angle = _finite(recording.angle)
        lock_angle = math.radians(round(math.degrees(float(np.median(angle))), _DECIMALS)) if angle.size else 0.0
    return JointCondition("locked", lock_angle, source)


def _detected(recording: Recording) -> tuple[str, str]:
    angle = _finite(recording.angle)
    if angle.size:
        if _range(angle) >= _STILL:
            return "free", "measured angle"
        if _range(_finite(recording.pressure[:, 0] - recording.pressure[:, 1])) >= _MOVING:
            return "locked", "measured angle"
    if recording.estimate is not None and len(recording.estimate.angle):
        return ("free" if _live_lock(recording) is None else "locked"), "recorded estimate"
    return "free", "nothing"


def _live_lock(recording: Recording) -> float | None:
    """Angle of a live filter whose joint was declared locked [rad], None for any other."""
    estimate = recording.estimate
    locked = [item.lock_angle for item in recording.checkpoints if item.joint == "locked"]
    if locked and math.isfinite(locked[-1]):
        return locked[-1]
    if estimate is None or len(estimate.angle) == 0 or np.any(estimate.velocity) or np.ptp(estimate.angle) > _ROUNDING:
        return None
    # The sample that started the filter has the angle to the last bit; means of sigma points may round it.
    exact = estimate.angle[estimate.stamp_ns == estimate.started_ns]
    return float(exact[0] if len(exact) else estimate.angle[0])


def _finite(values: NDArray[np.float64] | None) -> NDArray[np.float64]:
    return np.zeros(0) if values is None else values[np.isfinite(values)]


def _range(values: NDArray[np.float64]) -> float:
    """Range of 99 % of the values: a single wrong sample moves no joint."""
    return float(np.diff(np.quantile(values, [0.005, 0.995]))[0]) if values.size else 0.0
