"""The result of a diagnosis, and its parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.errors import ModelErrors, RigErrors
from pam_antagonist.diagnosis.hypotheses import TriedCandidate
from pam_antagonist.diagnosis.models import Model, contradict
from pam_antagonist.diagnosis.preparation import Prepared
from pam_antagonist.diagnosis.remaining import RemainingResidual
from pam_antagonist.diagnosis.residual_statistics import ResidualRow
from pam_antagonist.diagnosis.splits import Firmness
from pam_antagonist.diagnosis.verdicts import Verdict
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.point import Point
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law
from pam_antagonist.shown import Shown

if TYPE_CHECKING:
    from pam_antagonist.diagnosis.rig_choice import RigChoice
    from pam_antagonist.identification.result import HeldRecording

Floats = NDArray[np.float64]

MODELS = ("as_configured", "recalibrated", "extended")
_STAMPED = ("late", "early")
_WORDS = {
    "encoder_zero": ("the encoder reads", ("low", "high"), "°", 180.0 / np.pi),
    "torque_zero": ("the torque meter reads", ("low", "high"), "N m", 1.0),
    "torque_scale": ("the torque meter reads", ("little", "much"), "%", 100.0),
    "delay_voltage": ("the voltages are stamped", _STAMPED, "ms", 1e3),
    "delay_angle": ("the angle is stamped", _STAMPED, "ms", 1e3),
    "delay_torque": ("the torque is stamped", _STAMPED, "ms", 1e3),
    "delay_pressure": ("the pressures are stamped", _STAMPED, "ms", 1e3),
}
"""Words for each calibration: subject and verb, adjectives of a negative and a positive value, unit and its factor."""


@dataclass(frozen=True)
class FoundCalibration:
    """A calibration that recordings need."""

    name: str  # in :data:`~pam_antagonist.inference.calibration.CALIBRATIONS`
    value: float
    std: float  # its standard deviation, including the uncertainty of the rig's parameters
    unit: str
    delta_bic: float
    # value and standard deviation in each recording that shows it, by its name.
    by_recording: Mapping[str, tuple[float, float]]
    rivals: tuple[str, ...] = ()  # effects and calibrations that the recordings cannot distinguish from it

    @property
    def is_shared(self) -> bool:
        """Whether one value suits all recordings. If not, there is none to type."""
        return len(self.by_recording) < 2 or not contradict(list(self.by_recording.values()), self.value)

    def in_words(self) -> str:
        """It in words."""
        who, ways, unit, factor = _WORDS[self.name]
        size, std = abs(self.value) * factor, self.std * factor
        # A standard deviation has one digit, or two that begin with 1; the value has no more than these.
        magnitude = float(np.log10(max(std, 1e-6)))
        digits = max(0, -int(np.floor(magnitude)) + (magnitude % 1.0 < np.log10(2.0)))
        number = f"{size:.{digits}f} ± {std:.{digits}f} {unit}".replace(" °", "°")
        return f"{who} {number} too {ways[int(self.value > 0.0)]}"


class Size(NamedTuple):
    """A parameter of a found effect."""

    value: float
    std: float
    unit: str

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        return self._asdict()


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the recordings show.

    Attributes:
        name: in the catalogue.
        muscle: 1 or 2; None for both, and for an effect that belongs to neither.
        parameters: by name.
        delta_bic: evidence for it: what the model loses without it, the price of its parameters paid.
        holdout_gain: share of the held-out excess over noise (:mod:`models`) that goes with it; None for a
            disturbance torque in recordings of which nothing is held out.
        recordings: names of the recordings that show it.
        part: of the joint that shows it, see :class:`PartVerdict`.
        onset_s: since when it acts [s]; None: throughout.
        onset_std_s: standard deviation of that [s].
        end_s: until when it acts [s]; None: to the end of every recording that shows it.
        end_std_s: standard deviation of that [s].
        splits: how many of them support it; None where it was not judged so.
        law: of a learned effect; None of the catalogue's.
        like: effects of the catalogue that act where a learned one does and explain something.
        alternatives: other laws that simulate as well as a learned one, in words.
    """

    name: str
    muscle: int | None
    parameters: Mapping[str, Size]
    delta_bic: float
    holdout_gain: float | None
    recordings: tuple[str, ...] = ()
    part: str = ""
    onset_s: float | None = None
    onset_std_s: float | None = None
    end_s: float | None = None
    end_std_s: float | None = None
    splits: Firmness | None = None
    law: Law | None = None
    like: tuple[str, ...] = ()
    alternatives: tuple[str, ...] = ()

    @property
    def in_short(self) -> str:
        """Its name, and the place of a learned law."""
        return self.name if self.law is None else f"a law of {self.law.where}"

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        of_law = ("law", "like", "alternatives")
        out = {item.name: getattr(self, item.name) for item in fields(self) if item.name not in of_law}
        if self.law is None:
            return out
        return {**out, **self.law.to_json(), "like": list(self.like), "alternatives": list(self.alternatives)}


