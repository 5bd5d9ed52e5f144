"""Executable ``controller``: parameters and entry point."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pam_antagonist.control import LAWS, LOST, PUBLISHED_GAINS, Mode, ModelGains
from pam_antagonist.control.stiffness import LEAST_FORCE, SUPPLY_MARGIN
from pam_antagonist.nodes.parameters import JOINT_NAME, PRESSURE_SENSORS, RIG, SAFETY, Parameter
from pam_antagonist.nodes.spin import run_node

if TYPE_CHECKING:
    from pam_antagonist.nodes.controller_node import ControllerNode

DESCRIPTION = """
Control of the joint's angle or torque on the estimate: one command for each estimate, with the estimate's stamp.
Parameter law chooses the paper's PI, or the law through the model, which holds a stiffness as well.
The valves get safe voltages as long as no reference has come, when it has timed out, while it is not finite or of an
unknown mode, while estimates are late or not finite, when they stop coming, and once more at the end. It
stops, until it is cleared, when the estimated angle is too large, when measured and expected pressures disagree, and
when the estimate goes without a pressure for too long (docs/how-to/safety.md).

subscribes:  joint_estimate (pam_antagonist_msgs/JointEstimate), reference (pam_antagonist_msgs/JointReference) or what
             reference_source names: joint_command (sensor_msgs/JointState), commands (std_msgs/Float64MultiArray),
             joint_trajectory (trajectory_msgs/JointTrajectory); limited, slewed, of one publisher at a time;
             valve_state (pam_antagonist_msgs/ValveCommand, to start from what is on the valves), rig (std_msgs/String:
             which rig file the other nodes were given; that of another joint stops the valves). A rig with
             drive: regulator has pressure_state and pressure_command (pam_antagonist_msgs/PressureCommand) in the place
             of valve_state and valve_command, and the law model alone.
