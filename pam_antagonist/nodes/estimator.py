"""Executable ``estimator``: parameters and entry point."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pam_antagonist.nodes.parameters import (
    ANGLE_SENSORS,
    FRAME,
    JOINT,
    JOINT_NAME,
    LOCK_ANGLE,
    PRESSURE_SENSORS,
    RIG,
    Parameter,
)
from pam_antagonist.nodes.spin import run_node

if TYPE_CHECKING:
    from pam_antagonist.nodes.estimator_node import EstimatorNode

DESCRIPTION = """
Angle and torque of the joint, with their covariance, from the two muscle pressures and the valve voltages: the
unscented Kalman filter of the rig, one estimate for each sample, in the order of the stamps. It reads a measured angle
only where it is told to (angle_sensor: encoder), and never what is measured for validation.

subscribes:  pressure_1, pressure_2 (sensor_msgs/FluidPressure), valve_state (pam_antagonist_msgs/ValveCommand);
             angle_sensor (sensor_msgs/JointState, with angle_sensor: encoder); of a rig with drive: regulator
             pressure_state (pam_antagonist_msgs/PressureCommand) in the place of valve_state, and with
             pressure_sensors: none nothing else
publishes:   joint_estimate (pam_antagonist_msgs/JointEstimate), joint_states (sensor_msgs/JointState),
             external_torque (geometry_msgs/WrenchStamped, of a rig with that state), rig (std_msgs/String),
             filter_checkpoint (pam_antagonist_msgs/FilterCheckpoint, once a second)
services:    ~/reset (std_srvs/Trigger), ~/set_state (pam_antagonist_msgs/SetState), and those of a lifecycle node
"""

PARAMETERS = (
    RIG,
    JOINT,
    LOCK_ANGLE,
    JOINT_NAME,
    FRAME,
    Parameter(
        "tuning",
        "default",
        "name of one of the rig's filter tunings; a change starts the filter anew",
        read_only=False,
    ),
    Parameter(
        "angle_sensor",
        "none",
        "encoder: topic angle_sensor is an input as well, with noise and offset of the rig file's encoder",
        choices=ANGLE_SENSORS,
    ),
    Parameter(
        "pressure_sensors",
        "measured",
        "none: the filter uses the commanded pressures of the regulators and subscribes to no pressure topic; for a "
        "rig with drive: regulator",
        choices=PRESSURE_SENSORS,
    ),
    Parameter("pairing_timeout", 0.02, "longest time that a sample waits for its other topics [s]", 0.001, 1.0),
    Parameter(
        "max_age",
        0.0,
        "age beyond which an estimate is flagged LATE [s]; 0: three samples of the rig, at least 0.02",
        0.001,
        10.0,
        left=0.0,
    ),
)


def _create(_options: None, **node_options: Any) -> EstimatorNode:
    from pam_antagonist.nodes.estimator_node import EstimatorNode

    return EstimatorNode(**node_options)


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``estimator --help``."""
    return run_node(_create, argv, name="estimator", description=DESCRIPTION, table=PARAMETERS)
