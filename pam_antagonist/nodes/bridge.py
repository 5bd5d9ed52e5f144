"""The bridge to real hardware."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from std_srvs.srv import Trigger
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.calibration import Converter, ZeroPressureMeasurement, load_calibration
from pam_antagonist.hardware.device import Device
from pam_antagonist.hardware.link import DeviceSample, Link, RequiredDevice
from pam_antagonist.hardware.protocol import Status
from pam_antagonist.hardware.serial_device import SerialDevice, SerialTransport
from pam_antagonist.nodes import wire
from pam_antagonist.nodes.health import Health, Level, Rate, Rises, judged
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.parameters import ANGLE_SENSORS, FRAME, JOINT_NAME, RIG, VALVE_OWNER, Parameter
from pam_antagonist.nodes.spin import run_node
from pam_antagonist.nodes.valve_port import ValvePort

DESCRIPTION = """
Bridge to real hardware: a microcontroller on a serial port that reads two pressures and drives two valves, by the
protocol of docs/reference/protocol.md. Samples are stamped by the device's clock, mapped to ROS time. The bridge obeys
one commander. Commands are clamped and slew-limited. The valves get safe voltages when commands stop or a pressure is
missing, frozen or too high (docs/how-to/safety.md). The device does that by itself 20 ms after the bridge's last
command. A device that is unplugged is opened again when it is back.

publishes:   pressure_1, pressure_2 (sensor_msgs/FluidPressure), valve_state (pam_antagonist_msgs/ValveCommand),
             joint_sample (pam_antagonist_msgs/JointSample, with samples: one),
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
    Parameter("port", "/dev/ttyACM0").about("serial port of the device; better a link in /dev/serial/by-id"),
    Parameter("baud", 921_600, 9600, 20_000_000).about("bit rate of the port; USB devices ignore it [1/s]"),
    Parameter("hardware", "example").about("calibration: a name in config/hardware, or path of a YAML file"),
    Parameter("pressure_rest", [0.0, 0.0], -50e3, 50e3).about(
        "correction that is added to the pressures, as ~/measure_rest finds it [Pa]"
    ),
    Parameter("angle_sensor", "none", choices=ANGLE_SENSORS).about(
        "encoder: publishes the encoder's angle as angle_sensor"
    ),
    Parameter("device_timeout", 3.0, 0.1, 30.0).about("time that the device may take to answer the greeting [s]"),
)


_TROUBLE = (
    "damaged frames from the device",
    "damaged frames at the device",
    "commands refused by the device",
    "watchdog trips of the device",
)
"""Counters of a device that cause a warning when they rise."""

_DEVICE_STOPS = (
    (Status.STOPPED, "the emergency stop at the device"),
    (Status.OUTPUT_FAULT, "the device could not put the voltages on the valves"),
)


