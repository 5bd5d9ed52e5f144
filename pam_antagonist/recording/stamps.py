"""Time stamps: order, duplicates and restarts of one topic, and samples of several topics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from .notes import Issue
from .plausible import few

Restarts = Literal["refuse", "last"]

MAX_BACKWARD_NS = 500_000_000
"""A message this far behind an earlier stamp is not late: time ran backwards. The live estimator restarts there."""

CLOCKS_APART = 0.1
"""[s] Topics whose delays against the recorder's clock differ by more are stamped by different clocks."""
LARGEST_DELAY = 1.0
"""[s] A larger difference of stamps is no delay, but comes from another clock."""
_SAME_PACE = 0.1
"""Where messages were received this much faster or slower than they were stamped, a program wrote the bag later."""
_HOLE_S, _HOLE_PERIODS = 0.1, 5.0
"""A hole is longer than both: a model cannot know what the valves did meanwhile."""
_LISTED = 3  # holes that are listed one by one
_SAME_VALUE = 1e-6
"""Largest relative difference of two copies of one value, one of which may have been rounded to 32 bits."""
_FAR = 10.0
"""Two publishers contradict each other where they differ by more than this many usual steps between samples."""

_FEWEST = 10  # messages of a publisher

_MIN_TOGETHER = 0.1  # with a smaller share of samples that have both pressures, the stamps do not form samples
ONE_STAMP = "expected one and the same stamp on all messages of a sample"
"""What is said of stamps that form no samples, of a bag and of live topics."""


def unstamped(topic: str) -> str:
    """What is said of a topic without stamps."""
    return f"no message of {topic} carries a stamp (all are 0), expected the time of the sample"


def last_restart(stamp_ns: NDArray[np.int64]) -> int:
    """Index of the first message after the last backward jump, 0 where there is none."""
    jumps = np.flatnonzero(np.diff(stamp_ns) < -MAX_BACKWARD_NS)
    return int(jumps[-1]) + 1 if len(jumps) else 0


def order(
    where: str, topic: str, stamp_ns: NDArray[np.int64], issues: list[str], values: NDArray[np.float64] | None = None
) -> NDArray[np.intp]:
    """Sort the messages of one topic by their header stamps, given in the order of reception (K,) [ns].

    `values`: What the messages say (K, m), NaN where nothing; None: messages with one stamp are not compared.
    """
    keep = np.flatnonzero(stamp_ns != 0)
    if len(keep) == 0:
        raise BadInput(f"{where}: {unstamped(topic)}; type --align-clocks to use the times of reception")
    if len(keep) < len(stamp_ns):
        unset = len(stamp_ns) - len(keep)
        issues.append(Issue(f"{unset} messages of {topic} without a stamp: dropped", "unstamped", unset))
    stamps = stamp_ns[keep]
    newest = np.maximum.accumulate(stamps)
    behind = newest - stamps
    if np.any(behind > MAX_BACKWARD_NS):
        index = int(np.argmax(behind > MAX_BACKWARD_NS))
        raise BadInput(
            f"{where}: time runs backwards on {topic}, message {keep[index]} is stamped {stamps[index] * 1e-9:.3f} s "
            f"after one of {newest[index] * 1e-9:.3f} s, expected increasing stamps; if the plant or its clock was "
            "restarted while recording, --restarts last reads what follows the last restart; two publishers with "
            "clocks of their own look alike"
        )
    if np.any(behind):
        late = int(np.count_nonzero(behind))
        text = f"{late} messages of {topic} came out of order, by {behind.max() * 1e-6:.3g} ms at most: sorted by stamp"
        issues.append(Issue(text, "late", late))
        keep = keep[np.argsort(stamps, kind="stable")]
        stamps = stamp_ns[keep]
    repeated = np.flatnonzero(np.diff(stamps) == 0) + 1
    if len(repeated):
        apart = _contradictions(where, topic, stamps, repeated, None if values is None else values[keep])
        text = f"{len(repeated)} messages of {topic} repeat a stamp: the first of each stamp was kept"
        if apart:
            text = f"{text}; {apart} of them contradict it (two publishers, or a clock that is too coarse)"
        at = (stamps[repeated[0]] - stamps[0]) * 1e-9
        issues.append(Issue(text, "publishers" if apart else "repeated", len(repeated), at))
        keep = np.delete(keep, repeated)
    return keep


def _contradictions(
    where: str, topic: str, stamps: NDArray[np.int64], repeated: NDArray[np.intp], values: NDArray[np.float64] | None
) -> int:
    """Number of messages that contradict the one before with the same stamp; many of them are refused."""
    if values is None:
        return 0
    first, second = values[repeated - 1], values[repeated]
    both = np.isfinite(first) & np.isfinite(second)
    apart = both & (np.abs(first - second) > _SAME_VALUE * np.maximum(np.abs(first), np.abs(second)))
    wrong = np.flatnonzero(apart.any(axis=1))
    if few(len(wrong), len(stamps)):
        return len(wrong)
    row, column = int(wrong[0]), int(np.argmax(apart[wrong[0]]))
    raise _two_publishers(
        where,
        topic,
        f"{len(wrong)} of {len(stamps)} messages repeat a stamp with another value, first "
        f"{(stamps[repeated[row]] - stamps[0]) * 1e-9:.3f} s after the first message: {first[row, column]:.6g} and "
        f"{second[row, column]:.6g}",
    )


