"""The bridge to real hardware."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from sensor_msgs.msg import FluidPressure, JointState
from std_srvs.srv import Trigger
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.calibration import Converter, load_calibration
from pam_antagonist.hardware.device import Device
from pam_antagonist.hardware.link import Link, Sample, Wanted
from pam_antagonist.hardware.protocol import Status
from pam_antagonist.hardware.serial_device import SerialDevice
from pam_antagonist.hardware.transport import SerialTransport
from pam_antagonist.hardware.zero_pressure import ZeroPressureMeasurement
from pam_antagonist.nodes import bridge_health, wire
from pam_antagonist.nodes.bridge import PARAMETERS
from pam_antagonist.nodes.health import Health
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.rigs import announce
from pam_antagonist.nodes.valve_port import ValvePort
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist.rig import load_rig

_DEVICE_STOPS = (
    (Status.STOPPED, "the emergency stop at the device"),
    (Status.OUTPUT_FAULT, "the device could not put the voltages on the valves"),
)


_Conversion = Callable[[tuple[float, float]], tuple[float, float]]


def _unchanged(command: tuple[float, float]) -> tuple[float, float]:
    """For a joint with valves, commands are the device's voltages."""
    return command


class _SharedPort(ValvePort):
    """A valve port that two threads use: the device's and the executor's.

    Args:
        others: as :class:`ValvePort`.
    """

    def __init__(self, lock: threading.RLock, *others: Any) -> None:
        self._lock = lock
        super().__init__(*others)

    @override
    def _on_clear(self, request: Any, response: Any) -> Any:
        with self._lock:
            return super()._on_clear(request, response)

    @override
    def stop(self, reason: str) -> None:
        """As :class:`ValvePort`, from any thread."""
        with self._lock:
            super().stop(reason)


