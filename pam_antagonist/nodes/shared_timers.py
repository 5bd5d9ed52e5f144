"""Many timers of several nodes behind one timer of the executor (without ROS).

Waking up costs an executor more than most callbacks. Six joints have some fifty timers, which would wake it 5000 times
a second. With one shared timer it wakes up 1000 times a second.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

_EARLY = 500_000  # [ns] by which a call may come early; otherwise it would come up to a tick late


@dataclass(eq=False)
class Entry:
    """One timer.

    Attributes:
        period_ns: time between two calls [ns].
        next_ns: steady time of the next call [ns].
    """

    period_ns: int
    callback: Callable[[], object]
    next_ns: int


class SharedTimers:
    """Calls each timer when its period has passed. Missed periods are skipped, as in ROS.

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
        """Add a timer.

        Args:
            period: time between two calls [s].
        """
        period_ns = round(period * 1e9)
        entry = Entry(period_ns, callback, self._clock() + period_ns)
        self._entries = [*self._entries, entry]
        return entry

    def remove(self, entry: Entry) -> None:
        """Remove a timer."""
        self._entries = [other for other in self._entries if other is not entry]

    def run(self) -> None:
        """Call all due timers; called by the executor's timer every millisecond."""
        now = self._clock()
        for entry in self._entries:  # the present list; a callback may replace it
            if now >= entry.next_ns - _EARLY:
                behind = now - entry.next_ns
                entry.next_ns += entry.period_ns * (1 + max(behind, 0) // entry.period_ns)
                entry.callback()
