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

from pam_antagonist.identification.air_stage import step_errors
from pam_antagonist.identification.joint_stage import torque_scale
from pam_antagonist.identification.runs import Run
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.replays import replay
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]
Given = tuple[Recording, JointCondition, str]

UNKNOWN_TORQUE = "effects.load_torque.constant"
_LEAST_RATE = 1e3
"""[Pa] Least error of a predicted pressure over 10 ms. Below it, a valve's error is taken for a motion of the joint."""
_WITHIN_GATE = 0.7
"""Largest error of a predicted pressure in the fitted recordings, as a share of the distance that the gate allows."""
_COVERED = 0.95
_FIRST_SHARE = 0.01
"""First standard deviation of the unknown torque, as a share of a muscle's torque."""
_ROUNDS = 3
_MARGIN = 1.05
"""Fitted recordings have smaller errors than others will have."""


def with_process_noise(rig: Rig, runs: Sequence[Run], zero: float) -> Rig:
    """The rig with the noise of its pressures, and with their process noise.

    Args:
        rig: with all values that were found.
        runs: that were fitted.
        zero: reading of the encoder at ψ = 0 [rad].
    """
    errors, period = step_errors(rig, runs, zero)
    tuning = rig.tuning("default")
    # After a step a regulator's model errs by many standard deviations. The gate must not reject the measurement there.
    largest = float(np.max(np.abs(errors), initial=0.0)) / (_WITHIN_GATE * tuning.gate)
    size = max(float(np.std(errors)), largest) if len(errors) else 0.0
    rate = max(size * math.sqrt(0.01 / period), _LEAST_RATE)
    pressure = rate**2 * rig.sample_period / 0.01
    process = (tuning.process[0], tuning.process[1], pressure, pressure)
    tuned = tuning.replaced(process=process, consider=True)
    return rig.replaced(tunings={**rig.tunings, "default": tuned}, directions={}, uncertainty={})


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
    torque, noise = _FIRST_SHARE * torque_scale(rig), rig.sensors.error("angle")
    share = math.nan
    for number in range(_ROUNDS):
        if progress:
            progress(f"covariance of the angle, run {number + 1} of {_ROUNDS}")
        now = rig.replaced(uncertainty={**rig.uncertainty, UNKNOWN_TORQUE: torque})
        parts = Parallel(n_jobs=jobs, prefer="threads")(delayed(_errors)(now, *item) for item in recordings)
        error, std = (np.concatenate(column) for column in zip(*parts, strict=True))
        share = float(np.mean(np.abs(error) <= 1.96 * np.hypot(std, noise)))
        if number == _ROUNDS - 1:
            break
        # Errors within the encoder's own noise need no torque; the interval grows in proportion to it.
        beyond = np.sqrt(np.maximum((error / 1.96) ** 2 - noise**2, 0.0)) / np.maximum(std, 1e-9)
        factor = _MARGIN * float(np.quantile(beyond, _COVERED)) if number == _ROUNDS - 2 else float(
            np.quantile(beyond, _COVERED))  # fmt: skip
        torque *= min(max(factor, 0.05), 50.0)
    return Covered(now, torque, share)


def _errors(rig: Rig, recording: Recording, state: JointCondition, _name: str) -> tuple[Floats, Floats]:
    """Errors of the estimated angle and their standard deviations (M,) [rad]."""
    assert recording.angle is not None
    run = replay(recording, rig, "default", state.condition, None).run
    measured = recording.angle[run.index]
    known = np.isfinite(measured)
    std = np.sqrt(run.rows["covariance"][:, 0, 0])
    return (run.rows["angle"] - measured)[known], std[known]
