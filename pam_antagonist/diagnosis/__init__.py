"""From the residual of a recording to a physical effect that the model lacks."""

from pam_antagonist.diagnosis.pipeline import diagnose
from pam_antagonist.diagnosis.result import Diagnosis, FoundEffect

__all__ = ["Diagnosis", "FoundEffect", "diagnose"]
