"""Where a replay starts its filter, and its bit-by-bit comparison with the estimates that were published live.

A replay that starts at the live filter's first sample gives the same bits. This sample is missing where the recording
began while the estimator ran, and it does not help where the state was set by hand. Then the replay uses the first
checkpoint whose sample was recorded. Until then it runs a filter of its own, which is not compared with the live one.
Where no estimate was recorded, each episode starts a filter.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import ESTIMATE_DTYPE, EstimateRun, Estimator
from pam_antagonist.estimation.memory import (
    LATE,
    MISSING_PRESSURE_1,
    MISSING_PRESSURE_2,
    MISSING_VALVE,
    NO_ANGLE,
    Checkpoint,
)
from pam_antagonist.recording import RecordedEstimate, Recording

ENDED = "the recording ended while the live filter ran"
"""Reason why the last live estimates are not compared."""


class LiveInput(NamedTuple):
    """Inputs of a filter for N samples."""

    pressure: NDArray[np.float64]  # (N, 2) [Pa], NaN where the live filter had none
    voltage: NDArray[np.float64]  # (N, 2) [V], NaN where the live filter had none
    angle: NDArray[np.float64]  # of the encoder (N,) [rad], NaN where the live filter had none
    had: NDArray[np.bool_]  # whether the live filter had the sample at all (N,)
    lacked: NDArray[np.bool_]  # whether the live filter lacked the sample or a value that was recorded (N,)


def as_live(recording: Recording, impossible: NDArray[np.bool_]) -> LiveInput:
    """The inputs that the live filter had, where its estimates were recorded.

    The recorder may have got a message that the estimator got too late, or not at all. Values that the live filter
    flagged as missing are left out of the replay, too, except those that no filter uses. So are samples without an
    estimate between the first and the last recorded estimate.

    `impossible`: which pressures and voltages the filter itself takes for missing (N, 4).
    """
    pressure, voltage = recording.pressure.copy(), recording.voltage.copy()
    had = np.ones(len(recording.stamp_ns), dtype=bool)
    angle = np.full(len(had), np.nan) if recording.angle_sensor is None else recording.angle_sensor.copy()
    live = recording.estimate
    if live is None or len(live.stamp_ns) == 0:
        return LiveInput(pressure, voltage, angle, had, ~had)
    _, at, at_live = np.intersect1d(recording.stamp_ns, live.stamp_ns, return_indices=True)
    between = (recording.stamp_ns > live.stamp_ns[0]) & (recording.stamp_ns < live.stamp_ns[-1])
    had[between] = False
    had[at] = True
    flags = live.flags[at_live].astype(np.int64)
    odd = impossible[at]
    for bit, column in ((MISSING_PRESSURE_1, 0), (MISSING_PRESSURE_2, 1)):
        pressure[at[((flags & bit) != 0) & ~odd[:, column]], column] = np.nan
    voltage[at[((flags & MISSING_VALVE) != 0) & ~odd[:, 2:].any(axis=1)]] = np.nan
    angle[at[(flags & NO_ANGLE) != 0]] = np.nan
    lost = ~had
    for ours, theirs in ((pressure, recording.pressure), (voltage, recording.voltage)):
        lost |= (np.isnan(ours) & np.isfinite(theirs)).any(axis=1)
    if recording.angle_sensor is not None:
        lost |= np.isnan(angle) & np.isfinite(recording.angle_sensor)
    return LiveInput(pressure, voltage, angle, had, lost)


def same_bits(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Whether two arrays (N, ...) of doubles have the same bits in each row (N,); all NaNs count as equal."""
    shape = (len(one), int(np.prod(one.shape[1:])))
    a = np.ascontiguousarray(one, dtype=np.float64).reshape(shape)
    b = np.ascontiguousarray(other, dtype=np.float64).reshape(shape)
    return np.asarray(((a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))).all(axis=1))


@dataclass(frozen=True)
class LiveComparison:
    """Comparison of recorded estimates with replayed ones."""

    compared: int
    equal: int  # compared samples that agree in every field except the ``LATE`` flag
    only_live: int
    only_replay: int  # samples between the first and the last recorded estimate that have only a replayed one
    first_difference_ns: int | None  # stamp of the first sample that differs [ns], or None
    differing: Mapping[str, int]
    not_compared: int = 0  # samples with a live estimate for which the replay had a filter of its own
    why_not: tuple[str, ...] = ()
    # largest difference of the angle in the samples not compared, and the last one [deg].
    apart_deg: tuple[float, float] | None = None


_LATER = ("external_torque", "external_torque_covariance")
"""Fields of JointEstimate that recordings of version 0.1.0 lack; they are not compared there."""


