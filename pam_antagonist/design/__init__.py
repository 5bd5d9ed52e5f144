"""Design of experiments: valve voltages, within limits, that give the most information about a joint's parameters."""

from pam_antagonist.design.information import standard_errors
from pam_antagonist.design.optimal import SHORTEST, Limits, Plan, designed

__all__ = ["SHORTEST", "Limits", "Plan", "designed", "standard_errors"]
