"""Reference firmware of a device: a state machine with bytes and ticks as inputs.

It is simple on purpose (no significant allocation, no exceptions, 32-bit unsigned times), so that it can be translated
to C line by line. It checks everything that the host sends.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from pam_antagonist.hardware import protocol
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

_FULL = 1 << 32
_HALF_SEQUENCE = 1 << 15


@dataclass(frozen=True)
class DeviceSettings:
    """Fixed settings of the device."""

    name: str = "reference"
    features: Feature = Feature.ENCODER | Feature.TORQUE | Feature.VOLTS
    period_us: int = 1000  # time between two samples [µs]
    watchdog_us: int = 20_000  # time without a valid command until the safe voltages [µs]
    # time without a valid command until the device becomes silent and waits for a hello [µs].
    session_us: int = 1_000_000
    voltage_min: float = 0.0  # lowest output voltage [V]
    voltage_max: float = 10.0  # highest output voltage [V]
    safe_voltage: tuple[float, float] = (5.5, 5.5)  # on the valves from power-on until a host sends others (2,) [V]


@dataclass(frozen=True)
class Readings:
    """Readings of the inputs at a tick."""

    pressure_1: float  # [V or code]
    pressure_2: float  # [V or code]
    encoder: int = 0
    torque: float = 0.0  # [V or code]
    fault: Status = Status(0)


class Firmware:
    """The device's logic: call :meth:`receive` with bytes of the host, and :meth:`tick` at every sample.

    Commands take effect at the next tick, so that the voltages are constant over every sample, and the sample's
    telemetry can report them.

    `voltage`: on the valves now (2,) [V]; changes at ticks and with a goodbye. `safe`: whether these are the safe
    voltages for lack of a valid command.
    """

    def __init__(self, settings: DeviceSettings | None = None) -> None:
        self.settings = settings or DeviceSettings()
        # Rounded to float32 like the commands, so that a command at the limit is accepted.
        self._lowest, self._highest = as_float32(self.settings.voltage_min), as_float32(self.settings.voltage_max)
        self.safe_voltage = self.settings.safe_voltage
        self._vent, self._vent_step = self.safe_voltage, 0.0  # end of venting, and step a sample [V]
        self.voltage = self.safe_voltage
        self.safe = True
        self.running = False
        self.watchdog_trips = 0
        self.refused = 0
        self._frames = FrameReader()
        self._session = 0
        self._sequence = 0  # of the next sample
        self._wanted = self.safe_voltage
        self._fresh = False  # a valid command has come, and the watchdog has not acted since
        self._newest: int | None = None  # sequence number of the newest command
        self._command_us = 0  # when it came
        self._heard_us = 0  # when the newest command or hello came; a repeated hello does not count as a command

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes from the host. `now_us`: device's clock [µs], modulo 2³²."""
        answer = b""
        for payload in self._frames.feed(data):
            version = protocol.version_of(payload)
            if version is not None and version != protocol.VERSION:
                # Report our version; the rest of the hello may have another layout.
                answer += self._welcome(0, Result.OTHER_VERSION)
                continue
            message = protocol.unpack(payload)
            if isinstance(message, Hello):
                answer += self._begin(message, now_us)
            elif isinstance(message, Command):
                self._take(message, now_us)
            elif isinstance(message, Goodbye) and self.running and message.session == self._session:
                self._end()
        return answer

    def _begin(self, hello: Hello, now_us: int) -> bytes:
        voltage = (hello.safe_voltage_1, hello.safe_voltage_2)
        vent = (hello.vent_voltage_1, hello.vent_voltage_2)
        rate = hello.vent_rate
        if not (self._allowed(voltage) and self._allowed(vent) and math.isfinite(rate) and rate >= 0.0):
            return self._welcome(hello.session, Result.SAFE_VOLTAGE_REFUSED)
        if not (self.running and hello.session == self._session):  # a hello may come twice
            self._session = hello.session
            before = self.safe_voltage, self._vent, self._vent_step
            self.safe_voltage = voltage
            self._vent, self._vent_step = vent, rate * self.settings.period_us * 1e-6
            self._fresh, self._newest = False, None
            self.running = True
            # A host that returns with the same safe action does not fill vented muscles again.
            if not self.safe or (self.safe_voltage, self._vent, self._vent_step) != before:
                self._become_safe()
        self._heard_us = now_us
        return self._welcome(hello.session, Result.ACCEPTED)

    def _take(self, command: Command, now_us: int) -> None:
        ahead = 1 if self._newest is None else (command.sequence - self._newest) & 0xFFFF
        delay_us = ((self._sequence - 1 - command.seen) & 0xFFFF) * self.settings.period_us
        voltage = (command.voltage_1, command.voltage_2)
        if (
            not self.running
            or command.session != self._session
            or not 0 < ahead < _HALF_SEQUENCE  # repeated, or older than the newest
            or delay_us >= self.settings.watchdog_us  # delayed in a buffer, or the host receives no samples
            or not self._allowed(voltage)
        ):
            self.refused += 1
            return
        self._wanted = voltage
        self._newest = command.sequence
        self._command_us = self._heard_us = now_us
        self._fresh = True

    def _allowed(self, voltage: tuple[float, float]) -> bool:
        return all(math.isfinite(value) and self._lowest <= value <= self._highest for value in voltage)

    def tick(self, now_us: int, readings: Readings) -> bytes:
        """End a sample: read, report, and put the voltages of the next sample on the valves.

        `now_us`: device's clock [µs], modulo 2³².
        """
        silence_us = _since(self._command_us, now_us)
        sent = self._telemetry(now_us, silence_us, readings) if self.running else b""
        self._sequence = (self._sequence + 1) & 0xFFFF
        if self._fresh and silence_us >= self.settings.watchdog_us:
            # Latched until the next command: the clock wraps every 71 minutes, and an old command would look new.
            self._fresh = False
            self.watchdog_trips += 1
        if self.running and _since(self._heard_us, now_us) >= self.settings.session_us:
            self._end()
        stopped = bool(readings.fault & Status.STOPPED)
        if self._fresh and not stopped:
            self.safe, self.voltage = False, self._wanted
        elif self.safe:
            self._vent_further()
        else:
            self._become_safe()
        return sent

    def _become_safe(self) -> None:
        self.safe, self.voltage = True, self.safe_voltage

    def _vent_further(self) -> None:
        """Go one step from the safe voltages towards the venting ones, at most at the host's rate."""
        step = self._vent_step
        first, second = (
            now + min(max(end - now, -step), step) for now, end in zip(self.voltage, self._vent, strict=True)
        )
        self.voltage = first, second

    def _end(self) -> None:
        self.running = self._fresh = False
        if not self.safe:
            self._become_safe()

    def _welcome(self, session: int, result: Result) -> bytes:
        s = self.settings
        name = protocol.padded_name(s.name)
        welcome = Welcome(
            protocol.VERSION, session, result, s.features, s.period_us, s.watchdog_us,
            s.voltage_min, s.voltage_max, name,
        )  # fmt: skip
        return frame(protocol.pack(welcome))

    def _telemetry(self, now_us: int, silence_us: int, readings: Readings) -> bytes:
        known = self._newest is not None and self._fresh
        status = readings.fault | (Status.SAFE if self.safe else Status(0))
        telemetry = Telemetry(
            self._sequence, now_us % _FULL,
            readings.pressure_1, readings.pressure_2, readings.encoder, readings.torque, *self.voltage,
            status, self._newest or 0, min(silence_us, 0xFFFF) if known else 0xFFFF,
            self.watchdog_trips & 0xFFFF, self._frames.damaged & 0xFFFF, self.refused & 0xFFFF,
        )  # fmt: skip
        return frame(protocol.pack(telemetry))


def _since(then_us: int, now_us: int) -> int:
    """Time from one reading of the clock to another [µs].

    Bytes may be received between the due time of a tick and the tick. So a time ahead by less than half the counter's
    range counts as 0, not as a long time ago.
    """
    passed = (now_us - then_us) % _FULL
    return passed if passed < _FULL // 2 else 0


def as_float32(value: float) -> float:
    """A number rounded to float32, as on the wire."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])
