"""What may reach the valves: the one gate between commands and hardware.

Every sample, whoever owns the valves asks :meth:`ValveGuard.output` and puts on them what it says. Use one clock for
all times, best the steady one: with a clock that can be set, a guard that is set back starts its time-out anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from pam_antagonist.control import VoltageLimits
from pam_antagonist.errors import BadInput
from pam_antagonist.safety.action import SafeAction
from pam_antagonist.safety.authority import Authority, Verdict

_SAME = 1e-9  # rounding [V]

_HOLD = 5.0
"""For so many time-outs a silent commander keeps its right. The valves are safe meanwhile; a controller whose estimates
stay away for the time-out says nothing for a little longer than that, and must not lose the joint to somebody else."""


class State(Enum):
    """What the guard does."""

    OBEYING = "obeys the commander"
    WAITING = "safe voltages: no command yet"
    SILENT = "safe voltages: no command in time"
    STOPPED = "safe voltages: stopped"
    INACTIVE = "safe voltages: not active"

    @property
    def safe(self) -> bool:
        """Whether the valves get what the safe action says."""
        return self is not State.OBEYING


class Decision(NamedTuple):
    """What the valves get now, and why.

    Attributes:
        voltage: (2,) [V].
        state: of the guard.
        reason: why the guard has stopped the valves, else empty.
    """

    voltage: tuple[float, float]
    state: State
    reason: str


@dataclass
class GuardCounts:
    """What became of the commands so far.

    Attributes:
        commands: accepted.
        not_finite: left out, as if they had not come.
        late: left out likewise, since they are too old.
        clamped: of the accepted, beyond the valves' limits.
        slewed: outputs that could not follow the command within one sample.
        safe: outputs of the safe action.
    """

    commands: int = 0
    not_finite: int = 0
    late: int = 0
    clamped: int = 0
    slewed: int = 0
    safe: int = 0


class ValveGuard:
    """Lets commands of one commander through: clamped, slew-limited, and only as long as they keep coming.

    In every other case the valves get the safe action's voltages, counted from the moment at which that began. They
    are not slew-limited: the limit is there against commands that make no sense, and a stop has to be quick. A command
    after that starts from the safe voltages, slew-limited.

    :meth:`stop` latches: nothing but :meth:`clear` ends it. Everything else ends by itself with the next command.

    Pressure regulators are guarded in the same way, with the pressures [Pa] that they are asked for as the voltages.

    Args:
        limits: of the valves [V].
        action: what is safe.
        max_slew: largest change of each voltage while commands are obeyed [V/s].
        timeout: time without a command after which the safe action begins [s].

    Raises:
        BadInput: a slew or a time-out that is not above 0.

    Example:
        >>> guard = ValveGuard(VoltageLimits(), SafeAction((5.5, 5.5)), max_slew=2000.0, timeout=0.02)
        >>> guard.command((6.0, 5.0), 1_000_000)
        <Verdict.ACCEPTED: 'accepted'>
        >>> guard.output(1_500_000).voltage
        (6.0, 5.0)
        >>> guard.output(30_000_000)
        Decision(voltage=(5.5, 5.5), state=<State.SILENT: 'safe voltages: no command in time'>, reason='')
    """

    def __init__(self, limits: VoltageLimits, action: SafeAction, max_slew: float, timeout: float) -> None:
        for name, value in (("slew", max_slew), ("command time-out", timeout)):
            if not (math.isfinite(value) and value > 0.0):
                raise BadInput(f"{name} {value!r}: expected a finite number above 0")
        self.counts = GuardCounts()
        self.authority = Authority(_HOLD * timeout)
        self._limits = limits
        self._action = action
        self._slew = max_slew * 1e-9  # [V/ns]
        self._timeout = round(timeout * 1e9)
        self._command: tuple[float, float] | None = None
        self._heard_ns = 0
        self._heard = False
        self._active = True
        self._reason = ""
        self._last: tuple[float, float] = action.hold
        self._last_ns: int | None = None
        self._safe_since_ns: int | None = None

    @property
    def stopped(self) -> str:
        """Why it is stopped; empty if it is not."""
        return self._reason

    def stop(self, reason: str) -> bool:
        """Give the valves the safe voltages from the next output on, until :meth:`clear`.

        Args:
            reason: in words; of several stops the first one's reason stays, since the others may follow from it.

        Returns:
            Whether this is a new stop.
        """
        self._command = None
        if self._reason:
            return False
        self._reason = reason
        return True

    def clear(self) -> str:
        """Obey again, whoever is heard first from now on.

        Returns:
            The reason of the stop that was cleared; empty where there was none.
        """
        reason, self._reason = self._reason, ""
        self.authority.release()
        self._command, self._heard = None, False
        return reason

    def set_active(self, active: bool) -> None:
        """Take commands or not; a guard that is not active gives the safe voltages. A stop stays a stop."""
        if active != self._active:
            self._active = active
            self._command, self._heard = None, False
            self.authority.release()

    def command(
        self,
        voltage: tuple[float, float],
        now_ns: int,
        sequence: int | None = None,
        publishers: int = 1,
        late: bool = False,
    ) -> Verdict:
        """Take a command.

        Args:
            voltage: asked for (2,) [V], any numbers.
            now_ns: when it came [ns].
            sequence: the number that its publisher gave to it, see :class:`Authority`.
            publishers: how many publishers there are.
            late: whether it is too old: commands that lay somewhere on the way keep coming, and feed no watchdog.

        Returns:
            What became of it; ``UNCLEAR`` has stopped the guard. ``ACCEPTED`` does not mean obeyed: while the guard is
            stopped or not active, it is not.
        """
        verdict = self.authority.admit(sequence, publishers, now_ns)
        if verdict is Verdict.UNCLEAR:
            self.stop(verdict.value)
        if verdict is not Verdict.ACCEPTED:
            return verdict
        if not (math.isfinite(voltage[0]) and math.isfinite(voltage[1])):
            self.counts.not_finite += 1  # as if it had not come: the time-out takes care
            return verdict
        if late:
            self.counts.late += 1
            return verdict
        self.counts.commands += 1
        self._heard, self._heard_ns = True, now_ns
        if self._reason or not self._active:
            return verdict
        self._command = (self._limits.clip(voltage[0]), self._limits.clip(voltage[1]))
        if self._command != voltage:
            self.counts.clamped += 1
        return verdict

    def output(self, now_ns: int) -> Decision:
        """What the valves get now.

        Args:
            now_ns: [ns]; calls come in the order of time, once a sample.
        """
        if now_ns < self._heard_ns:
            self._heard_ns = min(self._heard_ns, now_ns + self._timeout)
        before_ns, self._last_ns = self._last_ns, now_ns
        state = self._state(now_ns)
        if state.safe:
            if self._safe_since_ns is None or now_ns < self._safe_since_ns:
                self._safe_since_ns = now_ns
            self._last = self._action.voltage(now_ns - self._safe_since_ns)
            self.counts.safe += 1
            return Decision(self._last, state, self._reason)
        self._safe_since_ns = None
        assert self._command is not None
        if self._command != self._last:
            # The first output has nothing before it but the voltages that valves at rest have.
            largest = self._slew * max(0, now_ns - before_ns) if before_ns is not None else math.inf
            self._last = (
                self._last[0] + min(max(self._command[0] - self._last[0], -largest), largest),
                self._last[1] + min(max(self._command[1] - self._last[1], -largest), largest),
            )
            if abs(self._command[0] - self._last[0]) < _SAME and abs(self._command[1] - self._last[1]) < _SAME:
                self._last = self._command
            else:
                self.counts.slewed += 1
        return Decision(self._last, state, "")

    def _state(self, now_ns: int) -> State:
        if self._reason:
            return State.STOPPED
        if not self._active:
            return State.INACTIVE
        if self._command is None:
            return State.SILENT if self._heard else State.WAITING
        return State.OBEYING if now_ns - self._heard_ns <= self._timeout else State.SILENT
