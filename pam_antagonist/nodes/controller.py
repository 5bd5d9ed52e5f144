"""The controller node."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

from std_srvs.srv import SetBool, Trigger
from typing_extensions import override

from pam_antagonist.control.command import Command, Status
from pam_antagonist.control.model_law import Seen
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.stamps import RESTART_AFTER_NS
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.nodes import qos, wire
from pam_antagonist.nodes.ages import Moment
from pam_antagonist.nodes.health import Health, Level, Rate, Rises, Window, judged
from pam_antagonist.nodes.laws import PARAMETERS, described, make_laws, retune
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.parameters import by_rig
from pam_antagonist.nodes.references import ReferenceInput
from pam_antagonist.nodes.rig_watch import RigWatch
from pam_antagonist.nodes.sources import OneEstimator, absent
from pam_antagonist.nodes.spin import run_node
from pam_antagonist.nodes.valve_port import drive_of
from pam_antagonist.recording.topics import COMMAND_TOPICS, STATE_TOPICS, TOPICS
from pam_antagonist.rig.schema import ENCODER_ZERO
from pam_antagonist.safety import EstimateSupervision, Following
from pam_antagonist_msgs.msg import Health as HealthMessage
from pam_antagonist_msgs.msg import JointEstimate

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
             health (pam_antagonist_msgs/Health), with stop_on
publishes:   valve_command (pam_antagonist_msgs/ValveCommand), rig; reference, where references come from another topic
services:    ~/enable (std_srvs/SetBool), ~/clear_stop (std_srvs/Trigger), and those of a lifecycle node
"""

_CHECKS = 4  # checks of the estimates' time-out and of the valves, within ``max_age``


