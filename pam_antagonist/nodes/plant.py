"""The node of the simulated joint."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import DISTURBANCE
from pam_antagonist.nodes import wire
from pam_antagonist.nodes.ages import Moment
from pam_antagonist.nodes.further import SignalTopics, SignalValues
from pam_antagonist.nodes.health import Health, Level, Rate, Rises, Window, judged, too_slow
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.parameters import (
    ANGLE_SENSORS,
    PRESSURE_SENSORS,
    SIMULATED_JOINT,
    VALVE_OWNER,
    Parameter,
)
from pam_antagonist.nodes.spin import run_node
from pam_antagonist.nodes.valve_port import ValvePort
from pam_antagonist.rig import NO_ENCODER
from pam_antagonist.simulation.plant import Plant

DESCRIPTION = """
Simulated joint with two pneumatic muscles, in place of a real one: the physics of the rig in real time at its sample
period, with finer steps, parameters off their declared values, sensor noise and quantisation. It obeys one commander.
Commands are clamped and slew-limited. The valves get safe voltages when commands stop or a pressure is missing, frozen
or too high (docs/how-to/safety.md).

publishes:   pressure_1, pressure_2 (sensor_msgs/FluidPressure), valve_state (pam_antagonist_msgs/ValveCommand),
             joint_sample (pam_antagonist_msgs/JointSample, with samples: one),
             measured/joint_states (sensor_msgs/JointState: encoder and torque meter, for validation only),
             angle_sensor (sensor_msgs/JointState, with angle_sensor: encoder),
             measured/external_torque (geometry_msgs/WrenchStamped: push, for validation only; of a rig with the state
             external_torque), rig (std_msgs/String)
subscribes:  valve_command (pam_antagonist_msgs/ValveCommand)
             A rig with drive: regulator has pressure_state and pressure_command (pam_antagonist_msgs/PressureCommand)
             in the place of valve_state and valve_command. A rig with signals has also/NAME
             (sensor_msgs/FluidPressure, JointState or Temperature).