def _two_publishers(where: str, topic: str, seen: str) -> BadInput:
    """The refusal of a topic with two publishers that contradict each other."""
    return BadInput(
        f"{where}: {topic} seems to have two publishers that contradict each other, or stamps that are too coarse for "
        f"its rate: {seen}; expected one publisher and one message a stamp. 'ros2 topic info --verbose {topic}' lists "
        "the publishers: stop one or remap its topic, and record again"
    )


def judge_publishers(
    where: str, topic: str, stamp_ns: NDArray[np.int64], values: NDArray[np.float64], paired: NDArray[np.bool_]
) -> None:
    """Refuse a topic whose messages come from two publishers with stamps of their own that contradict each other.

    `paired`: Whether the stamp of each message is one of another topic's (K,).
    """
    known = np.isfinite(values)
    stamp_ns, values, paired = stamp_ns[known], values[known], paired[known]
    share = float(np.mean(paired)) if len(paired) else 0.0
    one = paired if 0.1 < share < 0.9 else np.arange(len(values)) % 2 == 0
    mine, between = stamp_ns[one], stamp_ns[~one]
    if min(len(mine), len(between)) < _FEWEST:
        return
    after = np.clip(np.searchsorted(mine, between), 1, len(mine) - 1)
    near = (mine[after] - mine[after - 1] <= 5 * np.median(np.diff(mine))) & (between > mine[0]) & (between < mine[-1])
    if np.count_nonzero(near) < _FEWEST:
        return
    apart = np.abs(values[~one] - np.interp(between - stamp_ns[0], mine - stamp_ns[0], values[one]))
    usual = float(np.median(apart[near]))
    step = max(float(np.quantile(np.abs(np.diff(part)), 0.9)) for part in (values[one], values[~one]))
    if usual > _FAR * step and usual > _SAME_VALUE * float(np.max(np.abs(values))):
        raise _two_publishers(where, topic, f"messages that follow each other differ by {usual:.3g} in the median")


def clock_shifts(
    where: str, times: Mapping[str, tuple[NDArray[np.int64], NDArray[np.int64]]], issues: list[str], align: bool
) -> dict[str, NDArray[np.int64]]:
    """By how much to shift the stamps of each topic with another clock than the first topic's (K,) [ns].

    Messages of one moment are received together. So the delays of reception tell how far two clocks are apart, at the
    beginning and at the end. `times`: Topic -> times of reception and stamps of its messages (K,) [ns].
    """
    (first, (log_ns, stamp_ns)), *others = times.items()
    shifts = {}
    live = any(_received_live(*its) for its in times.values())
    for topic, (its_log, its_stamp) in others:
        together = its_stamp.max() >= stamp_ns.min() and its_stamp.min() <= stamp_ns.max()
        apart = _delay(log_ns, stamp_ns, its_log) - _delay(its_log, its_stamp, its_log) if live else np.zeros(1)
        begin, end = float(apart[0]) * 1e-9, float(apart[-1]) * 1e-9
        largest = max(begin, end, key=abs)
        if abs(largest) <= CLOCKS_APART:
            if not together:
                away = (its_stamp.min() - stamp_ns.min()) * 1e-9
                text = (
                    f"no stamp of {topic} lies between those of {first}, they begin {away:.4g} s apart: different "
                    "clocks, or another time; its values were left out"
                )
                issues.append(Issue(text, "clock", len(its_stamp), length_s=away))
            continue
        much = f"{abs(largest):.4g} s {'later' if largest > 0.0 else 'earlier'}"
        if abs(end - begin) > CLOCKS_APART:
            much = f"{begin:+.4g} s at the beginning and {end:+.4g} s at the end later"
        text = (
            f"{topic} is stamped {much} than {first} for messages that came at the same time: they are stamped by "
            "different clocks"
        )
        if align:
            shifts[topic] = -np.rint(apart).astype(np.int64)
            late = its_log - its_stamp - shifts[topic] - _delay(log_ns, stamp_ns, its_log)
            if float(np.quantile(np.abs(late), 0.9)) > CLOCKS_APART * 1e9:
                raise BadInput(f"{where}: {topic} has a clock that jumps, which --align-clocks cannot mend: {text}")
            text += "; its stamps were shifted by that, which is exact to some milliseconds (--align-clocks)"
        else:
            text += "; type --align-clocks to shift its stamps by that"
            if abs(largest) > LARGEST_DELAY or not together:
                raise BadInput(f"{where}: {text}, or record again with all topics stamped by one clock")
        issues.append(Issue(text, "clock", len(its_stamp), length_s=largest))
    return shifts


