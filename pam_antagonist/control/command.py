"""The common part of all control laws: modes, voltages and their limits, safe voltages, and bumpless starts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple

from pam_antagonist.errors import BadInput


class Mode(IntEnum):
    """What is controlled; the values are those of ``JointReference``."""

    ANGLE = 0
    TORQUE = 1
    ANGLE_STIFFNESS = 2
    TORQUE_STIFFNESS = 3
    IMPEDANCE = 4

    @property
    def quantity(self) -> Mode:
        """Quantity of the reference's value: ``Mode.TORQUE`` [N m] or ``Mode.ANGLE`` [rad]."""
        return Mode.TORQUE if self in (Mode.TORQUE, Mode.TORQUE_STIFFNESS) else Mode.ANGLE

    @property
    def unit(self) -> str:
        """Unit of the reference's value."""
        return "N m" if self.quantity is Mode.TORQUE else "rad"

    @property
    def has_stiffness(self) -> bool:
        """Whether the reference has a stiffness, which only the law through the model can follow."""
        return self not in PI_MODES


PI_MODES = (Mode.ANGLE, Mode.TORQUE)
"""The modes of the paper, and of the PI controller."""


class Status(Enum):
    """Reason for a command."""

    TRACKING = "tracking"
    SATURATED = "valve at its limit"
    NO_REFERENCE = "no reference yet: safe voltages"
    BAD_REFERENCE = "reference not usable: safe voltages"
    LATE = "estimate late: safe voltages"
    NOT_FINITE = "estimate not finite: safe voltages"
    LOST = "reference lost: safe voltages"
    STOPPED = "stopped: safe voltages"
    DISABLED = "disabled: safe voltages once, then silent"

    @property
    def safe(self) -> bool:
        """Whether the command is the safe voltages."""
        return self not in (Status.TRACKING, Status.SATURATED)


class Command(NamedTuple):
    """Command to the valves: voltages (2,) [V], or pressures of regulators [Pa], and the reason for it."""

    voltage: tuple[float, float]
    status: Status


@dataclass(frozen=True)
class VoltageLimits:
    """Limits of the command to a valve [V], or to a pressure regulator [Pa]."""

    minimum: float = 0.0
    maximum: float = 10.0
    unit: str = "V"

    def __post_init__(self) -> None:
        if not -math.inf < self.minimum < self.maximum < math.inf:
            text = f"{self.minimum!r} to {self.maximum!r} {self.unit}"
            raise BadInput(f"{self.quantity} limits {text}: expected one below the other")

    @property
    def quantity(self) -> str:
        """``voltage`` or ``pressure``."""
        return "voltage" if self.unit == "V" else "pressure"

    def clip(self, voltage: float) -> float:
        """The nearest voltage within the limits; ``voltage`` must be a number [V]."""
        return min(max(voltage, self.minimum), self.maximum)

    def check(self, name: str, voltage: tuple[float, float]) -> tuple[float, float]:
        """Two voltages [V], which have to be within the limits; `name` is for the message."""
        if len(voltage) != 2 or not all(self.minimum <= u <= self.maximum for u in voltage):
            limits = f"{self.minimum:g} to {self.maximum:g} {self.unit}"
            raise BadInput(f"{name} {list(voltage)}: expected two {self.quantity}s within {limits}")
        return (float(voltage[0]), float(voltage[1]))


class ControlLaw:
    """Base class of the control laws: the last voltages, safe voltages, and bumpless starts.

    The safe voltages (2,) [V] are commanded without a usable reference or estimate, and at the start. After an
    interruption longer than `resume_time` [s] the law begins anew; the offset of a bumpless start decays with
    `blend_time` [s].
    """

    def __init__(
        self,
        sample_period: float,
        limits: VoltageLimits | None,
        safe_voltage: tuple[float, float],
        resume_time: float,
        blend_time: float,
    ) -> None:
        self._limits = limits or VoltageLimits()
        self._period = sample_period
        self._safe = self._limits.check("safe voltage", safe_voltage)
        self._resume_samples = round(resume_time / sample_period)
        self._decay = math.exp(-sample_period / blend_time)
        self._mode: Mode | None = None
        self._offset = (0.0, 0.0)
        self._valves = self._safe
        self._interrupted = 0

    @property
    def safe_voltage(self) -> tuple[float, float]:
        """The safe voltages (2,) [V]."""
        return self._safe

    @property
    def valves(self) -> tuple[float, float]:
        """The last commanded voltages (2,) [V]."""
        return self._valves

    @property
    def running(self) -> bool:
        """Whether the next command goes on with the present integral; otherwise it starts bumplessly."""
        return self._mode is not None

    def stop(self, valves: tuple[float, float] | None = None) -> None:
        """Forget the integral: the next command starts bumplessly, from these voltages (2,) [V] or the last ones."""
        self._mode = None
        if valves is not None:
            self._valves = self._limits.check("valve voltage", valves)

    def safe(self, status: Status) -> Command:
        """The safe voltages, for one sample without a usable reference or estimate."""
        self._interrupted += 1
        self._valves = self._safe
        if self._interrupted > self._resume_samples or status is Status.NO_REFERENCE:
            self._mode = None
        return Command(self._safe, status)

    def _fade(self) -> tuple[float, float]:
        """Offset of a bumpless start, decayed by one sample."""
        self._offset = (self._offset[0] * self._decay, self._offset[1] * self._decay)
        return self._offset

    def _clipped(self, first: float, second: float) -> Command:
        voltage = (self._limits.clip(first), self._limits.clip(second))
        return Command(voltage, Status.TRACKING if voltage == (first, second) else Status.SATURATED)
