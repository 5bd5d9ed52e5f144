"""Results of ``close_loop`` as typed numbers, the content of its ``report.json``.

The fields of :class:`CloseLoopReport` and of the classes in it are the keys of ``report.json``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from pam_antagonist.diagnosis import found_calibrations, thresholds
from pam_antagonist.diagnosis.errors import ModelErrors
from pam_antagonist.diagnosis.found_calibrations import FoundCalibration
from pam_antagonist.diagnosis.remaining import RemainingResidual
from pam_antagonist.diagnosis.result import (
    Ambiguity,
    Diagnosis,
    FoundEffect,
    PartVerdict,
    RecordingEntry,
    Size,
    SizeProfile,
    Splits,
    Verdict,
)
from pam_antagonist.diagnosis.rig_choice import RigChoice
from pam_antagonist.diagnosis.warnings import like_a_curve
from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.program import typed as typed_command
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.report.assumption import assumption
from pam_antagonist.rig import Rig
from pam_antagonist.shown import Shown
from pam_antagonist.software import versions


@dataclass(frozen=True)
class Calibration:
    """A calibration of a sensor or a clock that the recordings need.

    Attributes:
        name: ``encoder_zero``, ``torque_zero``, ``torque_scale``, or ``delay_`` and the signal that is stamped early.
        value: in ``unit``; positive where a sensor reads too high, or stamps are early.
        ambiguous_with: effects and calibrations that the recordings cannot distinguish from this one.
    """

    name: str
    value: float
    std: float
    unit: str
    sentence: str
    delta_bic: float
    recordings: Mapping[str, Size]
    ambiguous_with: tuple[str, ...]

    @classmethod
    def of(cls, found: FoundCalibration) -> Calibration:
        """The entry of a calibration."""
        each = {name: Size(value, std, found.unit) for name, (value, std) in found.by_recording.items()}
        words = found_calibrations.in_words(found)
        return cls(found.name, found.value, found.std, found.unit, words, found.delta_bic, each, found.rivals)


@dataclass(frozen=True)
class Candidate:
    """A candidate in one round.

    Attributes:
        round: from 1.
        holdout_gain: share of the held-out excess that the candidate explains; None likewise.
        score_by_muscle: score on each muscle alone; None where this was not tried.
    """

    name: str
    round: int
    score: float
    delta_bic: float | None
    holdout_gain: float | None
    taken: bool
    score_by_muscle: tuple[float, float] | None


@dataclass(frozen=True)
class Settings:
    """Settings of the diagnosis, and the thresholds of its decisions.

    Attributes:
        holdout: share of each recording that was held out, or names of recordings.
        first_share: least share of the held-out excess that a first effect explains.
    """

    rig: str
    rig_source: str
    seed: int
    holdout: float | tuple[str, ...]
    strong_evidence: float
    first_share: float
    further_share: float
    explained_share: float


@dataclass(frozen=True, repr=False)
class CloseLoopReport(Shown):
    """All numbers of a diagnosis.

    Attributes:
        verdict: ``effect``, ``none`` or ``unexplained``.
        ambiguous_with: effects and calibrations that the recordings cannot distinguish from the detected ones.
        ambiguities: effects that were compared with a detected one under equal conditions.
        share_explained: share of the held-out excess over noise that the effects explain; None if that is a disturbance
            torque in recordings of which nothing is held out.
        parts: verdict on each part of the joint with a test of its own.
        reference: errors of straight-line maps without physics [N m]; None where there is none.
        base_friction_removed: whether the rig file's friction was removed before the tests.
        timing: durations of the steps [s].
        splits: of the effect with the fewest supporting splits; None without splits.
        calibration: zeros, scales and late stamps that the recordings need; these are no effects.
        corrections: command line options for this calibration, including those that were already given.
        assumption: the uncertainty that the configured rig claims; None for an identified one.
        next_rig: name of the rig file to use; None: keep the one that there is.
    """

    verdict: Verdict
    sentence: str
    effects: tuple[FoundEffect, ...]
    ambiguous_with: tuple[str, ...]
    experiments: Mapping[str, str]
    ambiguities: tuple[Ambiguity, ...]
    share_explained: float | None
    parts: tuple[PartVerdict, ...]
    reference: Mapping[str, float] | None
    base_friction_removed: bool
    errors: ModelErrors
    recordings: tuple[RecordingEntry, ...]
    ranking: tuple[Candidate, ...]
    profiles: tuple[SizeProfile, ...]
    remaining: tuple[str, ...]
    left: tuple[RemainingResidual, ...]
    unseen: tuple[str, ...]
    warnings: tuple[str, ...]
    settings: Settings
    timing: Mapping[str, float]
    software: Mapping[str, str]
    splits: Splits | None = None
    calibration: tuple[Calibration, ...] = ()
    corrections: tuple[str, ...] = ()
    assumption: str | None = None
    next_steps: tuple[str, ...] = ()
    next_rig: str | None = None

    @property
    def driven(self) -> bool:
        """Whether the measured angle drives the model, as for a sealed joint."""
        return any(part.joint == "driven" for part in self.recordings)


def _least(effects: Sequence[FoundEffect]) -> Splits | None:
    return min((effect.splits for effect in effects if effect.splits is not None), default=None)


def _options(typed: Corrections, found: Sequence[FoundCalibration]) -> tuple[str, ...]:
    """Options for what was typed and what was found together; none if that is more than an option may say."""
    try:
        further = found_calibrations.corrections({item.name: item.value for item in found})
        return tuple(typed.followed_by(further).options()) if found else ()
    except BadInput:
        return ()


def report(
    found: Diagnosis,
    rig: Rig,
    hashes: Sequence[str],
    seed: int,
    holdout: float | Sequence[str],
    typed: Corrections,
    choice: RigChoice,
) -> CloseLoopReport:
    """The numbers of a diagnosis.

    Args:
        hashes: SHA-256 of each bag, whole held-out recordings last.
        holdout: share of each recording that was held out, or names of held-out recordings.
    """
    return CloseLoopReport(
        verdict=found.verdict,
        sentence=found.sentence,
        effects=found.effects,
        calibration=tuple(map(Calibration.of, found.calibrations)),
        corrections=_options(typed, found.calibrations),
        ambiguous_with=tuple(found.ambiguous_with),
        experiments=dict(found.experiment),
        ambiguities=tuple(found.ambiguities),
        share_explained=found.share,
        parts=found.parts,
        reference=None if found.reference is None else dict(found.reference),
        base_friction_removed=found.base_friction_removed,
        errors=found.errors,
        recordings=tuple(replace(part, sha256=value) for part, value in zip(found.by_recording, hashes, strict=True)),
        ranking=tuple(
            Candidate(
                item.effect,
                item.round,
                item.score,
                item.delta_bic,
                None if item.shares is None else item.shares[0],
                item.taken,
                item.muscles,
            )
            for item in found.ranking
        ),
        profiles=found.profiles,
        remaining=tuple(item.line() for item in found.remaining),
        left=found.remaining,
        unseen=tuple(found.unseen),
        warnings=tuple(found.warnings),
        settings=Settings(
            rig.name,
            " ".join(rig.source.split()),
            seed,
            holdout if isinstance(holdout, float) else tuple(holdout),
            thresholds.STRONG,
            thresholds.FIRST_SHARE,
            thresholds.FURTHER_SHARE,
            thresholds.EXPLAINED,
        ),
        timing=dict(found.seconds),
        software=versions(),
        splits=_least(found.effects),
        assumption=assumption(rig),
        next_steps=next_steps(found, rig, choice),
        next_rig=None if choice.proposed is None else choice.proposed.name,
    )


def next_steps(found: Diagnosis, rig: Rig, choice: RigChoice) -> tuple[str, ...]:
    """Recommended next steps after a diagnosis, in sentences."""
    out, files = [], [file.name for file in choice.files]
    if choice.no_common:
        own = [file.name for file in choice.files if file.number is not None]
        have = "have each recording's own values" if len(own) > 1 else "has the values of one recording"
        each = f" {', '.join(own)} {have}." if own else ""
        out.append(f"There is no rig_extended.yaml, since {choice.no_common}.{each}")
    rivals = [name for name in found.ambiguous_with if name in CATALOGUE]
    if found.effects and rivals and "rig_extended.yaml" in files and rig.drive == "valve" and not rig.valves.sealed:
        either = " and ".join(name.replace("_", " ") for name in (found.effects[0].name, *rivals))
        out.append(
            f"Next: record once more, to decide between {either}. {typed_command('excite')} --tell-apart with the "
            "folder of this report designs the experiment."
        )
    keep = f"keep the rig file of {rig.name}"
    proposed, use = choice.proposed, ""
    if proposed is not None:
        which = "" if proposed.number is None else f" for {found.by_recording[proposed.number].recording}"
        use = f"use {proposed.name}{which}, which every command and node takes ({proposed.gain} on held-out data)"
    alike = like_a_curve(rig, [effect.name for effect in found.effects])
    if alike:
        out.append(
            "Next: measure the valves' curves before you repair anything: a curve of another slope looks like "
            f"{' or '.join(alike)}. Hold six voltages of each valve until the pressures stand, give that recording to "
            f"{typed_command('identify')} with the others, and run {typed_command('close_loop')} with the rig file "
            f"that it writes. Until then, {use or keep}."
        )
    elif found.verdict == "effect":
        out.append(f"Next: repair the joint and record again{f', or {use}' if use else f'; until then, {keep}'}.")
    elif found.verdict == "unexplained":
        out.append(
            "Next: read in section What is left when the remaining residual appears and on what it depends. Until its "
            f"cause is known, {use or keep}{': it halves all errors' if use else ''}."
        )
    elif use:
        out.append(f"Next: nothing to repair; {use}: it is {rig.name}, recalibrated by these recordings.")
    else:
        out.append(f"Next: nothing; {keep}.")
    return tuple(out)
