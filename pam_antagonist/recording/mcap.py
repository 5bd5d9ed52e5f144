"""MCAP files, read record by record (https://mcap.dev/spec).

rosbags reads such files by the index at their end, message by message. This module scans them from front to back, for
three reasons. A recording that was cut off has no index, but all messages up to the cut; and behind damage, the scan
goes on at the next whole chunk. Every length is checked against the size of the file before memory is allocated. And a
compiled kernel takes consecutive messages as one block, because a recording has about a million.
"""

from __future__ import annotations

import math
import mmap
import re
import struct
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from .._jit import in_place
from .raw import MAX_MESSAGE, CompressionError, Payloads, RawTopic, Room, inflate

MAGIC = b"\x89MCAP0\r\n"
MAX_CHUNK = 128 << 20
"""Largest chunk that is unpacked [bytes]; rosbag2 writes chunks of about 1 MB."""

_FOOTER, _SCHEMA, _CHANNEL, MESSAGE, _CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
_NAMES = {
    0x01: "header", _FOOTER: "footer", _SCHEMA: "schema", _CHANNEL: "channel", MESSAGE: "message", _CHUNK: "chunk",
    0x07: "message index", 0x08: "chunk index", 0x09: "attachment", 0x0A: "attachment index", 0x0B: "statistics",
    0x0C: "metadata", 0x0D: "metadata index", 0x0E: "summary offset", 0x0F: "data end",
}  # fmt: skip
MESSAGE_HEAD = 22  # channel, sequence, log time, publish time [bytes]
CHANNEL_OF, LOG, BEGIN, SIZE = range(4)  # columns of a block of consecutive messages
_CHUNK_HEAD = re.compile(rb"(?=\x06.{5}\0\0\0)", re.DOTALL)  # a chunk record of less than a terabyte
_CHUNK_LEAST, _LONGEST_NAME = 44, 4  # body of a chunk, and name of its compression [bytes]
_RUN = 1 << 16  # largest number of messages in a block

Run = NDArray[np.int64]


class Damage(Exception):
    """The file is damaged; the text says where and how."""


class Lost(NamedTuple):
    """A part of a file that could not be read."""

    begin: int
    end: int
    # when the last message before it was received, from the first message that was read on [s]; NaN for none.
    since: float
    until: float  # when the first message behind it was received [s]; NaN for none


def scan_mcap(path: Path, types: Collection[str], room: Room) -> tuple[list[RawTopic], str | None, list[Lost]]:
    """Read all messages of the given types; messages of other types are only counted.

    `room`: Limit on unpacked bytes. Returns an entry for each channel; where and why the file is damaged first, None
    for a whole file; and what is lost. All messages before the damage are read, and those in whole chunks behind it.
    """
    if path.stat().st_size == 0:
        return [], "it is empty", []
    with path.open("rb") as file:
        view = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    scan = _Scan(types, room)
    damage: str | None = None
    gaps: list[tuple[int, int, int]] = []  # begin and end, with the number of blocks that were read before
    position = len(MAGIC)
    while True:
        try:
            if view[: len(MAGIC)] != MAGIC:
                raise Damage("it does not start like an MCAP file")
            if not scan.file(view, position):
                raise Damage(f"it ends at byte {len(view)} without a footer")
            break
        except Damage as exc:
            damage = damage or str(exc)
            begin, position = scan.at, _next_chunk(view, scan.at + 1)
            if not position:
                break
            scan.declare(view)
            gaps.append((begin, position, len(scan.blocks)))
    spans = [(int(block.log_ns.min()), int(block.log_ns.max())) for _, block in scan.blocks]
    first = min((low for low, _ in spans), default=0)
    lost = [
        Lost(
            begin,
            end,
            max(((high - first) * 1e-9 for _, high in spans[:count]), default=math.nan),
            min(((low - first) * 1e-9 for low, _ in spans[count:]), default=math.nan),
        )
        for begin, end, count in gaps
    ]
    return scan.topics(), damage, lost


def _next_chunk(view: memoryview, start: int) -> int:
    """Where the next whole chunk record begins; 0 for none."""
    for match in _CHUNK_HEAD.finditer(view, start):
        (size,) = struct.unpack_from("<Q", view, match.start() + 1)
        body = view[match.start() + 9 : match.start() + 9 + size]
        if len(body) == size > _CHUNK_LEAST:
            (length,) = struct.unpack_from("<I", body, 28)
            (packed,) = struct.unpack_from("<Q", body, 32 + length) if length <= _LONGEST_NAME else (0,)
            if packed and packed == size - 40 - length:
                return match.start()
    return 0


