"""What a replay gives: arrays for figures, and the numbers of ``report.json``.

The fields of :class:`ReplayReport` and of the classes in it are the keys of ``report.json``. Angles are in degrees,
torques in N m, pressures in Pa; a ratio `q` is a fraction. What was not recorded is null.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import Counts, EstimateRun
from pam_antagonist.estimation.errors import FilterErrors, ModelErrors
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.replays.live import LiveComparison
from pam_antagonist.replays.segments import Plan
from pam_antagonist.rig import Rig

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Innovation:
    """Whether the filter is as wrong as it says: in the pressures, and in what was measured beside them.

    Attributes:
        nis_mean: mean normalised innovation squared; 2 is right for two pressures.
        nis_in_95: share of the samples within the 95 % interval of its chi-square distribution.
        whiteness_p: p-value of a test for whiteness.
        largest_correlation: largest autocorrelation at any lag that was tested.
        samples: how many samples have an innovation.
        nees_angle: mean normalised error squared of the angle [-]; 1 is right, None: not measured.
        nees_torque: the same of the torque [-].
    """

    nis_mean: float
    nis_in_95: float
    whiteness_p: float
    largest_correlation: float
    samples: int
    nees_angle: float | None = None
    nees_torque: float | None = None


@dataclass(frozen=True)
class RecordedRig:
    """The rig that a node reported.

    Attributes:
        name: of the rig.
        fingerprint: of its values.
        same: whether it has the values of the replay's rig.
    """

    name: str
    fingerprint: str
    same: bool


@dataclass(frozen=True)
class RecordingFacts:
    """The recording that was replayed.

    Attributes:
        name: of the bag.
        sha256: of the bag's files.
        topics: what stands for each of the package's topics.
        first_stamp_ns: stamp of the first sample [ns].
        issues: what a reader of the report should know of the recording.
        rigs: by node, where the bag names them.
    """

    name: str
    sha256: str
    topics: Mapping[str, str]
    first_stamp_ns: int
    issues: tuple[str, ...]
    rigs: Mapping[str, RecordedRig]


@dataclass(frozen=True)
class JointFacts:
    """Whether the joint could move.

    Attributes:
        condition: ``free`` or ``locked``.
        lock_angle_rad: where a locked joint was held [rad].
        source: where that is from: ``command line``, ``measured angle``, ``recorded estimate`` or ``nothing``.
    """

    condition: str
    lock_angle_rad: float | None
    source: str

    @classmethod
    def of(cls, joint: JointCondition) -> JointFacts:
        """The facts of a condition; only a locked joint has an angle."""
        return cls(joint.condition, joint.lock_angle if joint.condition == "locked" else None, joint.source)


@dataclass(frozen=True)
class FilterFacts:
    """What the filter did.

    Attributes:
        started_ns: stamps at which the filter was started [ns].
        counts: what became of its samples.
        resumed_ns: stamps of the live filter's checkpoints from which it went on [ns].
        refused: why other checkpoints were of no use.
    """

    started_ns: tuple[int, ...]
    counts: Counts
    resumed_ns: tuple[int, ...] = ()
    refused: tuple[str, ...] = ()


@dataclass(frozen=True)
class Timing:
    """How long a replay took.

    Attributes:
        read_s: reading the recording [s].
        filter_s: the filter [s].
        model_s: the model alone [s].
        total_s: all of it [s].
    """

    read_s: float
    filter_s: float
    model_s: float
    total_s: float


@dataclass(frozen=True)
class ReplayReport:
    """The numbers of one replayed recording.

    Attributes:
        samples: how many there are.
        duration_s: length of the recording [s].
        realtime_factor: length over the time that the replay took.
        ukf: errors of the filter.
        model_alone: errors of the model that runs on the voltages only.
        innovation: consistency of the filter.
        recording: what was replayed.
        joint: whether it could move.
        estimator: when it was started, and what it met.
        live_equal: how the estimates that were recorded live compare with these, bit by bit; None: none were recorded.
        live_without: samples that the live filter did not have in whole, left out here as well; None likewise.
        timing: what took how long.
    """

    samples: int
    duration_s: float
    realtime_factor: float
    ukf: FilterErrors
    model_alone: ModelErrors
    innovation: Innovation
    recording: RecordingFacts
    joint: JointFacts
    estimator: FilterFacts
    live_equal: LiveComparison | None
    live_without: int | None
    timing: Timing


@dataclass(frozen=True, eq=False)
class ModelTrack:
    """The model alone at the samples with an estimate: angle (M,) [rad], torque (M,) [N m], pressure (M, 2) [Pa].

    Attributes:
        angle: (M,) [rad].
        torque: (M,) [N m].
        pressure: (M, 2) [Pa].
    """

    angle: FloatArray
    torque: FloatArray
    pressure: FloatArray


@dataclass(frozen=True, eq=False)
class Replay:
    """A replayed recording.

    Attributes:
        recording: what was recorded.
        rig: the rig as configured.
        tuning: name of the filter's tuning.
        joint: whether the joint could move.
        run: the estimates, M of them; ``run.index`` are their samples in the recording.
        model: the model alone at the same samples.
        report: the recording's entry in ``report.json``.
        plan: where the filter was started.
    """

    recording: Recording
    rig: Rig
    tuning: str
    joint: JointCondition
    run: EstimateRun
    model: ModelTrack
    report: ReplayReport
    plan: Plan

    @property
    def name(self) -> str:
        """Of the recording."""
        return self.report.recording.name

    @cached_property
    def measured_angle(self) -> FloatArray | None:
        """Encoder at the estimates' samples, (M,) [rad]."""
        return None if self.recording.angle is None else self.recording.angle[self.run.index]

    @cached_property
    def measured_torque(self) -> FloatArray | None:
        """Torque meter at the estimates' samples, (M,) [N m]."""
        return None if self.recording.torque is None else self.recording.torque[self.run.index]

    @cached_property
    def measured_pressure(self) -> FloatArray:
        """Pressures at the estimates' samples, (M, 2) [Pa]."""
        return self.recording.pressure[self.run.index]
