"""The simulated joint that stands in for a real one."""

from __future__ import annotations

import math
from collections.abc import Mapping

from sensor_msgs.msg import FluidPressure, JointState

from pam_antagonist.control import VoltageLimits
from pam_antagonist.model.plant import Plant
from pam_antagonist.nodes import qos, wire
from pam_antagonist.nodes.health import Health, Level, Rate, Window
from pam_antagonist.nodes.node import JOINT_NAME, PamNode
from pam_antagonist.nodes.plant import PARAMETERS
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist.rig import load_rig
from pam_antagonist_msgs.msg import ValveCommand

_BURST = 25  # samples in a row while catching up, before commands are looked at again
_JUMP = 1.0  # difference between clock and samples that is not caught up with [s]
_SETTLE = 0.3  # time that subscribers have to find the publishers, after these have found them [s]


class PlantNode(PamNode):
    """Runs the physics in real time, finer and off its declared values, behind noisy sensors.

    Sample k is stamped start + k T, without drift, and is published when the clock has reached that. After a stall
    every missed sample is made up for, as a device that runs on by itself would have sent them.
    """

    def __init__(self) -> None:
        super().__init__("plant", PARAMETERS)
        values = self.values
        rig = load_rig(values["rig"])
        self._period = round(rig.sample_period * 1e9)
        self._limits = VoltageLimits(rig.valves.voltage_min, rig.valves.voltage_max)
        self._safe = self._limits.check("parameter safe_voltage:", tuple(values["safe_voltage"]))
        self._plant = Plant(
            rig,
            joint=values["joint"],
            lock_angle=values["lock_angle"],
            seed=values["seed"],
            substeps=values["substeps"],
            mismatch=values["mismatch"],
            noise=values["noise"],
            initial_pressure=tuple(values["initial_pressure"]),
        )
        # Compiles, or loads, what a step needs; a plant of its own, so that the real one starts at rest.
        Plant(rig, joint=values["joint"], lock_angle=values["lock_angle"]).step(self._safe)
        self._timeout = round(values["command_timeout"] * 1e9)
        self._command: tuple[float, float] | None = None
        self._command_ns = 0
        self._next: int | None = None
        self._found_ns: int | None = None
        self._samples = self._commands = self._refused = self._without = self._jumps = 0
        self._lateness, self._rate, self._command_rate = Window(), Rate(), Rate()
        self._variance = rig.sensors.pressure_std**2 if values["noise"] else 0.0
        body, self._joint_values = wire.joint_state(JOINT_NAME, velocity=False)
        self._pressures = tuple(
            wire.Outgoing(self, FluidPressure, TOPICS[f"pressure_{i}"].relative, f"muscle_{i}", wire.PRESSURE)
            for i in (1, 2)
        )
        self._valves = wire.Outgoing(self, ValveCommand, TOPICS["valve_state"].relative, "valves", wire.VALVES)
        name = TOPICS["measured_joint_states"].relative
        self._joint = wire.Outgoing(self, JointState, name, values["frame_id"], body)
        self._from_command = wire.Incoming(wire.VALVES)
        self.start_diagnostics(rig.name)

    def activate(self) -> None:
        """Take commands and let time pass."""
        name = TOPICS["valve_command"].relative
        self.create_subscription(ValveCommand, name, self._on_command, qos.COMMAND, raw=True)
        self.steady_timer(self._period * 1e-9, self._tick)

    def _on_command(self, data: bytes) -> None:
        _, first, second = self._from_command(data)
        if not (math.isfinite(first) and math.isfinite(second)):
            self._refused += 1  # as if it had not come: the time-out takes care
            return
        self._commands += 1
        self._command = (self._limits.clip(first), self._limits.clip(second))
        self._command_ns = self.now_ns()

    def _tick(self) -> None:
        now = self.now_ns()
        if self._next is None:
            if now == 0 or not self._may_start(now):
                return
            self._next = now
        if abs(now - self._next) > _JUMP * 1e9:
            self._jumps += 1
            self.get_logger().warning(
                f"the clock is {(now - self._next) * 1e-9:+.3f} s off the samples: they go on from the clock"
            )
            self._next = now
        for _ in range(_BURST):
            if self._next > now:
                break
            self._sample(self._next)
            now = self.now_ns()
            self._lateness.add(now - self._next)
            self._next += self._period

    def _may_start(self, now: int) -> bool:
        """Whether the subscribers that are waited for can receive by now."""
        wanted: int = self.values["wait_for_subscribers"]
        if wanted == 0:
            return True
        outputs = (*self._pressures, self._valves)
        if any(output.publisher.get_subscription_count() < wanted for output in outputs):
            self._found_ns = None
            return False
        if self._found_ns is None:
            self._found_ns = now
        return now - self._found_ns >= _SETTLE * 1e9

    def _sample(self, stamp_ns: int) -> None:
        """Advance by one period, which ends at the stamp, and publish."""
        voltage = self._command
        if voltage is None or stamp_ns - self._command_ns > self._timeout:
            voltage = self._safe
            self._without += 1
        sample = self._plant.step(voltage)
        for output, pressure in zip(self._pressures, sample.pressure, strict=True):
            output.send(stamp_ns, pressure, self._variance)
        self._valves.send(stamp_ns, *sample.voltage)
        self._joint.send(stamp_ns, *self._joint_values(sample.angle, sample.torque))
        self._samples += 1

    def health(self, steady_ns: int) -> Mapping[str, Health]:
        lateness = self._lateness.take()
        rate = self._rate.take(self._samples, steady_ns)
        commands = self._command_rate.take(self._commands, steady_ns)
        without, self._without = self._without, 0
        if self._next is None:
            sampling = Health(Level.WARN, "waits for the clock or for subscribers")
        else:
            sampling = Health(Level.OK, "running")
        message = f"safe voltages for {without} samples: no command in time" if without else "obeyed"
        return {
            "sampling": Health(
                sampling.level,
                sampling.message,
                {
                    "rate [Hz]": f"{rate:.1f}",
                    "samples": self._samples,
                    "clock jumps": self._jumps,
                    **lateness.as_values("lateness", "ms", 1e6),
                },
            ),
            "commands": Health(
                Level.WARN if without else Level.OK,
                message,
                {
                    "rate [Hz]": f"{commands:.1f}",
                    "samples at safe voltages": without,
                    "refused, not finite": self._refused,
                    "commanders": self.count_publishers(TOPICS["valve_command"].relative),
                },
            ),
        }
