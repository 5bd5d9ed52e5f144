"""Results of a replay: arrays for figures, and the numbers of ``report.json``.

The fields of :class:`ReplayReport` and of the classes in it are the keys of ``report.json``. Angles are in degrees,
torques in N m, pressures in Pa; a ratio `q` is a fraction. Quantities that were not recorded are null.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Counts, EstimateRun
from pam_antagonist.estimation.metrics import ChannelErrors, FilterErrors, ModelAloneErrors
from pam_antagonist.program import versions
from pam_antagonist.recording import RecordedEstimate, Recording, write_bag
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.replays.live import LiveComparison, ReplayPlan
from pam_antagonist.rig import Rig
from pam_antagonist.rig.units import assumption
from pam_antagonist.shown import Shown, error_in_words, number
from pam_antagonist.strict_json import picked, plain

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Innovation:
    """Consistency of the filter: whether its errors agree with its covariance, in the pressures, angle and torque."""

    nis_mean: float  # mean normalised innovation squared; 2 is right for two pressures
    nis_in_95: float  # share of the samples with a NIS within the 95 % interval of its chi-square distribution
    whiteness_p: float
    largest_correlation: float
    samples: int
    nees_angle: float | None = None  # mean normalised error squared of the angle [-]; 1 is right, None: not measured
    nees_torque: float | None = None  # mean normalised error squared of the torque [-], likewise


@dataclass(frozen=True)
class RecordedRig:
    """The rig that a node reported."""

    name: str
    fingerprint: str
    same: bool


@dataclass(frozen=True)
class RecordingFacts:
    """The recording that was replayed."""

    name: str
    sha256: str
    topics: Mapping[str, str]  # logical name of each of the package's topics -> name in the bag
    first_stamp_ns: int  # stamp of the first sample [ns]
    issues: tuple[str, ...]
    rigs: Mapping[str, RecordedRig]


@dataclass(frozen=True)
class JointFacts:
    """Whether the joint was free or locked."""

    condition: str  # ``free`` or ``locked``
    lock_angle_rad: float | None  # angle of a locked joint [rad]
    source: str  # origin of the condition: ``command line``, ``measured angle``, ``recorded estimate`` or ``nothing``

    @classmethod
    def of(cls, joint: JointCondition) -> JointFacts:
        """The facts of a condition; only a locked joint has an angle."""
        return cls(joint.condition, joint.lock_angle if joint.condition == "locked" else None, joint.source)


@dataclass(frozen=True)
class FilterFacts:
    """Starts and counts of the filter."""

    started_ns: tuple[int, ...]  # stamps at which the filter was started [ns]
    counts: Counts
    resumed_ns: tuple[int, ...] = ()  # stamps of the live filter's checkpoints from which the filter went on [ns]
    refused: tuple[str, ...] = ()


@dataclass(frozen=True)
class Timing:
    """How long a replay took."""

    read_s: float  # reading the recording [s]
    filter_s: float  # the filter [s]
    model_s: float  # the model alone [s]
    total_s: float  # all of it [s]


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
    model_alone: ModelAloneErrors
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
    plan: ReplayPlan

    @override
    def _brief(self) -> str:
        report = self.report
        errors = [
            f"{name} RMSE {error_in_words(filtered.rmse, unit, 3)} (model alone {error_in_words(alone.rmse, unit, 3)})"
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


class EstimatedChannel(NamedTuple):
    """The angle or the torque."""

    name: str
    unit: str

    @property
    def title(self) -> str:
        """The name, capitalised."""
        return self.name.capitalize()

    def of(self, errors: ModelAloneErrors) -> ChannelErrors | None:
        """Errors of the channel; None where it was not measured."""
        return errors.angle if self.name == "angle" else errors.torque

    def write(self, value: float) -> str:
        """A value with its unit; of a model that diverges, it says so."""
        return "diverges" if math.isinf(value) else f"{number(value, 2)}{'' if self.unit == '°' else ' '}{self.unit}"


ANGLE, TORQUE = EstimatedChannel("angle", "°"), EstimatedChannel("torque", "N m")
CHANNELS = (ANGLE, TORQUE)
"""Channels that are estimated from the pressures."""
LEAST_COVERAGE, HIGH_COVERAGE = 0.92, 0.98
"""Range of the coverage in which a 95 % interval is right."""
_ONE_SIDED = 1.645
"""Standard deviations below which 95 % of normal values lie."""
WIDE = 2.0 * 1.96
"""A 95 % interval is wide if its half width over the RMS error is larger: the claimed error is twice the real one."""


class JudgedChannel(NamedTuple):
    """A channel with its errors in one recording."""

    channel: EstimatedChannel
    ukf: ChannelErrors
    model: ChannelErrors

    @property
    def coverage(self) -> float:
        """Share of the measured values in the filter's 95 % interval."""
        return math.nan if self.ukf.coverage95 is None else self.ukf.coverage95


