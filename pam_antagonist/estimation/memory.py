"""Settings of a filter, its memory from sample to sample, and the type of its estimates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pam_antagonist.estimation import encoder, readings
from pam_antagonist.estimation.stamps import CLOCK_SIZE

MISSING_PRESSURE_1, MISSING_PRESSURE_2, MISSING_VALVE, OUTLIER, GAP, REPAIRED, LATE, NO_ANGLE = (
    1, 2, 4, 8, 16, 32, 64, 128,
)  # fmt: skip
"""Flags of an estimate, as in ``JointEstimate.msg``."""

COUNTERS = ("processed", "predicted_only", "missing", "outliers", "late", "duplicates", "gaps", "repaired", "restarts",
            "angles_used", "angles_refused", "repeated")  # fmt: skip
"""Outcomes of samples, in the order of the counters."""

ESTIMATE_DTYPE = np.dtype(
    [
        ("angle", "f8"),
        ("velocity", "f8"),
        ("torque", "f8"),
        ("covariance", "f8", (3, 3)),
        ("pressure", "f8", (2,)),
        ("force", "f8", (2,)),
        ("stiffness", "f8"),
        ("innovation", "f8", (2,)),
        ("innovation_covariance", "f8", (2, 2)),
        ("nis", "f8"),
        ("subsystem", "f8"),
        ("flags", "f8"),
        ("external_torque", "f8"),
        ("external_torque_covariance", "f8", (4,)),
    ]
)
"""One estimate: rad, rad/s, N m, their covariance, Pa, N, N m/rad, Pa, Pa², then NIS, subsystem and flags. The external
torque [N m] and its covariance with angle, velocity, torque and itself are NaN if the rig has no such state."""


class Settings(NamedTuple):
    """Settings of a filter; n states, m consider parameters.

    Attributes:
        parameter_sets: parameter vectors of the sigma points (1 + 2 m, parameters.SIZE), the nominal one first.
        initial: diagonal of P(0) (n,).
        process_noise: diagonal of Q for a nominal sample period (n,).
        measurement_noise: diagonal of R (2,) [Pa²].
        gain_noise: value of R in the gain (2,) [Pa²], see :func:`pam_antagonist.estimation.ukf.update`.
        period: nominal sample period [s].
        step: approximate step of the model [s].
        kappa: κ, the scaling of the sigma points [-].
        gate: largest Mahalanobis distance of a pressure that is used [-].
        lock_angle: angle of a locked joint [rad].
        possible: bounds of both pressures [Pa] and both voltages [V] (4, 2), see
            :func:`pam_antagonist.estimation.possible.bounds`.
        commands: least and largest command of each muscle (2, 2) [V], of regulators [Pa].
        change_noise: variance of the error of a predicted change of pressure over a sample, relative to its square [-].
        angle_noise: variance of a measured angle [rad²]; 0: no angle is used.
        angle_offset: of the measured angle [rad], positive if it reads too high.
        angle_step: of the angle's converter [rad]; 0: none.
    """

    parameter_sets: np.ndarray
    initial: np.ndarray
    process_noise: np.ndarray
    measurement_noise: np.ndarray
    gain_noise: np.ndarray
    period: float
    step: float
    kappa: float
    gate: float
    lock_angle: float
    possible: np.ndarray
    commands: np.ndarray
    change_noise: float = 0.0
    angle_noise: float = 0.0
    angle_offset: float = 0.0
    angle_step: float = 0.0


class Memory(NamedTuple):
    """Memory of a filter from sample to sample, changed in place.

    Attributes:
        x: estimate of the state (n,) [rad, rad/s, Pa, Pa, added states].
        covariance: P (n, n).
        cross: covariance with the consider parameters C (n, m).
        held: last known voltages (2,) [V].
        clock: memory of the stream's stamps (stamps.CLOCK_SIZE,).
        innovation: of the last sample (2,) [Pa], NaN where a pressure was not used.
        innovation_covariance: (2, 2) [Pa²].
        torque_moments: mean of the torque [N m], its variance, its covariance with each state (2 + n,).
        noise: diagonal of Q for the present step (n,).
        encoder: memory of the encoder (encoder.MEMORY,).
        readings: memory of the pressures' own rate (readings.PRESSURES,).
    """

    x: np.ndarray
    covariance: np.ndarray
    cross: np.ndarray
    held: np.ndarray
    clock: np.ndarray
    counts: np.ndarray
    innovation: np.ndarray
    innovation_covariance: np.ndarray
    torque_moments: np.ndarray
    noise: np.ndarray
    encoder: np.ndarray
    readings: np.ndarray


def make_memory(states: int, considered: int) -> Memory:
    """The memory of a filter that has not started."""
    n = states
    return Memory(
        x=np.zeros(n),
        covariance=np.zeros((n, n)),
        cross=np.zeros((n, considered)),
        held=np.zeros(2),
        clock=np.zeros(CLOCK_SIZE, dtype=np.int64),
        counts=np.zeros(len(COUNTERS), dtype=np.int64),
        innovation=np.zeros(2),
        innovation_covariance=np.zeros((2, 2)),
        torque_moments=np.zeros(2 + n),
        noise=np.zeros(n),
        encoder=encoder.new(),
        readings=readings.new(2),
    )
