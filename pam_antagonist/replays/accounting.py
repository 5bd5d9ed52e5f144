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


_NONE = Arrival(np.empty(0, np.int64), np.empty(0, np.int64))


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
    """Account for the samples of a recording; None where a stage has none."""
    # With pressure regulators their topics replace those of the valves.
    own = {"valve_state": STATE_TOPICS[recording.drive], "valve_command": COMMAND_TOPICS[recording.drive]}
    without_sensors = recording.drive == "regulator" and not np.isfinite(recording.pressure).any()
    stages = STAGES[2:] if without_sensors else STAGES
    arrivals = {stage: recording.received_ns.get(own.get(stage, stage), _NONE) for stage in stages}
    samples = recording.stamp_ns
    # Commands of safe voltages without an estimate are stamped when they are sent, so they belong to no sample.
    stamps = {stage: np.intersect1d(arrival.stamp_ns, samples) for stage, arrival in arrivals.items()}
    if any(len(stamp) == 0 for stamp in stamps.values()):
        return None
    first, last = max(int(stamp[0]) for stamp in stamps.values()), min(int(stamp[-1]) for stamp in stamps.values())

    def counted(stamp: Stamps) -> NDArray[np.bool_]:
        return np.asarray((stamp >= first) & (stamp <= last))

    inside = samples[counted(samples)]
    # Counting goes from stamp to stamp, because a device's clock drifts against the host's.
    expected = min(1, len(inside)) + round(np.rint(np.diff(inside) / (sample_period * 1e9)).sum())
    late, out_of_order = 0, {}
    if recording.estimate is not None:
        late = int(np.count_nonzero(recording.estimate.flags[counted(recording.estimate.stamp_ns)] & LATE))
    for stage, (log, stamp) in arrivals.items():
        keep = np.isin(stamp, samples) & counted(stamp)
        order = np.argsort(stamp[keep], kind="stable")
        out_of_order[stage] = int(np.count_nonzero(np.diff(log[keep][order]) < 0))
    # From the first topic of a sample to its command.
    begun, command = arrivals[stages[0]], arrivals["valve_command"]
    stamp, one, two = np.intersect1d(begun.stamp_ns, command.stamp_ns, return_indices=True)
    took = (command.log_ns[two] - begun.log_ns[one])[counted(stamp)] * 1e-6
    median, p99, largest = np.percentile(took, [50.0, 99.0, 100.0]).tolist() if len(took) else [math.nan] * 3
    return Accounting(
        expected=expected,
        lost={stage: expected - int(np.count_nonzero(counted(stamp))) for stage, stamp in stamps.items()},
        out_of_order=out_of_order,
        late=late,
        latency=Latency(len(took), median, p99, largest),
    )
