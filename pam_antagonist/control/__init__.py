"""The paper's PI controller for angle and for torque."""

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

__all__ = ["FAST_GAINS", "PUBLISHED_GAINS", "Command", "Gains", "Mode", "PiController", "Status", "VoltageLimits"]
