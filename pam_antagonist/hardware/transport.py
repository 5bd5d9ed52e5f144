"""Transport of bytes to and from a device: an interface, and the serial port."""

from __future__ import annotations

import os
import select
from typing import Protocol

from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs


class DeviceLost(Exception):
    """The device cannot be reached, or is not the expected one. The message says why, in one line."""


class Transport(Protocol):
    """Bytes to and from a device."""

    def read(self, timeout_s: float) -> bytes:
        """Received bytes, as soon as there are some; empty after the time [s]."""

    def write(self, data: bytes) -> None:
        """Send without waiting; bytes that do not fit into the buffer are dropped, never sent late."""

    def close(self) -> None:
        """Close the transport. May be called twice."""


class SerialTransport:
    """A serial port, opened by pyserial: exclusively, raw, eight bits, no parity, one stop bit, no flow control.

    `port`: such as ``/dev/ttyACM0``, or a link below ``/dev/serial/by-id``, whose name is fixed. `baud`: bit rate
    [1/s]; USB devices ignore it.
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
