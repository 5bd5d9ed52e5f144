"""MCAP files byte by byte, for tests of damage: records that say what they should not, and where records begin."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from pam_antagonist.recording.mcap import MAGIC


def record(opcode: int, body: bytes, size: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(body) if size is None else size) + body


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def chunk(data: bytes, compression: str, size: int, *, packed: int | None = None, crc: int = 0) -> bytes:
    """A chunk of data that may claim other sizes than it has."""
    head = struct.pack("<QQQI", 0, 0, size, crc) + text(compression)
    return record(6, head + struct.pack("<Q", len(data) if packed is None else packed) + data)


def message(channel: int, data: bytes) -> bytes:
    return record(5, struct.pack("<HIQQ", channel, 0, 5, 5) + data)


HEADER = MAGIC + record(1, text("ros2") + text("test"))
FOOTER = record(2, bytes(20)) + MAGIC


def records(data: bytes, at: int = len(MAGIC), end: int | None = None) -> Iterator[tuple[int, int, int]]:
    """Opcode, first byte and end of each record."""
    while at + 9 <= (len(data) if end is None else end):
        opcode, size = struct.unpack_from("<BQ", data, at)
        yield opcode, at, at + 9 + size
        at += 9 + size


def chunks(data: bytes) -> list[tuple[int, int]]:
    """First byte and end of each chunk record."""
    return [(at, end) for opcode, at, end in records(data) if opcode == 6]
