"""Consistent overhead byte stuffing (COBS): encodes bytes without zeros, so that a zero can end a frame.

Cheshire and Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on Networking 7 (1999). Frames here are
too short for the special case of 254 bytes without a zero.
"""

from __future__ import annotations

LONGEST = 253
"""Largest number of bytes to encode, so that there is one byte of overhead and no block of 254."""


def encode(data: bytes) -> bytes:
    """Encode data without zeros; the result is one byte longer.

    Args:
        data: at most ``LONGEST`` bytes.
    """
    if len(data) > LONGEST:
        raise ValueError(f"{len(data)} bytes, expected at most {LONGEST}")
    return b"".join(bytes((len(block) + 1,)) + block for block in data.split(b"\0"))


def decode(encoded: bytes) -> bytes | None:
    """Decode; None for an invalid encoding."""
    if not 0 < len(encoded) <= LONGEST + 1:
        return None
    blocks = []
    position, end = 0, len(encoded)
    while position < end:
        code = encoded[position]
        if code == 0 or position + code > end:
            return None
        blocks.append(encoded[position + 1 : position + code])
        position += code
    return b"\0".join(blocks)
