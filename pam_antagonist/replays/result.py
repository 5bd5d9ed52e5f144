"""Results of a replay: arrays for figures, and the numbers of ``report.json``.

The fields of :class:`ReplayReport` and of the classes in it are the keys of ``report.json``. Angles are in degrees,
torques in N m, pressures in Pa; a ratio `q` is a fraction. Quantities that were not recorded are null.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.estimation import Counts, EstimateRun
from pam_antagonist.estimation.errors import FilterErrors, ModelErrors
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.replays.live import LiveComparison
from pam_antagonist.replays.segments import Plan
from pam_antagonist.rig import Rig
from pam_antagonist.shown import Shown

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Innovation:
    """Consistency of the filter: whether its errors agree with its covariance, in the pressures, angle and torque.

    Attributes:
        nis_mean: mean normalised innovation squared; 2 is right for two pressures.
        nis_in_95: share of the samples with a NIS within the 95 % interval of its chi-square distribution.
        nees_angle: mean normalised error squared of the angle [-]; 1 is right, None: not measured.
        nees_torque: mean normalised error squared of the torque [-], likewise.
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
    """The rig that a node reported."""

    name: str
    fingerprint: str
    same: bool


@dataclass(frozen=True)
class RecordingFacts:
    """The recording that was replayed.

    Attributes:
        topics: logical name of each of the package's topics -> name in the bag.
        first_stamp_ns: stamp of the first sample [ns].
    """

    name: str
    sha256: str
    topics: Mapping[str, str]
    first_stamp_ns: int
    issues: tuple[str, ...]
    rigs: Mapping[str, RecordedRig]


@dataclass(frozen=True)
class JointFacts:
    """Whether the joint was free or locked.

    Attributes:
        condition: ``free`` or ``locked``.
        lock_angle_rad: angle of a locked joint [rad].
        source: origin of the condition: ``command line``, ``measured angle``, ``recorded estimate`` or ``nothing``.
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
    """Starts and counts of the filter.

    Attributes:
        started_ns: stamps at which the filter was started [ns].
        resumed_ns: stamps of the live filter's checkpoints from which the filter went on [ns].
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


@dataclass(frozen=True, repr=False)
class ReplayReport(Shown):
    """The numbers of one replayed recording.

    Attributes:
        samples: number of samples.
        duration_s: length of the recording [s].
        realtime_factor: duration of the recording over that of the replay.
        ukf: errors of the filter.
        model_alone: errors of the model that runs on the voltages only.
        innovation: consistency of the filter.
        recording: the replayed recording.
        joint: whether the joint was free or locked.
        estimator: starts and counts of the filter.
        live_equal: comparison with the live estimates, bit by bit; None: none were recorded.
        live_without: samples that the live filter lacked in part, left out of the replay as well; None likewise.
        timing: durations of the steps.
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


@dataclass(frozen=True, eq=False, repr=False)
class ModelTrack(Shown):
    """The model alone at the samples with an estimate: angle (M,) [rad], torque (M,) [N m], pressure (M, 2) [Pa].

    Attributes:
        angle: (M,) [rad].
        torque: (M,) [N m].
        pressure: (M, 2) [Pa].
    """

    angle: FloatArray
    torque: FloatArray
    pressure: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class Replay(Shown):
    """A replayed recording.

    Attributes:
        recording: the recording.
        rig: the rig as configured.
        tuning: name of the filter's tuning.
        joint: whether the joint was free or locked.
        run: M estimates; ``run.index`` are their samples in the recording.
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

    @override
    def _brief(self) -> str:
        report = self.report
        errors = [
            f"{name} RMSE {filtered.rmse:.3g}{unit} (model alone {alone.rmse:.3g}{unit})"
            for name, unit, filtered, alone in (
                ("angle", "°", report.ukf.angle, report.model_alone.angle),
                ("torque", " N m", report.ukf.torque, report.model_alone.torque),
            )
            if filtered is not None and alone is not None
        ]
        return (
            f"{self.name}, {report.duration_s:.1f} s, joint {self.joint.condition}, rig {self.rig.name}; "
            f"{', '.join(errors) or 'neither angle nor torque was measured'}"
        )

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self.report.recording.name

    @cached_property
    def measured_angle(self) -> FloatArray | None:
        """Encoder angle at the estimates' samples, (M,) [rad]."""
        return None if self.recording.angle is None else self.recording.angle[self.run.index]

    @cached_property
    def measured_torque(self) -> FloatArray | None:
        """Measured torque at the estimates' samples, (M,) [N m]."""
        return None if self.recording.torque is None else self.recording.torque[self.run.index]

    @cached_property
    def measured_pressure(self) -> FloatArray:
        """Measured pressures at the estimates' samples, (M, 2) [Pa]."""
        return self.recording.pressure[self.run.index]
