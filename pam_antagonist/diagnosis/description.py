"""From the verdicts on all groups to the diagnosis: a sentence, errors before and after, rigs, remaining residuals."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from pam_antagonist.diagnosis import ambiguity, found_calibrations, held_out, rig_choice, splits, warnings
from pam_antagonist.diagnosis.agreement import common_rig, with_tuning
from pam_antagonist.diagnosis.errors import Errors, ModelErrors
from pam_antagonist.diagnosis.findings import profile_sizes
from pam_antagonist.diagnosis.found_calibrations import FoundCalibration
from pam_antagonist.diagnosis.hypotheses import TriedCandidate
from pam_antagonist.diagnosis.models import Model, in_threads
from pam_antagonist.diagnosis.preparation import Group, Prepared, Settings, Timings
from pam_antagonist.diagnosis.remaining import describe as describe_remaining
from pam_antagonist.diagnosis.result import (
    Ambiguity,
    Diagnosis,
    FoundEffect,
    HeldOutComparison,
    Judged,
    PartVerdict,
    Verdict,
)
from pam_antagonist.diagnosis.search import about
from pam_antagonist.identification.sealed_tuning import tuned
from pam_antagonist.inference.angle_driven import AIR, AngleDriven
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.measured_motion import MeasuredMotion
from pam_antagonist.rig import Rig

_T = TypeVar("_T")
_TUNINGS = 25
"""Tunings of the estimator that are tried for each model, beginning with the rig file's."""


def describe(prepared: Prepared, judged: Sequence[Judged], settings: Settings, timings: Timings) -> Diagnosis:
    """Everything that a report says. `judged`: the verdict on each group of them, the strongest effect first."""
    jobs, progress = settings.jobs, settings.progress
    ended = [_with_held_out_end(j) for j in judged]
    compared = tuple(c for end, j in zip(ended, judged, strict=True) for c in held_out.compare(*end, j.values))
    rivals = tuple(rival for j in judged if j.verdict == "effect" for rival in ambiguity.ambiguities(j.base, j.model))
    effects = _effects(prepared, judged, rivals)
    ambiguous = ambiguity.not_told_apart(judged, rivals)
    calibrated = tuple(_named(prepared, j, item) for j in judged for item in j.calibrations)
    profiles = [item for j in judged if settings.profiles for item in profile_sizes(j.model, j.effects, progress)]
    timings.end("profiles")
    common = {name: _common_rig(prepared, judged, name == "extended") for name in ("recalibrated", "extended")}
    tunings = _tunings(prepared, common, bool(effects), settings)
    timings.end("tuning")
    progress("errors before and after")
    entries = held_out.by_recording(prepared, compared, tunings, settings.estimator, jobs)
    totals = held_out.total_errors(compared, entries)
    rigs = {name: with_tuning(common[name], tunings.get(name)) for name in common}
    models: dict[str, list[tuple[Group, Model, Mapping[str, float]]]] = {
        "recalibrated": [(group, base, {}) for group, base, _ in ended],
        "extended": [(group, model, j.values) for (group, _, model), j in zip(ended, judged, strict=True)],
    }
    of_one_rig = rig_choice.rig_errors(prepared, models, rigs, compared, entries, settings)
    timings.end("errors")
    remaining = tuple(item for j in judged if j.verdict != "none" for item in describe_remaining(j.model))
    timings.end("remaining residual")
    verdict, share = _overall(judged)
    as_prepared = sorted(judged, key=lambda j: [group.name for group in prepared.groups].index(j.group.name))
    extended = _all(j.model for j in as_prepared)
    ranking = tuple(_ranked(j, tried) for j in judged for tried in j.ranking.tried)
    reference = held_out.static_map(prepared)
    return Diagnosis(
        verdict=verdict,
        sentence=sentence(
            verdict,
            _in_words(prepared, judged, effects),
            [found_calibrations.in_words(item) for item in calibrated],
            splits.in_words({name: firm for j in judged for name, firm in j.firmness.items()}),
            ambiguous,
            share,
            totals,
            ranking,
            reference,
            prepared.angle_driven,
            any(isinstance(experiment, MeasuredMotion) for experiment in extended.experiments),
        ),
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
        share=share,
        parts=tuple(PartVerdict(j.group.name, j.verdict, j.share) for j in judged),
        errors=totals,
        of_one_rig=of_one_rig,
        by_recording=entries,
        reference=reference,
        remaining=remaining,
        unseen=warnings.unseen(prepared, map(_throughout, judged)),
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
        recalibrated=_all(j.base for j in as_prepared),
        extended=extended,
        compared=compared,
        seconds=timings.seconds,
    )


