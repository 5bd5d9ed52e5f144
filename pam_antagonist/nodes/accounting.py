"""What became of every sample of a recorded pipeline: lost, late, out of order, how long it took (no ROS in here)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation.filter import LATE
from pam_antagonist.recording import Recording

Stamps = NDArray[np.int64]

STAGES = ("pressure_1", "pressure_2", "valve_state", "joint_estimate", "valve_command")
"""The topics with one message a sample, in the order in which they come about."""


@dataclass(frozen=True)
class Latency:
    """Times [ms] from the reception of a sample's first pressure to that of its command, both by the recorder.

    Attributes:
        samples: with both.
        median: half of them took no longer.
        p99: 99 of 100 took no longer.
        largest: of all.
    """

    samples: int
    median: float
    p99: float
    largest: float


@dataclass(frozen=True)
class Accounting:
    """What became of the samples between discovery and the end.

    Discovery is over at the first stamp from which on every stage is in the bag; the end is the last such stamp. In
    between, one sample a period is expected.

    Attributes:
        expected: samples in that time, at one a period.
        lost: stage -> how many of them have no message.
        out_of_order: stage -> messages that were received before one with an earlier stamp.
        late: estimates that were flagged LATE.
        latency: pressure to command.
    """

    expected: int
    lost: Mapping[str, int]
    out_of_order: Mapping[str, int]
    late: int
    latency: Latency


def account(recording: Recording, sample_period: float) -> Accounting | None:
    """Account for the samples of a recording.

    Args:
        recording: of the whole pipeline.
        sample_period: [s].

    Returns:
        The account; None where a stage is missing altogether.
    """
    arrivals = recording.received_ns
    if any(stage not in arrivals or len(arrivals[stage].stamp_ns) == 0 for stage in STAGES):
        return None
    # Commands at safe voltages for lack of estimates carry the time at which they were sent, which is no sample's.
    samples = recording.stamp_ns
    stamps = {stage: np.intersect1d(arrivals[stage].stamp_ns, samples) for stage in STAGES}
    if any(len(stamp) == 0 for stamp in stamps.values()):
        return None
    first = max(stamp[0] for stamp in stamps.values())
    last = min(stamp[-1] for stamp in stamps.values())
    # Counted from stamp to stamp: a device's period is a sample period on its own clock, which drifts against ours.
    between = samples[(samples >= first) & (samples <= last)]
    expected = round(np.rint(np.diff(between) / (sample_period * 1e9)).sum()) + 1 if first <= last else 0
    inside = {stage: int(np.count_nonzero((stamp >= first) & (stamp <= last))) for stage, stamp in stamps.items()}
    late = 0
    if recording.estimate is not None:
        counted = (recording.estimate.stamp_ns >= first) & (recording.estimate.stamp_ns <= last)
        late = int(np.count_nonzero(recording.estimate.flags[counted] & LATE))
    return Accounting(
        expected=expected,
        lost={stage: expected - inside[stage] for stage in STAGES},
        out_of_order={stage: _out_of_order(recording, stage, first, last) for stage in STAGES},
        late=late,
        latency=_latency(recording, first, last),
    )


def _out_of_order(recording: Recording, stage: str, first: int, last: int) -> int:
    log, stamp = recording.received_ns[stage]
    keep = np.isin(stamp, recording.stamp_ns) & (stamp >= first) & (stamp <= last)
    order = np.argsort(stamp[keep], kind="stable")
    return int(np.count_nonzero(np.diff(log[keep][order]) < 0))


def _latency(recording: Recording, first: int, last: int) -> Latency:
    pressure, command = recording.received_ns["pressure_1"], recording.received_ns["valve_command"]
    _, one, two = np.intersect1d(pressure.stamp_ns, command.stamp_ns, return_indices=True)
    inside = (pressure.stamp_ns[one] >= first) & (pressure.stamp_ns[one] <= last)
    took = (command.log_ns[two] - pressure.log_ns[one])[inside] * 1e-6
    if len(took) == 0:
        return Latency(0, math.nan, math.nan, math.nan)
    median, p99 = np.percentile(took, [50.0, 99.0])
    return Latency(len(took), float(median), float(p99), float(took.max()))
