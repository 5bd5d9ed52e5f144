"""Lost, late and out-of-order samples of a recorded pipeline, and its latency (without ROS)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation.memory import LATE
from pam_antagonist.recording import Recording
from pam_antagonist.recording.recording import Arrival
from pam_antagonist.recording.topics import COMMAND_TOPICS, STATE_TOPICS

Stamps = NDArray[np.int64]

STAGES = ("pressure_1", "pressure_2", "valve_state", "joint_estimate", "valve_command")
"""The topics with one message a sample, in the order of the pipeline; the first two are missing where no pressures are
measured."""


@dataclass(frozen=True)
class Latency:
    """Times from the recorder's reception of a sample's first message to its reception of the command [ms]."""

    samples: int
    median: float  # median time [ms]
    p99: float  # 99 % quantile [ms]
    largest: float  # largest time [ms]


@dataclass(frozen=True)
class Accounting:
    """Lost and late samples between the end of discovery and the end of the recording.

    Counting begins at the first stamp at which every stage has begun, and ends at the last stamp before one stage ends.
    In between, one sample a period is expected.
    """

    expected: int
    lost: Mapping[str, int]
    out_of_order: Mapping[str, int]  # stage -> messages that were received before one with an earlier stamp
    late: int
    latency: Latency


def account(recording: Recording, sample_period: float) -> Accounting | None:
    """Account for the samples of a recording."""
    found = _between(recording)
    if found is None:
        return None
    stamps, first, last = found
    samples = recording.stamp_ns
    inside = samples[(samples >= first) & (samples <= last)]
    # Counting goes from stamp to stamp, because a device's clock drifts against the host's.
    expected = min(1, len(inside)) + round(np.rint(np.diff(inside) / (sample_period * 1e9)).sum())
    there = {stage: int(np.count_nonzero((stamp >= first) & (stamp <= last))) for stage, stamp in stamps.items()}
    late = 0
    if recording.estimate is not None:
        counted = (recording.estimate.stamp_ns >= first) & (recording.estimate.stamp_ns <= last)
        late = int(np.count_nonzero(recording.estimate.flags[counted] & LATE))
    return Accounting(
        expected=expected,
        lost={stage: expected - there[stage] for stage in stamps},
        out_of_order={stage: _out_of_order(recording, stage, first, last) for stage in stamps},
        late=late,
        latency=_latency(recording, first, last),
    )


def _arrivals(recording: Recording) -> dict[str, Arrival]:
    """Stage -> its messages; with pressure regulators their topics replace those of the valves."""
    own = {"valve_state": STATE_TOPICS[recording.drive], "valve_command": COMMAND_TOPICS[recording.drive]}
    names = {stage: own.get(stage, stage) for stage in STAGES}
    return {stage: recording.received_ns[name] for stage, name in names.items() if name in recording.received_ns}


def _stages(recording: Recording) -> tuple[str, ...]:
    """The entries of ``STAGES`` that this joint has."""
    without_sensors = recording.drive == "regulator" and not np.isfinite(recording.pressure).any()
    return STAGES[2:] if without_sensors else STAGES


def _between(recording: Recording) -> tuple[dict[str, Stamps], int, int] | None:
    """Stage -> stamps of samples; then the latest first stamp and the earliest last stamp of all stages."""
    arrivals, stages = _arrivals(recording), _stages(recording)
    if any(stage not in arrivals or len(arrivals[stage].stamp_ns) == 0 for stage in stages):
        return None
    # Commands of safe voltages without an estimate are stamped when they are sent, so they belong to no sample.
    stamps = {stage: np.intersect1d(arrivals[stage].stamp_ns, recording.stamp_ns) for stage in stages}
    if any(len(stamp) == 0 for stamp in stamps.values()):
        return None
    return stamps, max(int(stamp[0]) for stamp in stamps.values()), min(int(stamp[-1]) for stamp in stamps.values())


def _out_of_order(recording: Recording, stage: str, first: int, last: int) -> int:
    log, stamp = _arrivals(recording)[stage]
    keep = np.isin(stamp, recording.stamp_ns) & (stamp >= first) & (stamp <= last)
    order = np.argsort(stamp[keep], kind="stable")
    return int(np.count_nonzero(np.diff(log[keep][order]) < 0))


def _latency(recording: Recording, first: int, last: int) -> Latency:
    arrivals = _arrivals(recording)
    pressure, command = arrivals[_stages(recording)[0]], arrivals["valve_command"]
    stamp, one, two = np.intersect1d(pressure.stamp_ns, command.stamp_ns, return_indices=True)
    took = (command.log_ns[two] - pressure.log_ns[one])[(stamp >= first) & (stamp <= last)] * 1e-6
    if len(took) == 0:
        return Latency(0, math.nan, math.nan, math.nan)
    median, p99 = np.percentile(took, [50.0, 99.0])
    return Latency(len(took), float(median), float(p99), float(took.max()))
