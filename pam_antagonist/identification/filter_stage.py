"""The filter of an identified rig: its noise, and a covariance of the angle that is right for the recordings.

The pressures are measured well, and valves are modelled badly: with a small process noise the innovations tell of the
valve's error, and the filter would explain it by a motion of the joint. So the process noise of the pressures is not
below the error of the predicted pressures. The measured pressures then drive the joint, as in the fit.

What is left is the joint's own error, slow and of unknown form. The filter considers a constant torque that is not
known (Schmidt-Kalman). Its standard deviation is chosen so that 95 % of the measured angles lie in their intervals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.identification.joint_stage import torque_scale
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.replays import replay
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]
Given = tuple[Recording, JointCondition, str]

UNKNOWN_TORQUE = "effects.load_torque.constant"
_LEAST_RATE = 1e3
"""[Pa] Least error of a predicted pressure over 10 ms. Below it, a valve's error is taken for a motion of the joint."""
_FIRST_RATE = 1e5
"""[Pa] The same, so large that the measured pressures are followed whatever the valves do."""
_OPEN_GATE = 1e4
_GATE_MARGIN = 1.5
"""The gate by the largest Mahalanobis distance in the fitted recordings."""
_COVERED = 0.95
_FIRST_SHARE = 0.01
"""First standard deviation of the unknown torque, as a share of a muscle's torque."""
_ROUNDS = 6
_CLOSE = math.log(1.05)
"""The interval's width need not be closer."""
_LARGEST_STEP = (math.log(0.1), math.log(10.0))
"""Of the logarithm of the torque."""
_MARGIN = 1.05
"""Fitted recordings have smaller errors than others will have."""


def with_process_noise(rig: Rig, recordings: Sequence[Given], jobs: int = 1) -> Rig:
    """The rig with process noise of its pressures, and with a gate that lets the errors of their prediction pass.

    Args:
        rig: with all values that were found.
        recordings: parts that were fitted, of a free joint.
        jobs: threads.
    """
    rig = rig.replaced(directions={}, uncertainty={})
    innovation, _ = _innovations(_with_process(rig, _FIRST_RATE, _OPEN_GATE), recordings, jobs)
    rate = max(float(np.sqrt(np.mean(innovation**2))) * math.sqrt(0.01 / rig.sample_period), _LEAST_RATE)
    _, distance = _innovations(_with_process(rig, rate, _OPEN_GATE), recordings, jobs)
    # After a step a regulator's model errs by many standard deviations. The gate must not reject the measurement there.
    return _with_process(rig, rate, max(rig.tuning("default").gate, _GATE_MARGIN * float(np.max(distance))))


def _with_process(rig: Rig, rate: float, gate: float) -> Rig:
    """The rig with an error of the predicted pressures over 10 ms [Pa], and a gate."""
    tuning, pressure = rig.tuning("default"), rate**2 * rig.sample_period / 0.01
    tuned = tuning.replaced(process=(*tuning.process[:2], pressure, pressure), gate=gate, consider=True)
    return rig.replaced(tunings={**rig.tunings, "default": tuned})


def _innovations(rig: Rig, recordings: Sequence[Given], jobs: int) -> tuple[Floats, Floats]:
    """Innovations (K,) [Pa] and Mahalanobis distances (M,) of all samples."""

    def of(recording: Recording, state: JointCondition, _name: str) -> tuple[Floats, Floats]:
        rows = replay(recording, rig, "default", state.condition, None).run.rows
        return rows["innovation"].ravel(), np.sqrt(rows["nis"])

    parts = Parallel(n_jobs=jobs, prefer="threads")(delayed(of)(*item) for item in recordings)
    innovation, distance = (np.concatenate(column) for column in zip(*parts, strict=True))
    return innovation[np.isfinite(innovation)], distance[np.isfinite(distance)]


@dataclass(frozen=True)
class Covered:
    """The unknown torque, and what it gives.

    Attributes:
        rig: with it.
        torque: its standard deviation [N m].
        share: of the measured angles in their 95 % intervals, on the fitted recordings.
    """

    rig: Rig
    torque: float
    share: float


def with_unknown_torque(
    rig: Rig, recordings: Sequence[Given], jobs: int = 1, progress: Callable[[str], None] | None = None
) -> Covered:
    """The rig with the standard deviation of an unknown torque.

    Args:
        rig: with process noise.
        recordings: parts that were fitted, of a free joint with a measured angle, corrected by the found calibration.
        jobs: threads.
        progress: called with what is being done.
    """
    noise, seen = rig.sensors.error("angle"), []
    torque = _FIRST_SHARE * torque_scale(rig)
    for number in range(_ROUNDS):
        if progress:
            progress(f"covariance of the angle, run {number + 1} of {_ROUNDS} at most")
        now = rig.replaced(uncertainty={**rig.uncertainty, UNKNOWN_TORQUE: torque})
        parts = Parallel(n_jobs=jobs, prefer="threads")(delayed(_errors)(now, *item) for item in recordings)
        error, std = (np.concatenate(column) for column in zip(*parts, strict=True))
        # Errors within the encoder's own noise need no torque.
        beyond = np.sqrt(np.maximum((error / 1.96) ** 2 - noise**2, 0.0)) / np.maximum(std, 1e-9)
        lacking = float(np.clip(math.log(_MARGIN * max(float(np.quantile(beyond, _COVERED)), 1e-9)), *_LARGEST_STEP))
        share = float(np.mean(np.abs(error) <= 1.96 * np.hypot(std, noise)))
        seen.append((abs(lacking), math.log(torque), lacking, Covered(now, torque, share)))
        if abs(lacking) < _CLOSE:
            break
        torque = math.exp(_next(seen))
    return min(seen, key=lambda item: item[0])[-1]


def _next(seen: Sequence[tuple[float, float, float, Covered]]) -> float:
    """Logarithm of the next torque to try.

    The interval grows with the torque, but not in proportion where the joint sticks or nears its stop. Between a torque
    that is too small and one that is too large, a straight line is taken.

    Args:
        seen: of each torque the logarithm, and by how much the logarithm of the interval's width falls short.
    """
    below = max(((at, lacks) for _, at, lacks, _ in seen if lacks > 0.0), default=None)
    above = min(((at, lacks) for _, at, lacks, _ in seen if lacks <= 0.0), default=None)
    if below is None or above is None or below[0] >= above[0]:
        return seen[-1][1] + seen[-1][2]
    share = below[1] / (below[1] - above[1])
    return below[0] + min(max(share, 0.1), 0.9) * (above[0] - below[0])


def _errors(rig: Rig, recording: Recording, state: JointCondition, _name: str) -> tuple[Floats, Floats]:
    """Errors of the estimated angle and their standard deviations (M,) [rad]."""
    assert recording.angle is not None
    run = replay(recording, rig, "default", state.condition, None).run
    measured = recording.angle[run.index]
    known = np.isfinite(measured)
    std = np.sqrt(run.rows["covariance"][:, 0, 0])
    return (run.rows["angle"] - measured)[known], std[known]
