"""Decompression with a limit on the unpacked size."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

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
