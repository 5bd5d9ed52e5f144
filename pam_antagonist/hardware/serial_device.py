"""The host's side of the protocol: a device that is reached by a transport of bytes, such as a serial port."""

from __future__ import annotations

import math
import os
import random
import select
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Protocol

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware import protocol
from pam_antagonist.hardware.device import SEQUENCES, DeviceInfo, DeviceLost, RawSample
from pam_antagonist.hardware.link import Unwrapped
from pam_antagonist.hardware.protocol import (
    Command,
    Feature,
    FrameReader,
    Goodbye,
    Hello,
    Result,
    Status,
    Telemetry,
    Welcome,
    frame,
)
from pam_antagonist.optional import needs
from pam_antagonist.safety import SafeAction


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


_HELLO_EVERY = 0.1  # [s]
_HELLO_FOR = 3.0  # [s]; boards that restart when their port is opened need two seconds
_NO_COMMAND_YET = 0xFFFF


class SerialDevice:
    """A microcontroller that speaks the protocol.

    `open_transport`: opens a new transport; called again after the device was lost. `hello_for_s`: how long a device
    may take to answer [s].
    """

    def __init__(self, open_transport: Callable[[], Transport], hello_for_s: float = _HELLO_FOR) -> None:
        self._open = open_transport
        self._hello_for_s = hello_for_s
        self._transport: Transport | None = None
        self._frames = FrameReader()
        self._closed = False
        self.sessions = 0
        self.strange = 0
        self.telemetry: Telemetry | None = None
        self._features = Feature(0)
        self._session = 0
        self._trips = self._trips_before = 0
        self._round_trips: deque[int] = deque(maxlen=1000)
        self._begin(0)

    def _begin(self, session: int) -> None:
        self._session = session
        self._clock = Unwrapped()
        self._sequence = 0
        self._sent: dict[int, int] = {}  # sequence number of a command -> when it was sent [ns]
        self._acknowledged: int | None = None
        self.telemetry = None

    def start(self, action: SafeAction) -> DeviceInfo:
        """See :meth:`Device.start`; opens the transport if needed, and does the handshake."""
        self._closed = False
        if self._transport is None:
            self._transport = self._open()
            self._frames.reset()
        self._begin((self._session + random.randrange(1, SEQUENCES)) % SEQUENCES)
        vent, rate = (action.hold, 0.0) if action.vent is None else (action.vent, action.rate)
        hello = frame(protocol.pack(Hello(protocol.VERSION, self._session, *action.hold, *vent, rate)))
        end = time.monotonic() + self._hello_for_s
        while time.monotonic() < end and not self._closed:
            self._write(b"\0" + hello)  # the zero ends an incomplete frame
            until = time.monotonic() + _HELLO_EVERY
            while (left := until - time.monotonic()) > 0.0:
                for payload in self._frames.feed(self._read(left)):
                    info = self._answer(payload)
                    if info is not None:
                        self.sessions += 1
                        return info
        self._drop()
        raise DeviceLost("no answer to the greeting: is this the device's port, and does its firmware run?")

    def _answer(self, payload: bytes) -> DeviceInfo | None:
        """Device information from a welcome; None for another message."""
        if payload[0] != protocol.Kind.WELCOME:
            return None
        version = protocol.version_of(payload)
        if version != protocol.VERSION:
            raise DeviceLost(f"it speaks version {version} of the protocol, expected {protocol.VERSION}")
        welcome = protocol.unpack(payload)
        if not isinstance(welcome, Welcome) or welcome.session != self._session:
            return None
        if welcome.result == Result.OTHER_VERSION:
            raise DeviceLost(f"it does not speak version {protocol.VERSION} of the protocol")
        if welcome.result != Result.ACCEPTED:
            low, high = welcome.voltage_min, welcome.voltage_max
            raise DeviceLost(f"it refuses the safe voltages: its outputs go from {low:g} to {high:g} V")
        self._features = Feature(welcome.features)
        return DeviceInfo(
            name=protocol.text_name(welcome.name),
            unit="V" if self._features & Feature.VOLTS else "code",
            encoder=bool(self._features & Feature.ENCODER),
            torque=bool(self._features & Feature.TORQUE),
            period_ns=welcome.period_us * 1000,
            watchdog_ns=welcome.watchdog_us * 1000,
            voltage_min=welcome.voltage_min,
            voltage_max=welcome.voltage_max,
        )

    def samples(self, timeout_s: float) -> list[RawSample]:
        """See :meth:`Device.samples`."""
        data = self._read(timeout_s)
        if not data:
            return []
        arrival = time.monotonic_ns()
        out = []
        for payload in self._frames.feed(data):
            message = protocol.unpack(payload)
            if not isinstance(message, Telemetry):
                self.strange += message is None
                continue
            out.append(self._sample(message, arrival))
        return out

    def _sample(self, telemetry: Telemetry, arrival_ns: int) -> RawSample:
        time_us = self._clock(telemetry.time_us)
        if time_us is None:
            raise DeviceLost("its clock went back: it has started anew")
        if self.telemetry is None:
            self._trips_before = telemetry.watchdog_trips
        self._trips += (telemetry.watchdog_trips - self._trips_before) % SEQUENCES
        self._trips_before = telemetry.watchdog_trips
        self.telemetry = telemetry
        self._time(telemetry, arrival_ns)
        return RawSample(
            telemetry.sequence,
            time_us * 1000,
            arrival_ns,
            (telemetry.pressure_1, telemetry.pressure_2),
            (telemetry.voltage_1, telemetry.voltage_2),
            telemetry.encoder if self._features & Feature.ENCODER else None,
            telemetry.torque if self._features & Feature.TORQUE else None,
            Status(telemetry.status),
        )

    def _time(self, telemetry: Telemetry, arrival_ns: int) -> None:
        """Measure the round trip of the newest command, without its waiting time at the device."""
        if telemetry.command_age_us == _NO_COMMAND_YET or telemetry.command == self._acknowledged:
            return
        self._acknowledged = telemetry.command
        sent = self._sent.get(telemetry.command)
        if sent is not None:
            self._round_trips.append(arrival_ns - sent - telemetry.command_age_us * 1000)

    def command(self, voltage: tuple[float, float]) -> None:
        """See :meth:`Device.command`. Sends nothing before the first sample, which every command has to refer to."""
        if self.telemetry is None:
            return
        self._sequence = sequence = (self._sequence + 1) % SEQUENCES
        self._sent[sequence] = time.monotonic_ns()
        self._sent.pop((sequence - 64) % SEQUENCES, None)
        self._write(frame(protocol.pack(Command(self._session, sequence, self.telemetry.sequence, *voltage))))

    def close(self) -> None:
        """See :meth:`Device.close`; sends a goodbye, so that the valves are safe before the watchdog acts."""
        self._closed = True
        if self._transport is not None:
            with suppress(DeviceLost):
                self._write(frame(protocol.pack(Goodbye(self._session))))
            self._drop()

    def counters(self) -> Mapping[str, float]:
        """See :meth:`Device.counters`."""
        trips = sorted(self._round_trips)
        self._round_trips.clear()
        newest = self.telemetry
        return {
            "damaged frames from the device": self._frames.damaged,
            "damaged frames at the device": math.nan if newest is None else newest.damaged,
            "commands refused by the device": math.nan if newest is None else newest.refused,
            "strange frames": self.strange,
            "watchdog trips of the device": self._trips,
            "round trip median [ms]": trips[len(trips) // 2] * 1e-6 if trips else math.nan,
            "round trip largest [ms]": trips[-1] * 1e-6 if trips else math.nan,
            "sessions": self.sessions,
        }

    def _read(self, timeout_s: float) -> bytes:
        if self._transport is None:
            raise DeviceLost("it was closed")
        try:
            return self._transport.read(timeout_s)
        except DeviceLost:
            self._drop()
            raise

    def _write(self, data: bytes) -> None:
        if self._transport is None:
            raise DeviceLost("it was closed")
        try:
            self._transport.write(data)
        except DeviceLost:
            self._drop()
            raise

    def _drop(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()
