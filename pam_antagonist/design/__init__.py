"""Designed experiments: voltages under which a joint tells most of what is not known of it, within limits."""

from pam_antagonist.design.information import standard_errors
from pam_antagonist.design.limits import Limits
from pam_antagonist.design.optimal import SHORTEST, Plan, designed

__all__ = ["SHORTEST", "Limits", "Plan", "designed", "standard_errors"]
