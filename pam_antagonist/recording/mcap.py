"""MCAP files, read record by record (https://mcap.dev/spec).

This module scans the file from front to back, unlike rosbags' indexed reader, for three reasons. A recording that was
cut off has no index, but all messages up to the cut; and behind damage, the scan goes on at the next whole chunk. Every
length is checked against the size of the file before memory is allocated. And a compiled kernel takes consecutive
messages as one block. The scan never uses the index.
"""

from __future__ import annotations

import math
import mmap
import re
import struct
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from .cdr import Channel, Collector, Payloads, RawTopic
from .compression import MAX_MESSAGE, CompressionError, Room, inflate

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


class Damage(Exception):
    """The file is damaged; the text says where and how."""


@dataclass
class McapContents:
    """Result of a scan."""

    topics: list[RawTopic]  # One entry for each channel, with payloads only of the requested message types
    # Where and why the file is damaged first, or None for a whole file. ``topics`` holds all messages before it, and
    # those in whole chunks behind it.
    damage: str | None
    lost: list[Lost] = field(default_factory=list)


@dataclass
class Lost:
    """A part of a file that could not be read."""

    begin: int
    end: int
    # when the last message before it was received, from the first message that was read on [s]; NaN for none.
    since: float = math.nan
    until: float = math.nan  # when the first message behind it was received [s]; NaN for none