class Apart(NamedTuple):
    """Consecutive samples for which a replay has a filter of its own."""

    first_ns: int  # stamp of the first sample [ns]
    end_ns: int  # end of the range, after the stamp of the last sample [ns]
    why: str


def compare_with_live(live: RecordedEstimate, run: EstimateRun, apart: Sequence[Apart] = ()) -> LiveComparison:
    """Compare recorded estimates with replayed ones, sample by sample."""
    own_live, own_run = _within(live.stamp_ns, apart), _within(run.stamp_ns, apart)
    compared = _compare(live.take(~own_live), subset(run, ~own_run))
    if not own_live.any():
        return compared
    _, at_live, at_run = np.intersect1d(live.stamp_ns[own_live], run.stamp_ns[own_run], return_indices=True)
    angle = np.degrees(np.abs(live.angle[own_live][at_live] - run.rows["angle"][own_run][at_run]))
    return dataclasses.replace(
        compared,
        not_compared=int(own_live.sum()),
        why_not=tuple(dict.fromkeys(part.why for part in apart if _within(live.stamp_ns, [part]).any())),
        apart_deg=(float(angle.max()), float(angle[-1])) if len(angle) else None,
    )


def ended(recording: Recording) -> Apart | None:
    """The last samples, where the live filter had values that the recording lacks.

    A recorder that ends while the pipeline runs unsubscribes from the topics one after the other.
    """
    live, stamps = recording.estimate, recording.stamp_ns
    if live is None or len(live) == 0:
        return None
    lacks = np.column_stack([np.isnan(recording.pressure), np.isnan(recording.voltage).any(axis=1)])
    bits = np.array([MISSING_PRESSURE_1, MISSING_PRESSURE_2, MISSING_VALVE])
    _, at, at_live = np.intersect1d(stamps, live.stamp_ns, return_indices=True)
    had = (live.flags[at_live, None].astype(np.int64) & bits) == 0
    # The first sample of a filter has no flags, even where no pressure is measured.
    had &= (live.stamp_ns != live.started_ns)[at_live, None]
    tail = at > np.flatnonzero(~lacks.any(axis=1))[-1:].sum()
    more = stamps[at[tail & (lacks[at] & had).any(axis=1)]]
    first = int(more[0]) if len(more) else int(stamps[-1]) + 1
    return Apart(first, int(live.stamp_ns[-1]) + 1, ENDED) if live.stamp_ns[-1] >= first else None


def _within(stamp_ns: NDArray[np.int64], apart: Sequence[Apart]) -> NDArray[np.bool_]:
    inside = np.zeros(len(stamp_ns), dtype=bool)
    for part in apart:
        inside |= (stamp_ns >= part.first_ns) & (stamp_ns < part.end_ns)
    return inside


def subset(run: EstimateRun, keep: NDArray[np.bool_]) -> EstimateRun:
    """Some of the estimates of a run. `keep`: whether to keep each estimate (M,)."""
    arrays = {name: getattr(run, name)[keep] for name in ("rows", "stamp_ns", "index", "started_ns")}
    return dataclasses.replace(run, added={name: values[keep] for name, values in run.added.items()}, **arrays)


def _compare(live: RecordedEstimate, run: EstimateRun) -> LiveComparison:
    _, at_live, at_run = np.intersect1d(live.stamp_ns, run.stamp_ns, return_indices=True)
    differing: dict[str, int] = {}
    equal = live.started_ns[at_live] == run.started_ns[at_run]
    if not equal.all():
        differing["started"] = int(np.count_nonzero(~equal))
    for name in ESTIMATE_DTYPE.names or ():
        recorded = np.asarray(getattr(live, name))[at_live]
        replayed = run.rows[name][at_run]
        if name in _LATER and np.isnan(recorded).all():
            continue
        if name == "flags":
            # LATE depends on the time of arrival, which a replay does not know.
            recorded = recorded.astype(np.int64) & ~LATE
            replayed = replayed.astype(np.int64)
        same = same_bits(recorded, replayed)
        if not same.all():
            differing[name] = int(np.count_nonzero(~same))
        equal &= same
    within = (run.stamp_ns >= live.stamp_ns[0]) & (run.stamp_ns <= live.stamp_ns[-1]) if len(live.stamp_ns) else []
    stamps = live.stamp_ns[at_live]
    return LiveComparison(
        compared=len(at_live),
        equal=int(np.count_nonzero(equal)),
        only_live=len(live.stamp_ns) - len(at_live),
        only_replay=int(np.count_nonzero(within)) - len(at_run),
        first_difference_ns=int(stamps[~equal][0]) if not equal.all() else None,
        differing=differing,
    )


