"""From recordings to a diagnosis: prepare, recalibrate, select, judge, describe.

A description has a sentence, errors before and after, rigs, and what is left.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from pam_antagonist.blas import one_blas_thread
from pam_antagonist.diagnosis import ambiguity, held_out, intervals, rig_choice, splits, warnings
from pam_antagonist.diagnosis.agreement import common_rig, with_tuning
from pam_antagonist.diagnosis.errors import Errors, ModelErrors
from pam_antagonist.diagnosis.findings import profile_sizes
from pam_antagonist.diagnosis.hypotheses import TriedCandidate, Work
from pam_antagonist.diagnosis.judgement import judge
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.diagnosis.preparation import Group, Prepared, Settings, Timings, prepare
from pam_antagonist.diagnosis.remaining import RemainingResidual
from pam_antagonist.diagnosis.remaining import describe as describe_remaining
from pam_antagonist.diagnosis.result import (
    MODELS,
    Ambiguity,
    Diagnosis,
    FoundEffect,
    HeldOutComparison,
    Judged,
    PartVerdict,
)
from pam_antagonist.diagnosis.search import CALIBRATIONS, about, hypotheses, search
from pam_antagonist.diagnosis.splits import by_itself_or_in_turn, parted
from pam_antagonist.diagnosis.verdicts import EFFECT, NONE, UNEXPLAINED, overall
from pam_antagonist.inference.angle_driven import AIR, AngleDriven
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.measured_motion import MeasuredMotion
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.shown import DIVERGES


@one_blas_thread
def diagnose(
    recordings: Sequence[Recording],
    rig: Rig,
    *,
    held_out: Sequence[Recording] = (),
    first: Model | None = None,
    **settings: Any,
) -> Diagnosis:
    """Trace what a model lacks to a physical effect, if possible.

    Args:
        recordings: of one rig; a free and a locked one show most. Of a sealed rig, its joint driven to and fro.
        rig: as configured.
        held_out: whole recordings of the same rig that no fit sees; the others are then fitted to their ends.
        first: the model without a law that was learned since; the law then counts as the first effect, and any
            beside it has to remove enough of what was there before the law.
        settings: fields of :class:`~pam_antagonist.diagnosis.preparation.Settings`.

    Returns:
        The verdict and everything behind it.

    Raises:
        BadInput: recordings from which nothing can be learned.
    """
    how, timings = Settings(**settings), Timings()
    prepared = prepare(recordings, held_out, rig, how)
    if how.in_turn:
        groups = (replace(one, experiments=tuple(map(parted, one.experiments))) for one in prepared.groups)
        prepared = replace(prepared, groups=tuple(groups))
    # What was before a law is described already.
    filters = () if not how.estimator else MODELS if first is None else MODELS[-1:]
    return describe(prepared, verdicts(prepared, how, timings, first), how, timings, filters)


def verdicts(prepared: Prepared, settings: Settings, timings: Timings, first: Model | None = None) -> list[Judged]:
    """The verdict on each group, the one with the strongest effect first."""
    judged = []
    for group in prepared.groups:
        settings.progress("recalibrating the base parameters")
        base = by_itself_or_in_turn(group)
        timings.end("recalibration")
        names = {experiment.trial.name for experiment in group.experiments}
        before = [] if first is None else [k for k, e in enumerate(first.experiments) if e.trial.name in names]
        work = Work(settings.about(group), settings.store)
        asked = hypotheses() if settings.catalogue else CALIBRATIONS
        ranking = search(base, work, asked, first=None if first is None else first.of(before))
        timings.end("selection")
        work = Work(settings.progress, settings.store)
        judged.append(judge(prepared, group, ranking, work, settings.catalogue))
        timings.end("judgement")
    return sorted(judged, key=lambda j: -max((effect.delta_bic for effect in j.effects), default=0.0))


_T = TypeVar("_T")
_NAMED = 3
"""Residuals that the sentence names; all of them are in a section of their own."""


def describe(
    prepared: Prepared, judged: Sequence[Judged], settings: Settings, timings: Timings, filters: Sequence[str]
) -> Diagnosis:
    """Everything that a report says.

    `judged`: the verdict on each group of them, the strongest effect first. `filters`: models that the estimator runs
    with.
    """
    jobs, progress = settings.jobs, settings.progress
    ended = [_with_held_out_end(j) for j in judged]
    compared = tuple(c for end, j in zip(ended, judged, strict=True) for c in held_out.compare(*end, j.values))
    rivals = tuple(rival for j in judged if j.verdict == EFFECT for rival in ambiguity.ambiguities(j.base, j.model))
    effects = _effects(prepared, judged, rivals)
    ambiguous = ambiguity.not_told_apart(judged, rivals)
    calibrated = tuple(
        replace(item, by_recording=_own_names(prepared, j.group, item.by_recording))
        for j in judged for item in j.calibrations
    )  # fmt: skip
    profiles = [item for j in judged if settings.profiles for item in profile_sizes(j.model, j.effects, progress)]
    timings.end("profiles")
    common = {name: _common_rig(prepared, judged, name == "extended") for name in ("recalibrated", "extended")}
    differ = MODELS[1:] if effects else MODELS[1:2]  # without effects, both are the recalibrated one
    asked = [name for name in differ if name in filters] or filters
    tunings = intervals.tuned(prepared, common, compared, asked, settings)
    timings.end("tuning")
    progress("errors before and after")
    entries = held_out.by_recording(prepared, compared, tunings, filters, jobs)
    totals = held_out.total_errors(compared, entries)
    rigs = {name: with_tuning(common[name], tunings.get(name)) for name in common}
    models: dict[str, list[tuple[Group, Model, Mapping[str, float]]]] = {
        "recalibrated": [(group, base, {}) for group, base, _ in ended],
        "extended": [(group, model, j.values) for (group, _, model), j in zip(ended, judged, strict=True)],
    }
    of_one_rig = rig_choice.rig_errors(prepared, models, rigs, compared, entries, filters)
    timings.end("errors")
    # What is said of held-out data is said of the filters above: the files' intervals were made by these data.
    tunings = intervals.of_files(prepared, tunings, compared, settings)
    rigs = {name: with_tuning(common[name], tunings.get(name)) for name in common}
    timings.end("tuning")
    remaining = tuple(item for j in judged for item in left(j))
    timings.end("remaining residual")
    as_prepared = sorted(judged, key=lambda j: [group.name for group in prepared.groups].index(j.group.name))
    extended = all_of(j.model for j in as_prepared)
    ranking = tuple(ranked(j, tried) for j in judged for tried in j.ranking.tried)
    # The models without effects, of recordings in which all effects act throughout.
    throughout = [replace(j.base, experiments=tuple(replace(e, spans={}) for e in j.model.experiments)) for j in judged]
    found = Diagnosis(
        verdict=overall(j.verdict for j in judged),
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
        ranking=ranking,
        share=share_of_found(judged),
        parts=parts_of(judged),
        errors=totals,
        of_one_rig=of_one_rig,
        by_recording=entries,
        reference=held_out.static_map(prepared),
        remaining=remaining,
        unseen=warnings.unseen(prepared, throughout),
        warnings=(
            *prepared.notes,
            *warnings.guessed_curves(extended.experiments[0].rig, [item.name for item in effects]),
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
        recalibrated=all_of(j.base for j in as_prepared),
        extended=extended,
        compared=compared,
        seconds=timings.seconds,
        notes=(),
        held=(),
        decided=None,
    )
    firm = splits.in_words({name: firm for j in judged for name, firm in j.firmness.items()})
    return replace(found, sentence=_sentence(found, _in_words(prepared, judged, effects), firm))


def left(judged: Judged) -> list[RemainingResidual]:
    """What a verdict leaves; where nothing explains it, at least the largest residual."""
    if judged.verdict == NONE:
        return []
    known = {(item.recording, item.channel) for item in judged.left}
    found = describe_remaining(judged.model, judged.verdict == UNEXPLAINED and not known)
    return [*judged.left, *(item for item in found if (item.recording, item.channel) not in known)]


def _with_held_out_end(judged: Judged) -> tuple[Group, Model, Model]:
    """A group with its end held out, as prepared; models that were fitted to all data are fitted again to the rest."""
    group = judged.group
    if not any(experiment.splits for experiment in judged.model.experiments):
        return group, judged.base, judged.model

    def again(model: Model) -> Model:
        prepared = replace(model, experiments=group.experiments)
        return prepared.map(lambda experiment, fitted: refit(experiment, fitted.point, fitted.free))

    return group, again(judged.base), again(judged.model)


def share_of_found(judged: Sequence[Judged]) -> float | None:
    """The smallest share of a held-out excess that effects explain; of all groups where none has effects."""
    shares = [j.share for j in judged if j.effects] or [j.share for j in judged]
    return min((share for share in shares if share is not None), default=None)


def parts_of(judged: Sequence[Judged]) -> tuple[PartVerdict, ...]:
    """The verdict on each group."""
    return tuple(PartVerdict(j.group.name, j.verdict, j.share) for j in judged)


def all_of(models: Iterable[Model]) -> Model:
    """The models of all groups as one."""
    columns = zip(*((model.experiments, model.fits, model.effects) for model in models), strict=True)
    return Model(*(tuple(itertools.chain(*each)) for each in columns))


def _effects(prepared: Prepared, judged: Sequence[Judged], rivals: Sequence[Ambiguity]) -> tuple[FoundEffect, ...]:
    """What was found in all groups, with the recordings' own names."""
    out = []
    for j in judged:
        for effect in j.effects:
            names = tuple(_own_names(prepared, j.group, dict.fromkeys(effect.recordings)))
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
        in_words(effect, prepared.rig.valves.sealed) + ("" if everywhere else f" in {' and '.join(effect.recordings)}")
        for effect in effects
    ]


