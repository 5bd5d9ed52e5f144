"""What has come of the topics of a sample, and why no samples come of it (without ROS)."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from pam_antagonist.recording.stamps import LARGEST_DELAY, ONE_STAMP, unstamped
from pam_antagonist.shown import listed

_RECENT = 200
"""Stamps of each topic that are kept. At 1 kHz these are 0.2 s: topics may be that far apart in the queues."""
_FEWEST, _CROWDED = 10, 0.75
"""Of so many messages it is judged whether they are several nodes': these are half a period apart on average."""
_MOST = 0.5
"""Share of the stamps of a topic that another one has to share; lost messages are fewer."""


class Arrivals:
    """Keeps the last stamps of each topic. `topics`: those of a sample, as numbers."""

    def __init__(self, topics: Sequence[int]) -> None:
        self._recent = {topic: deque[int](maxlen=_RECENT) for topic in topics}

    def add(self, topic: int, stamp_ns: int) -> None:
        """A message of a topic, with its stamp [ns]."""
        self._recent[topic].append(stamp_ns)

    def take(self) -> dict[int, np.ndarray]:
        """The last stamps of each topic (N,) [ns] since the last call; none where it had no message."""
        out = {topic: np.array(stamps, dtype=np.int64) for topic, stamps in self._recent.items()}
        for stamps in self._recent.values():
            stamps.clear()
        return out


def mixed(stamps: np.ndarray, period: float) -> bool:
    """Whether more messages come than one node sends. `stamps`: in the order of arrival (N,) [ns]. `period`: [s]."""
    if len(stamps) < _FEWEST:
        return False
    steps = np.diff(stamps) * 1e-9
    return bool(np.mean(np.clip(steps, 0.0, period)) < _CROWDED * period)


def disagreement(recent: Mapping[str, np.ndarray]) -> str:
    """What is wrong with the stamps of the topics of a sample, in words; empty if nothing is.

    `recent`: the last stamps of each topic (N,) [ns], at least one.
    """
    still = [name for name, stamps in recent.items() if len(stamps) > 1 and np.ptp(stamps) == 0]
    if zero := [name for name in still if not recent[name][0]]:
        return unstamped(listed(zero))
    if still:
        value = recent[still[0]][0] * 1e-9
        return f"every message of {listed(still)} has the stamp {value:.9g} s, expected the time of the sample"
    (first, base), *others = recent.items()
    apart = [(name, _apart(base, stamps)) for name, stamps in others if _shared(base, stamps) < _MOST]
    if not apart:
        return ""
    parts = [f"{name} {_time(abs(by))} {'after' if by > 0 else 'before'} {first}" for name, by in apart]
    clocks = " (two clocks)" if max(abs(by) for _, by in apart) > LARGEST_DELAY * 1e9 else ""
    return f"messages come, but no stamp of theirs is the same: {listed(parts)}{clocks}; {ONE_STAMP}"


def _shared(base: np.ndarray, stamps: np.ndarray) -> float:
    """Share of the stamps, within the time of the others, that the others have as well; 0 where there is none."""
    inside = stamps[(stamps >= base.min()) & (stamps <= base.max())]
    return float(np.isin(inside, base).mean()) if len(inside) else 0.0


def _apart(base: np.ndarray, stamps: np.ndarray) -> int:
    """Median of the times from the nearest stamp of the others to each stamp [ns]."""
    distance = stamps[:, None] - base[None, :]
    return int(np.median(distance[np.arange(len(stamps)), np.abs(distance).argmin(axis=1)]))


def _time(ns: int) -> str:
    """A time with a unit that suits it."""
    for scale, unit in ((1e9, "s"), (1e6, "ms"), (1e3, "us")):
        if ns >= scale:
            return f"{ns / scale:.3g} {unit}"
    return f"{ns} ns"