Honesty = Literal["honest", "too small", "larger than needed", "not told"]


class Covered(NamedTuple):
    """An estimated quantity that was measured as well, with the coverage of its 95 % interval."""

    what: str
    errors: ChannelErrors
    coverage: float

    @property
    def honesty(self) -> Honesty:
        """Whether its variance is right.

        Coverage below the range says that it is too small, unless so few independent errors have it by chance.
        """
        if self.coverage >= LEAST_COVERAGE:
            wide = self.coverage > HIGH_COVERAGE and (self.errors.width or 0.0) > WIDE
            return "larger than needed" if wide else "honest"
        count = math.inf if self.errors.independent is None else max(self.errors.independent, 1.0)
        return "too small" if self.coverage < 0.95 - _ONE_SIDED * math.sqrt(0.95 * 0.05 / count) else "not told"


def covered(report: ReplayReport) -> list[Covered]:
    """Every estimated quantity that was measured, the external torque as well."""
    pairs = [(item.channel.name, item.ukf) for item in judged(report)]
    pairs += [("external torque", item) for item in [report.ukf.external_torque] if item is not None]
    known = ((what, errors, errors.coverage95) for what, errors in pairs)
    return [Covered(what, errors, share) for what, errors, share in known if share is not None and math.isfinite(share)]


def judged(report: ReplayReport) -> list[JudgedChannel]:
    """Channels with a measurement, without a locked joint's angle, which is not estimated."""
    out = []
    for channel in CHANNELS:
        ukf, model = channel.of(report.ukf), channel.of(report.model_alone)
        if ukf is not None and model is not None and (channel is TORQUE or report.joint.condition == "free"):
            out.append(JudgedChannel(channel, ukf, model))
    return out


def joint_text(joint: JointFacts) -> str:
    """``free``, or ``locked at 5.7°``."""
    if joint.lock_angle_rad is None:
        return joint.condition
    return f"{joint.condition} at {math.degrees(joint.lock_angle_rad):.1f}°"


def numbers(replays: Sequence[Replay]) -> dict[str, Any]:
    """Content of ``report.json``: of one recording its numbers, of several those of each in a list."""
    rig, name = replays[0].rig, replays[0].tuning
    tuning, reports = rig.tuning(name), [plain(replay.report) for replay in replays]
    settings = {
        "rig": rig.name,
        "rig_source": rig.source.strip(),
        "sample_period_s": rig.sample_period,
        "tuning": {
            "name": name,
            **picked(tuning, "initial", "process", "measurement", "kappa"),
            "consider": rig.uncertainty if tuning.consider else {},
            "gate": tuning.gate,
        },
        "assumption": assumption(rig, name),
    }
    whole = reports[0] if len(reports) == 1 else {"recordings": reports}
    return {**whole, "settings": settings, "software": versions()}


_STATES = ("angle", "velocity", "torque")
_UNITS = {"angle": "rad", "velocity": "rad_s", "torque": "Nm"}


