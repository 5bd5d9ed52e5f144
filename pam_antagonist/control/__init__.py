"""The paper's PI controller, the control law through the model, and the references that they follow."""

from pam_antagonist.control.command import PI_MODES, Command, Law, Mode, Status, VoltageLimits
from pam_antagonist.control.governor import Governor, Limits
from pam_antagonist.control.laws import LAWS, Laws, Range, Reachable
from pam_antagonist.control.model_law import ModelController, ModelGains, Reached, Seen
from pam_antagonist.control.pi import FAST_GAINS, PUBLISHED_GAINS, Gains, PiController
from pam_antagonist.control.reference import LOST, Nearest, References, Rules, Trajectory, Wanted
from pam_antagonist.control.stiffness import Box

__all__ = [
    "Governor",
    "LAWS",
    "LOST",
    "Limits",
    "PI_MODES",
    "FAST_GAINS",
    "PUBLISHED_GAINS",
    "Box",
    "Command",
    "Gains",
    "Law",
    "Laws",
    "Mode",
    "ModelController",
    "ModelGains",
    "Nearest",
    "PiController",
    "Range",
    "Reachable",
    "Reached",
    "References",
    "Rules",
    "Seen",
    "Status",
    "Trajectory",
    "VoltageLimits",
    "Wanted",
]
