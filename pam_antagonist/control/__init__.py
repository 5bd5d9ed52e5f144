"""The paper's PI controller for angle and for torque, and the references that it follows."""

from pam_antagonist.control.pi import (
    FAST_GAINS,
    PUBLISHED_GAINS,
    Command,
    Gains,
    Mode,
    PiController,
    Status,
    VoltageLimits,
)
from pam_antagonist.control.reference import LOST, References, Rules, Trajectory, Wanted

__all__ = [
    "FAST_GAINS",
    "LOST",
    "PUBLISHED_GAINS",
    "Command",
    "Gains",
    "Mode",
    "PiController",
    "References",
    "Rules",
    "Status",
    "Trajectory",
    "VoltageLimits",
    "Wanted",
]
