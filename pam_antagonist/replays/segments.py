"""Where a replay starts its filter: at a sample, or from a checkpoint of the live filter.

A replay that starts at the live filter's first sample gives the same bits. This sample is missing where the recording
began while the estimator ran, and it does not help where the state was set by hand. Then the replay uses the first
checkpoint whose sample was recorded. Until then it runs a filter of its own, which is not compared with the live one.
Where no estimate was recorded, each episode starts a filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.checkpoint import Checkpoint, FilterIdentity
from pam_antagonist.recording import RecordedEstimate, Recording
from pam_antagonist.recording.signals import RecordedCheckpoint

BEGUN_LATER = "the recording was begun while the live filter ran"
SET_BY_HAND = "the state of the live filter was set by hand"
NOT_RECORDED = "the sample that started the live filter was not recorded"


class Segment(NamedTuple):
    """Samples between two starts of the filter.

    Attributes:
        first: index of the first sample; the segment ends before the next one.
        started_ns: start of the live filter [ns], None where none was recorded.
        checkpoint: from which the filter goes on; None: it starts at the first complete sample.
        why_not: why the filter differs from the live one; empty where it does not, or none was recorded.
    """

    first: int
    started_ns: int | None = None
    checkpoint: Checkpoint | None = None
    why_not: str = ""


@dataclass
class Plan:
    """How a recording is replayed.

    Attributes:
        skipped: index of the first sample that the filter runs for; earlier ones are not needed.
        model_first: index of the first sample of the model alone, which also runs over skipped samples.
    """

    segments: list[Segment]
    refused: dict[str, None]
    skipped: int = 0
    model_first: int = 0


def plan(recording: Recording, estimator: Estimator, begin_ns: int | None = None) -> Plan:
    """Plan the starts of the filter.

    Args:
        begin_ns: stamp from which estimates are wanted [ns]; None: for the whole recording.
    """
    out = Plan([], {})
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
    recording: Recording, live: RecordedEstimate, start: int, at: int, estimator: Estimator, out: Plan
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


def _skip(recording: Recording, begin_ns: int, estimator: Estimator, out: Plan) -> None:
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
    recording: Recording, start: int, end: int, estimator: Estimator, out: Plan, newest_first: bool = False
) -> Iterator[tuple[int, Checkpoint]]:
    """Index of the sample and checkpoint, for checkpoints of one start up to a stamp that the filter accepts."""
    for recorded in reversed(recording.checkpoints) if newest_first else recording.checkpoints:
        place = _place(recording, recorded.stamp_ns)
        if recorded.started_ns != start or recorded.stamp_ns > end or place is None:
            continue
        checkpoint = of_recorded(recorded)
        try:
            estimator.restore(checkpoint)
        except BadInput as error:
            out.refused[str(error)] = None
        else:
            yield place, checkpoint


def of_recorded(recorded: RecordedCheckpoint) -> Checkpoint:
    """A checkpoint from a bag; arrays of a wrong size keep their shape, and the filter refuses them."""
    names = {item.name for item in fields(FilterIdentity)}
    n = max(1, len(recorded.state))

    def matrix(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return values.reshape(n, -1) if len(values) % n == 0 else values

    return Checkpoint(
        recorded.stamp_ns,
        recorded.started_ns,
        FilterIdentity(**{name: getattr(recorded, name) for name in names}),
        recorded.state,
        matrix(recorded.covariance),
        matrix(recorded.cross),
        recorded.voltage,
        recorded.rejected,
        recorded.distances,
        recorded.angle_sensor,
    )


def _place(stamped: Recording | RecordedEstimate, stamp_ns: int) -> int | None:
    """Index of the sample with a stamp; None where there is none."""
    place = int(np.searchsorted(stamped.stamp_ns, stamp_ns))
    return place if place < len(stamped) and stamped.stamp_ns[place] == stamp_ns else None
