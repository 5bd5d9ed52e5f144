"""Samples for a monitor from the messages of each topic, and the last minutes of them (without ROS)."""

from __future__ import annotations

import heapq
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.nodes.pairing import Sample, SamplePairing

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

COLUMNS = len(Sample._fields) - 1
"""Both pressures, both voltages and the angle."""
_PATIENCE = 1.0
"""[s] A topic that is behind the others by more is missing."""


class Feed:
    """Pairs messages as the estimator does, and keeps the rows of the last `seconds`.

    `topics`: those that are expected, as of :mod:`~pam_antagonist.nodes.pairing`. `clock`: present time [ns].
    """

    def __init__(self, topics: Sequence[int], seconds: float, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._pairing, self._span = SamplePairing(_PATIENCE, clock, topics), round(seconds * 1e9)
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self._pairing.reset()
        self._parts = deque[tuple[Stamps, Floats]]()

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample; 0 before the first."""
        return int(self._parts[-1][0][-1]) if self._parts else 0

    @property
    def kept(self) -> tuple[Stamps, Floats]:
        """Stamps (N,) [ns] and rows (N, 5) of the last seconds."""
        parts = self._parts
        stamps = np.concatenate([np.zeros(0, np.int64), *(one for one, _ in parts)])
        rows = np.concatenate([np.zeros((0, COLUMNS)), *(one for _, one in parts)])
        inside = stamps > self.newest_ns - self._span
        return stamps[inside], rows[inside]

    @property
    def jumps(self) -> int:
        """How often the clock was set back."""
        return self._pairing.counts.restarts

    def add(self, batches: Mapping[int, Sequence[Sequence[float]]]) -> tuple[Stamps, Floats, bool]:
        """New messages of each topic, each as its stamp [ns] and values.

        Returns the stamps (N,) and rows (N, 5) that are complete, NaN where a topic has no value, and whether the clock
        was set back: then all before is forgotten.
        """
        jumps, samples = self.jumps, list[Sample]()
        # In the order of the stamps hardly any sample waits; each topic keeps its own order.
        topics = [[(message, topic) for message in messages] for topic, messages in batches.items()]
        for (stamp, *values), topic in heapq.merge(*topics, key=lambda item: item[0][0]):
            before = self.jumps
            new = self._pairing.add(topic, int(stamp), *values)
            if self.jumps > before:
                samples.clear()
            samples += new
        samples += self._pairing.expire()
        if self.jumps > jumps:
            self._parts.clear()
        stamps = np.array([sample.stamp_ns for sample in samples], dtype=np.int64)
        rows = np.array([sample[1:] for sample in samples]).reshape(-1, COLUMNS)
        if len(stamps):
            # To join all that is kept with each message would take longer than the monitor itself.
            self._parts.append((stamps, rows))
            while self._parts[0][0][-1] <= self.newest_ns - self._span:
                self._parts.popleft()
        return stamps, rows, self.jumps > jumps
