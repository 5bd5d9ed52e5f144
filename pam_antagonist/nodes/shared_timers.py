"""Timers of many nodes behind one (no ROS in here).

Being woken costs the executor more than most callbacks take. Six joints have some fifty timers, and would be woken 5000
times a second; with this, 1000 times.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

_EARLY = 500_000  # by which a call may come too early, rather than a whole tick too late [ns]


@dataclass(eq=False)
class Entry:
    """One timer.

    Attributes:
        period_ns: between two calls [ns].
        callback: what is called.
        next_ns: steady time of the next call [ns].
    """

    period_ns: int
    callback: Callable[[], object]
    next_ns: int


class SharedTimers:
    """Calls each timer once its period has passed. Periods that were missed are left out, as ROS does.

    Args:
        clock: steady time [ns].

    Example:
        >>> now, calls = [0], []
        >>> timers = SharedTimers(lambda: now[0])
        >>> entry = timers.add(0.002, lambda: calls.append(now[0]))
        >>> for now[0] in range(0, 9_000_000, 1_000_000):
        ...     timers.run()
        >>> calls
        [2000000, 4000000, 6000000, 8000000]
    """

    def __init__(self, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._clock = clock
        self._entries: list[Entry] = []

    def add(self, period: float, callback: Callable[[], object]) -> Entry:
        """Call something from now on.

        Args:
            period: between two calls [s].
            callback: without arguments.
        """
        period_ns = round(period * 1e9)
        entry = Entry(period_ns, callback, self._clock() + period_ns)
        self._entries = [*self._entries, entry]
        return entry

    def remove(self, entry: Entry) -> None:
        """Do not call it any more."""
        self._entries = [other for other in self._entries if other is not entry]

    def run(self) -> None:
        """Call what is due; the one timer behind all of them calls this, once a millisecond."""
        now = self._clock()
        for entry in self._entries:  # of this moment: a callback may add and remove
            if now >= entry.next_ns - _EARLY:
                behind = now - entry.next_ns
                entry.next_ns += entry.period_ns * (1 + max(behind, 0) // entry.period_ns)
                entry.callback()
