"""Pairing of the messages of one sample by their stamp, and the last minutes of samples for a monitor (without ROS).

A sample is final as soon as every topic has delivered a message with the sample's stamp or a later one. If a topic is
missing, a sample is final after the time-out, counted in stamps against the newest stamp *and* in waiting time. Missing
values are NaN. Samples come out in the order of their stamps. So the result does not depend on the order of arrival,
only on which messages are lost.

Call :meth:`SamplePairing.expire` after the queue is empty, not after every message. After a stall of the machine, all
messages of one topic may come before those of the next topic, and messages in the queue are not lost.
"""

from __future__ import annotations

import heapq
import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.nodes.arrivals import Arrivals

if TYPE_CHECKING:
    from pam_antagonist.nodes.further import SignalValues

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

PRESSURE_1, PRESSURE_2, VOLTAGES, ANGLE, WHOLE = range(5)
"""The topics of a sample; ANGLE only where a measured angle is used, WHOLE where a sample is one message."""

_FIRST = (0, 1, 2, 4, 0)  # where each topic's values start in a sample
_BITS = 5  # index of the bit mask of received topics, after the values
_RESTART = 500_000_000  # a message older than the last final sample by more than this restarts the pairing [ns]
_LIMIT = 5000  # largest number of waiting samples; only invalid stamps lead to more


class Sample(NamedTuple):
    """One sample; NaN where a value is missing."""

    stamp_ns: int  # time of the sample [ns]
    pressure_1: float  # absolute [Pa]
    pressure_2: float  # absolute [Pa]
    voltage_1: float  # on valve 1 over the sample that ends at the stamp [V]
    voltage_2: float  # on valve 2 [V]
    angle: float = math.nan  # as the encoder reads it [rad]
    signals: tuple[float, ...] = ()  # further signals of the rig, in its order [SI]


@dataclass
class PairingCounts:
    """Counters of the pairing."""

    samples: int = 0
    incomplete: int = 0
    late: int = 0
    duplicates: int = 0
    restarts: int = 0
    lacking: dict[int, int] = field(default_factory=dict)  # topic -> incomplete samples without it


