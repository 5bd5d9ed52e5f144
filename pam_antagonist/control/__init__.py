"""The paper's PI controller, the control law through the model, and the references that they follow."""

from pam_antagonist.control.command import Command as Command
from pam_antagonist.control.command import Mode as Mode
from pam_antagonist.control.command import Status as Status
from pam_antagonist.control.command import VoltageLimits as VoltageLimits
from pam_antagonist.control.model_law import Seen as Seen
