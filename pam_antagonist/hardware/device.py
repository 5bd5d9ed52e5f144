"""Interface of a device at the level of samples, and of the bytes below: what the bridge needs of it."""

from __future__ import annotations

import os
import select
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.protocol import Status
from pam_antagonist.optional import needs
from pam_antagonist.safety import SafeAction

SEQUENCES = 1 << 16
"""Sequence numbers count modulo this."""


@dataclass(frozen=True)
class DeviceInfo:
    """Properties that a device reports when it starts.

    Attributes:
        unit: of the readings of pressures and torque, ``V`` or ``code``.
        period_ns: time between two samples [ns].
        watchdog_ns: time without a command until the device applies the safe voltages [ns]; None: it has no watchdog,
            and the valves stay as they are when the host dies.
        voltage_min: lowest output voltage [V].
        voltage_max: highest output voltage [V].
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
    """One sample of a device, not yet converted.

    Attributes:
        sequence: number of the sample, modulo 65536; lost samples count.
        device_ns: time of the sample on the device's clock, since the start [ns].
        arrival_ns: time of arrival on the host's steady clock (``time.monotonic_ns``) [ns].
        pressure: readings of both muscles (2,) [V or code].
        voltage: on the valves over the sample that ends at ``device_ns`` (2,) [V].
        torque: reading [V or code], None without a torque meter.
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

    One thread makes all calls except ``counters`` and ``close``, which may come from any thread at any time.
    """

    def start(self, action: SafeAction) -> DeviceInfo:
        """Begin to sample, with safe voltages on the valves.

        The method is called again after every ``DeviceLost``; it closes what it had opened before.

        Args:
            action: of the valves until the first command, and whenever commands stop.
        """

    def samples(self, timeout_s: float) -> Sequence[RawSample]:
        """The samples since the last call, as soon as there is one; empty after the time [s]."""

    def command(self, voltage: tuple[float, float]) -> None:
        """Put voltages on the valves, with the next sample or at once (2,) [V]. Does not wait."""

    def close(self) -> None:
        """Apply the safe voltages and close the device. May be called at any time, also twice."""

    def counters(self) -> Mapping[str, float]:
        """Counters of the connection for diagnostics: name with unit -> value."""


class DeviceLost(Exception):
    """The device cannot be reached, or is not the expected one. The message says why, in one line."""


class Transport(Protocol):
    """Bytes to and from a device."""

    def fileno(self) -> int:
        """File descriptor for ``select``."""

    def read(self, timeout_s: float) -> bytes:
        """Received bytes, as soon as there are some; empty after the time [s]."""

    def write(self, data: bytes) -> None:
        """Send without waiting; bytes that do not fit into the buffer are dropped, never sent late."""

    def close(self) -> None:
        """Close the transport. May be called twice."""


class SerialTransport:
    """A serial port, opened by pyserial: exclusively, raw, eight bits, no parity, one stop bit, no flow control.

    Args:
        port: such as ``/dev/ttyACM0``, or a link below ``/dev/serial/by-id``, whose name is fixed.
        baud: bit rate [1/s]; USB devices ignore it.
    """

    def __init__(self, port: str, baud: int = 921_600) -> None:
        with needs("hardware", port):
            import serial

        try:
            self._serial = serial.Serial(port, baud, timeout=0, write_timeout=0, exclusive=True)
        except ValueError as error:
            raise BadInput(f"{port} with {baud} baud: {error}") from None
        except (OSError, EOFError) as error:  # SerialException is an OSError
            raise DeviceLost(f"{port} cannot be opened: {_reason(error)}") from None
        self._port = port
        self._fd: int = self._serial.fileno()

    def fileno(self) -> int:
        """File descriptor of the port."""
        return self._fd

    def read(self, timeout_s: float) -> bytes:
        """See :meth:`Transport.read`."""
        try:
            ready, _, _ = select.select([self._fd], [], [], timeout_s)
            if not ready:
                return b""
            data = os.read(self._fd, 65_536)
        except (OSError, ValueError) as error:
            raise DeviceLost(f"{self._port} is gone: {_reason(error)}") from None
        if not data:  # Linux reports an unplugged port as readable without data
            raise DeviceLost(f"{self._port} is gone: end of file")
        return data

    def write(self, data: bytes) -> None:
        """See :meth:`Transport.write`."""
        try:
            os.write(self._fd, data)
        except BlockingIOError:
            pass
        except (OSError, ValueError) as error:
            raise DeviceLost(f"{self._port} is gone: {_reason(error)}") from None

    def close(self) -> None:
        """See :meth:`Transport.close`."""
        try:
            self._serial.close()
        except (OSError, ValueError):  # it is gone anyway
            pass


def _reason(error: BaseException) -> str:
    text = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
    return " ".join(text.split())[:200]
