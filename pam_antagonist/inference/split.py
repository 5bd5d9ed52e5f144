"""Which blocks of a recording are fitted and which are held out, where that is not its first part and its end.

Blocks are held out in turn. Between what is fitted and what is held out lies a buffer as long as the memory of the
residual: what is next to a fitted block is no prediction (Burman, Chow and Nolan 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Split:
    """A split of a recording.

    Attributes:
        fitted: blocks that may be fitted (B,).
        held: blocks that are held out (B,).
        errors_from: sample from which on errors are shown in a report.
    """

    fitted: Mask
    held: Mask
    errors_from: int


def in_turn(
    count: int, splits: int, length: float, buffer: int, errors_from: int, edges: Sequence[int] = ()
) -> tuple[Split, ...]:
    """Splits that hold out blocks in turn, so that each part of a recording is held out once.

    Args:
        count: how many block means the recording has (B).
        splits: how many splits.
        length: of what is held out at once, about [block means].
        buffer: block means on either side of what is held out that are neither fitted nor held out.
        errors_from: sample from which on errors are shown in a report.
        edges: where the recording changes; every part between them is split by itself.
    """
    turn = np.zeros(count, dtype=int)
    bounds = [0, *(edge for edge in edges if splits <= edge <= count - splits), count]
    for begin, end in zip(bounds[:-1], bounds[1:], strict=True):
        pieces = splits * max(round((end - begin) / (splits * length)), 1)
        turn[begin:end] = np.arange(end - begin) * pieces // (end - begin) % splits
    out = []
    for number in range(splits):
        held = turn == number
        near = np.convolve(held, np.ones(2 * buffer + 1), mode="full")[buffer : buffer + count] > 0.0
        out.append(Split(~near, held, errors_from))
    return tuple(out)
