"""The messages between host and device, byte by byte; docs/reference/protocol.md has them as tables.

Everything is little-endian and packed. The first byte of a payload is its kind. The second one of ``Hello`` and
``Welcome`` is the version of the protocol: these two bytes stay where they are in every version.
"""

from __future__ import annotations

import struct
from enum import IntEnum, IntFlag
from typing import NamedTuple

VERSION = 1
_NAME_BYTES = 16
_HELLO = struct.Struct("<BBHfffff")
_WELCOME = struct.Struct("<BBHBBIIff16s")
_COMMAND = struct.Struct("<BHHHff")
_TELEMETRY = struct.Struct("<BHIffifffHHHHHH")
_GOODBYE = struct.Struct("<BH")


class Kind(IntEnum):
    """First byte of a payload."""

    HELLO = 1
    WELCOME = 2
    TELEMETRY = 3
    COMMAND = 4
    GOODBYE = 5


class Result(IntEnum):
    """What a device says to a hello."""

    ACCEPTED = 0
    OTHER_VERSION = 1
    SAFE_VOLTAGE_REFUSED = 2
    """Not finite, or beyond its outputs; or the rate is negative."""


class Feature(IntFlag):
    """What a device has."""

    ENCODER = 1
    TORQUE = 2
    VOLTS = 4
    """Readings of pressures and torque are in V, not in codes of the converter."""


class Status(IntFlag):
    """How a device is, in every sample; several may be set."""

    SAFE = 1
    """The valves had the safe voltages over this sample: no valid command in time."""
    PRESSURE_1_FAULT = 2
    """The reading of pressure 1 is not to be used (converter, wire)."""
    PRESSURE_2_FAULT = 4
    """The same of pressure 2."""
    OUTPUT_FAULT = 8
    """The voltages could not be put on the valves."""
    OVERRUN = 16
    """The device missed samples before this one."""
    STOPPED = 32
    """A switch at the device (emergency stop) holds the safe voltages; commands have no effect."""


class Hello(NamedTuple):
    """Host to device: begin a session.

    Attributes:
        version: of the protocol.
        session: number of this session, any other than the last one.
        safe_voltage_1: what valve 1 gets at once without commands [V].
        safe_voltage_2: the same of valve 2 [V].
        vent_voltage_1: where that of valve 1 goes from there, slowly [V].
        vent_voltage_2: the same of valve 2 [V].
        vent_rate: largest change on the way [V/s]; 0: it stays.
    """

    version: int
    session: int
    safe_voltage_1: float
    safe_voltage_2: float
    vent_voltage_1: float
    vent_voltage_2: float
    vent_rate: float


class Welcome(NamedTuple):
    """Device to host: the answer to a hello.

    Attributes:
        version: of the device's protocol.
        session: of the hello.
        result: a ``Result``.
        features: a ``Feature``.
        period_us: time between two samples [µs].
        watchdog_us: time without a valid command until the safe voltages [µs].
        voltage_min: least voltage that the device puts on a valve [V].
        voltage_max: largest [V].
        name: of the device, up to 16 bytes of ASCII.
    """

    version: int
    session: int
    result: int
    features: int
    period_us: int
    watchdog_us: int
    voltage_min: float
    voltage_max: float
    name: bytes


class Command(NamedTuple):
    """Host to device: voltages.

    Attributes:
        session: of the hello.
        sequence: counts commands, modulo 65536.
        seen: sequence number of the newest sample that the host had when it sent this.
        voltage_1: for valve 1 [V].
        voltage_2: for valve 2 [V].
    """

    session: int
    sequence: int
    seen: int
    voltage_1: float
    voltage_2: float


class Telemetry(NamedTuple):
    """Device to host: one sample.

    Attributes:
        sequence: counts samples, modulo 65536; one that the device missed counts as well.
        time_us: device's clock when the pressures were read [µs], modulo 2³².
        pressure_1: reading of muscle 1 [V or code].
        pressure_2: reading of muscle 2 [V or code].
        encoder: counts; 0 without an encoder.
        torque: reading of the torque meter [V or code]; 0 without one.
        voltage_1: on valve 1 over the sample that ends at ``time_us`` [V].
        voltage_2: on valve 2 over that sample [V].
        status: a ``Status``.
        command: sequence number of the newest command that was accepted.
        command_age_us: from its arrival to ``time_us`` [µs], at most 65535, which also means none yet.
        watchdog_trips: how often the watchdog has acted, modulo 65536.
        damaged: frames that came damaged, modulo 65536.
        refused: commands that were refused, modulo 65536: other session, old, not finite, out of range.
    """

    sequence: int
    time_us: int
    pressure_1: float
    pressure_2: float
    encoder: int
    torque: float
    voltage_1: float
    voltage_2: float
    status: int
    command: int
    command_age_us: int
    watchdog_trips: int
    damaged: int
    refused: int


class Goodbye(NamedTuple):
    """Host to device: the session ends; safe voltages at once.

    Attributes:
        session: of the hello.
    """

    session: int


Message = Hello | Welcome | Command | Telemetry | Goodbye

_LAYOUTS: dict[type[Message], tuple[Kind, struct.Struct]] = {
    Hello: (Kind.HELLO, _HELLO),
    Welcome: (Kind.WELCOME, _WELCOME),
    Command: (Kind.COMMAND, _COMMAND),
    Telemetry: (Kind.TELEMETRY, _TELEMETRY),
    Goodbye: (Kind.GOODBYE, _GOODBYE),
}
_KINDS = {int(kind): (message, layout) for message, (kind, layout) in _LAYOUTS.items()}


def pack(message: Message) -> bytes:
    """The payload of a message."""
    kind, layout = _LAYOUTS[type(message)]
    return layout.pack(kind, *message)


def unpack(payload: bytes) -> Message | None:
    """The message in a payload; None for a kind or a length that this version does not know.

    Args:
        payload: of a frame whose check sum was right.
    """
    known = _KINDS.get(payload[0]) if payload else None
    if known is None:
        return None
    message, layout = known
    if len(payload) != layout.size:
        return None
    return message(*layout.unpack(payload)[1:])


def version_of(payload: bytes) -> int | None:
    """Version in a hello or welcome of any version; None for anything else."""
    if len(payload) >= 2 and payload[0] in (Kind.HELLO, Kind.WELCOME):
        return payload[1]
    return None


def text_name(name: bytes) -> str:
    """A device's name for people; whatever is not printable ASCII is replaced."""
    text = name.split(b"\0")[0].decode("ascii", "replace")
    return "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in text)


def padded_name(name: str) -> bytes:
    """A device's name for the wire."""
    return name.encode("ascii", "replace")[:_NAME_BYTES].ljust(_NAME_BYTES, b"\0")