class ControllerNode(PamNode):
    """Sends one command for each estimate; safe voltages without a valid estimate or reference.

    Linked with the estimator, which calls :meth:`estimate`, it does not subscribe to ``joint_estimate``. ``deliver`` is
    called with each command: stamp [ns], voltages (2,) [V].
    """

    NAME, TABLE = "controller", PARAMETERS
    stopped = ""

    @override
    def configure(self) -> None:
        self._rig = rig = self.load_rig()
        values = self.values
        drive = drive_of(rig, values)
        self._limits, self._action = drive.limits, drive.action
        self._laws = make_laws(values, rig, self._limits, self._action.hold)
        self._supervision = EstimateSupervision(
            values["stop_angle"],
            values["stop_angle_time"],
            values["nis_limit"],
            values["nis_time"],
            values["blind_time"] if values["pressure_sensors"] == "measured" else None,
            rig.sample_period,
        )
        self.input = ReferenceInput(self, self._laws.nearest)
        self._references = self.input.references
        self._max_age = round(values["max_age"] * 1e9)
        self._resume = round(values["resume_time"] * 1e9)
        self.stopped = ""
        self._enabled: bool = values["start_enabled"]
        self._estimate_ns = 0
        self._safe_since_ns: int | None = None
        self._heard: Moment | None = None
        self._stamp = 0
        self._voltage = self._action.hold
        self._following = Following(self._action.hold, drive.astray, rig.sample_period)
        self._silent = False
        self._commands = self._jumps = 0
        self._statuses = dict.fromkeys(Status, 0)
        self._last = Status.NO_REFERENCE
        self._latency, self._rate, self._rises = Window(), Rate(), Rises()
        self._output = wire.Outgoing(self, COMMAND_TOPICS[rig.drive], f"{rig.drive}s", wire.VALVES)
        self._decode, self._valves = wire.Incoming(wire.ESTIMATE_FOR_CONTROL), wire.Incoming(wire.VALVES)
        self._stops_on = stops_on(values["stop_on"])
        self.serve(SetBool, "~/enable", self._enable)
        self.serve(Trigger, "~/clear_stop", self._clear)
        self._rigs = RigWatch(self, self.announce(rig), self.stop)
        self._estimators = OneEstimator(self, self.stop)

    @override
    def change(self, changed: Mapping[str, Any]) -> None:
        values = by_rig({**self.given, **changed}, self._rig)
        retune(self._laws, self.values, values, self._references.mode)  # without a bump
        self.values = values

    @override
    def activate(self) -> None:
        self._heard = None
        self._laws.active.stop()
        self._supervision.reset()
        if not self.linked:
            name = TOPICS["joint_estimate"].relative
            self.create_subscription(JointEstimate, name, self.take_message, qos.STREAM, raw=True)
        self.input.listen()
        if self._stops_on:
            self.create_subscription(HealthMessage, TOPICS["health"].relative, self._heard_of, qos.LATCHED)
        state = STATE_TOPICS[self._rig.drive]
        self._valve_state = self.collect(wire.message_class(state), TOPICS[state].relative, qos.GLANCE)
        self.steady_timer(self.values["max_age"] / _CHECKS, self._watch)

    @override
    def deactivate(self) -> None:
        if self._enabled:
            self._send(self._laws.active.safe(Status.DISABLED), self._stamp + 1)

    @override
    def close(self) -> None:
        if self.active:
            self.deactivate()

    # ---------------------------------------------------------------- services

    def _enable(self, request: Any) -> str:
        """Start commanding from the voltages on the valves, or stop commanding so that another node may."""
        if not self.active:
            raise BadInput("the node is not active: activate it first")
        wanted = bool(request.data)
        if wanted == self._enabled:
            return f"it is {'enabled' if wanted else 'disabled'} already"
        if wanted:
            self._from_the_valves()
            self._supervision.reset()
            self._enabled = True
            return f"enabled, from {self._voltage[0]:.3f} and {self._voltage[1]:.3f} {self._limits.unit}"
        self.deactivate()
        self._enabled = False
        return "disabled: safe voltages once, then silent"

    def _clear(self, _request: Any) -> str:
        self._rigs.forget_the_gone()
        recent = self._heard is not None and self.ages.since(self._heard) <= self._max_age
        present = self._causes() or (recent and self._supervision.present)
        if not self.stopped:
            return "there is no stop to clear"
        if present:
            raise BadInput(f"not cleared, since the cause is still present: {present}")
        words, self.stopped = f"cleared: {self.stopped}", ""
        self._supervision.reset()
        self._from_the_valves()
        self.get_logger().warning(words)
        return words

    def _causes(self) -> str:
        return self._rigs.present or self._estimators.present

    def stop(self, reason: str) -> None:
        """Safe voltages until ``clear_stop``."""
        if not self.stopped:
            self.stopped = reason
            self.get_logger().error(f"stopped: {reason}")

    def _heard_of(self, message: HealthMessage) -> None:
        """Stop on a finding of the monitor, if the parameter ``stop_on`` names it."""
        if message.name in self._stops_on:
            self.stop(f"the monitor found {message.name}: {message.sentence}")

    def _look(self) -> None:
        """Read the voltages on the valves; only while active."""
        if not self.active:
            return
        for data, _ in wire.take(self._valve_state):
            _, first, second = self._valves(data)
            if math.isfinite(first) and math.isfinite(second):
                self._following.saw((self._limits.clip(first), self._limits.clip(second)), time.monotonic_ns())

    def _from_the_valves(self) -> None:
        """Restart the laws at the voltages on the valves; where these are not known, at the last command."""
        self._look()
        self._voltage = self._following.on_valves(time.monotonic_ns()) or self._voltage
        self._laws.active.stop(self._voltage)

    # ---------------------------------------------------------------- samples

    def take_message(self, data: bytes) -> None:
        """Take a serialised estimate."""
        self.estimate(*self._decode(data))

    def estimate(self, stamp: int, *values: float) -> None:
        """Send the command for an estimate with a stamp [ns]. `values`: as in ``wire.ESTIMATE_FOR_CONTROL``."""
        if not self.active:
            return
        age, behind = self.ages.of(stamp), self._estimate_ns - stamp
        if behind > RESTART_AFTER_NS:  # the clock was set back, and the filter has started again
            self._jumps += 1
            self._laws.active.stop(self._voltage)
        elif behind >= 0:  # no sample is answered twice
            self._estimators.repeats += 1
            return
        self._estimate_ns = stamp
        self._heard = self.ages.now()
        self._silent = False
        if age < math.inf:
            self._latency.add(age)
        if not self._enabled:
            return
        angle, velocity, torque, of_angle, of_velocity, of_torque, *rest = values
        first, second, of_first, of_second, nis, flags, external, of_external = rest
        reason = self._supervision.check(stamp, angle, nis, int(flags))
        if reason:
            self.stop(reason)
        if self.stopped:
            self._send(self._laws.active.safe(Status.STOPPED), stamp)
            return
        late = age > self._max_age or bool(int(flags) & JointEstimate.LATE) or self._supervision.settling
        wanted = self._references.at(stamp, time.monotonic_ns(), angle, torque)
        if wanted.lost:
            self._send(self._laws.active.safe(Status.LOST), stamp)
            return
        seen = Seen(
            angle, velocity, torque, first, second, external, of_external, of_angle, of_velocity, of_torque, of_first,
            of_second,
        )  # fmt: skip
        self._send(self._laws.step(wanted, seen, late=late), stamp)
        self.input.repeat(stamp)

    def _watch(self) -> None:
        """Send safe voltages while no estimates come, and check that the valves follow.

        These commands are stamped from the last answered sample on, a nanosecond apart. So stamps never decrease, even
        if the missing estimates come late, and no such command has the stamp of a sample.
        """
        self._look()
        self._estimators.look(time.monotonic_ns())
        if self._heard is None or not self._enabled:
            return
        silent = self.ages.since(self._heard)
        if silent > self._max_age:
            if silent > self._resume:
                self._laws.active.stop()
            self._silent = True
            self._send(self._laws.active.safe(Status.STOPPED if self.stopped else Status.LATE), self._stamp + 1)
        elif self._following.astray(self._voltage, time.monotonic_ns()):
            # The valves are stopped or obey another node. The command must not jump when they obey again.
            self._from_the_valves()

    def _send(self, command: Command, stamp_ns: int) -> None:
        voltage = command.voltage
        if not command.status.safe:
            self._safe_since_ns = None
        else:
            self._references.not_tracking()
            now = time.monotonic_ns()
            if self._safe_since_ns is None:
                self._safe_since_ns = now
            voltage = self._action.voltage(now - self._safe_since_ns)
            if voltage != command.voltage and not self._laws.active.running:
                self._laws.active.stop(voltage)
        self._output.send(stamp_ns, *voltage)
        if self.deliver is not None:
            self.deliver(stamp_ns, voltage)
        self._voltage = voltage
        self._stamp = stamp_ns
        self._commands += 1
        self._statuses[command.status] += 1
        self._last = command.status

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        statuses, self._statuses = self._statuses, dict.fromkeys(Status, 0)
        safe = sum(count for status, count in statuses.items() if status.safe)
        risen = self._rises.take(jumps=self._jumps, astray=self._following.astray_count)
        values = {
            "rate [Hz]": f"{self._rate.take(self._commands, steady_ns):.1f}",
            "commands": self._commands,
            **described(self._laws),
            "cause of a stop is there": self._causes() or self._supervision.present or "no",
            "jumps backwards": self._jumps,
            "estimates not newer than the last": self._estimators.repeats,
            "times not obeyed": self._following.astray_count,
            **{status.value: count for status, count in statuses.items() if count},
            **self._latency.take().as_values("age of the estimate", "ms", 1e6),
        }
        complaint, second = self._references.complaint, self._estimators.publishers
        if second and self.linked:
            second = f"the estimator of this process alone is obeyed: {second}"
        none = "no estimate has come yet"
        if self._heard is None and not self.linked:
            none += f": {absent(self, [TOPICS['joint_estimate'].relative])}"
        commands = judged(
            values,
            self._last.value,
            (self.stopped, Level.ERROR, f"stopped: {self.stopped}; clear_stop clears it"),
            (not self._enabled, Level.WARN, "disabled: silent"),
            (risen["jumps"], Level.WARN, "the stamps jumped backwards: started again"),
            (
                risen["astray"],
                Level.ERROR,
                "the valves do not get what is commanded: the node that owns them is stopped, or it obeys another "
                "commander",
            ),
            (second, Level.ERROR, second),
            (self._heard is None, Level.WARN, none),
            (self._silent, Level.ERROR, "estimates have stopped: safe voltages"),
            (self.ages.trouble, Level.ERROR, f"safe voltages: {self.ages.trouble}"),
            (complaint, Level.ERROR, f"{complaint}: safe voltages"),
            (safe, Level.WARN, self._last.value if self._last.safe else f"{safe} commands at safe voltages"),
        )
        return {"rig": self._rigs.health(), "reference": self.input.health(), "commands": commands}


def stops_on(names: Sequence[str]) -> frozenset[str]:
    """Names of the parameter ``stop_on`` that the monitor may publish."""
    given, known = frozenset(names) - {""}, (*CATALOGUE, ENCODER_ZERO)
    if unknown := sorted(given - set(known)):
        raise BadInput(f"stop_on: no effect is called {unknown[0]!r}; expected some of {', '.join(known)}")
    return given


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``controller --help``."""
    return run_node(ControllerNode, argv, name="controller", description=DESCRIPTION, table=PARAMETERS)
