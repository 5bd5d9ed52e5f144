"""Guard of the valves: the only way from commands to hardware, for one publisher at a time.

The node that owns the valves calls :meth:`ValveGuard.output` once a sample and applies the result. Use one clock for
all times, preferably the steady one: when an adjustable clock is set back, the time-out starts anew.

In ROS 2 a subscriber gets neither the name nor the identifier of a message's publisher, only the message's number
(``publication_sequence_number``). Every publisher counts its own messages, so messages with consecutive numbers come
from one publisher. This is enough to distinguish two publishers.

The rule for valves is the stricter one. References are limited and slewed later, and many are sent only once. So the
first publisher is obeyed at once, and silence frees the joint for others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from pam_antagonist.control.command import VoltageLimits
from pam_antagonist.errors import BadInput

LONGEST_STEP = 100
"""Largest difference between the numbers of two consecutive messages of one publisher. A commander sends one command a
sample, at 1 kHz 20 within the time-out; the limit allows bursts of five times as many. Two publishers whose numbers are
closer than this cannot be distinguished."""


class Ruling(Enum):
    """Decision about a command."""

    ACCEPTED = "accepted"
    LISTENING = "its publisher has not been the only one for long enough"
    REFUSED = "from a second commander"
    UNCLEAR = "two commanders, and nothing says which of them is the right one"


class Authority:
    """Admits the commands of one publisher and refuses those of any other.

    The first publisher holds the valves until it is silent for ``timeout``. Then another one may take over, so that a
    restarted controller is obeyed. While the topic has several publishers (a killed one is still counted for some
    seconds), a new one must first be heard alone for ``timeout``. A publisher that was refused does not take over when
    the first one fails. If two publishers are heard and none holds the valves, the verdict is ``UNCLEAR``, and the
    valves should stop.

    Args:
        timeout: silence after which the valves are free [s].

    Attributes:
        refused: number of refused commands so far.
    """

    def __init__(self, timeout: float) -> None:
        self.refused = 0
        self._timeout = round(timeout * 1e9)
        self.release()

    def release(self) -> None:
        """Free the valves, and forget refused publishers."""
        self._last: int | None = None  # number of the last message of the publisher that holds the valves, or may soon
        self._heard_ns = self._since_ns = 0
        self._holds = False
        self._rival_ns: int | None = None

    def admit(self, sequence: int | None, publishers: int, now_ns: int) -> Ruling:
        """Judge one command.

        Args:
            sequence: the message's number at its publisher; None where the middleware gives none. Without numbers, more
                than one publisher on the topic is ``UNCLEAR``.
            publishers: number of publishers on the topic now (``subscription.get_publisher_count()``).
            now_ns: time of one clock throughout [ns].
        """
        if publishers <= 1:
            self._rival_ns = None  # any other publisher is gone
            self._holds = True
            return self._follow(sequence, now_ns)
        if sequence is None:
            return Ruling.UNCLEAR
        step = None if self._last is None else sequence - self._last
        if step is not None and 0 < step <= LONGEST_STEP:
            return self._follow(sequence, now_ns)
        if step is None or not 0 <= now_ns - self._heard_ns <= self._timeout:  # silent, or the clock was set back
            if self._rival_ns is not None and self._rival_ns >= self._heard_ns - self._timeout:
                return Ruling.UNCLEAR  # a publisher was refused until the holder fell silent
            self._holds, self._since_ns = False, now_ns
            return self._follow(sequence, now_ns)
        if not self._holds or -LONGEST_STEP <= step <= 0:  # no publisher gives a number twice
            return Ruling.UNCLEAR
        self.refused += 1
        self._rival_ns = now_ns
        return Ruling.REFUSED

    def _follow(self, sequence: int | None, now_ns: int) -> Ruling:
        self._last, self._heard_ns = sequence, now_ns
        self._holds = self._holds or now_ns - self._since_ns > self._timeout
        return Ruling.ACCEPTED if self._holds else Ruling.LISTENING


_SILENCE_NS = 1_000_000_000  # of the owner of references


class ReferenceOwner:
    """Admits the references of one publisher, and refuses those of others while the first one is heard.

    Two publishers whose numbers are close by chance cannot be distinguished. After a second of silence another one may
    take over.

    Attributes:
        refused: number of refused references so far.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._last: int | None = None
        self._heard_ns = 0

    def admit(self, sequence: int | None, publishers: int, now_ns: int) -> bool:
        """Judge one reference.

        Args:
            sequence: the message's number at its publisher; None where the middleware gives none: then all are
                admitted.
            publishers: number of publishers on the topic now.
            now_ns: steady time [ns].
        """
        if publishers > 1 and self._last is not None and 0 <= now_ns - self._heard_ns <= _SILENCE_NS:
            if sequence is not None and not 0 < sequence - self._last <= LONGEST_STEP:
                self.refused += 1
                return False
        self._last, self._heard_ns = sequence, now_ns
        return True


ACTIONS = ("hold", "vent")
"""The choices of parameter ``safe_action``."""