class SamplePairing:
    """Combines messages to samples.

    Args:
        timeout: how long a sample waits for a topic [s]; for further signals half as long.
        clock: current time [ns], for the waiting time; a clock that always runs.
        signals: values of further signals, which :meth:`add_signal` adds; None: there are none.
    """

    def __init__(
        self,
        timeout: float,
        clock: Callable[[], int] = time.monotonic_ns,
        topics: Sequence[int] = (PRESSURE_1, PRESSURE_2, VOLTAGES),
        signals: SignalValues | None = None,
    ) -> None:
        self.signals = signals
        self._topics = tuple(topics)
        self._complete = sum(1 << topic for topic in self._topics)
        self.counts = PairingCounts(lacking=dict.fromkeys(self._topics, 0))
        self.arrivals = Arrivals(self._topics)
        self._timeout = round(timeout * 1e9)
        self._clock = clock
        self.reset()

    def reset(self) -> None:
        """Forget all waiting messages, and the last final sample."""
        self._waiting: dict[int, list[float]] = {}
        self._arrival: dict[int, int] = {}
        self._newest: dict[int, int | None] = dict.fromkeys(self._topics)
        self._final: int | None = None
        if self.signals is not None:
            self.signals.reset()

    def add(self, topic: int, stamp_ns: int, *values: float) -> list[Sample]:
        """Add one message.

        Args:
            topic: PRESSURE_1, PRESSURE_2, VOLTAGES, ANGLE or WHOLE.
            stamp_ns: stamp of the message [ns].
            values: one pressure [Pa], two voltages [V], one angle [rad], or all of them.
        """
        self.arrivals.add(topic, stamp_ns)
        if self._final is not None and stamp_ns <= self._final:
            if self._final - stamp_ns <= _RESTART:
                self.counts.late += 1
                return []
            self.counts.restarts += 1
            self.reset()
        sample = self._waiting.get(stamp_ns)
        if sample is None:
            sample = self._waiting[stamp_ns] = [math.nan, math.nan, math.nan, math.nan, math.nan, 0.0]
            self._arrival[stamp_ns] = self._clock()
        bit = 1 << topic
        if int(sample[_BITS]) & bit:
            self.counts.duplicates += 1
            return []
        sample[_BITS] += bit
        sample[_FIRST[topic] : _FIRST[topic] + len(values)] = values
        self._newest[topic] = stamp_ns
        if len(self._waiting) > _LIMIT:
            return self._pop_until(min(self._waiting))
        return self._pop_ready()

    def add_signal(self, signal: int, stamp_ns: int, value: float) -> list[Sample]:
        """Add a message of a further signal. `signal`: its number, from 0. `value`: [SI]."""
        assert self.signals is not None
        self.signals.add(signal, stamp_ns, value)
        return self._pop_ready() if self._waiting else []

    def _pop_ready(self) -> list[Sample]:
        newest = [stamp for stamp in self._newest.values() if stamp is not None]
        if len(newest) < len(self._newest):
            return []
        last = min(newest)
        return self._pop_until(last if self.signals is None else self.signals.ready(last))

    def whole(self, sample: Sample) -> list[Sample]:
        """Add a sample that was not split into messages; values may be NaN. Do not combine with :meth:`add`."""
        if self._final is not None and sample.stamp_ns <= self._final:
            if self._final - sample.stamp_ns <= _RESTART:
                self.counts.late += 1
                return []
            self.counts.restarts += 1
        self._final = sample.stamp_ns
        self.counts.samples += 1
        return [sample if self.signals is None else sample._replace(signals=self.signals.at(sample.stamp_ns))]

    def expire(self) -> list[Sample]:
        """The samples that have waited for too long, in the order of their stamps."""
        if not self._waiting:
            return []
        newest, now = max(stamp for stamp in self._newest.values() if stamp is not None), self._clock()
        out: list[Sample] = []
        if self.signals is not None:
            patience = self._timeout // 2
            if now - min(self._arrival.values()) >= patience:
                self.signals.give_up(newest - patience)
                out = self._pop_ready()
        oldest = newest - self._timeout
        gone = [stamp for stamp in self._waiting if stamp < oldest and now - self._arrival[stamp] >= self._timeout]
        return out + (self._pop_until(max(gone)) if gone else [])

    def _pop_until(self, last: int | None) -> list[Sample]:
        return [self._pop(stamp) for stamp in sorted(stamp for stamp in self._waiting if stamp <= last)]  # type: ignore[operator]

    def _pop(self, stamp: int) -> Sample:
        values = self._waiting.pop(stamp)
        del self._arrival[stamp]
        self._final = stamp
        self.counts.samples += 1
        if values[_BITS] != self._complete:
            self.counts.incomplete += 1
            for topic in self._topics:
                self.counts.lacking[topic] += not int(values[_BITS]) & 1 << topic
        first, second, voltage_1, voltage_2, angle, _ = values
        signals = () if self.signals is None else self.signals.at(stamp)
        return Sample(stamp, first, second, voltage_1, voltage_2, angle, signals)


COLUMNS = _BITS  # of a :class:`Feed`: both pressures, both voltages and the angle
_PATIENCE = 1.0  # [s] in a :class:`Feed`, a topic that is behind the others by more is missing


class Feed:
    """Pairs messages as the estimator does, and keeps the rows of the last `seconds`.

    `topics`: those that are expected. `clock`: present time [ns].
    """

    def __init__(self, topics: Sequence[int], seconds: float, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.pairing, self._span = SamplePairing(_PATIENCE, clock, topics), round(seconds * 1e9)
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self.pairing.reset()
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
        return self.pairing.counts.restarts

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
            new = self.pairing.add(topic, int(stamp), *values)
            if self.jumps > before:
                samples.clear()
            samples += new
        samples += self.pairing.expire()
        if self.jumps > jumps:
            self._parts.clear()
        stamps = np.array([sample.stamp_ns for sample in samples], dtype=np.int64)
        rows = np.array([sample[1 : 1 + COLUMNS] for sample in samples]).reshape(-1, COLUMNS)
        if len(stamps):
            # To join all that is kept with each message would take longer than the monitor itself.
            self._parts.append((stamps, rows))
            while self._parts[0][0][-1] <= self.newest_ns - self._span:
                self._parts.popleft()
        return stamps, rows, self.jumps > jumps
