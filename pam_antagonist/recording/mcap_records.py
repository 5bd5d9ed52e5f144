"""Message records of an MCAP file, many at a time; compiled because a recording has about a million."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import in_place

from .mcap import BEGIN, CHANNEL_OF, LOG, MESSAGE, MESSAGE_HEAD, SIZE


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
