"""Consistent overhead byte stuffing: bytes without zeros, so that a zero can end a frame.

Cheshire and Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on Networking 7 (1999). Frames here are
short, so that the case of 254 bytes in a row without a zero, which needs a block of its own, does not come up.
"""

from __future__ import annotations

LONGEST = 253
"""Most bytes that are encoded: one byte of overhead, no block of 254."""


def encode(data: bytes) -> bytes:
    """The data without zeros, one byte longer.

    Args:
        data: at most ``LONGEST`` bytes.

    Raises:
        ValueError: more than that.
    """
    if len(data) > LONGEST:
        raise ValueError(f"{len(data)} bytes, expected at most {LONGEST}")
    return b"".join(bytes((len(block) + 1,)) + block for block in data.split(b"\0"))


def decode(encoded: bytes) -> bytes | None:
    """What was encoded; None where this is no encoding of anything.

    Args:
        encoded: what stood between two zeros on the wire.
    """
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
