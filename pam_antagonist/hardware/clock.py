"""Map from the device's clock to the host's.

A sample reaches the host with the least delay of the line, often a little more, sometimes 300 ms more. So host time
over device time has a straight lower bound, whose slope is the ratio of the clocks' rates. The least delay of each
second gives a point, and the map is a robust line under the points of the last 16 s. Stamps approach this line by
running slightly faster or slower, without jumps, so that evenly taken samples are stamped evenly.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import combinations
from statistics import median

_COUNTER = 1 << 32


class Unwrapped:
    """Unwraps a 32-bit counter of microseconds, which wraps around every 71.6 minutes."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._time = 0

    def __call__(self, counter: int) -> int | None:
        """Time since the first call [µs]; None for a counter that went back, as after a restart of the device."""
        if self._last is None:
            self._last = counter
            return 0
        step = (counter - self._last) % _COUNTER
        if step >= _COUNTER // 2:
            return None
        self._last = counter
        self._time += step
        return self._time


class ClockMap:
    """Host time of device times, from the times of arrival of samples.

    Args:
        window_ns: time over which the least delay is searched [ns].
        warm_up_ns: host time from the first arrival until the map is used for stamps [ns].
        largest_rate: largest deviation of the ratio of the clocks' rates from 1 [-]; more is no drift.
        largest_error_ns: largest error of the map that is corrected smoothly [ns]; a larger one restarts the map.
    """

    def __init__(
        self,
        window_ns: int = 1_000_000_000,
        windows: int = 16,
        warm_up_ns: int = 300_000_000,
        largest_rate: float = 1e-3,
        largest_error_ns: int = 20_000_000,
    ) -> None:
        self._window_ns = window_ns
        self._warm_up_ns = warm_up_ns
        self._largest_rate = largest_rate
        self._largest_error_ns = largest_error_ns
        self._points: deque[tuple[int, int]] = deque(maxlen=windows)
        self.restarts = 0
        self._begin()

    def _begin(self) -> None:
        self._points.clear()
        self._best: tuple[int, int] | None = None  # device time and host - device of the least delay in this window
        self._window_end = 0
        self._first_ns: int | None = None
        self._anchor: tuple[int, int] | None = None
        self._rate = self._drift = 0.0

    @property
    def ready(self) -> bool:
        """Whether the warm-up is over."""
        return self._anchor is not None

    @property
    def drift(self) -> float:
        """Relative rate by which the host's clock is faster than the device's [-]; NaN while not known."""
        return self._drift if len(self._points) > 2 else math.nan

    @property
    def offset_s(self) -> float:
        """Host's time minus the device's, now [s]. Only when :attr:`ready`."""
        assert self._anchor is not None
        return (self._anchor[1] - self._anchor[0]) * 1e-9

    def add(self, device_ns: int, host_ns: int) -> None:
        """Take an arrival.

        Args:
            device_ns: time of the sample on the device's clock, increasing [ns].
            host_ns: time of its arrival on the host's clock [ns].
        """
        offset = host_ns - device_ns
        if self._first_ns is None:
            self._first_ns = host_ns
            self._window_end = device_ns + self._window_ns
        if self._best is None or offset < self._best[1]:
            self._best = device_ns, offset
        if self._anchor is None:
            if host_ns - self._first_ns >= self._warm_up_ns:
                self._anchor = device_ns, device_ns + self._best[1]
        elif device_ns >= self._window_end:
            self._points.append(self._best)
            self._best = None
            self._window_end = device_ns + self._window_ns
            self._steer(device_ns)

    def host_ns(self, device_ns: int) -> int:
        """Host time of a device time [ns]; strictly increasing. Only when :attr:`ready`."""
        assert self._anchor is not None
        device, host = self._anchor
        since = device_ns - device
        return host + since + round(since * self._rate)

    def _steer(self, now_ns: int) -> None:
        """Set the rate so that the map meets the line at the end of the next window."""
        if len(self._points) > 2:
            self._drift = self._clipped(
                median((b[1] - a[1]) / (b[0] - a[0]) for a, b in combinations(self._points, 2) if b[0] != a[0])
            )
        target = now_ns + self._window_ns
        below = min(offset + self._drift * (target - at) for at, offset in self._points)
        here = self.host_ns(now_ns)
        error = target + below - (here + self._window_ns)
        if abs(error) > self._largest_error_ns:
            self.restarts += 1
            self._begin()
            return
        self._anchor = now_ns, here
        self._rate = self._clipped(error / self._window_ns)

    def _clipped(self, rate: float) -> float:
        return min(max(rate, -self._largest_rate), self._largest_rate)
