"""Messages between host and device, byte by byte; docs/reference/protocol.md lists them as tables.

All fields are little-endian and packed. The first byte of a payload is its kind. The second byte of ``Hello`` and
``Welcome`` is the version of the protocol. These two bytes are the same in every version.

A frame is a payload with its check sum, without zeros by consistent overhead byte stuffing (Cheshire and Baker,
IEEE/ACM Transactions on Networking 7, 1999), and a zero at the end. Frames are too short for the special case of 254
bytes without a zero.
"""

from __future__ import annotations

import struct
import zlib
from enum import IntEnum, IntFlag
from typing import NamedTuple

VERSION = 1
_NAME_BYTES = 16


class Kind(IntEnum):
    """First byte of a payload."""

    HELLO = 1
    WELCOME = 2
    TELEMETRY = 3
    COMMAND = 4
    GOODBYE = 5


class Result(IntEnum):
    """A device's answer to a hello."""

    ACCEPTED = 0
    OTHER_VERSION = 1
    SAFE_VOLTAGE_REFUSED = 2
    """The voltages are not finite or out of range, or the rate is negative."""


class Feature(IntFlag):
    """Features of a device."""

    ENCODER = 1
    TORQUE = 2
    VOLTS = 4
    """Readings of pressures and torque are in V, not in codes of the converter."""


class Status(IntFlag):
    """State of a device, in every sample; several flags may be set."""

    SAFE = 1
    """The valves had the safe voltages over this sample: no valid command in time."""
    PRESSURE_1_FAULT = 2
    """The reading of pressure 1 is invalid (converter, wire)."""
    PRESSURE_2_FAULT = 4
    """The reading of pressure 2 is invalid."""
    OUTPUT_FAULT = 8
    """The voltages could not be put on the valves."""
    OVERRUN = 16
    """The device missed samples before this one."""
    STOPPED = 32
    """A switch at the device (emergency stop) holds the safe voltages; commands have no effect."""


class Hello(NamedTuple):
    """Host to device: begin a session."""

    version: int
    session: int
    safe_voltage_1: float  # safe voltage of valve 1, applied at once without commands [V]
    safe_voltage_2: float  # safe voltage of valve 2 [V]
    vent_voltage_1: float  # final voltage of valve 1 when venting [V]
    vent_voltage_2: float  # final voltage of valve 2 when venting [V]
    vent_rate: float  # rate from safe to final voltages [V/s]; 0: the safe voltages stay


class Welcome(NamedTuple):
    """Device to host: the answer to a hello."""

    version: int
    session: int
    result: int  # a ``Result``
    features: int  # a ``Feature``
    period_us: int  # time between two samples [µs]
    watchdog_us: int  # time without a valid command until the safe voltages [µs]
    voltage_min: float  # lowest output voltage [V]
    voltage_max: float  # highest output voltage [V]
    name: bytes  # of the device, up to 16 bytes of ASCII


class Command(NamedTuple):
    """Host to device: voltages."""

    session: int
    sequence: int  # counts commands, modulo 65536
    seen: int  # sequence number of the newest sample at the host when it sent the command
    voltage_1: float  # for valve 1 [V]
    voltage_2: float  # for valve 2 [V]


class Telemetry(NamedTuple):
    """Device to host: one sample."""

    sequence: int  # counts samples, modulo 65536; samples that the device missed count
    time_us: int  # device's clock when the pressures were read [µs], modulo 2³²
    pressure_1: float  # reading of muscle 1 [V or code]
    pressure_2: float  # reading of muscle 2 [V or code]
    encoder: int  # counts; 0 without an encoder
    torque: float  # reading of the torque meter [V or code]; 0 without one
    voltage_1: float  # on valve 1 over the sample that ends at ``time_us`` [V]
    voltage_2: float  # on valve 2 over that sample [V]
    status: int  # a ``Status``
    command: int  # sequence number of the newest command that was accepted
    command_age_us: int  # time from the command's arrival to ``time_us`` [µs]; 65535: longer, or no command yet
    watchdog_trips: int  # how often the watchdog has acted, modulo 65536
    damaged: int  # damaged frames received, modulo 65536
    refused: int  # refused commands, modulo 65536: other session, old, not finite, out of range


class Goodbye(NamedTuple):
    """Host to device: the session ends; safe voltages at once."""

    session: int


Message = Hello | Welcome | Command | Telemetry | Goodbye

