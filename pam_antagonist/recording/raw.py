"""Messages of a bag as they are stored: bytes by topic, before anything is decoded; unpacked up to a limit."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from numpy.typing import NDArray

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd


@dataclass(frozen=True)
class Payloads:
    """Raw messages of one topic, end to end."""

    data: NDArray[np.uint8]  # all payloads (B,)
    length: NDArray[np.int64]  # of each payload (N,) [bytes]

    @classmethod
    def of(cls, messages: Sequence[bytes | bytearray | memoryview]) -> Payloads:
        """Join a list of payloads."""
        length = np.fromiter(map(len, messages), np.int64, len(messages))
        return cls(np.frombuffer(b"".join(messages), np.uint8), length)

    @classmethod
    def joined(cls, parts: Sequence[Payloads]) -> Payloads:
        """Join blocks of payloads."""
        if len(parts) == 1:
            return parts[0]
        data = np.concatenate([part.data for part in parts])
        return cls(data, np.concatenate([part.length for part in parts]))

    def __len__(self) -> int:
        return len(self.length)

    def each(self) -> Iterator[memoryview]:
        """The messages one by one."""
        view = self.data.data
        for end, size in zip(self.length.cumsum().tolist(), self.length.tolist(), strict=True):
            yield view[end - size : end]


@dataclass(frozen=True)
class RawTopic:
    """Messages of one topic, in the order of the file."""

    topic: str
    msgtype: str  # such as "sensor_msgs/msg/FluidPressure"; "" where the bag does not say
    encoding: str  # "cdr" for ROS 2
    definition: str = ""
    digest: str = ""  # RIHS01 hash of the type, or ""
    log_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))  # times of reception (N,) [ns]
    payloads: Payloads | None = None  # the messages, or None where this type was not requested

    def __len__(self) -> int:
        return len(self.log_ns)

    def joined(self, others: Sequence[RawTopic]) -> RawTopic:
        """This topic with the messages of others behind it: files of a split bag, several publishers."""
        if not others:
            return self
        every = (self, *others)
        payloads = [part.payloads for part in every if part.payloads is not None]
        return replace(
            self,
            log_ns=np.concatenate([part.log_ns for part in every]),
            payloads=Payloads.joined(payloads) if len(payloads) == len(every) else None,
        )


@dataclass
class RawBag:
    """A bag as raw messages."""

    path: Path
    # Topic name -> messages; of several message types the one with most messages.
    topics: dict[str, RawTopic] = field(default_factory=dict)
    # Topic name -> its message types, for topics with more than one.
    conflicts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    issues: list[str] = field(default_factory=list)


ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAX_MESSAGE = 1 << 20
"""Largest message that is read [bytes]; the largest of this package has 400."""

_PIECE = 1 << 20  # [bytes]
_ROOM, _RATIO = 64 << 20, 20  # a file may unpack to this many bytes, plus this many for each of its own


class CompressionError(ValueError):
    """Compressed data that are damaged, or larger than they claimed."""


def most_unpacked(size: int) -> int:
    """Bytes that ``size`` bytes may unpack to; recordings shrink by a factor of 2 to 15."""
    return _ROOM + _RATIO * size


class Room:
    """Bytes that the files of one bag may unpack to in total. `size`: of all files [bytes]."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._left = most_unpacked(size)

    def take(self, size: int) -> None:
        """Use up a number of bytes."""
        self._left -= size
        if self._left < 0:
            raise CompressionError(f"{self._size} bytes unpack to more than {most_unpacked(self._size)}")


def inflate(data: bytes | memoryview, compression: str, size: int) -> bytes:
    """Unpack a block of "", "zstd" or "lz4" (frame format) whose unpacked size is known; no more is ever allocated."""
    if compression == "":
        result = bytes(data)
    elif compression in ("zstd", "lz4"):
        decompressor: Any = zstd.ZstdDecompressor() if compression == "zstd" else LZ4FrameDecompressor()
        try:
            result = decompressor.decompress(data, max_length=size + 1)
        except (zstd.ZstdError, RuntimeError, EOFError) as exc:
            raise CompressionError(str(exc)) from exc
        if len(result) == size and not decompressor.eof:
            raise CompressionError(f"{compression} data end early")
    else:
        raise CompressionError(f"compression {compression!r} is not known, expected zstd, lz4 or none")
    if len(result) != size:
        more = "more" if len(result) > size else str(len(result))
        raise CompressionError(f"{size} bytes were announced, {more} are there")
    return result


def inflate_message(data: bytes | memoryview, limit: int = MAX_MESSAGE) -> bytes:
    """Unpack one zstd-compressed message of at most ``limit`` bytes."""
    decompressor = zstd.ZstdDecompressor()
    try:
        result = decompressor.decompress(data, max_length=limit)
    except zstd.ZstdError as exc:
        raise CompressionError(str(exc)) from exc
    if not decompressor.eof:
        raise CompressionError(f"a message is cut off or larger than {limit} bytes")
    return result


def inflate_file(source: Path, target: Path, limit: int) -> str | None:
    """Unpack a zstd file piece by piece, and say how it is damaged; ``target`` then holds the data before that."""
    written = 0
    decompressor = zstd.ZstdDecompressor()
    with source.open("rb") as infile, target.open("wb") as outfile:
        while True:
            piece = b""
            if decompressor.eof:  # a file may hold several frames
                piece = decompressor.unused_data or infile.read(_PIECE)
                if not piece:
                    return None
                decompressor = zstd.ZstdDecompressor()
            elif decompressor.needs_input:
                piece = infile.read(_PIECE)
                if not piece:
                    return f"its zstd data end early, after {source.stat().st_size} bytes"
            try:
                unpacked = decompressor.decompress(piece, max_length=_PIECE)
            except zstd.ZstdError as exc:
                return f"its zstd data are damaged ({exc})"
            written += outfile.write(unpacked)
            if written > limit:
                raise CompressionError(f"it unpacks to more than {limit >> 20} MiB; unpack it with zstd -d first")


def unpack_messages(raw: RawTopic) -> Payloads:
    """The messages without rosbag2's message compression; a plain one never starts with the magic number of zstd."""
    payloads = raw.payloads
    assert payloads is not None
    if not len(payloads) or payloads.data[:4].tobytes() != ZSTD_MAGIC:
        return payloads
    messages, room = [], Room(payloads.data.nbytes)
    for packed in payloads.each():
        messages.append(inflate_message(packed))
        room.take(len(messages[-1]))
    return Payloads.of(messages)