@dataclass(frozen=True)
class Ambiguity:
    """An effect that was compared with a found one on equal terms."""

    found: str
    other: str
    evidence: float
    residual: tuple[float, float]  # root mean square of what each leaves (found, other) where they were compared
    unit: str
    shape: float  # the other's width [m] or time constant [s]
    about: str
    size: float = float("nan")  # of the found effect in the comparison, in `size_unit`; NaN if it has none of its own
    parameter: str = ""  # of the found effect, whose standard deviation should cover the difference to `size`; or empty
    ambiguous: bool = False
    size_unit: str = ""


@dataclass(frozen=True)
class PartVerdict:
    """The verdict on one part of the joint, which was judged by itself."""

    # ``joint``; ``pressures`` and ``torque`` of a joint that is driven by its angle; ``joint and muscles`` and
    # ``chambers and valves`` of a rig of data sheets and of short trials.
    name: str
    verdict: Verdict
    # of its held-out excess over noise that its effects remove; None if that is a disturbance torque in recordings of
    # which nothing is held out.
    share_explained: float | None


@dataclass(frozen=True, eq=False, repr=False)
class HeldOutComparison(Shown):
    """A recording, or a part of it, with the three models; what was held out of it judges them."""

    prepared: Prepared
    experiment: Experiment  # the recording; its ``held_samples`` were held out
    points: Mapping[str, Point]  # of the three models on it, by name (``MODELS``)
    role: str  # ``fitted`` to its end, ``held out`` as a whole, or ``both``: its end was held out
    number: int  # of the recording, in the order in which they were given
    before: HeldOutComparison | None = None  # the same without laws that were learned; None: there are none

    def of(self, model: str) -> HeldOutComparison:
        """That which a model belongs to: all but the extended one are without learned laws."""
        return self if self.before is None or model == MODELS[-1] else self.before

    @property
    def recording(self) -> Recording:
        """All of the recording, as it was read."""
        return self.prepared.recordings[self.number]

    def residual(self, model: str) -> Floats:
        """What a model leaves of the whole recording (B, C). `model`: one of ``MODELS``."""
        own = self.of(model)
        return own.experiment.residual(own.points[model], whole=True)

    @property
    def judges(self) -> bool:
        """Whether anything of it was held out."""
        return self.role != "fitted"


Residuals = Mapping[str, tuple[ResidualRow, ...]]
"""Rows of the recalibrated and of the extended model."""


@dataclass(frozen=True)
class RecordingEntry:
    """A recording with the errors of the models on it."""

    recording: str
    joint: str  # ``free``, ``locked`` or ``driven``
    lock_angle_rad: float | None  # where a locked joint was held [rad]
    role: str  # ``fitted``, ``held out``, or ``both``: its end was held out
    held_out_from_s: float | None  # where the held-out part begins, the first of them if there are several [s]
    errors: ModelErrors | None = None
    residuals: Residuals | None = None
    ukf: ModelErrors | None = None
    # how often a driven joint slides in the fitted and in the held-out part; None of other joints.
    sweeps: Mapping[str, int] | None = None
    sha256: str = ""  # of the bag's files; empty where it was not read from a bag
    # begin and end of every held-out part [s]; None where nothing was held out.
    held_out_s: tuple[tuple[float, float], ...] | None = None

    def to_json(self) -> dict[str, Any]:
        """Without what was not worked out."""
        return {
            item.name: getattr(self, item.name)
            for item in fields(self)
            if getattr(self, item.name) is not None or item.name in ("lock_angle_rad", "errors", "held_out_from_s")
        }


