"""Whether a recording is what it is taken for: the model, driven by the recorded voltages, tells."""

from pam_antagonist.checks.check import SHORTEST, Checked, check_recording
from pam_antagonist.checks.wiring import Finding

__all__ = ["SHORTEST", "Checked", "Finding", "check_recording"]