def _with_held_out_end(judged: Judged) -> tuple[Group, Model, Model]:
    """A group with its end held out, as prepared; models that were fitted to all data are fitted again to the rest."""
    group = judged.group
    if not any(experiment.splits for experiment in judged.model.experiments):
        return group, judged.base, judged.model

    def again(model: Model) -> Model:
        prepared = replace(model, experiments=group.experiments)
        return prepared.map(lambda experiment, fitted: refit(experiment, fitted.point, fitted.free))

    return group, again(judged.base), again(judged.model)


def _all(models: Iterable[Model]) -> Model:
    """The models of all groups as one."""
    columns = zip(*((model.experiments, model.fits, model.effects) for model in models), strict=True)
    return Model(*(tuple(itertools.chain(*each)) for each in columns))


def _throughout(judged: Judged) -> Model:
    """The model without effects, of recordings in which all effects act throughout."""
    experiments = tuple(replace(experiment, spans={}) for experiment in judged.model.experiments)
    return replace(judged.base, experiments=experiments)


def _overall(judged: Sequence[Judged]) -> tuple[Verdict, float | None]:
    """The verdict on all groups together, and the least share that effects remove in any of them, if it is known."""
    verdicts = {j.verdict for j in judged}
    verdict: Verdict = "effect" if "effect" in verdicts else "unexplained" if "unexplained" in verdicts else "none"
    shares = [j.share for j in judged if j.effects] or [j.share for j in judged]
    return verdict, min((share for share in shares if share is not None), default=None)


def _effects(prepared: Prepared, judged: Sequence[Judged], rivals: Sequence[Ambiguity]) -> tuple[FoundEffect, ...]:
    """What was found in all groups, with the recordings' own names."""
    out = []
    for j in judged:
        for effect in j.effects:
            known = replace(effect, recordings=tuple(_own_names(prepared, j.group, dict.fromkeys(effect.recordings))))
            out.append(ambiguity.with_compared_size(known, rivals))
    return tuple(out)


def _own_names(prepared: Prepared, group: Group, values: Mapping[str, _T]) -> dict[str, _T]:
    """Values by the recordings' names instead of the names of a group's experiments."""
    numbers = {e.trial.name: number for e, number in zip(group.experiments, group.numbers, strict=True)}
    return {prepared.trials[numbers[name]].name: value for name, value in values.items()}


def _named(prepared: Prepared, judged: Judged, item: FoundCalibration) -> FoundCalibration:
    """A calibration with the recordings' own names."""
    return replace(item, by_recording=_own_names(prepared, judged.group, item.by_recording))


def _in_words(prepared: Prepared, judged: Sequence[Judged], effects: Sequence[FoundEffect]) -> list[str]:
    """Each found effect in words, with the recordings that show it if one of them does not."""
    counts = [len(j.group.experiments) for j in judged for _ in j.effects]
    everywhere = all(len(effect.recordings) == count for effect, count in zip(effects, counts, strict=True))
    return [
        in_words(effect, prepared.rig.valves.sealed) + ("" if everywhere else f" in {' and '.join(effect.recordings)}")
        for effect in effects
    ]


def _ranked(judged: Judged, tried: TriedCandidate) -> TriedCandidate:
    """A candidate that says whether it is in the final model."""
    chosen = judged.ranking.model.effects
    selected = tried.model is not None and tried.model.effects == chosen[: tried.round]
    return replace(tried, taken=judged.verdict == "effect" and selected and tried.effect in judged.model.effects)


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


def _tunings(prepared: Prepared, common: Mapping[str, Rig], has_effects: bool, settings: Settings) -> dict[str, Rig]:
    """Rigs whose tuning the estimator uses, by model.

    In an angle-driven joint most of the innovations come from slow deviations of the muscles, which no fit knows. So
    the tuning is fitted for each model.
    """
    if not (prepared.angle_driven and settings.estimator):
        return {}
    settings.progress("tuning the estimators")
    named = [(recording, trial.name) for recording, trial in zip(prepared.recordings, prepared.trials, strict=True)]
    names = ("recalibrated", "extended") if has_effects else ("recalibrated",)
    tried, most = itertools.count(1), _TUNINGS * len(names)

    def report(text: str) -> None:
        settings.progress(f"tuning the estimators, {min(next(tried), most)} of at most {most}")

    tasks = [(common[name], named, 1.0 - settings.holdout, report, _TUNINGS) for name in names]
    best = in_threads(tuned, tasks, settings.jobs)
    rigs = {name: rig for name, (rig, _, _) in zip(names, best, strict=True)}
    return {"extended": rigs["recalibrated"], **rigs}


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
    values = {name: value for name, (value, _, _) in effect.parameters.items()}
    words = about(effect.name).sentence(effect.name, effect.muscle, values, sealed)
    begin, end = (
        None if time is None else f"{time:.1f} ± {max(std or 0.0, 0.1):.1f} s"
        for time, std in ((effect.onset_s, effect.onset_std_s), (effect.end_s, effect.end_std_s))
    )
    if begin is None:
        return words if end is None else f"{words}, until {end}"
    return f"{words}, from {begin} on" if end is None else f"{words}, from {begin} to {end}"


