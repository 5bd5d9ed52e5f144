"""Samples for a monitor from the messages of each topic, in batches, and the last minutes of them (without ROS)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation.stamps import RESTART_AFTER_NS

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

PLACES = (slice(0, 1), slice(1, 2), slice(2, 4), slice(4, 5))
"""Columns of pressure 1, pressure 2, valves and angle in a row."""
COLUMNS = 5
_PATIENCE_NS = 1_000_000_000
"""A topic that is behind the others by more is missing."""


class Feed:
    """Pairs messages by their stamps, and keeps the rows of the last `seconds`.

    `places`: topics that are expected, as indices of ``PLACES``.
    """

    def __init__(self, places: Sequence[int], seconds: float) -> None:
        self._places, self._span = tuple(places), round(seconds * 1e9)
        self.jumps = 0
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self._waiting = {place: (np.zeros(0, np.int64), np.zeros((0, COLUMNS))) for place in self._places}
        self.stamps, self.rows = np.zeros(0, np.int64), np.zeros((0, COLUMNS))

    def add(self, batches: dict[int, list[Sequence[float]]]) -> tuple[Stamps, Floats, bool]:
        """New messages of each topic, each as its stamp [ns] and values.

        Returns the stamps (N,) and rows (N, 5) that are complete, NaN where a topic has no value, and whether the clock
        was set back: then all before is forgotten.
        """
        last = int(self.stamps[-1]) if len(self.stamps) else None
        for place, messages in batches.items():
            if messages and last is not None and min(message[0] for message in messages) < last - RESTART_AFTER_NS:
                self.jumps += 1
                self.reset()
                newest = {place: [one for one in many if one[0] < last] for place, many in batches.items()}
                return (*self._paired(newest), True)
        return (*self._paired(batches), False)

    def _paired(self, batches: dict[int, list[Sequence[float]]]) -> tuple[Stamps, Floats]:
        for place, messages in batches.items():
            if not messages:
                continue
            stamps, rows = self._waiting[place]
            values = np.full((len(messages), COLUMNS), np.nan)
            values[:, PLACES[place]] = [message[1:] for message in messages]
            new = np.array([message[0] for message in messages], dtype=np.int64)
            self._waiting[place] = np.append(stamps, new), np.concatenate([rows, values])
        heads = [int(stamps.max()) if len(stamps) else None for stamps, _ in self._waiting.values()]
        known = [head for head in heads if head is not None]
        if not known:
            return np.zeros(0, np.int64), np.zeros((0, COLUMNS))
        behind = max(known) - _PATIENCE_NS
        until = max(min(known), behind) if len(known) == len(heads) else behind
        stamps = np.unique(np.concatenate([stamps[stamps <= until] for stamps, _ in self._waiting.values()]))
        if len(self.stamps):
            stamps = stamps[stamps > self.stamps[-1]]
        rows = np.full((len(stamps), COLUMNS), np.nan)
        for place, (own, values) in self._waiting.items():
            here = np.searchsorted(stamps, own)
            here[here == len(stamps)] = 0
            if len(stamps):
                hit = stamps[here] == own
                rows[here[hit], PLACES[place]] = values[hit, PLACES[place]]
            self._waiting[place] = own[own > until], values[own > until]
        if len(stamps):
            whole, all_rows = np.append(self.stamps, stamps), np.concatenate([self.rows, rows])
            kept = whole > whole[-1] - self._span
            self.stamps, self.rows = whole[kept], all_rows[kept]
        return stamps, rows
