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
    """Settings of a filter; n states, m consider parameters."""

    # parameter vectors of the sigma points (1 + 2 m, parameters.SIZE), the nominal one first.
    parameter_sets: np.ndarray
    initial: np.ndarray  # diagonal of P(0) (n,)
    process_noise: np.ndarray  # diagonal of Q for a nominal sample period (n,)
    measurement_noise: np.ndarray  # diagonal of R (2,) [Pa²]
    gain_noise: np.ndarray  # value of R in the gain (2,) [Pa²], see :func:`pam_antagonist.estimation.ukf.update`
    period: float  # nominal sample period [s]
    step: float  # approximate step of the model [s]
    kappa: float  # κ, the scaling of the sigma points [-]
    gate: float  # largest Mahalanobis distance of a pressure that is used [-]
    lock_angle: float  # angle of a locked joint [rad]
    # bounds of both pressures [Pa] and both voltages [V] (4, 2), see :func:`pam_antagonist.estimation.possible.bounds`.
    possible: np.ndarray
    commands: np.ndarray  # least and largest command of each muscle (2, 2) [V], of regulators [Pa]
    # variance of the error of a predicted change of pressure over a sample, relative to its square [-].
    change_noise: float = 0.0
    angle_noise: float = 0.0  # variance of a measured angle [rad²]; 0: no angle is used
    angle_offset: float = 0.0  # of the measured angle [rad], positive if it reads too high
    angle_step: float = 0.0  # of the angle's converter [rad]; 0: none


class Memory(NamedTuple):
    """Memory of a filter from sample to sample, changed in place."""

    x: np.ndarray  # estimate of the state (n,) [rad, rad/s, Pa, Pa, added states]
    covariance: np.ndarray  # P (n, n)
    cross: np.ndarray  # covariance with the consider parameters C (n, m)
    held: np.ndarray  # last known voltages (2,) [V]
    clock: np.ndarray  # memory of the stream's stamps (stamps.CLOCK_SIZE,)
    counts: np.ndarray
    innovation: np.ndarray  # of the last sample (2,) [Pa], NaN where a pressure was not used
    innovation_covariance: np.ndarray  # (2, 2) [Pa²]
    torque_moments: np.ndarray  # mean of the torque [N m], its variance, its covariance with each state (2 + n,)
    noise: np.ndarray  # diagonal of Q for the present step (n,)
    encoder: np.ndarray  # memory of the encoder (encoder.MEMORY,)
    readings: np.ndarray  # memory of the pressures' own rate (readings.PRESSURES,)


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