def _received_live(log_ns: NDArray[np.int64], stamp_ns: NDArray[np.int64]) -> bool:
    """Whether messages were received at the pace of their stamps, as by a recorder."""
    lasted, stamped = (float(np.ptp(np.quantile(times - times[0], [0.1, 0.9]))) for times in (log_ns, stamp_ns))
    return len(stamp_ns) > 1 and abs(lasted - stamped) <= _SAME_PACE * stamped


def _delay(log_ns: NDArray[np.int64], stamp_ns: NDArray[np.int64], at_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Delay of reception at some times (K,) [ns]: a line through its medians in the first and the last fifth."""
    delay, part = log_ns - stamp_ns, max(1, len(log_ns) // 5)
    if len(log_ns) < 2 * _FEWEST:
        return np.full(len(at_ns), np.median(delay))
    begin, end = (float(np.median(log_ns[its] - log_ns[0])) for its in (slice(part), slice(-part, None)))
    low, high = float(np.median(delay[:part])), float(np.median(delay[-part:]))
    drift = (high - low) / (end - begin) if end > begin else 0.0
    drift = drift if abs(drift * (end - begin)) > CLOCKS_APART * 1e9 else 0.0
    middle = low if drift else float(np.median(delay))
    return np.asarray(middle + drift * (at_ns - log_ns[0] - begin))


def nearest(stamp_ns: NDArray[np.int64], samples: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sorted stamps (K,), each moved to the nearest sample within half a period."""
    after = np.clip(np.searchsorted(samples, stamp_ns), 1, len(samples) - 1)
    before = samples[after - 1]
    close = np.where(stamp_ns - before <= samples[after] - stamp_ns, before, samples[after])
    return np.where(np.abs(close - stamp_ns) <= 0.5 * np.median(np.diff(samples)), close, stamp_ns)


def union(stamps: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """All stamps, sorted and each once."""
    if all(np.array_equal(stamps[0], other) for other in stamps[1:]):
        return stamps[0]
    return np.unique(np.concatenate(stamps))


def spread(samples: NDArray[np.int64], stamp_ns: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values of a topic (K,) at the sample stamps (N,), NaN where it has none; stamps of no sample are left out."""
    result = np.full(len(samples), np.nan)
    index = np.minimum(np.searchsorted(samples, stamp_ns), len(samples) - 1)
    match = samples[index] == stamp_ns
    result[index[match]] = values[match]
    return result


def interpolate(
    samples: NDArray[np.int64], stamp_ns: NDArray[np.int64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Linear interpolation of a topic (K,) at samples (N,); NaN outside it and in gaps of over five of its periods."""
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


def shortest_hole(period: float) -> float:
    """Length from which on missing samples are a hole [s], by the sample period [s]."""
    return max(_HOLE_S, _HOLE_PERIODS * period)


def judge_pairing(
    where: str,
    samples: NDArray[np.int64],
    present: Mapping[str, NDArray[np.bool_]],
    issues: list[str],
    episode_ns: NDArray[np.int64] | None = None,
) -> None:
    """Report how many samples miss a topic, and holes in the samples but for those before an episode.

    `present`: Topic -> which samples have its message (N,); the two pressures come first.
    """
    first, second = list(present)[0], list(present)[min(1, len(present) - 1)]
    for other, there in present.items():
        together = int(np.count_nonzero(present[first] & there))
        if together < _MIN_TOGETHER * (len(samples) if other == second else np.count_nonzero(there)):
            raise BadInput(
                f"{where}: {first} and {other} share a stamp in {together} of {len(samples)} samples, {ONE_STAMP}; "
                "type --align-clocks to pair nearest stamps of a bag"
            )
    for topic, there in present.items():
        missing = len(samples) - int(np.count_nonzero(there))
        if missing:
            issues.append(Issue(f"{missing} of {len(samples)} samples without {topic}", "missing", missing))
    period = float(np.median(np.diff(samples))) if len(samples) > 1 else 0.0
    gaps = np.flatnonzero(np.diff(samples) > 1e9 * shortest_hole(1e-9 * period))
    if episode_ns is not None:
        gaps = gaps[~np.isin(samples[gaps + 1], episode_ns)]
    lengths, since = (samples[gaps + 1] - samples[gaps]) * 1e-9, (samples[gaps] - samples[0]) * 1e-9
    longest = np.sort(np.argsort(-lengths, kind="stable")[:_LISTED])
    for length, begin in zip(lengths[longest].tolist(), since[longest].tolist(), strict=True):
        text = f"no samples for {length:.3f} s, from {begin:.3f} s after the first one on"
        issues.append(Issue(text, "hole", round(length * 1e9 / period) - 1, begin, length))
    if len(gaps) > _LISTED:
        rest = np.delete(lengths, longest)
        text = f"{len(rest)} more holes of up to {rest.max():.3g} s, {lengths.sum():.3g} s in total"
        issues.append(Issue(text, "hole", round(rest.sum() * 1e9 / period), length_s=float(rest.sum())))
