"""Interface of a device at the level of samples: what the bridge needs of a microcontroller or a DAQ card."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from pam_antagonist.hardware.protocol import Status
from pam_antagonist.safety import SafeAction

SEQUENCES = 1 << 16
"""Sequence numbers count modulo this."""


class DeviceLost(Exception):
    """The device cannot be reached, or is not the expected one. The message says why, in one line."""


@dataclass(frozen=True)
class DeviceInfo:
    """Properties that a device reports when it starts."""

    name: str
    unit: str  # of the readings of pressures and torque, ``V`` or ``code``
    encoder: bool
    torque: bool
    period_ns: int  # time between two samples [ns]
    # time without a command until the device applies the safe voltages [ns]; None: it has no watchdog, and the valves
    # stay as they are when the host dies.
    watchdog_ns: int | None
    voltage_min: float  # lowest output voltage [V]
    voltage_max: float  # highest output voltage [V]


class RawSample(NamedTuple):
    """One sample of a device, not yet converted."""

    sequence: int  # number of the sample, modulo 65536; lost samples count
    device_ns: int  # time of the sample on the device's clock, since the start [ns]
    arrival_ns: int  # time of arrival on the host's steady clock (``time.monotonic_ns``) [ns]
    pressure: tuple[float, float]  # readings of both muscles (2,) [V or code]
    voltage: tuple[float, float]  # on the valves over the sample that ends at ``device_ns`` (2,) [V]
    encoder: int | None = None
    torque: float | None = None  # reading [V or code], None without a torque meter
    status: Status = Status(0)


class Device(Protocol):
    """Hardware with two pressures and two valves, sampled by its own clock.

    One thread makes all calls except ``counters`` and ``close``, which may come from any thread at any time.
    """

    def start(self, action: SafeAction) -> DeviceInfo:
        """Begin to sample, with safe voltages on the valves.

        The method is called again after every ``DeviceLost``; it closes what it had opened before.

        `action`: of the valves until the first command, and whenever commands stop.
        """

    def samples(self, timeout_s: float) -> Sequence[RawSample]:
        """The samples since the last call, as soon as there is one; empty after the time [s]."""

    def command(self, voltage: tuple[float, float]) -> None:
        """Put voltages on the valves, with the next sample or at once (2,) [V]. Does not wait."""

    def close(self) -> None:
        """Apply the safe voltages and close the device. May be called at any time, also twice."""

    def counters(self) -> Mapping[str, float]:
        """Counters of the connection for diagnostics: name with unit -> value."""
