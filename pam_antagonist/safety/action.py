"""Voltages of the valves while there is no valid command."""

from __future__ import annotations

from dataclasses import dataclass

from pam_antagonist.control import VoltageLimits
from pam_antagonist.errors import BadInput

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
        """The safe voltages (2,) [V] at a time after the safe action began.

        Args:
            elapsed_ns: time since then [ns].
        """
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
    """The action that a node's parameters describe.

    Args:
        choice: parameter ``safe_action``, one of :data:`ACTIONS`.
        limits: of the valves.
        hold: parameter ``safe_voltage`` (2,) [V], or ``safe_pressure`` [Pa].
        vent: parameter ``vent_voltage`` (2,) [V], or ``vent_pressure`` [Pa].
        rate: parameter ``vent_rate`` [V/s], or ``vent_pressure_rate`` [Pa/s].

    Raises:
        BadInput: an unknown action, or voltages beyond the valves' limits.
    """
    if choice not in ACTIONS:
        raise BadInput(f"parameter safe_action is {choice!r}: expected one of {', '.join(ACTIONS)}")
    first, second = hold
    at_once = limits.check(f"parameter safe_{limits.quantity}:", (first, second))
    first, second = vent
    in_the_end = limits.check(f"parameter vent_{limits.quantity}:", (first, second))
    return SafeAction(at_once, in_the_end if choice == "vent" else None, rate)
