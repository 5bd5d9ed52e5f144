"""Health and statistics of a node for ``/diagnostics`` (without ROS)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum


class Level(IntEnum):
    """The levels of ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Health:
    """The state of one part of a node."""

    level: Level
    message: str
    values: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Spread:
    """Median, 99th percentile and maximum of some values; NaN without values.

    Attributes:
        p99: 99th percentile.
    """

    count: int
    median: float
    p99: float
    largest: float

    def as_values(self, name: str, unit: str, scale: float = 1.0) -> dict[str, str]:
        """Entries for ``Health.values``."""
        return {
            f"{name} median [{unit}]": f"{self.median / scale:.3f}",
            f"{name} 99th percentile [{unit}]": f"{self.p99 / scale:.3f}",
            f"{name} largest [{unit}]": f"{self.largest / scale:.3f}",
        }


class Window:
    """Collects values between two reports."""

    def __init__(self, limit: int = 20_000) -> None:
        self._values: list[float] = []
        self._limit = limit

    def add(self, value: float) -> None:
        """Add a value; values beyond the limit are left out."""
        if len(self._values) < self._limit:
            self._values.append(value)

    def take(self) -> Spread:
        """Statistics of the values since the last call."""
        values = sorted(self._values)
        self._values.clear()
        if not values:
            return Spread(0, math.nan, math.nan, math.nan)
        last = len(values) - 1
        return Spread(len(values), values[last // 2], values[math.ceil(0.99 * last)], values[last])


class Rate:
    """Rate of events [1/s]."""

    def __init__(self) -> None:
        self._count = 0
        self._since: int | None = None

    def take(self, count: int, now_ns: int) -> float:
        """Rate [1/s] since the last call; NaN at the first.

        Args:
            now_ns: steady time [ns].
        """
        if self._since is None or now_ns <= self._since:
            rate = math.nan
        else:
            rate = (count - self._count) / (now_ns - self._since) * 1e9
        self._count, self._since = count, now_ns
        return rate