@dataclass(frozen=True)
class SizeProfile:
    """Profile likelihood of a size."""

    parameter: str
    recording: str
    value: float
    std: float
    unit: str
    values: tuple[float, ...]
    rise: tuple[float, ...]  # of −2 log posterior there
    flat: bool  # whether half of the size would explain the recording as well


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Shown):
    """The result of a diagnosis.

    Attributes:
        verdict: ``effect``, ``none`` or ``unexplained``.
        sentence: the verdict with its evidence, for people.
        effects: what was found; empty unless the verdict is ``effect``.
        calibrations: of sensors and clocks, that the recordings need; they are no effects.
        ambiguous_with: effects and calibrations that the recordings cannot distinguish from the found ones.
        experiment: what would distinguish them, by effect.
        ambiguities: comparisons of found effects with others on equal terms.
        ranking: all candidates of all rounds, with their models.
        share: share of the held-out excess over noise (:mod:`models`) that the extended model removes; None if that
            is a disturbance torque in recordings of which nothing is held out.
        parts: the verdict on each part of the joint that was judged by itself.
        errors: of the three models, on each recording with its own values.
        of_one_rig: errors with one rig file for all recordings, by the name of the model.
        by_recording: errors of the three models and more, for each recording.
        reference: errors of maps without physics, by name [N m]; None where there is none to compare with.
        remaining: what is not explained, described.
        unseen: what these recordings cannot show.
        warnings: what the user should know.
        profiles: profile likelihoods of the found sizes.
        rig_recalibrated: common base parameters.
        rig_extended: with the effects.
        own: for each recording its name and its own extended rig.
        base_friction_removed: whether friction of the rig file was taken out before anything was tested.
        recalibrated: the model without effects.
        extended: the model with them.
        compared: the recordings with the three models on each, those that were held out as a whole as well.
        seconds: time of each step [s], by name.
        notes: what else the user may want to know.
        held: of a rig of data sheets and of short trials, the filter on what was held out, before and after.
        decided: the rig files, where the way of the recordings has its own rule.
    """

    verdict: Verdict
    sentence: str
    effects: tuple[FoundEffect, ...]
    calibrations: tuple[FoundCalibration, ...]
    ambiguous_with: tuple[str, ...]
    experiment: Mapping[str, str]
    ambiguities: tuple[Ambiguity, ...]
    ranking: tuple[TriedCandidate, ...]
    share: float | None
    parts: tuple[PartVerdict, ...]
    errors: ModelErrors
    of_one_rig: Mapping[str, RigErrors]
    by_recording: tuple[RecordingEntry, ...]
    reference: Mapping[str, float] | None
    remaining: tuple[RemainingResidual, ...]
    unseen: tuple[str, ...]
    warnings: tuple[str, ...]
    profiles: tuple[SizeProfile, ...]
    rig_recalibrated: Rig
    rig_extended: Rig
    own: tuple[tuple[str, Rig], ...]
    base_friction_removed: bool
    recalibrated: Model
    extended: Model
    compared: tuple[HeldOutComparison, ...]
    seconds: Mapping[str, float]
    notes: tuple[str, ...]
    held: tuple[HeldRecording, ...]
    decided: RigChoice | None

    @property
    def shared(self) -> tuple[FoundCalibration, ...]:
        """The calibrations with one value for all recordings."""
        return tuple(item for item in self.calibrations if item.is_shared)

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        """The recordings as they were compared."""
        return self.extended.experiments

    @property
    def driven(self) -> bool:
        """Whether the measured angle drives the model, as for a sealed joint."""
        return any(part.joint == "driven" for part in self.by_recording)
