"""Safety rules that plant, bridge and controller share: which commands reach the valves, and what stops them."""

from pam_antagonist.safety.action import ACTIONS, SafeAction, safe_action
from pam_antagonist.safety.authority import Authority, Verdict
from pam_antagonist.safety.following import Following
from pam_antagonist.safety.guard import Decision, GuardCounts, State, ValveGuard
from pam_antagonist.safety.owner import ReferenceOwner
from pam_antagonist.safety.supervision import EstimateSupervision, PressureSupervision, frozen_samples, frozen_time

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