@dataclass
class _Scan:
    """A scan in progress."""

    types: Collection[str]
    room: Room
    schemas: dict[int, tuple[str, str]] = field(default_factory=dict)
    channels: dict[int, RawTopic] = field(default_factory=dict)
    blocks: list[tuple[int, RawTopic]] = field(default_factory=list)  # channel and some of its messages
    at: int = 0  # the record of the file that is being read

    def topics(self) -> list[RawTopic]:
        """All messages of each channel."""
        parts: dict[int, list[RawTopic]] = {key: [] for key in self.channels}
        for key, block in self.blocks:
            parts[key].append(block)
        return [(its or [self.channels[key]])[0].joined(its[1:]) for key, its in parts.items()]

    def declare(self, view: memoryview) -> None:
        """Take schemas and channels from the summary, where the part that declares them is damaged."""
        foot = len(view) - len(MAGIC) - 29
        if foot > 0 and view[foot] == _FOOTER:
            (start,) = struct.unpack_from("<Q", view, foot + 9)
            if 0 < start < foot:
                with suppress(Damage):
                    self._walk(view, start, foot, "", [])

    def file(self, view: memoryview, position: int) -> bool:
        """Scan the records of the file; whether it ends with a footer."""
        return self._walk(view, position, len(view), "", None)

    def _walk(self, view: memoryview, position: int, end: int, of: str, runs: list[Run] | None) -> bool:
        """Scan records; those of a chunk go into ``runs`` (``of`` says which chunk), those of the file are kept."""
        head = struct.Struct("<BQ").unpack_from
        data = np.frombuffer(view, np.uint8)
        run = np.empty((min(_RUN, end // (9 + MESSAGE_HEAD) + 1), 4), np.int64)
        while position < end:
            self.at = self.at if of else position
            count, position = take_messages(data, position, end, run)
            if count:
                wrong = self._first_wrong(run[:count], of)
                good = run[: wrong[0]] if wrong else run[:count]
                if runs is None:
                    self._keep(data, good)
                elif len(good):
                    runs.append(good.copy())
                if wrong:
                    raise Damage(wrong[1])
                continue
            where = f"at byte {position}{of}"
            if end - position < 9:
                raise Damage(f"a record is cut off {where}")
            opcode, size = head(view, position)
            body = position + 9
            if opcode == 0:
                raise Damage(f"there is no record {where}")
            if body + size > end:
                record = f"{_NAMES.get(opcode, 'unknown')} record {where}"
                raise Damage(f"the {record} has {size} bytes, of which {end - body} are there")
            if opcode == MESSAGE:
                raise Damage(f"a message record {where} has {size} bytes, expected 22 or more")
            if opcode == _FOOTER and not of:
                return view[body + size : body + size + len(MAGIC)] == MAGIC
            try:
                self._record(opcode, view[body : body + size], position, of)
            except (struct.error, UnicodeDecodeError, CompressionError) as exc:
                raise Damage(f"the {_NAMES[opcode]} record {where} is damaged ({exc})") from exc
            position = body + size
        return False

    def _first_wrong(self, run: Run, of: str) -> tuple[int, str] | None:
        """The first message of no known channel, or that is too large, and what to say of it."""
        found = []
        for key in np.unique(run[:, CHANNEL_OF]).tolist():
            channel, its = self.channels.get(key), run[:, CHANNEL_OF] == key
            if channel is not None:
                its &= (run[:, SIZE] + MESSAGE_HEAD > MAX_MESSAGE) & (channel.msgtype in self.types)
            if its.any():
                row = int(np.argmax(its))
                at = f"at byte {run[row, BEGIN] - MESSAGE_HEAD - 9}{of}"
                text = f"a message {at} belongs to channel {key}, which is not declared"
                if channel is not None:
                    text = f"a message of {channel.msgtype} {at} has {run[row, SIZE] + MESSAGE_HEAD} bytes"
                found.append((row, text))
        return min(found, default=None)

    def _keep(self, data: NDArray[np.uint8], run: Run) -> None:
        """Add a block of messages, as :func:`take_messages` gives them."""
        for key in np.unique(run[:, CHANNEL_OF]).tolist():
            channel, its, payloads = self.channels[key], run[run[:, CHANNEL_OF] == key], None
            if channel.msgtype in self.types:
                payloads = Payloads(np.empty(its[:, SIZE].sum(), np.uint8), its[:, SIZE].copy())
                copy_payloads(data, its, payloads.data)
            self.blocks.append((key, replace(channel, log_ns=its[:, LOG].copy(), payloads=payloads)))

    def _record(self, opcode: int, body: memoryview, position: int, of: str) -> None:
        """Read a record that is no message."""
        if opcode == _CHUNK and of:
            raise Damage(f"there is a chunk inside the chunk at byte {self.at}")
        if opcode == _CHUNK:
            self._chunk(body, position)
        elif opcode == _SCHEMA:
            (key,) = struct.unpack_from("<H", body)
            name, at = _text(body, 2)
            _, at = _text(body, at)
            self.schemas[key] = (name, _text(body, at)[0])
        elif opcode == _CHANNEL:
            key, schema = struct.unpack_from("<HH", body)
            topic, at = _text(body, 4)
            msgtype, definition = self.schemas.get(schema, ("", ""))
            empty = Payloads.of([]) if msgtype in self.types else None
            channel = RawTopic(topic, msgtype, _text(body, at)[0], definition, payloads=empty)
            self.channels.setdefault(key, channel)  # the summary repeats the channels of the data section

    def _chunk(self, body: memoryview, position: int) -> None:
        size, crc = struct.unpack_from("<QI", body, 16)
        compression, at = _text(body, 28)
        (packed,) = struct.unpack_from("<Q", body, at)
        if size > MAX_CHUNK:
            raise Damage(f"the chunk at byte {position} claims {size} bytes, expected {MAX_CHUNK} at most")
        self.room.take(size)
        if packed != len(body) - at - 8:
            raise Damage(f"the chunk at byte {position} claims {packed} packed bytes, but has {len(body) - at - 8}")
        data = inflate(body[at + 8 :], compression, size)
        if crc and crc32(data) != crc:
            raise Damage(f"the chunk at byte {position} does not match its checksum")
        runs: list[Run] = []
        try:
            self._walk(memoryview(data), 0, len(data), f" of the chunk at byte {position}", runs)
        except Damage:
            # Without a checksum, damage may have reached any message of packed data, and the last one of plain data.
            runs = [] if compression or not runs else [*runs[:-1], runs[-1][:-1]]
            raise
        finally:
            for run in runs:
                self._keep(np.frombuffer(data, np.uint8), run)


def _text(body: memoryview, at: int) -> tuple[str, int]:
    """A length-prefixed string and where it ends."""
    (size,) = struct.unpack_from("<I", body, at)
    stop = at + 4 + size
    if stop > len(body):
        raise struct.error(f"a text of {size} bytes does not fit into {len(body)}")
    return bytes(body[at + 4 : stop]).decode(), stop


@in_place
def _number(data: NDArray[np.uint8], at: int, count: int) -> Any:
    """Little-endian unsigned number of ``count`` bytes, limited to the largest signed 64 bit number."""
    value = np.int64(0)
    for k in range(count):
        value |= np.int64(data[at + k]) << (8 * k)
    return value if value >= 0 else np.int64(2**63 - 1)


@in_place
def take_messages(data: NDArray[np.uint8], position: int, end: int, run: NDArray[np.int64]) -> tuple[int, int]:
    """Take consecutive complete message records, up to any other record.

    `data`: bytes of the file or chunk (B,). `run`: result (M, 4): channel, log time [ns], first byte and size of the
    payload of each.
    """
    count = 0
    while count < run.shape[0] and position + 9 + MESSAGE_HEAD <= end and data[position] == MESSAGE:
        size = _number(data, position + 1, 8)
        body = position + 9
        if size < MESSAGE_HEAD or size > end - body:
            break
        run[count, CHANNEL_OF] = _number(data, body, 2)
        run[count, LOG] = _number(data, body + 6, 8)
        run[count, BEGIN] = body + MESSAGE_HEAD
        run[count, SIZE] = size - MESSAGE_HEAD
        position = body + size
        count += 1
    return count, position


@in_place
def copy_payloads(data: NDArray[np.uint8], run: NDArray[np.int64], out: NDArray[np.uint8]) -> None:
    """Copy the payloads of messages (N, 4), as :func:`take_messages` gives them, end to end."""
    at = 0
    for k in range(run.shape[0]):
        for j in range(run[k, SIZE]):
            out[at + j] = data[run[k, BEGIN] + j]
        at += run[k, SIZE]
