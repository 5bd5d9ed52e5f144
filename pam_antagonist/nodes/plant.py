"""Executable ``plant``: parameters and entry point."""

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
    VALVE_OWNER,
    Parameter,
)
from pam_antagonist.nodes.spin import run_node

if TYPE_CHECKING:
    from pam_antagonist.nodes.plant_node import PlantNode

DESCRIPTION = """
Simulated joint with two pneumatic muscles, in place of a real one: the physics of the rig in real time at its sample
period, with finer steps, parameters off their declared values, sensor noise and quantisation. It obeys one commander.
Commands are clamped and slew-limited. The valves get safe voltages when commands stop or a pressure is missing, frozen
or too high (docs/how-to/safety.md).

publishes:   pressure_1, pressure_2 (sensor_msgs/FluidPressure), valve_state (pam_antagonist_msgs/ValveCommand),
             measured/joint_states (sensor_msgs/JointState: encoder and torque meter, for validation only),
             angle_sensor (sensor_msgs/JointState, with angle_sensor: encoder),
             measured/external_torque (geometry_msgs/WrenchStamped: push, for validation only; of a rig with the state
             external_torque), rig (std_msgs/String)
subscribes:  valve_command (pam_antagonist_msgs/ValveCommand)
             A rig with drive: regulator has pressure_state and pressure_command (pam_antagonist_msgs/PressureCommand)
             in the place of valve_state and valve_command.
services:    ~/stop, ~/clear_stop (std_srvs/Trigger), and those of a lifecycle node
"""

PARAMETERS = (
    RIG,
    JOINT,
    LOCK_ANGLE,
    JOINT_NAME,
    FRAME,
    *VALVE_OWNER,
    Parameter("seed", 0, "seed of the parameters' mismatch and of the sensor noise [-]", 0, 2**31 - 1),
    Parameter("mismatch", 0.0, "relative standard deviation of the parameters from the rig's [-]", 0.0, 0.29),
    Parameter("noise", True, "whether the sensors have noise and steps"),
    Parameter(
        "angle_sensor",
        "none",
        "encoder: publishes angle_sensor, by the rig file's encoder",
        choices=ANGLE_SENSORS,
    ),
    Parameter(
        "pressure_sensors",
        "measured",
        "none: publishes no pressures, like a joint without pressure sensors; for a rig with drive: regulator",
        choices=PRESSURE_SENSORS,
    ),
    Parameter(
        "push",
        0.0,
        "torque with which somebody pushes the joint, about +z [N m]",
        -10.0,
        10.0,
        read_only=False,
    ),
    Parameter("substeps", 4, "integration steps a sample [-]", 1, 64),
    Parameter(
        "initial_pressure", [0.0, 0.0], "pressures at the start, absolute [Pa]; 0: at rest, by the rig file", 0.0, 2e6
    ),
    Parameter(
        "wait_for_subscribers",
        0,
        "subscribers of each sample topic that the first sample waits for [-]",
        0,
        16,
    ),
)


def _create(_options: None, **node_options: Any) -> PlantNode:
    from pam_antagonist.nodes.plant_node import PlantNode

    return PlantNode(**node_options)


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``plant --help``."""
    return run_node(_create, argv, name="plant", description=DESCRIPTION, table=PARAMETERS)
