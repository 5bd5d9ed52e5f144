"""The PI controller behind its topics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import SetParametersResult

from pam_antagonist.control import Command, Gains, Mode, PiController, Status, VoltageLimits
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos, wire
from pam_antagonist.nodes.controller import PARAMETERS
from pam_antagonist.nodes.health import Health, Level, Rate, Window
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist.rig import load_rig
from pam_antagonist_msgs.msg import JointEstimate, JointReference, ValveCommand

_GAIN_NAMES = tuple(parameter.name for parameter in PARAMETERS if not parameter.read_only)
_CHECKS = 4  # looks at the time-out within it


def _gains(values: Mapping[str, Any], mode: Mode) -> Gains:
    name = mode.name.lower()
    return Gains(values[f"{name}_proportional"], values[f"{name}_integral"], values["bias"])


class ControllerNode(PamNode):
    """One command for each estimate; safe voltages whenever there is nothing to go by."""

    def __init__(self) -> None:
        super().__init__("controller", PARAMETERS)
        values = self.values
        rig = load_rig(values["rig"])
        self._pi = PiController(
            {mode: _gains(values, mode) for mode in Mode},
            sample_period=rig.sample_period,
            limits=VoltageLimits(rig.valves.voltage_min, rig.valves.voltage_max),
            safe_voltage=tuple(values["safe_voltage"]),
            resume_time=values["resume_time"],
            blend_time=values["blend_time"],
        )
        self._largest = {Mode.ANGLE: values["max_angle"], Mode.TORQUE: values["max_torque"]}
        self._max_age = round(values["max_age"] * 1e9)
        self._resume = round(values["resume_time"] * 1e9)
        self._mode: Mode | None = None
        self._reference = math.nan
        self._complaint = ""
        self._heard_ns: int | None = None
        self._stamp = 0
        self._silent = False
        self._commands = 0
        self._statuses = dict.fromkeys(Status, 0)
        self._last = Status.NO_REFERENCE
        self._latency, self._rate = Window(), Rate()
        self._output = wire.Outgoing(self, ValveCommand, TOPICS["valve_command"].relative, "valves", wire.VALVES)
        self._estimate = wire.Incoming(wire.ESTIMATE_FOR_CONTROL)
        self.add_on_set_parameters_callback(self._on_parameters)
        self.start_diagnostics(rig.name)

    def activate(self) -> None:
        """Listen, and watch over those who are listened to."""
        name = TOPICS["joint_estimate"].relative
        self.create_subscription(JointEstimate, name, self._on_estimate, qos.STREAM, raw=True)
        self.create_subscription(JointReference, TOPICS["reference"].relative, self._on_reference, qos.REFERENCE)
        self.steady_timer(self.values["max_age"] / _CHECKS, self._watch)

    def _on_reference(self, message: JointReference) -> None:
        """Hold it; what cannot be used leads to safe voltages until a better one comes."""
        complaint = ""
        try:
            mode = Mode(message.mode)
        except ValueError:
            complaint = f"reference has mode {message.mode}, expected {list(map(int, Mode))}"
        else:
            self._mode = mode
            if not abs(message.value) <= self._largest[mode]:
                unit = "rad" if mode is Mode.ANGLE else "N m"
                complaint = f"reference {message.value:g} {unit}, expected up to ±{self._largest[mode]:g} {unit}"
        if complaint and complaint != self._complaint:
            self.get_logger().error(f"{complaint}: safe voltages")
        self._complaint = complaint
        if complaint and self._mode is None:
            self._mode = Mode.ANGLE
        self._reference = math.nan if complaint else message.value

    def _on_estimate(self, data: bytes) -> None:
        stamp, angle, torque, flags = self._estimate(data)
        now = self.now_ns()
        self._heard_ns = now
        self._silent = False
        late = now - stamp > self._max_age or bool(flags & JointEstimate.LATE)
        value = torque if self._mode is Mode.TORQUE else angle
        self._send(self._pi.step(self._mode, self._reference, value, late=late), stamp)
        self._latency.add(now - stamp)

    def _watch(self) -> None:
        """Safe voltages at every look as long as estimates stay away.

        They are stamped just after the last sample that was answered, a nanosecond apart: so the stamps never
        decrease, also when the missing estimates come after all, and none of these commands passes for a sample's.
        """
        if self._heard_ns is None:
            return
        now = self.now_ns()
        silent = now - self._heard_ns
        if silent < 0:  # the clock was set back
            self._heard_ns = now
        elif silent > self._max_age:
            if silent > self._resume:
                self._pi.stop()
            self._silent = True
            self._send(self._pi.safe(Status.LATE), self._stamp + 1)

    def _send(self, command: Command, stamp_ns: int) -> None:
        self._output.send(stamp_ns, *command.voltage)
        self._stamp = stamp_ns
        self._commands += 1
        self._statuses[command.status] += 1
        self._last = command.status

    def _on_parameters(self, changed: list[Any]) -> SetParametersResult:
        """Take new gains, all or none of them, without a bump."""
        values = dict(self.values)
        try:
            for parameter in changed:
                if parameter.name in _GAIN_NAMES:
                    entry = next(item for item in PARAMETERS if item.name == parameter.name)
                    values[parameter.name] = entry.check(parameter.value)
            gains = {mode: _gains(values, mode) for mode in Mode}
            for mode in Mode:
                if gains[mode] != _gains(self.values, mode):
                    self._pi.retune(mode, gains[mode])
        except BadInput as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.values = values
        return SetParametersResult(successful=True)

    def close(self) -> None:
        """Leave the valves at the safe voltages."""
        self._send(self._pi.safe(Status.LATE), self._stamp + 1)

    def health(self, steady_ns: int) -> Mapping[str, Health]:
        rate = self._rate.take(self._commands, steady_ns)
        statuses, self._statuses = self._statuses, dict.fromkeys(Status, 0)
        safe = sum(count for status, count in statuses.items() if status.safe)
        if self._heard_ns is None:
            output = Health(Level.WARN, "no estimate has come yet")
        elif self._silent:
            output = Health(Level.ERROR, "estimates have stopped: safe voltages")
        elif self._complaint:
            output = Health(Level.ERROR, f"{self._complaint}: safe voltages")
        elif safe:
            output = Health(Level.WARN, self._last.value if self._last.safe else f"{safe} commands at safe voltages")
        else:
            output = Health(Level.OK, self._last.value)
        return {
            "commands": Health(
                output.level,
                output.message,
                {
                    "rate [Hz]": f"{rate:.1f}",
                    "commands": self._commands,
                    "mode": self._mode.name.lower() if self._mode is not None else "none",
                    "reference [rad or N m]": self._reference,
                    "integral term [V]": f"{self._pi.integral:.4f}",
                    **{status.value: count for status, count in statuses.items() if count},
                    **self._latency.take().as_values("age of the estimate", "ms", 1e6),
                },
            )
        }
