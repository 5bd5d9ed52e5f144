"""Frames: a payload with its check sum, stuffed, and a zero behind it."""

from __future__ import annotations

import zlib

from pam_antagonist.hardware import cobs

CRC_BYTES = 4
LONGEST_PAYLOAD = cobs.LONGEST - CRC_BYTES
_LONGEST_FRAME = cobs.LONGEST + 1  # stuffed, without the zero


def frame(payload: bytes) -> bytes:
    """What goes over the wire for a payload of at most ``LONGEST_PAYLOAD`` bytes.

    The check sum is the CRC-32 of IEEE 802.3 (reflected, 0xEDB88320, start and end inverted), least byte first.
    Sixteen bits would not do: where one byte in a hundred is damaged, some 300 of the 1000 frames a second are, and
    one of 65536 of those would pass for a good one: a wrong voltage every few minutes.
    """
    return cobs.encode(payload + zlib.crc32(payload).to_bytes(CRC_BYTES, "little")) + b"\0"


class FrameReader:
    """Finds the good frames in a stream of bytes, wherever it begins and whatever is wrong with it.

    Attributes:
        damaged: frames so far that were cut, stuffed wrongly, too long, or did not fit their check sum.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self._rest = b""
        self._skip = False

    def feed(self, data: bytes) -> list[bytes]:
        """Take what came.

        Args:
            data: bytes, in any portions.

        Returns:
            Payloads of the frames that are complete and good, in order.
        """
        *pieces, rest = (self._rest + data).split(b"\0")
        payloads = []
        for piece in pieces:
            if self._skip:  # the end of something too long, counted already
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
        """Forget a frame that has only begun: another sender speaks from here on."""
        self._rest, self._skip = b"", False


def _checked(piece: bytes) -> bytes | None:
    decoded = cobs.decode(piece)
    if decoded is None or len(decoded) <= CRC_BYTES:
        return None
    payload, check = decoded[:-CRC_BYTES], decoded[-CRC_BYTES:]
    return payload if zlib.crc32(payload).to_bytes(CRC_BYTES, "little") == check else None
