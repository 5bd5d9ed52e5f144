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
        record: recording that would determine it; None where it is determined.
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
    """A number before and after."""

    before: float
    after: float


@dataclass(frozen=True)
class StageEntry:
    """A step of the identification. RMS errors are by channel, in SI units."""

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
    """Two strongly correlated parameters."""

    first: str
    second: str
    correlation: float


@dataclass(frozen=True)
class DifferenceEntry:
    """Relative differences between the recordings in one parameter."""

    name: str
    deviations: tuple[float, ...]
    largest: float
    std: float
    certain: bool


@dataclass(frozen=True)
class Between:
    """Differences between the recordings."""

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
    """The sensors' noise."""

    declared: SensorNoise
    found: SensorNoise


@dataclass(frozen=True)
class TuningEntry:
    """The filter's tuning; variances in squared SI units of the states and readings.

    Attributes:
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
        condition: ``free`` or ``locked``.
        lock_angle_rad: angle of a locked joint [rad]; None for a free one.
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
    """Settings of the identification."""

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
        between: differences between the recordings; None for a single one.
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