def columns(replay: Replay) -> dict[str, NDArray[np.generic]]:
    """Columns of M estimates, by name; the unit stands at the end of each name.

    Standard deviations and three covariances give the covariance. Quantities that were not measured have no column.
    """
    rows = replay.run.rows
    time = (replay.run.stamp_ns - replay.recording.stamp_ns[0]) * 1e-9
    out: dict[str, NDArray[np.generic]] = {"stamp_ns": replay.run.stamp_ns, "time_s": time}
    for k, name in enumerate(_STATES):
        out[f"{name}_{_UNITS[name]}"] = rows[name]
        out[f"{name}_std_{_UNITS[name]}"] = np.sqrt(rows["covariance"][:, k, k])
    for j, k in ((0, 1), (0, 2), (1, 2)):
        pair = (_STATES[j], _STATES[k])
        out[f"covariance_{pair[0]}_{pair[1]}_{_UNITS[pair[0]]}_{_UNITS[pair[1]]}"] = rows["covariance"][:, j, k]
    for muscle in (0, 1):
        out[f"pressure_{muscle + 1}_Pa"] = rows["pressure"][:, muscle]
        out[f"force_{muscle + 1}_N"] = rows["force"][:, muscle]
        out[f"innovation_{muscle + 1}_Pa"] = rows["innovation"][:, muscle]
    for j, k in ((0, 0), (0, 1), (1, 1)):
        out[f"innovation_covariance_{j + 1}{k + 1}_Pa2"] = rows["innovation_covariance"][:, j, k]
    if np.isfinite(rows["external_torque"]).any():
        out["external_torque_Nm"] = rows["external_torque"]
        out["external_torque_std_Nm"] = np.sqrt(rows["external_torque_covariance"][:, 3])
    out |= {"nis": rows["nis"], "stiffness_Nm_rad": rows["stiffness"]}
    out |= {name: rows[name] for name in ("subsystem", "flags")}
    out |= {f"state_{name}": values for name, values in replay.run.added.items()}
    measured = {"measured_angle_rad": replay.measured_angle, "measured_torque_Nm": replay.measured_torque}
    return out | {name: values for name, values in measured.items() if values is not None}


def check_estimate(path: Path, overwrite: bool = False) -> None:
    """Refuse a file name that :func:`write_estimate` would refuse, before the replay runs."""
    if path.suffix not in (".csv", ".mcap"):
        raise BadInput(f"{path}: expected a name that ends with .csv or .mcap")
    if path.exists() and not (overwrite and path.is_file()):
        raise BadInput(f"{path}: exists; expected a new file, nothing is overwritten")


def write_estimate(path: Path, replay: Replay, overwrite: bool = False) -> None:
    """Write the estimates of a replay.

    A bag holds ``joint_estimate`` (estimate, covariance, innovations, stamps) beside the recording's own topics, with
    the definitions of all message types.

    `path`: of a new file, ``*.csv`` or ``*.mcap``.
    """
    check_estimate(path, overwrite)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as aside:
            partial = Path(aside) / path.name
            if path.suffix == ".csv":
                _write_csv(partial, columns(replay))
            else:
                _write_mcap(partial, replay)
            partial.rename(path)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror or error}") from None


def _write_csv(path: Path, table: dict[str, NDArray[np.generic]]) -> None:
    formats = ["%d" if np.issubdtype(values.dtype, np.integer) else "%.10g" for values in table.values()]
    line = ",".join(formats)
    with path.open("w", encoding="utf-8") as stream:
        stream.write(",".join(table) + "\n")
        stream.writelines(
            f"{line % row}\n" for row in zip(*(values.tolist() for values in table.values()), strict=True)
        )


def _write_mcap(path: Path, replay: Replay) -> None:
    run = replay.run
    estimate = RecordedEstimate.from_rows(run.stamp_ns, run.started_ns, run.rows)
    folder = path.with_name("bag")
    write_bag(folder, replay.recording, estimate=estimate)
    (written,) = folder.glob("*.mcap")
    written.rename(path)