services:    ~/stop, ~/clear_stop (std_srvs/Trigger), and those of a lifecycle node
"""

PARAMETERS = (
    *SIMULATED_JOINT,
    *VALVE_OWNER,
    Parameter("seed", 0, 0, 2**31 - 1).about("seed of the parameters' mismatch and of the sensor noise [-]"),
    Parameter("mismatch", 0.0, 0.0, 0.29).about("relative standard deviation of the parameters from the rig's [-]"),
    Parameter("noise", True).about("whether the sensors have noise and steps"),
    Parameter("angle_sensor", "none", choices=ANGLE_SENSORS).about(
        "encoder: publishes angle_sensor, by the rig file's encoder"
    ),
    Parameter("pressure_sensors", "measured", choices=PRESSURE_SENSORS).about(
        "none: publishes no pressures, like a joint without pressure sensors; for a rig with drive: regulator"
    ),
    Parameter("push", 0.0, -10.0, 10.0, read_only=False).about(
        "torque with which somebody pushes the joint, about +z [N m]"
    ),
    Parameter("substeps", 4, 1, 64).about("integration steps a sample [-]"),
    Parameter("initial_pressure", [0.0, 0.0], 0.0, 2e6).about(
        "pressures at the start, absolute [Pa]; 0: at rest, by the rig file"
    ),
    Parameter("wait_for_subscribers", 0, 0, 16).about(
        "subscribers of each sample topic that the first sample waits for [-]"
    ),
)


_BURST = 25  # largest number of samples while catching up, before commands are read again
_JUMP = 1.0  # [s] largest lateness of the samples that is caught up
_JUMP_BACK = 0.5  # [s] largest time that the samples wait for a clock behind them; as in the estimator
_SETTLE = 0.3  # [s] time for subscribers to find the publishers, after the publishers have found them


class PlantNode(PamNode):
    """Simulates the joint in real time, with finer steps, deviating parameters and noisy sensors.

    Sample k is stamped start + k T, without drift, and is published when the clock reaches this time. After a stall all
    missed samples are published, as by a device that runs independently.

    Linked with the controller, which calls :meth:`command`, it does not subscribe to ``valve_command``. ``deliver`` is
    called with each sample: stamp [ns], two pressures [Pa], two voltages [V], and the encoder's angle [rad], NaN where
    none is published.
    """

    NAME, TABLE = "plant", PARAMETERS

    @override
    def configure(self) -> None:
        rig = self.load_rig()
        values = self.values
        self._period = round(rig.sample_period * 1e9)
        self.port = ValvePort(self, rig, noisy=values["noise"])
        held = {"joint": values["joint"], "lock_angle": values["lock_angle"]}
        given = {name: values[name] for name in ("seed", "substeps", "mismatch", "noise")}
        self._plant = Plant(rig, **held, **given, initial_pressure=tuple(values["initial_pressure"]))
        # Compiles or loads the code of a step; uses another plant, so that this one starts at rest.
        Plant(rig, **held).step(self.port.drive.action.hold)
        encoder = values["angle_sensor"] == "encoder"
        if encoder and rig.encoder is None:
            raise BadInput(f"angle_sensor encoder: {NO_ENCODER.format(rig=rig.name)}")
        self._next: int | None = None
        self._now: int | None = None  # present time while samples are made [ns]
        self._found_ns: int | None = None
        self._samples = self._jumps = self._left_out = 0
        self._ticked = self.ages.now()
        self._lateness, self._rate, self._rises = Window(), Rate(), Rises()
        variance = rig.sensors.pressure_std**2 if values["noise"] else 0.0
        measured = values["pressure_sensors"] == "measured"
        self._output = wire.SampleOutput(self, rig, pressures=measured, variance=variance, encoder=encoder)
        self._heard = SignalValues(len(rig.signals))
        self._signals = SignalTopics(self, tuple(rig.signals), self._heard.add)
        self._push: float = values["push"]
        self._pushed: wire.Outgoing | None = None
        if DISTURBANCE in rig.effects:
            self._pushed = wire.Outgoing(self, "measured_external_torque", values["frame_id"], wire.WRENCH)
        self.steady_timer(self._period * 1e-9, self._tick)
        self.announce(rig)

    @override
    def change(self, changed: Mapping[str, Any]) -> None:
        self._push = changed.get("push", self._push)  # from the next sample on

    @override
    def activate(self) -> None:
        self._heard.reset()
        self._signals.listen()
        self.port.listen()

    @override
    def deactivate(self) -> None:
        self._signals.close()
        self.port.rest()

    def _tick(self) -> None:
        now = self.now_ns()
        if self._next is None:
            if now == 0 or not self.active or not self._may_start(now):
                return
            self._next = now
        self.port.poll(now)
        if not -_JUMP_BACK * 1e9 <= now - self._next <= _JUMP * 1e9:
            off = f"{(now - self._next) * 1e-9:+.3f} s"
            # A clock that jumps moves more than the steady one. A computer that falls behind is late by both.
            if abs(now - self._ticked.clock_ns - (time.monotonic_ns() - self._ticked.steady_ns)) > _JUMP_BACK * 1e9:
                self._jumps += 1
                words = f"the clock is {off} off the samples: the samples go on at the clock's time"
            else:
                self._left_out += now - self._next
                words = too_slow(1e9 / self._period, f"the clock is {off} off the samples, which are left out")
            self.get_logger().warning(words)
            self._next = now
        for _ in range(_BURST):
            if self._next > now:
                break
            self._now = now
            self._sample(self._next)
            now = self.now_ns()
            self._lateness.add(now - self._next)
            self._next += self._period
        self._now = None
        self._ticked = Moment(now, time.monotonic_ns())

    def _may_start(self, now: int) -> bool:
        """Whether all expected subscribers are connected."""
        wanted: int = self.values["wait_for_subscribers"]
        if wanted == 0:
            return True
        if any(output.publisher.get_subscription_count() < wanted for output in self._output.counted):
            self._found_ns = None
            return False
        if self._found_ns is None:
            self._found_ns = now
        return now - self._found_ns >= _SETTLE * 1e9

    def _sample(self, stamp_ns: int) -> None:
        """Advance by one period, which ends at the stamp, and publish."""
        push = self._push
        sample = self._plant.step(self.port.output(stamp_ns).voltage, push, self._heard.at(stamp_ns))
        pressure = sample.pressure if self._output.pressures else (math.nan, math.nan)
        if self._output.pressures:
            self.port.supervise(stamp_ns, *pressure)
        self._samples += 1
        if not self.active:
            return
        self._output.send(stamp_ns, pressure, sample.voltage, sample.angle, sample.torque, sample.encoder)
        if self._pushed is not None:
            self._pushed.send(stamp_ns, 0.0, 0.0, 0.0, 0.0, 0.0, push)
        if self.deliver is not None:
            encoder = math.nan if self._output.encoder is None else sample.encoder
            self.deliver(stamp_ns, *pressure, *sample.voltage, encoder)

    def command(self, stamp_ns: int, voltage: tuple[float, float]) -> None:
        """Take a command (2,) [V] of the controller in the same process. `stamp_ns`: of the command's sample [ns]."""
        self.port.command(stamp_ns, voltage, self.now_ns() if self._now is None else self._now)

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        lateness = self._lateness.take()
        values = {
            "rate [Hz]": f"{self._rate.take(self._samples, steady_ns):.1f}",
            "samples": self._samples,
            "clock jumps": self._jumps,
            "left out, computer too slow [s]": f"{self._left_out * 1e-9:.1f}",
            **lateness.as_values("lateness", "ms", 1e6),
        }
        rises = self._rises.take(jumps=self._jumps, left_out=self._left_out)
        jumped, left_out = rises["jumps"], rises["left_out"] * 1e-9
        late = f"half of them come {lateness.median * 1e-6:.0f} ms late or more"
        slow = f"{left_out:.1f} s of them were left out" if left_out else late
        behind = left_out or lateness.median > self.values["command_timeout"] * 1e9
        sampling = judged(
            values,
            "running",
            (self.ages.clock_fails, Level.ERROR, f"no samples: {self.ages.clock_fails}"),
            (self._next is None, Level.WARN, "waits for the clock or for subscribers"),
            (jumped, Level.WARN, "the clock jumped: the samples went on from it"),
            (behind, Level.WARN, too_slow(1e9 / self._period, slow)),
        )
        further = {"signals": self._signals.health(self._heard.missing)} if self._heard.missing else {}
        return {"sampling": sampling, **self.port.health(steady_ns), **further}


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``plant --help``."""
    return run_node(PlantNode, argv, name="plant", description=DESCRIPTION, table=PARAMETERS)
