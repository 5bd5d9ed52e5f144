"""What a report says of a judged joint: errors before and after, rigs, what is left, and the result in a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from pam_antagonist.diagnosis import ambiguity, held_out, intervals, rig_choice, sentences, splits, warnings
from pam_antagonist.diagnosis.agreement import common_rig, with_tuning
from pam_antagonist.diagnosis.findings import profile_sizes
from pam_antagonist.diagnosis.judged import Judged, JudgedJoint
from pam_antagonist.diagnosis.law_findings import LawFindings
from pam_antagonist.diagnosis.preparation import Group, Prepared, Settings, Timings
from pam_antagonist.diagnosis.remaining import RemainingResidual
from pam_antagonist.diagnosis.remaining import describe as describe_remaining
from pam_antagonist.diagnosis.result import MODELS, Ambiguity, Diagnosis, FoundEffect, HeldOutComparison
from pam_antagonist.diagnosis.verdicts import EFFECT, NONE, UNEXPLAINED
from pam_antagonist.inference.angle_driven import AIR, AngleDriven
from pam_antagonist.rig import Rig

_T = TypeVar("_T")


def describe(joint: JudgedJoint, settings: Settings, timings: Timings) -> Diagnosis:
    """Everything that a report says. With learned laws, the model without them is what stands before."""
    prepared, judged, first, progress = joint.prepared, joint.parts, joint.steps[0], settings.progress
    ended = {"recalibrated": (first, held_out.ended(first))}
    ended["extended"] = ended["recalibrated"] if first is joint else (joint, held_out.ended(joint))
    compared = held_out.comparisons(*ended["extended"])
    if first is not joint:
        compared = _beside(held_out.comparisons(*ended["recalibrated"]), compared)
    *_, rivals = rivals_of = [_rivals(step) for step in joint.steps]
    *_, beside = found_in = [_effects(*each) for each in zip(joint.steps, rivals_of, strict=True)]
    laws = LawFindings.of(joint, found_in)
    effects = (*laws.named, *laws.effects, *beside)
    ambiguous = ambiguity.not_told_apart(judged, rivals)
    calibrated = tuple(
        replace(item, by_recording=_own_names(prepared, j.group, item.by_recording))
        for j in judged for item in j.calibrations
    )  # fmt: skip
    profiles = [item for j in judged if settings.profiles for item in profile_sizes(j.model, j.effects, progress)]
    timings.end("profiles")
    common = {name: _common_rig(one, name == "extended") for name, (one, _) in ended.items()}
    # Without effects both are the recalibrated one.
    tuned = () if not settings.estimator else MODELS[1:] if effects else MODELS[1:2]
    tunings = intervals.tuned(common, compared, tuned, settings)
    timings.end("tuning")
    progress("errors before and after")
    entries = held_out.by_recording(compared, tunings, settings.estimator, settings.jobs)
    totals = held_out.total_errors(compared, entries)
    rigs = {name: with_tuning(common[name], tunings.get(name)) for name in common}
    of_one_rig = rig_choice.rig_errors(ended, rigs, compared, entries, settings.estimator)
    timings.end("errors")
    # What is said of held-out data is said of the filters above: the files' intervals were made by these data.
    tunings = intervals.of_files(tunings, compared, settings)
    rigs = {name: with_tuning(common[name], tunings.get(name)) for name in common}
    timings.end("tuning")
    remaining = tuple(item for j in judged for item in left(j))
    timings.end("remaining residual")
    # The models without effects, of recordings in which all effects act throughout.
    throughout = [replace(j.base, experiments=tuple(replace(e, spans={}) for e in j.model.experiments)) for j in judged]
    found = Diagnosis(
        verdict=joint.verdict,
        sentence="",
        effects=effects,
        calibrations=calibrated,
        ambiguous_with=ambiguous,
        experiment=ambiguity.distinguishing_experiments(
            [name for j in judged for name in j.model.effects],
            ambiguous,
            {trial.joint for trial in prepared.trials[: prepared.fitted]},
            [item.name for item in calibrated if item.rivals],
        ),
        ambiguities=rivals,
        ranking=laws.ranking,
        share=share_of_found(judged) if not joint.laws else laws.share,
        parts=laws.parts,
        errors=totals,
        of_one_rig=of_one_rig,
        by_recording=entries,
        reference=held_out.static_map(prepared),
        remaining=remaining,
        unseen=warnings.unseen(prepared, throughout),
        warnings=(
            *joint.notes,
            *laws.warnings,
            *prepared.notes,
            *warnings.guessed_curves(joint.model.experiments[0].rig, [item.name for item in beside]),
            *(warning for j in judged for warning in j.warnings),
            *warnings.few_sweeps(prepared),
            *_either_muscle(judged),
            *warnings.flat_profiles(profiles),
            *warnings.estimator_worse(entries),
        ),
        profiles=tuple(profiles),
        rig_recalibrated=rigs["recalibrated"],
        rig_extended=rigs["extended"],
        own=_own_rigs(prepared, compared, tunings),
        base_friction_removed=prepared.friction_removed,
        recalibrated=joint.base,
        extended=joint.model,
        compared=compared,
        seconds=timings.seconds,
        notes=(),
        held=(),
        decided=None,
    )
    firm = splits.in_words({name: firm for j in judged for name, firm in j.firmness.items()})
    words = _in_words(prepared, judged, beside)
    said = sentences.of_laws(found, laws, words, firm) if joint.laws else sentences.of_catalogue(found, words, firm)
    why = joint.why if joint.verdict == UNEXPLAINED else ""
    return replace(found, sentence=f"{said} {why}".strip())


def _beside(before: Sequence[HeldOutComparison], after: Sequence[HeldOutComparison]) -> tuple[HeldOutComparison, ...]:
    """Comparisons with laws, each beside the one without, in the order of the parts that miss most without laws."""
    by_name = {(one.number, one.experiment.trial.name): one for one in after}
    return tuple(replace(by_name[one.number, one.experiment.trial.name], before=one) for one in before)


def left(judged: Judged) -> list[RemainingResidual]:
    """What a verdict leaves; where nothing explains it, at least the largest residual."""
    if judged.verdict == NONE:
        return []
    known = {(item.recording, item.channel) for item in judged.left}
    found = describe_remaining(judged.model, judged.verdict == UNEXPLAINED and not known)
    return [*judged.left, *(item for item in found if (item.recording, item.channel) not in known)]


def share_of_found(judged: Sequence[Judged]) -> float | None:
    """The smallest share of a held-out excess that effects explain; of all groups where none has effects."""
    shares = [j.share for j in judged if j.effects] or [j.share for j in judged]
    return min((share for share in shares if share is not None), default=None)


def _rivals(joint: JudgedJoint) -> tuple[Ambiguity, ...]:
    """Found effects compared with others on equal terms."""
    found = (ambiguity.ambiguities(one.base, one.model) for one in joint.parts if one.verdict == EFFECT)
    return tuple(rival for each in found for rival in each)


def _effects(joint: JudgedJoint, rivals: Sequence[Ambiguity]) -> tuple[FoundEffect, ...]:
    """What was found in all groups, with the recordings' own names."""
    out = []
    for j in joint.parts:
        for effect in j.effects:
            names = tuple(_own_names(joint.prepared, j.group, dict.fromkeys(effect.recordings)))
            known = replace(effect, recordings=names, part=j.group.name)
            out.append(ambiguity.with_compared_size(known, rivals))
    return tuple(out)


