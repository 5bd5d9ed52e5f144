"""Frames: a payload with its check sum, byte-stuffed, and a zero at the end."""

from __future__ import annotations

import zlib

from pam_antagonist.hardware import cobs

CRC_BYTES = 4
LONGEST_PAYLOAD = cobs.LONGEST - CRC_BYTES
_LONGEST_FRAME = cobs.LONGEST + 1  # stuffed, without the zero


def frame(payload: bytes) -> bytes:
    """The frame on the wire of a payload of at most ``LONGEST_PAYLOAD`` bytes.

    The check sum is the CRC-32 of IEEE 802.3 (reflected, 0xEDB88320, start and end inverted), least byte first.
    Sixteen bits are not enough: if one byte in a hundred is damaged, so are about 300 of the 1000 frames a second. One
    in 65536 of these would be accepted, which is a wrong voltage every few minutes.
    """
    return cobs.encode(payload + zlib.crc32(payload).to_bytes(CRC_BYTES, "little")) + b"\0"


class FrameReader:
    """Finds the valid frames in a stream of bytes that may be damaged and may begin anywhere.

    Attributes:
        damaged: number of frames that were cut, wrongly stuffed, too long, or had a wrong check sum.
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
    decoded = cobs.decode(piece)
    if decoded is None or len(decoded) <= CRC_BYTES:
        return None
    payload, check = decoded[:-CRC_BYTES], decoded[-CRC_BYTES:]
    return payload if zlib.crc32(payload).to_bytes(CRC_BYTES, "little") == check else None