def sentence(
    verdict: Verdict,
    effects: Sequence[str],
    calibrated: Sequence[str],
    firmness: str,
    ambiguous: Sequence[str],
    share: float | None,
    errors: ModelErrors,
    ranking: Sequence[TriedCandidate],
    reference: Mapping[str, float] | None,
    mean_pressure: bool,
    along_motion: bool = False,
) -> str:
    """The verdict in a sentence.

    Args:
        share: of the held-out excess that the effects remove; None if it is not known.
        mean_pressure: whether the model is compared by the mean of the pressures, not by each of them.
        along_motion: whether the verdict rests on the model along the measured motion, not on the one that runs by
            itself.
    """
    each = [_errors(own, mean_pressure) for own in errors.all]
    configured, recalibrated, extended = map(_listed, each)
    beside = f" The recordings need a calibration: {'; '.join(calibrated)}." if calibrated else ""
    others = "; ".join(about(name).instead(name) for name in ambiguous)
    doubts = f" The recordings do not exclude another explanation: {others}." if others else ""
    if verdict == "none":
        return (
            f"The model lacks nothing that these recordings show.{beside} After {'calibration and ' if beside else ''}"
            f"recalibration its errors on held-out data are {recalibrated}, as small as the sensors' noise allows; as "
            f"configured they are {configured}.{doubts}"
        )
    if verdict == "effect":
        what = " ".join(f"{words[0].upper()}{words[1:]}." for words in effects)
        these = "these effects" if len(effects) > 1 else "this effect"
        gone = ""
        if share is not None:
            gone = f"Of the excess over the sensors' noise after recalibration, {100 * share:.0f} % is explained"
        if along_motion:
            gone = "" if share is None else f": {gone[0].lower()}{gone[1:]} on held-out data"
            text = (
                f"{what} The joint sticks, so the balance of its torques along the measured motion decides{gone}. The "
                "errors there of the model that gets the commands only are "
                f"{configured} as configured and {extended} with {these}."
            )
        else:
            change = change_in_words(errors.as_configured, errors.extended, " as configured", mean_pressure)
            text = f"{what} With {these} the model's errors on held-out data {change}." + (f" {gone}." if gone else "")
        text += beside + (f" {firmness}." if firmness else "")
        if reference is not None:
            straight = reference["angle_and_pressures"]
            text += f" A straight-line map of angle and pressures has an error of {straight:.2g} N m."
        return text + doubts
    tried = [item for item in ranking if item.shares is not None and item.round == 1]
    best = max(tried, key=lambda item: item.shares[0] if item.shares else 0.0, default=None)
    closest = ""
    if best is not None and best.shares is not None:
        gone = f"{100 * max(best.shares[0], 0.0):.0f} %"
        closest = f" The effect that comes closest, {best.effect}, explains {gone} of that, which is not enough."
    return (
        "The model lacks something, and no effect of the catalogue explains it. Its errors on held-out data are "
        f"{configured} as configured and {recalibrated} after recalibration, well above the sensors' noise.{closest}"
        f"{beside}"
    )


def change_in_words(before: Errors, after: Errors, whose: str = "", mean_pressure: bool = False) -> str:
    """How errors change from those of one model, and whose these are, to those of another one."""
    old, new = (_errors(own, mean_pressure) for own in (before, after))
    falls = all(a[0] < b[0] for b, a in zip(old, new, strict=True))
    return f"{'fall' if falls else 'change'} from {_listed(old)}{whose} to {_listed(new)}"


def _errors(own: Errors, mean_pressure: bool) -> list[tuple[float, str]]:
    """Each error with its unit."""
    out = [(item.rmse, unit) for item, unit in ((own.angle, "°"), (own.torque, " N m")) if item]
    if mean_pressure and own.mean_rmse_pa is not None:
        return [*out, (own.mean_rmse_pa / 1e3, " kPa (mean pressure)")]
    first, second = own.rmse_pa
    return [*out, (first / 1e3, " kPa (pressure 1)"), (second / 1e3, " kPa (pressure 2)")]


def _listed(errors: Sequence[tuple[float, str]]) -> str:
    text = ", ".join(f"{value:.2g}{unit}" for value, unit in errors)
    return text.replace(" kPa (pressure 1), ", " and ").replace(" kPa (pressure 2)", " kPa")
