"""The paper's PI controller for angle and for torque."""

from pam_antagonist.control.pi import (
    PUBLISHED_GAINS,
    Command,
    Gains,
    Mode,
    PiController,
    Status,
    VoltageLimits,
)

__all__ = ["PUBLISHED_GAINS", "Command", "Gains", "Mode", "PiController", "Status", "VoltageLimits"]
