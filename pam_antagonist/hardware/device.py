"""A device at the level of samples: what the bridge needs of a microcontroller, a DAQ card, or anything else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from pam_antagonist.hardware.protocol import Status
from pam_antagonist.safety import SafeAction

SEQUENCES = 1 << 16
"""Sequence numbers count modulo this."""


@dataclass(frozen=True)
class DeviceInfo:
    """What a device says about itself when it starts.

    Attributes:
        name: for people.
        unit: of the readings of pressures and torque, ``V`` or ``code``.
        encoder: whether it has one.
        torque: whether it has a torque meter.
        period_ns: between two samples [ns].
        watchdog_ns: without a command until it puts the safe voltages on the valves by itself [ns]; None: it never
            does, and a dead host leaves the valves as they are.
        voltage_min: least voltage that it puts on a valve [V].
        voltage_max: largest [V].
    """

    name: str
    unit: str
    encoder: bool
    torque: bool
    period_ns: int
    watchdog_ns: int | None
    voltage_min: float
    voltage_max: float


class RawSample(NamedTuple):
    """What a device read at one time.

    Attributes:
        sequence: counts samples, modulo 65536, those that were lost as well.
        device_ns: when it was read, on the device's clock, since the start [ns].
        arrival_ns: when it arrived, on the host's steady clock (``time.monotonic_ns``) [ns].
        pressure: readings of both muscles (2,) [V or code].
        voltage: on the valves over the sample that ends at ``device_ns`` (2,) [V].
        encoder: counts, None without an encoder.
        torque: reading [V or code], None without a torque meter.
        status: faults.
    """

    sequence: int
    device_ns: int
    arrival_ns: int
    pressure: tuple[float, float]
    voltage: tuple[float, float]
    encoder: int | None = None
    torque: float | None = None
    status: Status = Status(0)


class Device(Protocol):
    """Hardware with two pressures and two valves, sampled by its own clock.

    All is called by one thread, but for ``counters``, and ``close``, which may come at any time.
    """

    def start(self, action: SafeAction) -> DeviceInfo:
        """Begin to sample, with safe voltages on the valves.

        It is called again after every ``DeviceLost``. What it had open then is its own to close.

        Args:
            action: what the valves get until the first command, and whenever commands stay away.

        Raises:
            DeviceLost: it cannot be reached.
        """

    def samples(self, timeout_s: float) -> Sequence[RawSample]:
        """The samples since the last call, as soon as there is one; none after the time [s].

        Raises:
            DeviceLost: it is gone.
        """

    def command(self, voltage: tuple[float, float]) -> None:
        """Put voltages on the valves, with the next sample or at once (2,) [V]. Does not wait.

        Raises:
            DeviceLost: it is gone.
        """

    def close(self) -> None:
        """Safe voltages, and the end. May be called at any time, also twice."""

    def counters(self) -> Mapping[str, float]:
        """What is worth telling about the line, for diagnostics: name with unit -> value."""
