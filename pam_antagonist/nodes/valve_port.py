"""Port from commands to valves or pressure regulators, for the node that owns them: the plant, or a bridge to hardware.

The port connects the rules of :mod:`pam_antagonist.safety` with ROS. A node that owns valves has the parameters
``VALVE_OWNER``. It makes a port in ``configure``, calls :meth:`ValvePort.listen` in ``activate`` and
:meth:`ValvePort.rest` in ``deactivate``, and for each sample :meth:`ValvePort.poll`, :meth:`ValvePort.supervise` and
:meth:`ValvePort.output`::

    port.poll(now_ns)
    voltage = port.output(now_ns).voltage      # on the valves, and into valve_state
    ...
    port.supervise(stamp_ns, pressure_1, pressure_2)

If controller and valves are in one process, :meth:`ValvePort.command` replaces the topic.

These calls may come from any single thread. The services and :meth:`ValvePort.health` run in the executor's thread. If
these are two threads, all calls need a lock.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from std_srvs.srv import Trigger

from pam_antagonist.control import VoltageLimits
from pam_antagonist.nodes import qos, wire
from pam_antagonist.nodes.health import Health, Level, Rate
from pam_antagonist.nodes.node import PamNode, take
from pam_antagonist.nodes.wire import number_of
from pam_antagonist.recording.topics import COMMAND_TOPICS, STATE_TOPICS, TOPICS
from pam_antagonist.rig import Rig
from pam_antagonist.safety import (
    Decision,
    PressureSupervision,
    SafeAction,
    ValveGuard,
    Verdict,
    frozen_time,
    safe_action,
)
from pam_antagonist_msgs.msg import PressureCommand, ValveCommand

if TYPE_CHECKING:
    from rclpy.subscription import Subscription

_ASTRAY_VOLTAGE, _ASTRAY_PRESSURE = 0.25, 25e3
"""[V], [Pa] Largest normal difference between command and output; commands of consecutive samples differ by less."""


class Topics(NamedTuple):
    """Topics of the commands and of the outputs."""

    message: type
    command: str
    state: str  # topic of the voltages or pressures that valves or regulators got, relative
    frame_id: str


class Drive(NamedTuple):
    """Limits of the commands, in V for valves or Pa for regulators."""

    topics: Topics
    limits: VoltageLimits
    action: SafeAction
    slew: float  # largest change of each command [V/s] or [Pa/s]
    astray: float  # largest normal difference between command and output [V] or [Pa]


def topics_of(rig: Rig) -> Topics:
    """Topics of a rig's commands."""
    message, frame_id = (ValveCommand, "valves") if rig.drive == "valve" else (PressureCommand, "regulators")
    command, state = (TOPICS[names[rig.drive]].relative for names in (COMMAND_TOPICS, STATE_TOPICS))
    return Topics(message, command, state, frame_id)


def drive_of(rig: Rig, values: Mapping[str, Any]) -> Drive:
    """Limits of the commands of a rig. `values`: the node's parameters by name, including ``SAFETY``."""
    topics = topics_of(rig)
    low, high = rig.command_limits
    if rig.drive == "valve":
        limits = VoltageLimits(low, high)
        action = safe_action(
            values["safe_action"], limits, values["safe_voltage"], values["vent_voltage"], values["vent_rate"]
        )
        return Drive(topics, limits, action, values.get("max_slew", 0.0), _ASTRAY_VOLTAGE)
    limits = VoltageLimits(low, high, "Pa")
    hold = tuple(value or 0.5 * (low + high) for value in values["safe_pressure"])
    vent = tuple(value or low for value in values["vent_pressure"])
    action = safe_action(values["safe_action"], limits, hold, vent, values["vent_pressure_rate"])
    return Drive(topics, limits, action, values.get("max_pressure_slew", 0.0), _ASTRAY_PRESSURE)


_SUPPLY_MARGIN = 1.1  # valves cannot exceed the supply pressure; a fast motion may compress the air by a tenth


