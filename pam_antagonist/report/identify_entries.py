"""Numbers of an identification: the fields of :class:`IdentifyReport` are the keys of its ``report.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pam_antagonist.identification.result import Step
from pam_antagonist.report.held_out import HeldOut
from pam_antagonist.rig import Rig


@dataclass(frozen=True)
class ParameterEntry:
    """A free parameter before and after the fit, in SI units.

    Attributes:
        name: of the parameter.
        start: value of the rig file.
        value: identified value.
        std: standard deviation of the value.
        relative_change: of the value.
        prior_std: standard deviation of the prior.
        bound: bound of the search that the value met; None for none.
        determined: whether the recordings determine the parameter.
        reason: why they do not; empty where they do.
        record: recording that would determine it; None where it is determined.
        unit: SI unit of these numbers.
    """

    name: str
    start: float
    value: float
    std: float
    relative_change: float
    prior_std: float
    bound: float | None
    determined: bool
    reason: str
    record: str | None
    unit: str


@dataclass(frozen=True)
class Change:
    """A number before and after.

    Attributes:
        before: number before.
        after: number after.
    """

    before: float
    after: float


@dataclass(frozen=True)
class StageEntry:
    """A step of the identification. RMS errors are by channel, in SI units.

    Attributes:
        name: of the step.
        source: data that the step used.
        values: parameters that changed, in SI units.
        before: RMS errors before the step.
        after: RMS errors after the step.
        note: for the user.
    """

    name: str
    source: str
    values: Mapping[str, Change]
    before: Mapping[str, float]
    after: Mapping[str, float]
    note: str

    @classmethod
    def of(cls, step: Step) -> StageEntry:
        """The entry of a step."""
        values = {name: Change(old, new) for name, (old, new) in step.values.items()}
        return cls(step.name, step.source, values, step.before, step.after, step.note)


@dataclass(frozen=True)
class Pair:
    """Two strongly correlated parameters.

    Attributes:
        first: a parameter.
        second: another one.
        correlation: of their errors.
    """

    first: str
    second: str
    correlation: float


@dataclass(frozen=True)
class DifferenceEntry:
    """Relative differences between the recordings in one parameter.

    Attributes:
        name: of the parameter.
        deviations: of each recording from the common value.
        largest: largest difference of two recordings.
        std: standard deviation of this difference.
        certain: whether the difference is significant.
    """

    name: str
    deviations: tuple[float, ...]
    largest: float
    std: float
    certain: bool


@dataclass(frozen=True)
class Between:
    """Differences between the recordings.

    Attributes:
        differences: for each parameter.
    """

    differences: tuple[DifferenceEntry, ...]


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations and steps of the sensors.

    Attributes:
        pressure_std: [Pa].
        angle_std: [rad].
        angle_step: [rad].
        torque_std: [N m].
        torque_step: [N m].
    """

    pressure_std: float
    angle_std: float
    angle_step: float
    torque_std: float
    torque_step: float

    @classmethod
    def of(cls, rig: Rig) -> SensorNoise:
        """The entry of a rig."""
        s = rig.sensors
        return cls(*(float(v) for v in (s.pressure_std, s.angle_std, s.angle_step, s.torque_std, s.torque_step)))


@dataclass(frozen=True)
class Noise:
    """The sensors' noise.

    Attributes:
        declared: by the rig file.
        found: in the recordings.
    """

    declared: SensorNoise
    found: SensorNoise


@dataclass(frozen=True)
class TuningEntry:
    """The filter's tuning; variances in squared SI units of the states and readings.

    Attributes:
        process: diagonal of Q.
        process_before: diagonal of Q in the rig file.
        measurement: diagonal of R.
        measurement_before: diagonal of R in the rig file.
        unknown_torque_nm: standard deviation of a constant torque that the filter considers [N m].
        directions: of the uncertain parameters in the filter: change of each by one standard deviation.
    """

    process: tuple[float, ...]
    process_before: tuple[float, ...]
    measurement: tuple[float, ...]
    measurement_before: tuple[float, ...]
    unknown_torque_nm: float
    directions: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class RecordingEntry:
    """A recording that was used.

    Attributes:
        sha256: of the bag's files.
        topics: logical name -> name in the bag.
        issues: found while reading.
        name: of the recording.
        condition: ``free`` or ``locked``.
        lock_angle_rad: angle of a locked joint [rad]; None for a free one.
        source: origin of the condition.
        samples: number of samples.
        duration_s: length [s].
        fitted_until_s: end of the fitted part [s].
    """

    sha256: str
    topics: Mapping[str, str]
    issues: tuple[str, ...]
    name: str
    condition: str
    lock_angle_rad: float | None
    source: str
    samples: int
    duration_s: float
    fitted_until_s: float


@dataclass(frozen=True)
class Settings:
    """Settings of the identification.

    Attributes:
        rig: name of the rig.
        free: additional free parameters.
        frozen: parameters that were held.
        holdout: share of each recording that was held out.
        starts: number of starts of the fit of joint and muscles.
        seed: of the starts.
    """

    rig: str
    free: tuple[str, ...]
    frozen: tuple[str, ...]
    holdout: float
    starts: int
    seed: int


@dataclass(frozen=True)
class IdentifyReport:
    """All numbers of an identification.

    Attributes:
        held_out: errors on the part of each recording that was not fitted.
        coverage95: mean coverage of the identified rig's 95 % interval on the held-out parts, over channels and
            recordings; NaN where nothing was measured.
        coverage95_own: mean coverage with each recording's own values; NaN for a single recording.
        errors_deg: of the angle, over all held-out data of free joints, by what gives it, RMS [deg].
        parameters: the free parameters.
        stages: steps.
        correlations: strongly correlated parameters.
        between: differences between the recordings; None for a single one.
        noise: of the sensors.
        tuning: of the filter.
        recordings: used recordings.
        warnings: for the user.
        settings: of the identification.
        software: versions.
        assumption: the uncertainty that the rig file claims; None for an identified rig.
        rejected: why the identified rig should not be used; empty if it may.
    """

    held_out: tuple[HeldOut, ...]
    coverage95: float
    coverage95_own: float
    errors_deg: Mapping[str, float]
    parameters: tuple[ParameterEntry, ...]
    stages: tuple[StageEntry, ...]
    correlations: tuple[Pair, ...]
    between: Between | None
    noise: Noise
    tuning: TuningEntry
    recordings: tuple[RecordingEntry, ...]
    warnings: tuple[str, ...]
    settings: Settings
    software: Mapping[str, str]
    assumption: str | None = None
    rejected: str = ""