def ranked(judged: Judged, tried: TriedCandidate) -> TriedCandidate:
    """A candidate that says in which part it was tried, and whether it is in the final model."""
    chosen = judged.ranking.model.effects
    selected = tried.model is not None and tried.model.effects == chosen[: tried.round]
    taken = judged.verdict == EFFECT and selected and tried.effect in judged.model.effects
    return replace(tried, taken=taken, part=judged.group.name)


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


def _common_rig(prepared: Prepared, judged: Sequence[Judged], extended: bool) -> Rig:
    """One rig with what was found in all groups."""
    rig = prepared.base
    for j in judged:
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
        rig = with_tuning(held_out.rig_of(prepared, parts, "extended"), tunings.get("extended"))
        out.append((prepared.trials[number].name, rig))
    return tuple(out)


def in_words(effect: FoundEffect, sealed: bool = False) -> str:
    """An effect in words."""
    if effect.law is not None:
        return f"{effect.law.in_words()} (a learned law)"
    values = {name: value for name, (value, _, _) in effect.parameters.items()}
    words = about(effect.name).sentence(effect.name, effect.muscle, values, sealed)
    begin, end = (
        None if time is None else f"{time:.1f} ± {max(std or 0.0, 0.1):.1f} s"
        for time, std in ((effect.onset_s, effect.onset_std_s), (effect.end_s, effect.end_std_s))
    )
    if begin is None:
        return words if end is None else f"{words}, until {end}"
    return f"{words}, from {begin} on" if end is None else f"{words}, from {begin} to {end}"