LAYOUTS: dict[type[Message], tuple[Kind, struct.Struct]] = {
    Hello: (Kind.HELLO, struct.Struct("<BBHfffff")),
    Welcome: (Kind.WELCOME, struct.Struct("<BBHBBIIff16s")),
    Command: (Kind.COMMAND, struct.Struct("<BHHHff")),
    Telemetry: (Kind.TELEMETRY, struct.Struct("<BHIffifffHHHHHH")),
    Goodbye: (Kind.GOODBYE, struct.Struct("<BH")),
}
_KINDS = {int(kind): (message, layout) for message, (kind, layout) in LAYOUTS.items()}


def pack(message: Message) -> bytes:
    """The payload of a message."""
    kind, layout = LAYOUTS[type(message)]
    return layout.pack(kind, *message)


def unpack(payload: bytes) -> Message | None:
    """The message in a payload; None for an unknown kind or length."""
    message, layout = _KINDS.get(payload[0], (None, None)) if payload else (None, None)
    if message is None or layout is None or len(payload) != layout.size:
        return None
    return message(*layout.unpack(payload)[1:])


def version_of(payload: bytes) -> int | None:
    """Version in a hello or welcome of any version; None for anything else."""
    if len(payload) >= 2 and payload[0] in (Kind.HELLO, Kind.WELCOME):
        return payload[1]
    return None


def text_name(name: bytes) -> str:
    """A device's name for display; characters other than printable ASCII are replaced."""
    text = name.split(b"\0")[0].decode("ascii", "replace")
    return "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in text)


def padded_name(name: str) -> bytes:
    """A device's name for the wire."""
    return name.encode("ascii", "replace")[:_NAME_BYTES].ljust(_NAME_BYTES, b"\0")


LONGEST = 253
"""Largest number of bytes to encode, so that there is one byte of overhead and no block of 254."""
CRC_BYTES = 4
LONGEST_PAYLOAD = LONGEST - CRC_BYTES
_LONGEST_FRAME = LONGEST + 1  # stuffed, without the zero


def frame(payload: bytes) -> bytes:
    """The frame on the wire of a payload of at most ``LONGEST_PAYLOAD`` bytes.

    The check sum is the CRC-32 of IEEE 802.3 (reflected, 0xEDB88320, start and end inverted), least byte first.
    Sixteen bits are not enough: if one byte in a hundred is damaged, so are about 300 of the 1000 frames a second. One
    in 65536 of these would be accepted, which is a wrong voltage every few minutes.
    """
    return stuffed(payload + _check_sum(payload)) + b"\0"


class FrameReader:
    """Finds the valid frames in a stream of bytes that may be damaged and may begin anywhere.

    `damaged`: number of frames that were cut, wrongly stuffed, too long, or had a wrong check sum.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self._rest = b""
        self._skip = False

    def feed(self, data: bytes) -> list[bytes]:
        """Take received bytes."""
        *pieces, rest = (self._rest + data).split(b"\0")
        payloads = []
        for piece in pieces:
            if self._skip:  # the end of a frame that was too long, counted already
                self._skip = False
                continue
            if not piece:  # two zeros in a row are allowed: a sender may begin with one
                continue
            payload = _checked(piece)
            if payload is None:
                self.damaged += 1
            else:
                payloads.append(payload)
        if len(rest) > _LONGEST_FRAME:
            self.damaged += not self._skip
            self._skip, rest = True, b""
        self._rest = rest
        return payloads

    def reset(self) -> None:
        """Forget an incomplete frame, because the following bytes come from another sender."""
        self._rest, self._skip = b"", False


def _checked(piece: bytes) -> bytes | None:
    decoded = unstuffed(piece)
    if decoded is None or len(decoded) <= CRC_BYTES:
        return None
    payload, check = decoded[:-CRC_BYTES], decoded[-CRC_BYTES:]
    return payload if _check_sum(payload) == check else None


def _check_sum(payload: bytes) -> bytes:
    return zlib.crc32(payload).to_bytes(CRC_BYTES, "little")


def stuffed(data: bytes) -> bytes:
    """Encode data without zeros; the result is one byte longer. `data`: at most ``LONGEST`` bytes."""
    if len(data) > LONGEST:
        raise ValueError(f"{len(data)} bytes, expected at most {LONGEST}")
    return b"".join(bytes((len(block) + 1,)) + block for block in data.split(b"\0"))


def unstuffed(encoded: bytes) -> bytes | None:
    """Decode; None for an invalid encoding."""
    end = len(encoded)
    if not 0 < end <= LONGEST + 1:
        return None
    blocks, position = [], 0
    while position < end:
        code = encoded[position]
        if code == 0 or position + code > end:
            return None
        blocks.append(encoded[position + 1 : position + code])
        position += code
    return b"\0".join(blocks)
