"""Safety rules that plant, bridge and controller share: which commands reach the valves, and what stops them."""

from pam_antagonist.safety.guard import Authority, ReferenceOwner, SafeAction, ValveGuard
from pam_antagonist.safety.supervision import EstimateSupervision, Following, PressureSupervision

__all__ = [
    "Authority",
    "EstimateSupervision",
    "Following",
    "PressureSupervision",
    "ReferenceOwner",
    "SafeAction",
    "ValveGuard",
]