publishes:   valve_command (pam_antagonist_msgs/ValveCommand), rig; reference, where references come from another topic
services:    ~/enable (std_srvs/SetBool), ~/clear_stop (std_srvs/Trigger), and those of a lifecycle node
"""

_MODEL = ModelGains()
_ANGLE, _TORQUE = PUBLISHED_GAINS[Mode.ANGLE], PUBLISHED_GAINS[Mode.TORQUE]

PARAMETERS = (
    RIG,
    JOINT_NAME,
    *SAFETY,
    Parameter(
        "pressure_sensors",
        "measured",
        "none: the pressures are not measured, so estimates without them do not stop the controller; for a rig with "
        "drive: regulator",
        choices=PRESSURE_SENSORS,
    ),
    Parameter(
        "bias",
        -1.0,
        "voltage of both valves at rest [V]; -1: at which they keep the pressure at rest, by the rig file",
        0.0,
        10.0,
        read_only=False,
        left=-1.0,
    ),
    Parameter("angle_proportional", _ANGLE.proportional, "T_P for the angle [V/rad]", 0.0, 1e3, read_only=False),
    Parameter("angle_integral", _ANGLE.integral, "T_I for the angle [V/(rad s)]", 0.0, 1e9, read_only=False),
    Parameter(
        "angle_velocity",
        0.0,
        "feed-forward of the velocity that a trajectory or a joint_command asks for [V s/rad]",
        0.0,
        1e3,
        read_only=False,
    ),
    Parameter("torque_proportional", _TORQUE.proportional, "T_P for the torque [V/(N m)]", 0.0, 1e3, read_only=False),
    Parameter("torque_integral", _TORQUE.integral, "T_I for the torque [V/(N m s)]", 0.0, 1e9, read_only=False),
    Parameter(
        "law",
        "pi",
        "law of control: pi, the paper's, or model, which goes through the model's equations and has the modes "
        "ANGLE_STIFFNESS, TORQUE_STIFFNESS and IMPEDANCE as well",
        choices=LAWS,
        read_only=False,
    ),
    Parameter(
        "pressure_bandwidth",
        _MODEL.bandwidth,
        "law model: rate at which a pressure's error is corrected [1/s]",
        0.1,
        200.0,
        read_only=False,
    ),
    Parameter(
        "model_integral",
        _MODEL.integral,
        "law model: rate at which the torque follows an error of the angle times stiffness, or of the torque [1/s]",
        0.0,
        100.0,
        read_only=False,
    ),
    Parameter(
        "approach",
        _MODEL.approach,
        "law model: distance from the reference within which the torque against friction fades [rad]",
        1e-4,
        1.0,
        read_only=False,
    ),
    Parameter(
        "lowest_pressure",
        0.0,
        "law model: least pressure of a muscle, absolute [Pa]; 0: a sixth of the supply's gauge pressure",
        0.0,
        1e7,
    ),
    Parameter(
        "supply_margin",
        SUPPLY_MARGIN,
        "law model: how far the pressures stay below the supply's pressure [Pa]",
        0.0,
        1e7,
    ),
    Parameter("least_force", LEAST_FORCE, "law model: least contraction force of a muscle [N]", 0.0, 1e4),
    Parameter(
        "governor", True, "law model: whether references are held back so that limits are kept (docs/interaction.md)"
    ),
    Parameter("governor_level", 0.999, "probability with which the governor keeps a limit [-]", 0.5, 0.999999),
    Parameter("governor_push", 0.0, "torque from outside that the governor counts on [N m]", 0.0, 1e3),
    Parameter("max_velocity", 0.0, "largest velocity that the governor allows [rad/s]; 0: any", 0.0, 1e3),
    Parameter(
        "max_contraction", 0.0, "largest contraction (L_0 − l)/L_0 that the governor allows [-]; 0: any", 0.0, 1.0
    ),
    Parameter("max_extension", 0.0, "largest extension (l − L_0)/L_0 that the governor allows [-]; 0: any", 0.0, 1.0),
    Parameter(
        "max_angle",
        0.0,
        "magnitude to which a reference of the angle is limited [rad]; 0: the rig file's joint.stop, or 25 degrees "
        "where it has none",
        0.0,
        1.6,
    ),
    Parameter(
        "max_torque",
        0.0,
        "magnitude to which a reference of the torque is limited [N m]; 0: what the muscles can do at angle 0",
        0.0,
        1e3,
    ),
    Parameter("max_angle_rate", 0.0, "fastest change of the angle's reference [rad/s]; 0: any", 0.0, 1e3),
    Parameter("max_torque_rate", 0.0, "fastest change of the torque's reference [N m/s]; 0: any", 0.0, 1e5),
    # An old angle reference only holds the joint. An old torque reference drives a free joint to its stop.
    Parameter(
        "angle_reference_timeout",
        0.0,
        "time after which an angle reference that is not repeated is lost [s]; 0: never",
        0.0,
        3600.0,
    ),
    Parameter(
        "torque_reference_timeout",
        0.5,
        "time after which a torque reference that is not repeated is lost [s]; 0: never",
        0.0,
        3600.0,
    ),
    Parameter(
        "reference_lost",
        "safe",
        "what follows a lost reference: safe, the safe voltages, or hold, which keeps the angle estimated at that "
        "moment",
        choices=LOST,
    ),
    Parameter(
        "reference_source",
        "reference",
        "the one topic that references come from: reference (JointReference), joint_command (JointState: position or "
        "effort of joint_name, NaN: not asked), commands (Float64MultiArray), joint_trajectory (JointTrajectory)",
        choices=("reference", "joint_command", "commands", "joint_trajectory"),
    ),
    Parameter("commands_mode", "angle", "quantity of the numbers in topic commands", choices=("angle", "torque")),
    Parameter("commands_index", 0, "index of this joint's number in topic commands, from 0 [-]", 0, 1000),
    Parameter(
        "max_age",
        0.0,
        "an estimate that is older than this is not used [s]; 0: three samples of the rig, at least 0.02",
        0.002,
        10.0,
        left=0.0,
    ),
    Parameter("resume_time", 0.5, "longest interruption after which the integral goes on as it was [s]", 0.001, 60.0),
    Parameter(
        "start_enabled",
        True,
        "whether the controller sends commands as soon as it is active, without a call of ~/enable",
    ),
    Parameter(
        "stop_angle",
        0.0,
        "magnitude of the estimated angle beyond which the controller stops [rad]; 0: a degree beyond the rig file's "
        "joint.stop, or 26 degrees where it has none",
        0.01,
        1.6,
        left=0.0,
    ),
    Parameter("stop_angle_time", 0.01, "time beyond stop_angle after which the controller stops [s]", 0.001, 1.0),
    # 99.9 % quantile for two pressures. On recordings of joints whose parameters differ from the model by one or two
    # per cent, or that have an unmodelled effect, at most 2 % of the samples in any 0.1 s are above.
    Parameter("nis_limit", 13.8, "normalised innovation squared that counts as out of bounds [-]", 0.1, 1e9),
    Parameter(
        "nis_time",
        0.1,
        "the controller stops when 15 % of the samples within this time are out of bounds [s]",
        0.01,
        60.0,
    ),
    Parameter(
        "blind_time",
        0.1,
        "time for which estimates may lack one of the pressures before the controller stops [s]",
        0.001,
        10.0,
    ),
    Parameter("blend_time", 0.5, "time constant with which the offset of a bumpless start fades [s]", 0.001, 60.0),
)


def _create(_options: None, **node_options: Any) -> ControllerNode:
    from pam_antagonist.nodes.controller_node import ControllerNode

    return ControllerNode(**node_options)


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``controller --help``."""
    return run_node(_create, argv, name="controller", description=DESCRIPTION, table=PARAMETERS)
