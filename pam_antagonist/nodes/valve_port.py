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
these are two threads, all calls need the port's lock; the services and :meth:`ValvePort.stop` take it by themselves.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from std_srvs.srv import Trigger

from pam_antagonist.control.command import VoltageLimits
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos, wire
from pam_antagonist.nodes.health import Health, Level, Rate, Rises, full_name, judged
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.wire import number_of, take
from pam_antagonist.recording.topics import COMMAND_TOPICS, TOPICS
from pam_antagonist.rig import Rig
from pam_antagonist.safety import PressureSupervision, SafeAction, ValveGuard
from pam_antagonist.safety.guard import Decision, Ruling, safe_action
from pam_antagonist.safety.supervision import frozen_time

if TYPE_CHECKING:
    from rclpy.subscription import Subscription

_ASTRAY_VOLTAGE, _ASTRAY_PRESSURE = 0.25, 25e3
"""[V], [Pa] Largest normal difference between command and output; commands of consecutive samples differ by less."""
_SUPPLY_MARGIN = 1.1  # valves cannot exceed the supply pressure; a fast motion may compress the air by a tenth


class Drive(NamedTuple):
    """Limits of the commands, in V for valves or Pa for regulators."""

    limits: VoltageLimits
    action: SafeAction
    slew: float  # largest change of each command [V/s] or [Pa/s]
    astray: float  # largest normal difference between command and output [V] or [Pa]


def drive_of(rig: Rig, values: Mapping[str, Any]) -> Drive:
    """Limits of the commands of a rig. `values`: the node's parameters by name, including ``SAFETY``."""
    low, high = rig.command_limits
    if rig.drive == "valve":
        limits, hold, vent = VoltageLimits(low, high), values["safe_voltage"], values["vent_voltage"]
        action = safe_action(values["safe_action"], limits, hold, vent, values["vent_rate"])
        return Drive(limits, action, values.get("max_slew", 0.0), _ASTRAY_VOLTAGE)
    limits = VoltageLimits(low, high, "Pa")
    hold = tuple(value or 0.5 * (low + high) for value in values["safe_pressure"])
    vent = tuple(value or low for value in values["vent_pressure"])
    action = safe_action(values["safe_action"], limits, hold, vent, values["vent_pressure_rate"])
    return Drive(limits, action, values.get("max_pressure_slew", 0.0), _ASTRAY_PRESSURE)


