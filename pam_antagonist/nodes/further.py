"""Further signals of a rig's model, live: the topics that carry them, and their values at the samples.

A further signal is a neighbour's pressure or angle, or a temperature. The rig file names it, and knows no type: the
topic ``also/NAME``, or one that is named in full, is looked for until it is there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from pam_antagonist.nodes import qos
from pam_antagonist.nodes.health import Health, Level, judged
from pam_antagonist.nodes.wire import class_of
from pam_antagonist.recording.signals import KINDS, topic_of
from pam_antagonist.recording.topics import ALSO
from pam_antagonist.shown import listed

if TYPE_CHECKING:
    from rclpy.node import Node

    from pam_antagonist.nodes.node import PamNode

_HELD_NS = 1_000_000_000
"""For so long a value holds of a signal whose stamps are not those of the samples."""
_LOOK = 1.0
"""[s] Time between two looks for the topics."""
_KEPT = 1000
"""Final samples whose stamps are remembered, for messages that come late."""


class SignalValues:
    """The values of further signals at the samples, in the order of the rig file.

    As a replay reads them: of a signal that mostly has the samples' stamps the value with the sample's own stamp
    counts, of another one the last value. NaN where there is none.

    `count`: of the signals.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self.missing = [0] * count
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self._waiting = [deque[tuple[int, float]]() for _ in range(self._count)]
        self._last = [(0, math.nan)] * self._count
        self._newest, self._seen, self._shared = ([0] * self._count for _ in range(3))
        self._comes = [False] * self._count  # whether it is waited for
        self._final, self._order = set[int](), deque[int]()

    def add(self, signal: int, stamp_ns: int, value: float) -> None:
        """Add a message. `signal`: its number, from 0. `value`: [SI]."""
        if stamp_ns < self._newest[signal]:
            self._waiting[signal].clear()  # its clock was set back
        self._newest[signal], self._comes[signal] = stamp_ns, True
        if stamp_ns in self._final:
            self._seen[signal] += 1
            self._shared[signal] += 1
            self._last[signal] = stamp_ns, value
        else:
            self._waiting[signal].append((stamp_ns, value))

    def has_samples_stamps(self, signal: int) -> bool:
        """Whether most of its messages so far have the stamp of a sample."""
        return 0 < self._seen[signal] <= 2 * self._shared[signal]

    def ready(self, last_ns: int) -> int:
        """Up to which sample all signals have come that are waited for: those that share the samples' stamps.

        `last_ns`: the last sample of which all else has come.
        """
        waited_for = (
            newest for k, newest in enumerate(self._newest) if self._comes[k] and self.has_samples_stamps(k)
        )  # fmt: skip
        return min([last_ns, *waited_for])

    def give_up(self, before_ns: int) -> None:
        """Wait no longer for signals without a message since a stamp [ns], until their next one."""
        for k, newest in enumerate(self._newest):
            self._comes[k] = self._comes[k] and newest >= before_ns

    def at(self, stamp_ns: int) -> tuple[float, ...]:
        """Values at a sample, which is final now."""
        self._final.add(stamp_ns)
        self._order.append(stamp_ns)
        if len(self._order) > _KEPT:
            self._final.discard(self._order.popleft())
        return tuple(self._value(k, stamp_ns) for k in range(self._count))

    def _value(self, signal: int, stamp_ns: int) -> float:
        waiting = self._waiting[signal]
        while waiting and waiting[0][0] <= stamp_ns:
            self._last[signal] = waiting.popleft()
            self._seen[signal] += 1
            self._shared[signal] += self._last[signal][0] == stamp_ns
        at, value = self._last[signal]
        if at != stamp_ns and (self.has_samples_stamps(signal) or not 0 <= stamp_ns - at <= _HELD_NS):
            value = math.nan
        self.missing[signal] += math.isnan(value)
        return value


class SignalTopics:
    """Subscriptions of further signals, each made as soon as its topic is there.

    `names`: as in the rig file. `take`: gets the signal's number, and stamp [ns] and value [SI] of each message.
    """

    def __init__(self, node: PamNode, names: Sequence[str], take: Callable[[int, int, float], None]) -> None:
        self._node, self._names, self._take = node, tuple(names), take
        self._made: dict[str, Any] = {}
        self._missed = [0] * len(names)

    def listen(self) -> None:
        """Begin to look for the topics; until the node is deactivated."""
        if self._names:
            self._look()
            self._node.steady_timer(_LOOK, self._look)

    def _look(self) -> None:
        """Subscribe to the topics that have come since the last call."""
        if len(self._made) == len(self._names):
            return
        for number, name in enumerate(self._names):
            if name not in self._made and (found := found_signal(self._node, name)) is not None:
                topic, kind = found
                take = partial(self._heard, number, KINDS[kind][0])
                self._made[name] = self._node.create_subscription(class_of(kind), topic, take, qos.STREAM)

    def close(self) -> None:
        """End all subscriptions."""
        for subscription in self._made.values():
            self._node.destroy_subscription(subscription)
        self._made.clear()

    def _heard(self, number: int, field: str, message: Any) -> None:
        stamp, value = message.header.stamp, getattr(message, field)
        if field == "position":
            value = value[0] if len(value) == 1 else math.nan
        self._take(number, stamp.sec * 1_000_000_000 + stamp.nanosec, float(value))

    def health(self, missing: Sequence[int]) -> Health:
        """Part ``signals``. `missing`: samples so far without a value of each signal."""
        absent = [name for name in self._names if name not in self._made]
        lacking = [
            name for name, now, before in zip(self._names, missing, self._missed, strict=True)
            if now > before and name not in absent
        ]  # fmt: skip
        self._missed = list(missing)
        taken = "their values in the rig file are taken, so errors may be larger than the covariance says"
        return judged(
            {f"samples without {name}": count for name, count in zip(self._names, missing, strict=True)},
            "used",
            (absent, Level.WARN, f"nobody publishes {listed([f'{ALSO}{name}' for name in absent])}: {taken}"),
            (lacking, Level.WARN, f"samples lack {listed(lacking)}: {taken}"),
        )


def found_signal(node: Node, name: str) -> tuple[str, str] | None:
    """Topic and type of a signal that somebody publishes; None while nobody does."""
    there = dict(node.get_topic_names_and_types())
    for topic in (node.resolve_topic_name(f"{ALSO}{name.lstrip('/')}"), topic_of(name)):
        for kind in there.get(topic, ()):
            if kind in KINDS and node.count_publishers(topic):
                return topic, kind
    return None