def _sentence(found: Diagnosis, effects: Sequence[str], firmness: str) -> str:
    """The verdict in a sentence, with the found effects and what the splits say of them in words."""
    errors, share, mean_pressure = found.errors, found.share, found.driven
    each = [_errors(own, mean_pressure) for own in errors.all]
    configured, recalibrated, extended = map(_listed, each)
    calibrated = "; ".join(item.in_words() for item in found.shared)
    beside = f" The recordings need a calibration: {calibrated}." if calibrated else ""
    others = "; ".join(about(name).instead(name) for name in found.ambiguous_with)
    doubts = f" The recordings do not exclude another explanation: {others}." if others else ""
    if found.verdict == "none":
        return (
            f"The model lacks nothing that these recordings show.{beside} After {'calibration and ' if beside else ''}"
            f"recalibration its errors on held-out data are {recalibrated}, as small as the sensors' noise allows; as "
            f"configured they are {configured}.{doubts}"
        )
    if found.verdict == "effect":
        what = " ".join(f"{words[0].upper()}{words[1:]}." for words in effects)
        these = "these effects" if len(effects) > 1 else "this effect"
        gone = ""
        if share is not None:
            gone = f"Of the excess over the sensors' noise after recalibration, {100 * share:.0f} % is explained"
        if any(isinstance(experiment, MeasuredMotion) for experiment in found.experiments):
            gone = "" if share is None else f": {gone[0].lower()}{gone[1:]} on held-out data"
            text = (
                f"{what} The joint sticks, so the balance of its torques along the measured motion decides{gone}. The "
                "errors there of the model that gets the commands only are "
                f"{configured} as configured, {recalibrated} after recalibration and {extended} with {these}."
            )
        else:
            text = f"{what} The model's errors on held-out data {course_in_words(errors, these, mean_pressure)}."
            text += f" {gone}." if gone else ""
        text += beside + (f" {firmness}." if firmness else "")
        if found.reference is not None:
            straight = found.reference["angle_and_pressures"]
            text += f" A straight-line map of angle and pressures has an error of {straight:.2g} N m."
        return text + doubts
    tried = [(item.shares[0], item.effect) for item in found.ranking if item.shares is not None and item.round == 1]
    closest = ""
    if tried:
        best, name = max(tried, key=lambda item: item[0])
        gone = f"{100 * max(best, 0.0):.0f} %"
        closest = f" The effect that comes closest, {name}, explains {gone} of the excess, which is not enough."
    return (
        "The model lacks something, and no effect of the catalogue explains it. Its errors on held-out data are "
        f"{configured} as configured and {recalibrated} after recalibration.{_above_noise(found)}{closest}{beside}"
    )