class BridgeNode(PamNode):
    """Publishes a device's samples, and sends it the commands that pass the valve guard.

    One thread reads the device, publishes, takes commands and sends them, so that the executor's work does not delay
    them. A command goes to the device at once. Without a command, the guard's voltages are sent every period, so that
    the device's watchdog acts only when this process fails.

    Args:
        device: makes the device; None: a device at the serial port of the parameters.
        options: as :class:`PamNode`.
    """

    def __init__(self, device: Callable[[], Device] | None = None, **options: Any) -> None:
        self._make_device = device or self._serial_device
        self._lock = threading.RLock()
        super().__init__("bridge", PARAMETERS, **options)

    def _serial_device(self) -> Device:
        port, baud = self.values["port"], self.values["baud"]
        return SerialDevice(lambda: SerialTransport(port, baud), self.values["device_timeout"])

    @override
    def configure(self) -> None:
        """Make everything except the connection to the device."""
        values = self.values
        if self.get_parameter("use_sim_time").value:
            raise BadInput(
                "use_sim_time is true, but hardware does not follow simulated time: set it to false, or replay a bag "
                "without a bridge"
            )
        rig = load_rig(values["rig"], regulators=True)
        values = self.with_rig(rig)
        first, second = values["pressure_rest"]
        self._converter = Converter(load_calibration(values["hardware"]), (first, second))
        self.port = _SharedPort(self._lock, self, rig)
        drive = self.port.drive
        # The device's outputs are voltages; for a rig with regulators all other commands are pressures.
        self._output: _Conversion = _unchanged
        self._asked: _Conversion = _unchanged
        action = drive.action
        self._converter.suits(rig.drive)
        if rig.drive == "regulator":
            self._output, self._asked = self._converter.output, self._converter.asked
            action = self._converter.action(action)
        low, high = (self._output((limit, limit)) for limit in (drive.limits.minimum, drive.limits.maximum))
        wanted = Wanted(round(rig.sample_period * 1e9), min(low), max(high), action)
        self._device = self._make_device()
        self._link = Link(self._device, self._converter, wanted, self.now_ns, self._deliver, self._attend)
        self._health = bridge_health.BridgeHealth(self._link, self._device)
        self._variance = rig.sensors.pressure_std**2
        self._period_ns = wanted.period_ns
        self._sent_ns = self._commands_sent = 0
        self._session = 0
        self._logged = ""
        self._rest = ZeroPressureMeasurement(self._converter)
        self._pressures = tuple(
            wire.Outgoing(self, FluidPressure, TOPICS[f"pressure_{i}"].relative, f"muscle_{i}", wire.PRESSURE)
            for i in ((1, 2) if self._converter.measures_pressures else ())
        )
        topics = drive.topics
        self._valves = wire.Outgoing(self, topics.message, topics.state, topics.frame_id, wire.VALVES)
        self._joint = JointOutput(self, values["joint_name"], values["frame_id"], values["angle_sensor"])
        self.create_service(Trigger, "~/measure_rest", self._on_measure_rest)
        announce(self, rig)
        self.start_diagnostics(values["joint_name"])

    @override
    def activate(self) -> None:
        """Open the device and take commands."""
        self.port.listen()
        self._link.start()

    @override
    def deactivate(self) -> None:
        """Close the device, which then applies its safe voltages."""
        with self._lock:
            self.port.rest()
        self._link.stop()

    @override
    def close(self) -> None:
        """Close the device in any state."""
        link = getattr(self, "_link", None)
        if link is not None:
            link.stop()

    # ---------------------------------------------------------------- thread of the device

    def _attend(self) -> None:
        now = time.monotonic_ns()
        with self._lock:
            if self._session != self._link.counts.sessions:
                self._session = self._link.counts.sessions
                # Commands from the time without a device are not for the new one.
                self.port.guard.set_active(False)
                self.port.poll(now)
                self.port.guard.set_active(True)
            self.port.poll(now)
            commands = self.port.guard.counts.commands
            if commands == self._commands_sent and now - self._sent_ns < self._period_ns:
                return
            voltage = self.port.output(now).voltage
        self._commands_sent, self._sent_ns = commands, now
        self._device.command(self._output(voltage))

    def _deliver(self, sample: Sample) -> None:
        for output, pressure in zip(self._pressures, sample.pressure, strict=False):
            output.send(sample.stamp_ns, pressure, self._variance)
        self._valves.send(sample.stamp_ns, *self._asked(sample.voltage))
        self._joint.send(sample)
        with self._lock:
            if self._pressures:
                self.port.supervise(sample.stamp_ns, *sample.pressure)
            for flag, reason in _DEVICE_STOPS:
                if sample.status & flag:
                    self.port.stop(reason)
            self._rest.add(sample.pressure)

    # ---------------------------------------------------------------- thread of the executor

    def _on_measure_rest(self, _request: Any, response: Any) -> Any:
        with self._lock:
            try:
                first, second = self._rest.result()
            except BadInput as error:
                response.success, response.message = False, str(error)
                return response
            self._converter.rest = (first, second)
            self._rest.clear()
        response.success = True
        response.message = f"in use now; keep it as parameter pressure_rest: [{first:.1f}, {second:.1f}]"
        self.get_logger().warning(f"sensors at rest: {response.message}")
        return response

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        """Health of the device and of its clock."""
        self._link.check()
        self._log_trouble(self._link.trouble)
        with self._lock:
            port = self.port.health(steady_ns)
        return {**self._health.parts(steady_ns), **port}

    def _log_trouble(self, trouble: str) -> None:
        """Log each problem once."""
        if trouble == self._logged or not self.active:
            return
        self._logged = trouble
        if trouble:
            self.get_logger().error(f"no device: {trouble}")
        else:
            self.get_logger().info("the device is there")


class JointOutput:
    """Publishes ``measured/joint_states`` with the available channels, and ``angle_sensor`` if wanted.

    Args:
        angle_sensor: ``encoder`` publishes the angle as ``angle_sensor`` as well.
    """

    def __init__(self, node: PamNode, name: str, frame_id: str, angle_sensor: str) -> None:
        self._encoder: wire.Outgoing | None = None
        if angle_sensor == "encoder":
            body, self._position = wire.joint_position(name)
            self._encoder = wire.Outgoing(node, JointState, TOPICS["angle_sensor"].relative, frame_id, body)
        body, self._values = wire.joint_state(name, velocity=False)
        self._both = wire.Outgoing(node, JointState, TOPICS["measured_joint_states"].relative, frame_id, body)
        self._message = JointState()
        self._message.header.frame_id = frame_id
        self._message.name = [name]

    def send(self, sample: Sample) -> None:
        """Publish angle and torque of a sample."""
        if self._encoder is not None and sample.angle is not None:
            self._encoder.send(sample.stamp_ns, *self._position(sample.angle))
        if sample.angle is not None and sample.torque is not None:
            self._both.send(sample.stamp_ns, *self._values(sample.angle, sample.torque))
        elif sample.angle is not None or sample.torque is not None:
            wire.set_stamp(self._message.header.stamp, sample.stamp_ns)
            self._message.position = [] if sample.angle is None else [sample.angle]
            self._message.effort = [] if sample.torque is None else [sample.torque]
            self._both.publisher.publish(self._message)
