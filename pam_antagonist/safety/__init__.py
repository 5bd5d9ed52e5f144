"""Safety rules that plant, bridge and controller share: which commands reach the valves, and what stops them."""

from pam_antagonist.safety.authority import Authority, ReferenceOwner, Verdict
from pam_antagonist.safety.guard import ACTIONS, Decision, GuardCounts, SafeAction, State, ValveGuard, safe_action
from pam_antagonist.safety.supervision import (
    EstimateSupervision,
    Following,
    PressureSupervision,
    frozen_samples,
    frozen_time,
)

__all__ = [
    "ACTIONS",
    "Authority",
    "Decision",
    "EstimateSupervision",
    "Following",
    "GuardCounts",
    "PressureSupervision",
    "ReferenceOwner",
    "SafeAction",
    "State",
    "ValveGuard",
    "Verdict",
    "frozen_samples",
    "frozen_time",
    "safe_action",
]
