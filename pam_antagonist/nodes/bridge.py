"""Executable ``bridge``: parameters and entry point."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pam_antagonist.nodes.parameters import ANGLE_SENSORS, FRAME, JOINT_NAME, RIG, VALVE_OWNER, Parameter
from pam_antagonist.nodes.spin import run_node

if TYPE_CHECKING:
    from pam_antagonist.hardware.device import Device
    from pam_antagonist.nodes.bridge_node import BridgeNode

DESCRIPTION = """
Bridge to real hardware: a microcontroller on a serial port that reads two pressures and drives two valves, by the
protocol of docs/reference/protocol.md. Samples are stamped by the device's clock, mapped to ROS time. The bridge obeys
one commander. Commands are clamped and slew-limited. The valves get safe voltages when commands stop or a pressure is
missing, frozen or too high (docs/how-to/safety.md). The device does that by itself 20 ms after the bridge's last
command. A device that is unplugged is opened again when it is back.

publishes:   pressure_1, pressure_2 (sensor_msgs/FluidPressure), valve_state (pam_antagonist_msgs/ValveCommand),
             measured/joint_states (sensor_msgs/JointState: encoder and torque meter where there are some, for
             validation only), angle_sensor (sensor_msgs/JointState, with angle_sensor: encoder), rig (std_msgs/String)
subscribes:  valve_command (pam_antagonist_msgs/ValveCommand)
             A rig with drive: regulator has pressure_state and pressure_command (pam_antagonist_msgs/PressureCommand)
             in the place of valve_state and valve_command; the calibration says which voltages ask for which pressures.
             With pressure_sensors: none in the calibration, no pressures are published.
services:    ~/stop, ~/clear_stop (std_srvs/Trigger); ~/measure_rest (std_srvs/Trigger: with both muscles open to the
             air, takes what the sensors show for the atmosphere's pressure); and those of a lifecycle node
"""

PARAMETERS = (
    RIG,
    JOINT_NAME,
    FRAME,
    *VALVE_OWNER,
    Parameter("port", "/dev/ttyACM0", "serial port of the device; better a link in /dev/serial/by-id"),
    Parameter("baud", 921_600, "bit rate of the port; USB devices ignore it [1/s]", 9600, 20_000_000),
    Parameter("hardware", "example", "calibration: a name in config/hardware, or path of a YAML file"),
    Parameter(
        "pressure_rest",
        [0.0, 0.0],
        "correction that is added to the pressures, as ~/measure_rest finds it [Pa]",
        -50e3,
        50e3,
    ),
    Parameter("angle_sensor", "none", "encoder: publishes the encoder's angle as angle_sensor", choices=ANGLE_SENSORS),
    Parameter("device_timeout", 3.0, "time that the device may take to answer the greeting [s]", 0.1, 30.0),
)


def main(argv: list[str] | None = None, device: Callable[[], Device] | None = None) -> int:
    """Run the node; see ``bridge --help``.

    Args:
        device: makes the device; default: a device at the serial port of the parameters.
    """

    def create(_options: None, **node_options: Any) -> BridgeNode:
        from pam_antagonist.nodes.bridge_node import BridgeNode

        return BridgeNode(device, **node_options)

    return run_node(create, argv, name="bridge", description=DESCRIPTION, table=PARAMETERS)