BEGUN_LATER = "the recording was begun while the live filter ran"
SET_BY_HAND = "the state of the live filter was set by hand"
NOT_RECORDED = "the sample that started the live filter was not recorded"


class Segment(NamedTuple):
    """Samples between two starts of the filter."""

    first: int  # index of the first sample; the segment ends before the next one
    started_ns: int | None = None  # start of the live filter [ns], None where none was recorded
    checkpoint: Checkpoint | None = None  # from which the filter goes on; None: it starts at the first complete sample
    why_not: str = ""  # why the filter differs from the live one; empty where it does not, or none was recorded


@dataclass
class ReplayPlan:
    """How a recording is replayed."""

    segments: list[Segment]
    refused: dict[str, None]
    skipped: int = 0  # index of the first sample that the filter runs for; earlier ones are not needed
    model_first: int = 0  # index of the first sample of the model alone, which also runs over skipped samples


def plan(recording: Recording, estimator: Estimator, begin_ns: int | None = None) -> ReplayPlan:
    """Plan the starts of the filter.

    `begin_ns`: stamp from which estimates are wanted [ns]; None: for the whole recording.
    """
    out = ReplayPlan([], {})
    live = recording.estimate
    if live is None or len(live) == 0:
        out.segments += [Segment(part.start) for part in recording.episodes]
    else:
        starts, first = np.unique(live.started_ns, return_index=True)
        for start, at in sorted(zip(starts.tolist(), first.tolist(), strict=True), key=lambda pair: pair[1]):
            out.segments.extend(_of_start(recording, live, start, at, estimator, out))
    if begin_ns is not None:
        _skip(recording, begin_ns, estimator, out)
    estimator.reset()
    return out


def _of_start(
    recording: Recording, live: RecordedEstimate, start: int, at: int, estimator: Estimator, out: ReplayPlan
) -> Iterator[Segment]:
    """The segments of one start of the live filter, whose first recorded estimate is number ``at``."""
    here = _place(recording, start)
    by_hand = here is not None and _place(live, start) is not None and int(live.stamp_ns[at]) != start
    if here is not None and not by_hand:
        yield Segment(here, start)
        return
    why_not = SET_BY_HAND if by_hand else BEGUN_LATER if start < recording.stamp_ns[0] else NOT_RECORDED
    # Start as early as possible: before the first recorded estimate nothing is compared.
    first = 0 if not out.segments else int(np.searchsorted(recording.stamp_ns, live.stamp_ns[at]))
    end = int(live.stamp_ns[np.flatnonzero(live.started_ns == start)[-1]])
    for place, checkpoint in _usable(recording, start, end, estimator, out):
        if place >= first:
            yield Segment(first, start, None, why_not)
        yield Segment(place + 1, start, checkpoint)
        return
    yield Segment(first, start, None, why_not)


def _skip(recording: Recording, begin_ns: int, estimator: Estimator, out: ReplayPlan) -> None:
    """Skip the samples before the last usable checkpoint before a stamp; the estimates stay the same."""
    wanted = int(np.searchsorted(recording.stamp_ns, begin_ns))
    number = max((k for k, segment in enumerate(out.segments) if segment.first <= wanted), default=0)
    segment = out.segments[number]
    # The model does not start at checkpoints.
    out.model_first = next(item.first for item in reversed(out.segments[: number + 1]) if not item.checkpoint)
    out.segments, before = out.segments[number:], segment.first
    if segment.why_not == "" and segment.started_ns is not None:
        last = int(recording.stamp_ns[max(wanted - 1, 0)])
        for place, checkpoint in _usable(recording, segment.started_ns, last, estimator, out, newest_first=True):
            if place >= segment.first:
                before = place + 1
                out.segments[0] = Segment(before, segment.started_ns, checkpoint)
            break
    out.skipped = before


def _usable(
    recording: Recording, start: int, end: int, estimator: Estimator, out: ReplayPlan, newest_first: bool = False
) -> Iterator[tuple[int, Checkpoint]]:
    """Index of the sample and checkpoint, for checkpoints of one start up to a stamp that the filter accepts."""
    for checkpoint in reversed(recording.checkpoints) if newest_first else recording.checkpoints:
        place = _place(recording, checkpoint.stamp_ns)
        if checkpoint.started_ns != start or checkpoint.stamp_ns > end or place is None:
            continue
        try:
            estimator.restore(checkpoint)
        except BadInput as error:
            out.refused[str(error)] = None
        else:
            yield place, checkpoint


def _place(stamped: Recording | RecordedEstimate, stamp_ns: int) -> int | None:
    """Index of the sample with a stamp; None where there is none."""
    place = int(np.searchsorted(stamped.stamp_ns, stamp_ns))
    return place if place < len(stamped) and stamped.stamp_ns[place] == stamp_ns else None