def _own_names(prepared: Prepared, group: Group, values: Mapping[str, _T]) -> dict[str, _T]:
    """Values by the recordings' names instead of the names of a group's experiments."""
    numbers = {e.trial.name: number for e, number in zip(group.experiments, group.numbers, strict=True)}
    return {prepared.trials[numbers[name]].name: value for name, value in values.items()}


def _in_words(prepared: Prepared, judged: Sequence[Judged], effects: Sequence[FoundEffect]) -> list[str]:
    """Each found effect in words, with the recordings that show it if one of them does not."""
    counts = [len(j.group.experiments) for j in judged for _ in j.effects]
    everywhere = all(len(effect.recordings) == count for effect, count in zip(effects, counts, strict=True))
    return [
        sentences.in_words(effect, prepared.rig.valves.sealed)
        + ("" if everywhere else f" in {' and '.join(effect.recordings)}")
        for effect in effects
    ]


def _either_muscle(judged: Sequence[Judged]) -> list[str]:
    """Warnings of effects with one size in both muscles that one muscle alone would explain nearly as well."""
    out = []
    for j in judged:
        driven = [e for e in j.model.experiments if isinstance(e, AngleDriven) and e.part == AIR]
        for effect in j.effects if driven else ():
            alone = ambiguity.either_muscle(driven, j.model.fits, effect.name)
            if alone is not None:
                out.append(
                    f"{effect.name}: the same size in both muscles is the simplest explanation, but muscle {alone} "
                    "alone explains nearly as much"
                )
    return out


def _common_rig(joint: JudgedJoint, extended: bool) -> Rig:
    """One rig with what was found in all groups."""
    rig = joint.prepared.base
    for j in joint.parts:
        model, values = (j.model, j.values) if extended else (j.base, {})
        rig = common_rig(model, values, rig)
    return rig


def _own_rigs(
    prepared: Prepared, compared: Sequence[HeldOutComparison], tunings: Mapping[str, Rig]
) -> tuple[tuple[str, Rig], ...]:
    """Each fitted recording's name and its own extended rig."""
    out = []
    for number in range(prepared.fitted):
        parts = [part for part in compared if part.number == number]
        rig = with_tuning(held_out.rig_of(parts, "extended"), tunings.get("extended"))
        out.append((prepared.trials[number].name, rig))
    return tuple(out)