def _above_noise(found: Diagnosis) -> str:
    """Where, when and by how much residuals are above their noise, the clearest first."""
    items = sorted(found.remaining, key=lambda item: (not item.is_of_sensor, -item.times_noise))
    more = f"; {len(items) - _NAMED} more in section What is left" if len(items) > _NAMED else ""
    block_s = found.experiments[0].trial.block_s
    named = "; ".join(item.in_short() for item in items[:_NAMED])
    return f" Above the sensors' noise, in means over {1e3 * block_s:.0f} ms: {named}{more}."


def course_in_words(errors: ModelErrors, these: str, mean_pressure: bool = False) -> str:
    """What recalibration takes off the errors, and what effects take off after it. `these`: the effects, in words."""
    first = change_in_words(errors.as_configured, errors.recalibrated, " as configured", mean_pressure)
    before, after = (_errors(own, mean_pressure) for own in (errors.recalibrated, errors.extended))
    then = "to" if _falls(before, after) else "are"
    return f"{first} by recalibration, and {then} {_listed(after)} with {these}"


def _falls(before: Sequence[tuple[float, str]], after: Sequence[tuple[float, str]]) -> bool:
    """Whether an error falls and none grows, as they are written."""
    written = [(float(f"{old[0]:.2g}"), float(f"{new[0]:.2g}")) for old, new in zip(before, after, strict=True)]
    return all(new <= old for old, new in written) and any(new < old for old, new in written)


def change_in_words(before: Errors, after: Errors, whose: str = "", mean_pressure: bool = False) -> str:
    """How errors change from those of one model, and whose these are, to those of another one."""
    old, new = (_errors(own, mean_pressure) for own in (before, after))
    return f"{'fall' if _falls(old, new) else 'change'} from {_listed(old)}{whose} to {_listed(new)}"


def _errors(own: Errors, mean_pressure: bool) -> list[tuple[float, str]]:
    """Each error with its unit."""
    out = [(item.rmse, unit) for item, unit in ((own.angle, "°"), (own.torque, " N m")) if item]
    if mean_pressure and own.mean_rmse_pa is not None:
        return [*out, (own.mean_rmse_pa / 1e3, " kPa (mean pressure)")]
    first, second = own.rmse_pa
    return [*out, (first / 1e3, " kPa (pressure 1)"), (second / 1e3, " kPa (pressure 2)")]


def _listed(errors: Sequence[tuple[float, str]]) -> str:
    if any(math.isinf(value) for value, _ in errors):
        return DIVERGES.replace("that", "those", 1)
    text = ", ".join(f"{value:.2g}{unit}" for value, unit in errors)
    return text.replace(" kPa (pressure 1), ", " and ").replace(" kPa (pressure 2)", " kPa")
