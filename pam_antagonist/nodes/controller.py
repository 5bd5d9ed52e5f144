"""Executable ``controller``: its parameters and its way into the node."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pam_antagonist.control import PUBLISHED_GAINS, Mode
from pam_antagonist.nodes.parameters import RIG, SAFETY, Parameter
from pam_antagonist.nodes.spin import run_node

if TYPE_CHECKING:
    from pam_antagonist.nodes.controller_node import ControllerNode

DESCRIPTION = """
PI control of the joint's angle or torque on the estimate: one command for each estimate, with the estimate's stamp.
The valves get safe voltages as long as no reference has come, while the last reference is not usable (not finite, out
of range, unknown mode), while estimates are late or not finite, when they stop coming, and once more at the end. It
stops, until it is cleared, when the estimated angle is too large, when measured and expected pressures disagree, and
when the estimate goes without a pressure for too long (docs/how-to/safety.md).

subscribes:  joint_estimate (pam_antagonist_msgs/JointEstimate), reference (pam_antagonist_msgs/JointReference; held),
             valve_state (pam_antagonist_msgs/ValveCommand, to start from what is on the valves), rig (std_msgs/String:
             which rig file the other nodes were given; that of another joint stops the valves)
publishes:   valve_command (pam_antagonist_msgs/ValveCommand), rig
services:    ~/enable (std_srvs/SetBool), ~/clear_stop (std_srvs/Trigger), and those of a lifecycle node
"""

_ANGLE, _TORQUE = PUBLISHED_GAINS[Mode.ANGLE], PUBLISHED_GAINS[Mode.TORQUE]

PARAMETERS = (
    RIG,
    *SAFETY,
    Parameter("bias", _ANGLE.bias, "voltage of both valves at rest [V]", 0.0, 10.0, read_only=False),
    Parameter("angle_proportional", _ANGLE.proportional, "T_P for the angle [V/rad]", 0.0, 1e3, read_only=False),
    Parameter("angle_integral", _ANGLE.integral, "T_I for the angle [V/(rad s)]", 0.0, 1e9, read_only=False),
    Parameter("torque_proportional", _TORQUE.proportional, "T_P for the torque [V/(N m)]", 0.0, 1e3, read_only=False),
    Parameter("torque_integral", _TORQUE.integral, "T_I for the torque [V/(N m s)]", 0.0, 1e9, read_only=False),
    Parameter("max_angle", 0.436333, "largest angle that is taken as a reference, either way [rad]", 0.0, 1.6),
    Parameter("max_torque", 3.0, "largest torque that is taken as a reference, either way [N m]", 0.0, 1e3),
    Parameter("max_age", 0.02, "age beyond which an estimate is not acted on [s]", 0.002, 10.0),
    Parameter("resume_time", 0.5, "longest interruption after which the integral goes on as it was [s]", 0.001, 60.0),
    Parameter("start_enabled", True, "whether it commands as soon as it is active, without a call of enable"),
    # A degree beyond the stop of the paper's joint: no estimate of a sound joint is there.
    Parameter("stop_angle", 0.4538, "magnitude of the estimated angle that stops it [rad]", 0.01, 1.6),
    Parameter("stop_angle_time", 0.01, "how long the angle has to be beyond that [s]", 0.001, 1.0),
    # 99.9 % of two pressures that are as expected stay below. On recordings of joints that are off their model by one
    # or two per cent, and on those with an effect that it lacks, at most 2 % of the samples in any 0.1 s are above.
    Parameter("nis_limit", 13.8, "normalised innovation squared that counts as out of bounds [-]", 0.1, 1e9),
    Parameter("nis_time", 0.1, "time of which 15 % of the samples are out of bounds to stop it [s]", 0.01, 60.0),
    Parameter("blind_time", 0.1, "how long an estimate may be without one of the pressures [s]", 0.001, 10.0),
    Parameter("blend_time", 0.5, "time constant of what is left over from a bumpless start [s]", 0.001, 60.0),
)


def _create(_options: None) -> ControllerNode:
    from pam_antagonist.nodes.controller_node import ControllerNode

    return ControllerNode()


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``controller --help``."""
    return run_node(_create, argv, name="controller", description=DESCRIPTION, table=PARAMETERS)