class BridgeNode(PamNode):
    """Publishes a device's samples, and sends it the commands that pass the valve guard.

    One thread reads the device, publishes, takes commands and sends them, so that the executor's work does not delay
    them. A command goes to the device at once. Without a command, the guard's voltages are sent every period, so that
    the device's watchdog acts only when this process fails.

    `device`: makes the device; None: a device at the serial port of the parameters. `options`: as :class:`PamNode`.
    """

    NAME, TABLE = "bridge", PARAMETERS

    def __init__(self, device: Callable[[], Device] | None = None, **options: Any) -> None:
        self._make_device = device or self._serial_device
        super().__init__(**options)

    def _serial_device(self) -> Device:
        port, baud = self.values["port"], self.values["baud"]
        return SerialDevice(lambda: SerialTransport(port, baud), self.values["device_timeout"])

    @override
    def configure(self) -> None:
        self.check_time(self.get_parameter("use_sim_time").value)
        rig = self.load_rig()
        values = self.values
        first, second = values["pressure_rest"]
        self._converter = Converter(load_calibration(values["hardware"]), (first, second))
        self._converter.adapt(rig.drive)
        self.port = ValvePort(self, rig)
        # The device's outputs are voltages; for a rig with regulators all other commands are pressures.
        limits, action = self.port.drive.limits, self._converter.action(self.port.drive.action)
        low, high = (self._converter.output((limit, limit)) for limit in (limits.minimum, limits.maximum))
        wanted = RequiredDevice(round(rig.sample_period * 1e9), min(low), max(high), action)
        self._device = self._make_device()
        self._link = Link(self._device, self._converter, wanted, self.now_ns, self._deliver, self._attend)
        self._rate, self._rises = Rate(), Rises(None)
        self._period_ns = wanted.period_ns
        self._sent_ns = self._commands_sent = 0
        self._session = 0
        self._logged = ""
        self._rest = ZeroPressureMeasurement(self._converter)
        self._samples = wire.SampleOutput(
            self,
            rig,
            pressures=self._converter.measures_pressures,
            variance=rig.sensors.pressure_std**2,
            encoder=values["angle_sensor"] == "encoder",
        )
        self.serve(Trigger, "~/measure_rest", self._measure_rest)
        self.announce(rig)

    @override
    def check_time(self, simulated: bool) -> None:
        if simulated:
            raise BadInput(
                "use_sim_time is true, but hardware does not follow simulated time: set it to false, or replay a bag "
                "without a bridge"
            )

    @override
    def activate(self) -> None:
        self.port.listen()
        self._link.start()

    @override
    def deactivate(self) -> None:
        with self.port.lock:
            self.port.rest()
        self._link.stop()

    @override
    def close(self) -> None:
        link = getattr(self, "_link", None)
        if link is not None:
            link.stop()

    # ---------------------------------------------------------------- thread of the device

    def _attend(self) -> None:
        now = time.monotonic_ns()
        with self.port.lock:
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
        self._device.command(self._converter.output(voltage))

    def _deliver(self, sample: DeviceSample) -> None:
        asked = self._converter.asked(sample.voltage)
        self._samples.send(sample.stamp_ns, sample.pressure, asked, sample.angle, sample.torque, sample.angle)
        with self.port.lock:
            if self._samples.pressures:
                self.port.supervise(sample.stamp_ns, *sample.pressure)
            for flag, reason in _DEVICE_STOPS:
                if sample.status & flag:
                    self.port.stop(reason)
            self._rest.add(sample.pressure)

    # ---------------------------------------------------------------- thread of the executor

    def _measure_rest(self, _request: Any) -> str:
        with self.port.lock:
            first, second = self._rest.result()
            self._converter.rest = (first, second)
            self._rest.clear()
        words = f"in use now; keep it as parameter pressure_rest: [{first:.1f}, {second:.1f}]"
        self.get_logger().warning(f"sensors at rest: {words}")
        return words

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        self._link.check()
        self._log_trouble(self._link.trouble)
        with self.port.lock:
            port = self.port.health(steady_ns)
        return {"device": self._device_health(steady_ns), "clock": self._clock_health(), **port}

    def _log_trouble(self, trouble: str) -> None:
        """Log each problem once."""
        if trouble == self._logged or not self.active:
            return
        self._logged = trouble
        if trouble:
            self.get_logger().error(f"no device: {trouble}")
        else:
            self.get_logger().info("the device is there")

    def _device_health(self, steady_ns: int) -> Health:
        counts, info, trouble = self._link.counts, self._link.info, self._link.trouble
        counters = dict(self._device.counters())
        watched = {name: counters[name] for name in _TROUBLE if name in counters and math.isfinite(counters[name])}
        watched |= {"samples lost": float(counts.lost), "devices lost": float(counts.lost_devices)}
        risen = [f"{name}: {more:g} more" for name, more in self._rises.take(**watched).items() if more > 0]
        values: dict[str, object] = {
            "name": "none" if info is None else info.name,
            "rate [Hz]": f"{self._rate.take(counts.samples, steady_ns):.1f}",
            "samples": counts.samples,
            "samples lost": counts.lost,
            "samples before the clocks were known": counts.without_stamp,
            "samples with the device's own safe voltages": counts.safe_by_itself,
            "devices lost": counts.lost_devices,
        }
        unwatched = info is not None and info.watchdog_ns is None
        return judged(
            values | {name: f"{value:.6g}" for name, value in counters.items()},
            "running",
            (trouble, Level.ERROR, f"no device: {trouble}"),
            (unwatched, Level.WARN, "this device does not become safe by itself when this process dies"),
            (risen, Level.WARN, ", ".join(risen)),
        )

    def _clock_health(self) -> Health:
        link, clock = self._link, self._link.clock
        values: dict[str, object] = {
            "drift [ppm]": f"{clock.drift * 1e6:.2f}",
            "samples left out, backwards": link.counts.backwards,
            "restarts of the map": link.clock_restarts + clock.restarts,
            "steps of the host's clock": link.counts.clock_steps,
            **({"offset [s]": f"{clock.offset_s:.6f}"} if link.info is not None and clock.ready else {}),
        }
        return judged(
            values,
            "mapped to ROS time",
            (link.info is None, Level.WARN, "no device"),
            (not clock.ready, Level.WARN, "listens to the device's clock before it stamps"),
        )


def main(argv: list[str] | None = None, device: Callable[[], Device] | None = None) -> int:
    """Run the node; see ``bridge --help``.

    `device`: makes the device; default: a device at the serial port of the parameters.
    """
    return run_node(partial(BridgeNode, device), argv, name="bridge", description=DESCRIPTION, table=PARAMETERS)
