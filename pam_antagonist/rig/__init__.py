"""Rigs: one validated YAML file each, with the numbers of the physics and of the estimator."""

from pam_antagonist.rig.file import as_rig, load_rig, rig_names
from pam_antagonist.rig.fingerprint import RigIdentity, differences, fingerprint
from pam_antagonist.rig.schema import NO_ENCODER, Encoder, Reading, Rig, Tuning

__all__ = [
    "NO_ENCODER",
    "Encoder",
    "Reading",
    "Rig",
    "RigIdentity",
    "Tuning",
    "as_rig",
    "differences",
    "fingerprint",
    "load_rig",
    "rig_names",
]