class ValvePort:
    """Takes commands, determines the voltages of the valves, and stops them.

    The port offers the services ``~/stop`` and ``~/clear_stop``; the latter fails while the cause of a stop is present.

    Args:
        node: owner of the valves, with the parameters ``VALVE_OWNER`` in ``values``.
        noisy: whether the pressures have the rig's noise; without noise they may be constant.
        linked: whether the controller is in the same process and calls :meth:`command`; others are then ignored.

    Attributes:
        drive: limits of the commands: voltages of valves, or pressures of regulators.
    """

    def __init__(self, node: PamNode, rig: Rig, *, noisy: bool = True, linked: bool = False) -> None:
        values = node.values
        self.drive = drive_of(rig, values)
        self.guard = ValveGuard(self.drive.limits, self.drive.action, self.drive.slew, values["command_timeout"])
        first, second = (limit or _SUPPLY_MARGIN * rig.supply.pressure for limit in values["max_pressure"])
        frozen: float | None = values["frozen_time"] or None
        if frozen is None and noisy:
            frozen = frozen_time(rig.sensors.pressure_std, rig.sensors.pressure_step, rig.sample_period)
        self.supervision = PressureSupervision(
            (first, second), values["over_pressure_time"], values["missing_time"], frozen, rig.sample_period
        )
        self._frozen = frozen
        self._max_age = round(values["max_command_age"] * 1e9)
        self._node = node
        self._topic = self.drive.topics.command
        self._unpack = wire.Incoming(wire.VALVES)
        self._linked = linked
        self._subscription: Subscription | None = None
        self._holder: str | None = None  # identifier of the publisher that is obeyed, where that is certain
        self._rate = Rate()
        self._without = self._samples = 0
        self._refused_before = self._late_before = 0
        node.create_service(Trigger, "~/clear_stop", self._on_clear)
        node.create_service(Trigger, "~/stop", self._on_stop)

    def listen(self) -> None:
        """Take commands from now on. The subscription ends with the node's transition."""
        if not self._linked:
            self._subscription = self._node.collect(self.drive.topics.message, self._topic, qos.COMMAND)
        self.guard.set_active(True)

    def rest(self) -> None:
        """Take no more commands; the valves get the safe voltages."""
        self._subscription = None
        self.guard.set_active(False)

    def poll(self, now_ns: int) -> None:
        """Take the commands that have come.

        Args:
            now_ns: time on the same clock as for :meth:`output` [ns].
        """
        if self._subscription is None:
            return
        for data, info in take(self._subscription):
            self.accept(data, now_ns, number_of(info), self._subscription.get_publisher_count())

    def accept(self, data: bytes, now_ns: int, sequence: int | None = None, publishers: int = 1) -> Verdict:
        """Take one command, serialised; see :meth:`ValveGuard.command`.

        Args:
            now_ns: time of reception on the steady clock [ns].
            sequence: the message's number at its publisher, None where the middleware gives none.
        """
        stamp_ns, first, second = self._unpack(data)
        was_stopped, refused = self.guard.stopped, self.guard.authority.refused
        late = stamp_ns > 0 and self._node.now_ns() - stamp_ns > self._max_age
        verdict = self.guard.command((first, second), now_ns, sequence, publishers, late)
        if verdict is Verdict.LISTENING:
            self._holder = None
        elif verdict is Verdict.UNCLEAR and not was_stopped:
            self._node.get_logger().error(f"stopped: {self._conflict()}")
        elif verdict is Verdict.REFUSED and refused == self._refused_before:
            self._node.get_logger().error(self._conflict())
        return verdict

    def command(self, stamp_ns: int, voltage: tuple[float, float], now_ns: int) -> None:
        """Take a command of the controller in the same process.

        Args:
            stamp_ns: of the command's sample [ns].
            voltage: command (2,) [V].
            now_ns: time on the same clock as for :meth:`output` [ns].
        """
        self.guard.command(voltage, now_ns, late=stamp_ns > 0 and now_ns - stamp_ns > self._max_age)

    def output(self, now_ns: int) -> Decision:
        """Voltages of the valves over the sample that ends now [ns]."""
        decision = self.guard.output(now_ns)
        self._samples += 1
        self._without += decision.state.safe
        return decision

    def supervise(self, stamp_ns: int, pressure_1: float, pressure_2: float) -> None:
        """Stop the valves if the measured pressures of a sample require it.

        Args:
            stamp_ns: of the sample [ns].
            pressure_1: absolute, NaN where missing [Pa].
        """
        reason = self.supervision.check(stamp_ns, pressure_1, pressure_2)
        if reason:
            self.stop(reason)

    def stop(self, reason: str) -> None:
        """Stop the valves for a reason in words, until the stop is cleared."""
        if self.guard.stop(reason):
            self._node.get_logger().error(f"stopped: {reason}")

    def _on_stop(self, _request: Any, response: Any) -> Any:
        """Stop on request."""
        before = self.guard.stopped
        self.stop("on request")
        response.success, response.message = True, f"was stopped: {before}" if before else "stopped"
        return response

    def _on_clear(self, _request: Any, response: Any) -> Any:
        if not self.guard.stopped:
            response.success, response.message = True, "there is no stop to clear"
        elif self.supervision.present:
            response.success, response.message = (
                False,
                f"not cleared, since the cause is still present: {self.supervision.present}",
            )
        else:
            response.success, response.message = True, f"cleared: {self.guard.clear()}"
            self.supervision.reset()
            self._node.get_logger().warning(response.message)
        return response

    def _commanders(self) -> dict[str, str]:
        """Identifier -> node of each publisher of commands."""
        found = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(self._topic))
        return {
            bytes(info.endpoint_gid).hex(): f"{info.node_namespace}/{info.node_name}".replace("//", "/")
            for info in found
        }

    def _conflict(self) -> str:
        commanders = self._commanders()
        others = sorted(name for gid, name in commanders.items() if gid != self._holder)
        if self._holder in commanders and others:
            return f"{commanders[self._holder]} is obeyed, refused: {', '.join(others)}"
        return f"several commanders: {', '.join(sorted(commanders.values()))}"

    def health(self, steady_ns: int) -> Mapping[str, Health]:
        """Parts ``commands`` and ``safety``; called every ``diagnostics_period`` with the steady time [ns]."""
        counts, authority = self.guard.counts, self.guard.authority
        commanders = self._commanders()
        refused, self._refused_before = authority.refused - self._refused_before, authority.refused
        if len(commanders) == 1:
            (self._holder,) = commanders
        without, self._without = self._without, 0
        late, self._late_before = counts.late - self._late_before, counts.late
        level = Level.OK if not without else Level.WARN
        message = "obeyed" if not without else f"safe voltages for {without} samples: no command in time"
        if late:
            level, message = Level.WARN, f"{message}; {late} came too late"
        if refused:
            level, message = Level.ERROR, f"{refused} commands refused: {self._conflict()}"
        if self._linked and len(commanders) > 1:
            names = ", ".join(sorted(commanders.values()))
            level, message = Level.ERROR, f"the controller of this process alone is obeyed; commands come from {names}"
        commands = Health(
            level,
            message,
            {
                "rate [Hz]": f"{self._rate.take(counts.commands, steady_ns):.1f}",
                "samples at safe voltages": without,
                "refused, not finite": counts.not_finite,
                "refused, too late": counts.late,
                "refused, second commander": authority.refused,
                "clamped": counts.clamped,
                "samples slew-limited": counts.slewed,
                "commanders": len(commanders),
                "publishers": ", ".join(sorted(commanders.values())),
            },
        )
        return {"commands": commands, "safety": self._safety()}

    def _safety(self) -> Health:
        values = {
            "stopped": self.guard.stopped or "no",
            "cause is there": self.supervision.present or "no",
            "frozen sensor [s]": "not watched" if self._frozen is None else f"{self._frozen:g}",
        }
        if self.guard.stopped:
            return Health(Level.ERROR, f"stopped: {self.guard.stopped}; clear_stop clears it", values)
        return Health(Level.OK, "nothing to stop for", values)