@dataclass(frozen=True)
class SafeAction:
    """The safe voltages, constant or venting.

    Action ``hold``: both valves get ``hold`` at once and keep it. At this voltage a valve roughly keeps the pressure of
    its muscle, so the joint stays stiff and holds a load. Action ``vent``: the valves get ``hold`` at once and then go
    to ``vent`` together at ``rate``, so slowly that the joint becomes soft without a jerk to one side.

    Attributes:
        hold: voltages (2,) at once [V]; for pressure regulators the commanded pressures [Pa], here and below.
        vent: voltages (2,) at the end [V]; None: those of ``hold``.
        rate: largest change of each voltage on the way from ``hold`` to ``vent`` [V/s].
    """

    hold: tuple[float, float]
    vent: tuple[float, float] | None = None
    rate: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < self.rate < float("inf"):
            raise BadInput(f"vent rate {self.rate!r}: expected a finite number above 0")

    def voltage(self, elapsed_ns: int) -> tuple[float, float]:
        """The safe voltages (2,) [V], `elapsed_ns` [ns] after the safe action began."""
        if self.vent is None:
            return self.hold
        largest = self.rate * max(elapsed_ns, 0) * 1e-9
        first, second = (
            start + min(max(end - start, -largest), largest) for start, end in zip(self.hold, self.vent, strict=True)
        )
        return (first, second)


def safe_action(
    choice: str, limits: VoltageLimits, hold: tuple[float, ...], vent: tuple[float, ...], rate: float
) -> SafeAction:
    """The action that a node's parameters describe: ``safe_action``, ``safe_voltage``, ``vent_voltage``, ``vent_rate``.

    For pressure regulators they are ``safe_pressure``, ``vent_pressure`` and ``vent_pressure_rate``.
    """
    if choice not in ACTIONS:
        raise BadInput(f"parameter safe_action is {choice!r}: expected one of {', '.join(ACTIONS)}")
    first, second = hold
    at_once = limits.check(f"parameter safe_{limits.quantity}:", (first, second))
    first, second = vent
    in_the_end = limits.check(f"parameter vent_{limits.quantity}:", (first, second))
    return SafeAction(at_once, in_the_end if choice == "vent" else None, rate)


_SAME = 1e-9  # rounding [V]

_HOLD = 5.0
"""Number of time-outs for which a silent commander stays the commander; the valves are safe meanwhile. A controller
without estimates is silent for a little longer than the time-out, and must not lose the joint to another one."""


class State(Enum):
    """State of the guard."""

    OBEYING = "obeys the commander"
    WAITING = "safe voltages: no command yet"
    SILENT = "safe voltages: no command in time"
    STOPPED = "safe voltages: stopped"
    INACTIVE = "safe voltages: not active"

    @property
    def safe(self) -> bool:
        """Whether the valves get the safe action's voltages."""
        return self is not State.OBEYING


class Decision(NamedTuple):
    """Voltages of the valves now, and the reason."""

    voltage: tuple[float, float]  # (2,) [V]
    state: State  # of the guard
    reason: str  # of a stop, else empty


@dataclass
class GuardCounts:
    """Numbers of commands and outputs so far."""

    commands: int = 0  # accepted commands
    not_finite: int = 0  # commands that were ignored because they were not finite
    late: int = 0  # commands that were ignored because they were too old
    clamped: int = 0  # accepted commands beyond the valves' limits
    slewed: int = 0  # outputs that could not reach the command within one sample


class ValveGuard:
    """Lets the commands of one commander through: clamped, slew-limited, and only while they keep coming.

    Otherwise the valves get the safe action's voltages. These are not slew-limited: the limit protects against wrong
    commands, and a stop has to be quick. A later command starts from the safe voltages, slew-limited.

    :meth:`stop` latches until :meth:`clear`. All other safe states end with the next command.

    Pressure regulators are guarded in the same way, with commanded pressures [Pa] in place of voltages.

    Args:
        limits: of the valves [V].
        action: the safe action.
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
        """Reason of the stop; empty if the guard is not stopped."""
        return self._reason

    def stop(self, reason: str) -> bool:
        """Give the valves the safe voltages from the next output on, until :meth:`clear`; whether this is a new stop.

        The first `reason`, in words, is kept, since later ones may be consequences.
        """
        self._command = None
        if self._reason:
            return False
        self._reason = reason
        return True

    def clear(self) -> str:
        """End a stop, and give its reason, empty for none; the first publisher from now on is obeyed."""
        reason, self._reason = self._reason, ""
        self.authority.release()
        self._command, self._heard = None, False
        return reason

    def set_active(self, active: bool) -> None:
        """Accept commands or not; an inactive guard gives the safe voltages. A stop is not ended."""
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
    ) -> Ruling:
        """Take a command.

        Args:
            voltage: command (2,) [V], any numbers.
            now_ns: time of reception [ns].
            sequence: the message's number at its publisher, see :class:`Authority`.
            publishers: number of publishers.
            late: whether the command is too old; it is then ignored and does not reset the time-out.

        Returns:
            The decision; ``UNCLEAR`` has stopped the guard. An ``ACCEPTED`` command is not obeyed while the guard is
            stopped or inactive.
        """
        verdict = self.authority.admit(sequence, publishers, now_ns)
        if verdict is Ruling.UNCLEAR:
            self.stop(verdict.value)
        if verdict is not Ruling.ACCEPTED:
            return verdict
        if not (math.isfinite(voltage[0]) and math.isfinite(voltage[1])):
            self.counts.not_finite += 1  # ignored, so that the time-out acts
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
        """Voltages of the valves at a time [ns]; call once a sample, in the order of time."""
        if now_ns < self._heard_ns:
            self._heard_ns = min(self._heard_ns, now_ns + self._timeout)
        before_ns, self._last_ns = self._last_ns, now_ns
        state = self._state(now_ns)
        if state.safe:
            if self._safe_since_ns is None or now_ns < self._safe_since_ns:
                self._safe_since_ns = now_ns
            self._last = self._action.voltage(now_ns - self._safe_since_ns)
            return Decision(self._last, state, self._reason)
        self._safe_since_ns = None
        assert self._command is not None
        if self._command != self._last:
            # The first output is not slew-limited, because there is no output before it.
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
