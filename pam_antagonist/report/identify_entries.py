"""Numbers of an identification: the fields of :class:`IdentifyReport` are the keys of its ``report.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pam_antagonist.identification.session import Start
from pam_antagonist.identification.stages import Stage
from pam_antagonist.inference.trial import CHANNELS
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
        moves: how far the optimum moves beyond what the standard deviation explains.
        misfit: how far errors of the model may have moved the value at worst.
        bound: bound of the search that the value met; None for none.
        determined: whether the recordings determine the parameter.
        reason: why they do not; empty where they do.
        record: recording that would determine it; None where it is determined.
        own: value of each recording.
        own_std: standard deviation of each recording's value.
        unit: SI unit of these numbers.
    """

    name: str
    start: float
    value: float
    std: float
    relative_change: float
    prior_std: float
    moves: float
    misfit: float
    bound: float | None
    determined: bool
    reason: str
    record: str | None
    own: tuple[float, ...]
    own_std: tuple[float, ...]
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
    """A step of the identification. RMS residuals are by channel [rad, N m, Pa, Pa], None where not measured.

    Attributes:
        name: of the step.
        source: data that the step used.
        values: parameters that changed, in SI units.
        before: RMS residuals before the step.
        after: RMS residuals after the step.
        balance_nm: RMS of the joint's torque balance [N m]; None where it was not used.
        note: for the user.
    """

    name: str
    source: str
    values: Mapping[str, Change]
    before: Mapping[str, float | None]
    after: Mapping[str, float | None]
    balance_nm: Change | None
    note: str

    @classmethod
    def of(cls, stage: Stage) -> StageEntry:
        """The entry of a step."""
        balance = stage.balance
        return cls(
            stage.name,
            stage.source,
            {name: Change(old, new) for name, (old, new) in stage.values.items()},
            dict(zip(CHANNELS, stage.before, strict=True)),
            dict(zip(CHANNELS, stage.after, strict=True)),
            None if balance is None else Change(balance.rms("before"), balance.rms("after")),
            stage.note,
        )


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
class ProfileEntry:
    """Profile likelihood of a parameter, and its 95 % interval.

    Attributes:
        name: of the parameter.
        value: values at which the parameter was held, in SI units.
        loss: loss of the logarithm of likelihood and prior at each value, 0 at the best.
        low95: lower end of the interval, in SI units; None where it is open.
        high95: upper end, likewise.
    """

    name: str
    value: tuple[float, ...]
    loss: tuple[float, ...]
    low95: float | None
    high95: float | None


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
        spread: group of parameters -> relative standard deviation between recordings.
        evidence_gain: gain in the logarithm of the evidence by allowing these differences.
        differences: for each parameter.
    """

    spread: Mapping[str, float]
    evidence_gain: float
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
class RelativeChange:
    """A parameter and its relative change.

    Attributes:
        name: of the parameter.
        relative: change over value.
    """

    name: str
    relative: float


@dataclass(frozen=True)
class DirectionEntry:
    """A direction: a combination of uncertain parameters, one standard deviation.

    Attributes:
        name: of the direction.
        angle_deg: change of the angle [deg].
        torque_nm: change of the torque [N m].
        share: share of the effect of all directions.
        largest: parameters that change most.
    """

    name: str
    angle_deg: float
    torque_nm: float
    share: float
    largest: tuple[RelativeChange, ...]


@dataclass(frozen=True)
class TuningEntry:
    """The filter's tuning; variances in squared SI units of the states and readings.

    Attributes:
        process: diagonal of Q.
        process_before: diagonal of Q in the rig file.
        measurement: diagonal of R.
        measurement_before: diagonal of R in the rig file.
        log_likelihood_a_sample: mean log likelihood of the innovations.
        evaluations: number of Q that were tried.
        scale: factor of all directions.
        scale_from_reference: whether a measured angle or torque gave this factor.
        directions: of the uncertain parameters in the filter.
    """

    process: tuple[float, ...]
    process_before: tuple[float, ...]
    measurement: tuple[float, ...]
    measurement_before: tuple[float, ...]
    log_likelihood_a_sample: Change
    evaluations: int
    scale: float
    scale_from_reference: bool
    directions: tuple[DirectionEntry, ...]


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
        starts: number of starts of the joint refinement.
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
        parameters: the free parameters.
        stages: steps.
        correlations: strongly correlated parameters.
        profiles: of the most important parameters.
        between: differences between the recordings; None for a single one.
        noise: of the sensors.
        tuning: of the filter.
        starts: of the joint refinement.
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
    parameters: tuple[ParameterEntry, ...]
    stages: tuple[StageEntry, ...]
    correlations: tuple[Pair, ...]
    profiles: tuple[ProfileEntry, ...]
    between: Between | None
    noise: Noise
    tuning: TuningEntry
    starts: tuple[Start, ...]
    recordings: tuple[RecordingEntry, ...]
    warnings: tuple[str, ...]
    settings: Settings
    software: Mapping[str, str]
    assumption: str | None = None
    rejected: str = ""