def scan_mcap(path: Path, types: Collection[str], room: Room | None = None) -> McapContents:
    """Read all messages of the given types.

    `types`: Message types whose payloads are wanted; messages of other types are only counted. `room`: Limit on
    unpacked bytes; None for the limit of this file alone.
    """
    with path.open("rb") as file:
        if path.stat().st_size == 0:
            return McapContents([], "it is empty")
        view = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    scan = _Scan(types, room or Room(len(view)))
    damage, position = None, len(MAGIC)
    while True:
        try:
            if bytes(view[: len(MAGIC)]) != MAGIC:
                raise Damage("it does not start like an MCAP file")
            scan.walk(view, position, len(view))
            if not scan.finished:
                raise Damage(f"it ends at byte {len(view)} without a footer")
        except Damage as exc:
            damage = damage or str(exc)
            scan.chunk_at = None
            begin, position = scan.at, _next_chunk(view, scan.at + 1)
            if position:
                scan.declare(view)
                scan.lost.append((Lost(begin, position), scan.counts()))
                continue
        return scan.contents(damage)


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
    types: Collection[str]
    room: Room
    schemas: dict[int, tuple[str, str]] = field(default_factory=dict)
    collectors: dict[int, Collector] = field(default_factory=dict)
    chunk_at: int | None = None
    finished: bool = False
    at: int = 0  # the record of the file that is being read
    latest: Collector | None = None  # that of the last message
    lost: list[tuple[Lost, dict[int, int]]] = field(default_factory=list)  # with the number of messages before each

    def counts(self) -> dict[int, int]:
        """Number of messages of each channel so far."""
        return {key: len(collector) for key, collector in self.collectors.items()}

    def contents(self, damage: str | None) -> McapContents:
        """All that was read, and when the damaged parts were received."""
        topics = {key: collector.finish() for key, collector in self.collectors.items()}
        first = min((int(topic.log_ns.min()) for topic in topics.values() if len(topic.log_ns)), default=0)
        for part, counts in self.lost:
            before = [topic.log_ns[: counts.get(key, 0)] for key, topic in topics.items()]
            after = [topic.log_ns[counts.get(key, 0) :] for key, topic in topics.items()]
            part.since = max(((times.max() - first) * 1e-9 for times in before if len(times)), default=math.nan)
            part.until = min(((times.min() - first) * 1e-9 for times in after if len(times)), default=math.nan)
        return McapContents(list(topics.values()), damage, [part for part, _ in self.lost])

    def declare(self, view: memoryview) -> None:
        """Take schemas and channels from the summary, where the part that declares them is damaged."""
        foot = len(view) - len(MAGIC) - 29
        if foot > 0 and view[foot] == _FOOTER:
            (start,) = struct.unpack_from("<Q", view, foot + 9)
            if 0 < start < foot:
                with suppress(Damage):
                    self.walk(view, start, foot)

    def walk(self, view: memoryview, position: int, end: int) -> None:
        """Scan the records of the file or, in a recursive call, of one chunk."""
        # Imported here because numba takes a quarter of a second, which writing a bag does not need.
        from .mcap_records import take_messages

        head = struct.Struct("<BQ").unpack_from
        data = np.frombuffer(view, np.uint8)
        run = np.empty((min(_RUN, end // (9 + MESSAGE_HEAD) + 1), 4), np.int64)
        while position < end:
            self.at = position if self.chunk_at is None else self.at
            count, position = take_messages(data, position, end, run)
            if count:
                self._take(data, run[:count])
                continue
            if end - position < 9:
                raise Damage(f"a record is cut off {self._at(position)}")
            opcode, size = head(view, position)
            body = position + 9
            stop = body + size
            if opcode == 0:
                raise Damage(f"there is no record {self._at(position)}")
            if stop > end:
                record = f"{_NAMES.get(opcode, 'unknown')} record {self._at(position)}"
                raise Damage(f"the {record} has {size} bytes, of which {end - body} are there")
            if opcode == MESSAGE:
                raise Damage(f"a message record {self._at(position)} has {size} bytes, expected 22 or more")
            if opcode == _FOOTER and self.chunk_at is None:
                self.finished = bytes(view[stop : stop + len(MAGIC)]) == MAGIC
                break
            self._record(opcode, view[body:stop], position)
            position = stop

    def _take(self, data: NDArray[np.uint8], run: NDArray[np.int64]) -> None:
        """Add a block of consecutive messages, as :func:`take_messages` gives them."""
        from .mcap_records import copy_payloads

        wrong = [(int(np.argmax(of)), why) for of, why in self._wrong(run) if of.any()]
        first, why = min(wrong, default=(len(run), ""))
        if first:
            self.latest = self.collectors[int(run[first - 1, CHANNEL_OF])]
        for channel in np.unique(run[:first, CHANNEL_OF]):
            collector, its = self.collectors[int(channel)], run[:first][run[:first, CHANNEL_OF] == channel]
            payloads = None
            if collector.wanted:
                payloads = Payloads(np.empty(its[:, SIZE].sum(), np.uint8), its[:, SIZE].copy())
                copy_payloads(data, its, payloads.data)
            collector.add(its[:, LOG].copy(), payloads)
        if wrong:
            size = int(run[first, SIZE]) + MESSAGE_HEAD
            at = self._at(int(run[first, BEGIN]) - MESSAGE_HEAD - 9)
            raise Damage(why.format(at=at, size=size))

    def _wrong(self, run: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.bool_], str]]:
        """Masks of wrong messages (N,), each with the error text for its first message."""
        for channel in np.unique(run[:, CHANNEL_OF]):
            of, collector = run[:, CHANNEL_OF] == channel, self.collectors.get(int(channel))
            if collector is None:
                yield of, f"a message {{at}} belongs to channel {channel}, which is not declared"
            elif collector.wanted:
                too_large = of & (run[:, SIZE] + MESSAGE_HEAD > MAX_MESSAGE)
                yield too_large, f"a message of {collector.channel.msgtype} {{at}} has {{size}} bytes"

    def _at(self, position: int) -> str:
        return f"at byte {position}" + ("" if self.chunk_at is None else f" of the chunk at byte {self.chunk_at}")

    def _record(self, opcode: int, body: memoryview, position: int) -> None:
        try:
            if opcode == _CHUNK:
                self._chunk(body, position)
            elif opcode == _SCHEMA:
                (key,) = struct.unpack_from("<H", body)
                name, at = _text(body, 2)
                _, at = _text(body, at)
                definition, _ = _text(body, at)
                self.schemas[key] = (name, definition)
            elif opcode == _CHANNEL:
                self._channel(body)
        except (struct.error, UnicodeDecodeError, CompressionError) as exc:
            name = _NAMES[opcode]
            raise Damage(f"the {name} record {self._at(position)} is damaged ({exc})") from exc

    def _channel(self, body: memoryview) -> None:
        key, schema = struct.unpack_from("<HH", body)
        if key in self.collectors:  # the summary repeats the channels of the data section
            return
        topic, at = _text(body, 4)
        encoding, _ = _text(body, at)
        msgtype, definition = self.schemas.get(schema, ("", ""))
        channel = Channel(topic, msgtype, encoding, definition=definition)
        self.collectors[key] = Collector(channel, msgtype in self.types)

    def _chunk(self, body: memoryview, position: int) -> None:
        if self.chunk_at is not None:
            raise Damage(f"there is a chunk inside the chunk at byte {self.chunk_at}")
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
        self.chunk_at = position
        counts, self.latest = self.counts(), None
        try:
            self.walk(memoryview(data), 0, len(data))
        except Damage:
            # Without a checksum, damage may have reached any message of packed data, and the last one of plain data.
            for key, collector in self.collectors.items():
                collector.cut(counts.get(key, 0) if compression else len(collector) - (collector is self.latest))
            raise
        self.chunk_at = None


def _text(body: memoryview, at: int) -> tuple[str, int]:
    """A length-prefixed string and where it ends."""
    (size,) = struct.unpack_from("<I", body, at)
    stop = at + 4 + size
    if stop > len(body):
        raise struct.error(f"a text of {size} bytes does not fit into {len(body)}")
    return bytes(body[at + 4 : stop]).decode(), stop
