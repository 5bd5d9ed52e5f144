"""Check units, wiring and stamps of a recording, by comparison with the model driven by the recorded voltages."""

from pam_antagonist.checks.check import Checked, check_recording
from pam_antagonist.checks.samples import SHORTEST
from pam_antagonist.checks.wiring import Finding

__all__ = ["SHORTEST", "Checked", "Finding", "check_recording"]