class ValvePort:
    """Takes commands, determines the voltages of the valves, and stops them.

    The port offers the services ``~/stop`` and ``~/clear_stop``; the latter fails while the cause of a stop is present.

    Args:
        node: owner of the valves, with the parameters ``VALVE_OWNER`` in ``values``. If it is linked, the controller is
            in the same process and calls :meth:`command`; others are then ignored.
        noisy: whether the pressures have the rig's noise; without noise they may be constant.

    Attributes:
        drive: limits of the commands: voltages of valves, or pressures of regulators.
        lock: for calls from a second thread.
    """

    def __init__(self, node: PamNode, rig: Rig, *, noisy: bool = True) -> None:
        values = node.values
        self.lock = threading.RLock()
        self.drive = drive_of(rig, values)
        self.guard = ValveGuard(self.drive.limits, self.drive.action, self.drive.slew, values["command_timeout"])
        first, second = (limit or _SUPPLY_MARGIN * rig.supply.pressure for limit in values["max_pressure"])
        frozen: float | None = values["frozen_time"] or None
        if frozen is None and noisy:
            frozen = frozen_time(rig.sensors.pressure_std, rig.sensors.pressure_step, rig.sample_period)
        self.supervision = PressureSupervision(
            (first, second), values["over_pressure_time"], values["missing_time"], frozen, rig.sample_period
        )
        self._frozen = "not watched" if frozen is None else f"{frozen:g}"
        self._max_age = round(values["max_command_age"] * 1e9)
        self._node = node
        topic = COMMAND_TOPICS[rig.drive]
        self._kind, self._topic = wire.message_class(topic), TOPICS[topic].relative
        self._unpack = wire.Incoming(wire.VALVES)
        self._subscription: Subscription | None = None
        self._holder: str | None = None  # identifier of the publisher that is obeyed, where that is certain
        self._rate, self._rises = Rate(), Rises()
        self._without = 0
        self._refused_before = 0
        node.serve(Trigger, "~/clear_stop", self._clear)
        node.serve(Trigger, "~/stop", self._stop)

    def listen(self) -> None:
        """Take commands from now on. The subscription ends with the node's transition."""
        if not self._node.linked:
            self._subscription = self._node.collect(self._kind, self._topic, qos.COMMAND)
        self.guard.set_active(True)

    def rest(self) -> None:
        """Take no more commands; the valves get the safe voltages."""
        self._subscription = None
        self.guard.set_active(False)

    def poll(self, now_ns: int) -> None:
        """Take the commands that have come. `now_ns`: time on the same clock as for :meth:`output` [ns]."""
        if self._subscription is None:
            return
        for data, info in take(self._subscription):
            self.accept(data, now_ns, number_of(info), self._subscription.get_publisher_count())

    def accept(self, data: bytes, now_ns: int, sequence: int | None = None, publishers: int = 1) -> Ruling:
        """Take one command, serialised; see :meth:`ValveGuard.command`."""
        stamp_ns, first, second = self._unpack(data)
        was_stopped, refused = self.guard.stopped, self.guard.authority.refused
        late = stamp_ns > 0 and self._node.ages.of(stamp_ns) > self._max_age
        verdict = self.guard.command((first, second), now_ns, sequence, publishers, late)
        if verdict is Ruling.LISTENING:
            self._holder = None
        elif verdict is Ruling.UNCLEAR and not was_stopped:
            self._node.get_logger().error(f"stopped: {self._conflict()}")
        elif verdict is Ruling.REFUSED and refused == self._refused_before:
            self._node.get_logger().error(self._conflict())
        return verdict

    def command(self, stamp_ns: int, voltage: tuple[float, float], now_ns: int) -> None:
        """Take a command of the controller in the same process. `stamp_ns`: of the command's sample [ns]."""
        self.guard.command(voltage, now_ns, late=stamp_ns > 0 and now_ns - stamp_ns > self._max_age)

    def output(self, now_ns: int) -> Decision:
        """Voltages of the valves over the sample that ends now [ns]."""
        decision = self.guard.output(now_ns)
        self._without += decision.state.safe
        return decision

    def supervise(self, stamp_ns: int, pressure_1: float, pressure_2: float) -> None:
        """Stop the valves if the measured pressures of a sample require it; absolute [Pa], NaN where missing."""
        reason = self.supervision.check(stamp_ns, pressure_1, pressure_2)
        if reason:
            self.stop(reason)

    def stop(self, reason: str) -> None:
        """Stop the valves for a reason in words, until the stop is cleared."""
        with self.lock:
            if self.guard.stop(reason):
                self._node.get_logger().error(f"stopped: {reason}")

    def _stop(self, _request: Any) -> str:
        before = self.guard.stopped
        self.stop("on request")
        return f"was stopped: {before}" if before else "stopped"

    def _clear(self, _request: Any) -> str:
        with self.lock:
            if not self.guard.stopped:
                return "there is no stop to clear"
            if self.supervision.present:
                raise BadInput(f"not cleared, since the cause is still present: {self.supervision.present}")
            words = f"cleared: {self.guard.clear()}"
            self.supervision.reset()
            self._node.get_logger().warning(words)
            return words

    def _commanders(self) -> dict[str, str]:
        """Identifier -> node of each publisher of commands."""
        found = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(self._topic))
        return {bytes(info.endpoint_gid).hex(): full_name(info.node_namespace, info.node_name) for info in found}

    def _conflict(self) -> str:
        commanders = self._commanders()
        others = sorted(name for gid, name in commanders.items() if gid != self._holder)
        if self._holder in commanders and others:
            return f"{commanders[self._holder]} is obeyed, refused: {', '.join(others)}"
        return f"several commanders: {', '.join(sorted(commanders.values()))}"

    def health(self, steady_ns: int) -> Mapping[str, Health]:
        """Parts ``commands`` and ``safety``; called every ``diagnostics_period`` with the steady time [ns]."""
        counts, self._refused_before = self.guard.counts, self.guard.authority.refused
        commanders = self._commanders()
        names = ", ".join(sorted(commanders.values()))
        rises = self._rises.take(refused=self._refused_before, late=counts.late)
        if len(commanders) == 1:
            (self._holder,) = commanders
        without, self._without = self._without, 0
        given = f"safe voltages for {without} samples: no command in time" if without else "obeyed"
        values = {
            "rate [Hz]": f"{self._rate.take(counts.commands, steady_ns):.1f}",
            "samples at safe voltages": without,
            "refused, not finite": counts.not_finite,
            "refused, too late": counts.late,
            "refused, second commander": self._refused_before,
            "clamped": counts.clamped,
            "samples slew-limited": counts.slewed,
            "commanders": len(commanders),
            "publishers": names,
        }
        commands = judged(
            values,
            given,
            (
                self._node.linked and len(commanders) > 1,
                Level.ERROR,
                f"the controller of this process alone is obeyed; commands come from {names}",
            ),
            (rises["refused"], Level.ERROR, f"{rises['refused']} commands refused: {self._conflict()}"),
            (rises["late"], Level.WARN, f"{given}; {rises['late']} came too late"),
            (without, Level.WARN, given),
        )
        stopped = self.guard.stopped
        values = {
            "stopped": stopped or "no",
            "cause is there": self.supervision.present or "no",
            "frozen sensor [s]": self._frozen,
        }
        cleared = (stopped, Level.ERROR, f"stopped: {stopped}; clear_stop clears it")
        return {"commands": commands, "safety": judged(values, "nothing to stop for", cleared)}
