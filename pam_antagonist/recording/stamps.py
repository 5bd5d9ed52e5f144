"""Time stamps: order, duplicates and restarts of one topic, and samples of several topics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput

Restarts = Literal["refuse", "last"]

MAX_BACKWARD_NS = 500_000_000
"""A message this far behind an earlier stamp is not late: time ran backwards. The live estimator restarts there."""

MAX_FORWARD_NS = 1_000_000_000
"""Longest gap between samples that the estimator predicts over; longer ones are reported."""

_MIN_TOGETHER = 0.1  # with a smaller share of samples that have both pressures, the stamps do not form samples


def last_restart(stamp_ns: NDArray[np.int64]) -> int:
    """Index of the first message after the last backward jump, 0 where there is none."""
    jumps = np.flatnonzero(np.diff(stamp_ns) < -MAX_BACKWARD_NS)
    return int(jumps[-1]) + 1 if len(jumps) else 0


def order(where: str, topic: str, stamp_ns: NDArray[np.int64], issues: list[str]) -> NDArray[np.intp]:
    """Sort the messages of one topic by their stamps.

    Args:
        where: The bag, for messages.
        topic: The topic, for messages.
        stamp_ns: Header stamps in the order of reception (K,) [ns].
        issues: Gets a sentence about messages without a stamp, late ones and duplicates.

    Returns:
        Indices of the messages to keep; their stamps increase strictly.

    Raises:
        BadInput: No message is stamped, or time runs backwards by more than 0.5 s.
    """
    keep = np.flatnonzero(stamp_ns != 0)
    if len(keep) == 0:
        raise BadInput(f"{where}: no message of {topic} carries a stamp (all are 0), expected the time of the sample")
    if len(keep) < len(stamp_ns):
        issues.append(f"{len(stamp_ns) - len(keep)} messages of {topic} without a stamp: dropped")
    stamps = stamp_ns[keep]
    newest = np.maximum.accumulate(stamps)
    behind = newest - stamps
    if np.any(behind > MAX_BACKWARD_NS):
        index = int(np.argmax(behind > MAX_BACKWARD_NS))
        raise BadInput(
            f"{where}: time runs backwards on {topic}, message {keep[index]} is stamped {stamps[index] * 1e-9:.3f} s "
            f"after one of {newest[index] * 1e-9:.3f} s, expected increasing stamps; if the plant or its clock was "
            "restarted while recording, --restarts last reads what follows the last restart"
        )
    if np.any(behind):
        late = int(np.count_nonzero(behind))
        issues.append(
            f"{late} messages of {topic} came out of order, by {behind.max() * 1e-6:.3g} ms at most: sorted by stamp"
        )
        keep = keep[np.argsort(stamps, kind="stable")]
        stamps = stamp_ns[keep]
    repeated = np.flatnonzero(np.diff(stamps) == 0) + 1
    if len(repeated):
        issues.append(f"{len(repeated)} messages of {topic} repeat a stamp: the first of each stamp was kept")
        keep = np.delete(keep, repeated)
    return keep


def union(stamps: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """All stamps, sorted and each once."""
    if all(np.array_equal(stamps[0], other) for other in stamps[1:]):
        return stamps[0]
    return np.unique(np.concatenate(stamps))


def spread(samples: NDArray[np.int64], stamp_ns: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values at the sample stamps (N,), NaN where the topic has none.

    Args:
        samples: Sample stamps (N,) [ns].
        stamp_ns: Stamps of the topic (K,) [ns], strictly increasing; stamps of no sample are left out.
        values: Values of the topic (K,).
    """
    result = np.full(len(samples), np.nan)
    index = np.minimum(np.searchsorted(samples, stamp_ns), len(samples) - 1)
    match = samples[index] == stamp_ns
    result[index[match]] = values[match]
    return result


def interpolate(
    samples: NDArray[np.int64], stamp_ns: NDArray[np.int64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Linear interpolation of a topic; NaN outside its stamps and in gaps of more than five of its periods.

    Args:
        samples: stamps at which values are wanted (N,) [ns].
        stamp_ns: stamps of the topic (K,) [ns].
        values: of the topic (K,).
    """
    finite = np.isfinite(values)
    stamp_ns, values = stamp_ns[finite], values[finite]
    if len(stamp_ns) < 2:
        return np.full(len(samples), np.nan)
    origin = samples[0]
    result = np.interp((samples - origin) * 1e-9, (stamp_ns - origin) * 1e-9, values, left=np.nan, right=np.nan)
    gap = np.diff(stamp_ns)
    after = np.clip(np.searchsorted(stamp_ns, samples, side="left"), 1, len(stamp_ns) - 1)
    result[(gap[after - 1] > 5 * np.median(gap)) & (stamp_ns[after] != samples)] = np.nan
    return np.asarray(result)


def judge_pairing(
    where: str,
    samples: NDArray[np.int64],
    present: Mapping[str, NDArray[np.bool_]],
    issues: list[str],
    episode_ns: NDArray[np.int64] | None = None,
) -> None:
    """Report how many samples miss a topic, and gaps in the samples.

    Args:
        where: The bag, for messages.
        samples: Sample stamps (N,) [ns].
        present: Topic -> which samples have its message (N,); the two pressures come first.
        issues: Gets the sentences.
        episode_ns: Stamps at which episodes begin (E,) [ns]; a gap before one is not reported. None for one piece.

    Raises:
        BadInput: The two pressures rarely share a stamp.
    """
    first, second = list(present)[0], list(present)[min(1, len(present) - 1)]
    together = int(np.count_nonzero(present[first] & present[second]))
    if together < _MIN_TOGETHER * len(samples):
        raise BadInput(
            f"{where}: {first} and {second} share a stamp in {together} of {len(samples)} samples, expected one and "
            "the same stamp on all messages of a sample"
        )
    for topic, there in present.items():
        missing = len(samples) - int(np.count_nonzero(there))
        if missing:
            issues.append(f"{missing} of {len(samples)} samples without {topic}")
    gaps = np.flatnonzero(np.diff(samples) > MAX_FORWARD_NS)
    if episode_ns is not None:
        gaps = gaps[~np.isin(samples[gaps + 1], episode_ns)]
    for index in gaps[:3]:
        length, since = (samples[index + 1] - samples[index]) * 1e-9, (samples[index] - samples[0]) * 1e-9
        issues.append(f"no samples for {length:.3f} s, from {since:.3f} s after the first one on")
    if len(gaps) > 3:
        issues.append(f"{len(gaps) - 3} more gaps of over a second")
