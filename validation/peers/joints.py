"""The joints on which peers are compared: what may be fitted, what is held out, and signals at a common rate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist import Recording, Rig, load_rig, read_bag
from validation import at_hand

Floats = NDArray[np.float64]
NAMES = ("rig_a_lab/supply_droop", *(f"strangers/{name}" for name in at_hand.STRANGERS), "measured/pamy_joint0")
ARM = NAMES[-1]
WARM_UP = 5.0
"""Seconds before the held-out end of a recording in which a filter may settle."""
MOVES = float(np.radians(2.0))
"""A joint that moves by more than this was free."""
_KEPT = 1.0 / 3.0
_RATE = 100.0
"""Soft sensors get at most so many samples a second, each the mean of a sample's span."""


@dataclass(frozen=True)
class Joint:
    """A joint, split."""

    name: str  # of ``NAMES``
    rig: Rig  # as its laboratory describes it
    fit: tuple[Recording, ...]  # recordings that may be fitted, those that show most first
    held: tuple[tuple[Recording, float], ...]  # that are held out, each with the time from which on it counts [s]
    also: tuple[str, ...] = ()  # further signals

    @property
    def seconds(self) -> float:
        """Length of what may be fitted [s]; episodes by their samples."""
        return sum(len(one) * self.rig.sample_period for one in self.fit)

    def shortened(self, seconds: float) -> Joint:
        """The joint with less to fit: the same share of the beginning of each recording."""
        share = min(seconds / self.seconds, 1.0)
        return replace(self, fit=tuple(one.slice(0.0, share * (one.duration_s + 1e-3)) for one in self.fit))


def joint(name: str, data: Path, scratch: Path) -> Joint:
    """A joint of ``NAMES``: the last third of each recording is held out where no whole one is."""
    found = at_hand.joint(name, data, scratch)
    rig = load_rig(found.rig, regulators=True)

    def read(path: Path) -> Recording:
        recording = read_bag(path)
        return recording if recording.signals else recording.driven_by(rig.drive)

    fit = [read(path) for path in found.recordings]
    if found.held_out:
        return Joint(name, rig, tuple(fit), tuple((read(path), 1.0) for path in found.held_out))
    ends = [(1.0 - _KEPT) * one.duration_s for one in fit]
    begin = 0.0 if name == ARM else WARM_UP
    held = (fit[0].slice(ends[0] - begin, np.inf), begin)
    return Joint(name, rig, tuple(one.slice(0.0, end) for one, end in zip(fit, ends, strict=True)), (held,), found.also)


def held_on(signals: Floats) -> Floats:
    """Signals (N, F) in which a value that is missing is the one before."""
    return signals[np.maximum.accumulate(np.where(np.isfinite(signals).all(axis=1), np.arange(len(signals)), 0))]


@dataclass(frozen=True)
class Course:
    """Signals of a recording at the soft sensors' rate."""

    inputs: Floats  # pressures, what drives the joint, further signals (N, F)
    angle: Floats  # (N,) [rad]
    counts: NDArray[np.bool_]  # which samples count (N,)
    first: NDArray[np.intp]  # of the episode that each sample belongs to (N,)
    period: float  # of a sample [s]


def course(recording: Recording, rig: Rig, begin_s: float = 0.0) -> Course:
    """Means over the spans of a common rate."""
    every = max(1, round(1.0 / _RATE / rig.sample_period))
    assert recording.angle is not None
    further = [signal.values for signal in recording.signals.values()]
    signals = held_on(np.column_stack([recording.pressure / 1e5, recording.voltage, recording.angle, *further]))
    spans = len(signals) // every
    means = signals[: spans * every].reshape(spans, every, -1).mean(axis=1)
    inputs = np.delete(means, 4, axis=1)
    inputs[:, 2:4] /= 1e5 if rig.drive == "regulator" else 1.0
    begins = np.zeros(1, int) if recording.episode_ns is None else np.searchsorted(
        recording.stamp_ns, recording.episode_ns
    )  # fmt: skip
    number = np.searchsorted(begins // every, np.arange(spans), side="right") - 1
    period = every * rig.sample_period
    return Course(inputs, means[:, 4], np.arange(spans) * period >= begin_s, (begins // every)[number], period)
