"""Which effect the model of a rig lacks that data sheets describe, or that short trials show.

Nothing in such a joint is known well enough to let the model run by its commands alone for minutes. So the rig is
identified first (:mod:`pam_antagonist.identification.from_pressures`), and its two parts are compared with the
recordings (:mod:`~pam_antagonist.diagnosis.model_parts`). What was found in both goes into one rig, whose filter is
judged on what was held out.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pam_antagonist.diagnosis import ambiguity, description, pipeline, sentences, warnings
from pam_antagonist.diagnosis.errors import Errors, ModelErrors, RigErrors, total_of
from pam_antagonist.diagnosis.judged import Judged, JudgedJoint
from pam_antagonist.diagnosis.learned_law import of_part
from pam_antagonist.diagnosis.model_parts import AIR, JOINT, ModelPart, group_of
from pam_antagonist.diagnosis.preparation import Prepared, Settings, Timings
from pam_antagonist.diagnosis.result import MODELS, Diagnosis, FoundCalibration, RecordingEntry
from pam_antagonist.diagnosis.rig_choice import RigChoice, RigFile
from pam_antagonist.diagnosis.verdicts import NONE, UNEXPLAINED, Verdict
from pam_antagonist.estimation.metrics import ModelAloneErrors
from pam_antagonist.identification import air_stage, joint_stage
from pam_antagonist.identification.filter_stage import Given
from pam_antagonist.identification.from_pressures import FromPressures, concluded, fitted_until, identify, with_joint
from pam_antagonist.identification.joint_stage import DELAY, ZERO
from pam_antagonist.identification.result import HeldRecording
from pam_antagonist.identification.said import CLEAR, put_back
from pam_antagonist.inference.fit import Fit, fitted, within_bounds
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.model.effects import parameter_path
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import refusal
from pam_antagonist.shown import number, percent

_AS_GOOD = 1.1
"""The filter's error with an effect may be larger by this factor than without it."""
_EVALUATIONS = 12
_SIZE_STD, _SHAPE_STD = 5.0, 1.5
"""Priors of an effect's parameters in the last fit: of sizes in their scales, of shapes on the logarithmic scale."""


@dataclass(frozen=True, eq=False)
class _Rigs:
    """The rig with all values fitted, and with the found effects as well; the latter is None if none was found."""

    recalibrated: FromPressures
    extended: FromPressures | None

    @property
    def last(self) -> FromPressures:
        """With effects, where there are any."""
        return self.extended or self.recalibrated

    @property
    def columns(self) -> dict[str, tuple[FromPressures, str]]:
        """Each model of a report: the identification, and which of its rigs."""
        base = self.recalibrated
        rigs = ((base, "as_configured"), (base, "identified"), (self.last, "identified"))
        return dict(zip(MODELS, rigs, strict=True))

    @property
    def proposed(self) -> FromPressures | None:
        """That whose rig is best on held-out data; None if that is the rig as configured."""
        base, extended = (None if one is None or one.rejected else one for one in (self.recalibrated, self.extended))
        if base is None or extended is None:
            return extended or base
        # An effect of the air hardly changes the angle, since the measured pressures drive the joint.
        worse = extended.pooled("identified") > _AS_GOOD * base.pooled("identified")
        return base if worse else extended


def diagnose(recordings: Sequence[Given], rig: Rig, settings: Settings, whole: int = 0) -> Diagnosis:
    """Find the effect that the model of a rig lacks.

    Args:
        recordings: each with its joint's condition and a name.
        rig: from data sheets, or a known one of which short trials were recorded.
        settings: of a diagnosis; profiles are not worked out.
        whole: number of recordings at the end that are held out as a whole, in place of the share.

    Raises:
        BadInput: no free joint with a measured angle.
    """
    progress, jobs, timings = settings.progress, settings.jobs, Timings()
    base = identify(recordings, rig, settings.holdout, 2, settings.seed, jobs, progress, whole, encoder=True)
    ends = fitted_until(recordings, settings.holdout, whole)
    own, corrected = with_joint(rig, base.joint, recordings)
    timings.end("identification")
    groups = [group_of(JOINT, rig, base.joint.moved, recordings, ends, settings)]
    if base.air is not None:
        groups.append(group_of(AIR, own, base.air.moved, corrected, ends, settings))
    there = tuple(group for group in groups if group is not None)
    prepared = Prepared(rig, rig, (), tuple(group.experiments[0].trial for group in there), there, len(recordings))
    with_laws = [of_part(one, progress) for one in pipeline.verdicts(prepared, settings, timings)]
    timings.end("laws")
    judged = [one for one, _ in with_laws]
    laws = {one.group.name: learned for one, learned in with_laws if learned is not None}
    extended = None
    while extended is None and (parts_found := [one.group.name for one in judged if one.effects]):
        progress("all values once more, with the effects")
        fits = {one.group.name: _with_effects(one) for one in judged if one.effects}
        joint, air = fits.get(JOINT, base.joint), fits.get(AIR, base.air)
        # What met a bound before the effects were known has no part in the fits with them.
        before: dict[str, Fit | None] = {JOINT: base.joint, AIR: base.air}
        earlier = [text for part in fits if (fit := before[part]) is not None for text in put_back(fit)]
        own = functools.reduce(lambda known, learned: learned.in_rig(known), laws.values(), rig)
        extended = concluded(recordings, ends, own, joint, air, jobs, progress, earlier=earlier)
        if not _contradicts(base, extended):
            judged = [_with_values(one, fits[one.group.name]) if one.effects else one for one in judged]
            break
        # What changes the pressures within the muscles acts on the joint too, which the air alone does not show.
        doubted = AIR if AIR in parts_found else JOINT
        laws.pop(doubted, None)
        judged = [_doubted(one, base, extended) if one.group.name == doubted else one for one in judged]
        extended = None
    timings.end("filter and held-out data")
    return _described(recordings, JudgedJoint.of(prepared, judged), _Rigs(base, extended), timings)


def _described(recordings: Sequence[Given], joint: JudgedJoint, rigs: _Rigs, timings: Timings) -> Diagnosis:
    """Everything that a report says."""
    judged = joint.parts
    effects = tuple(
        replace(effect, part=one.group.name, recordings=_names(one)) for one in judged for effect in one.effects
    )
    ambiguous = ambiguity.not_told_apart(judged, ())
    calibrated = _calibrations(rigs.recalibrated)
    entries = tuple(_entry(number, given, rigs) for number, given in enumerate(recordings))
    counts = [item.whole.report.samples for item in rigs.recalibrated.held]
    known = [entry for entry in entries if entry.errors is not None]
    totals = {name: _total([getattr(one.errors, name) for one in known], counts) for name in MODELS}
    for name, (found, rig) in rigs.columns.items():
        if rig == "identified" and math.isfinite(error := found.pooled("pressures_alone")):
            totals[name] = replace(totals[name], along_pressures_deg=error)
    of_one_rig = {
        name: RigErrors.total(totals[name], [(getattr(one.ukf, name), n) for one, n in zip(known, counts, strict=True)])
        for name in MODELS
    }
    timings.end("description")
    return Diagnosis(
        verdict=joint.verdict,
        sentence=_sentence(judged, rigs),
        effects=effects,
        calibrations=calibrated,
        ambiguous_with=ambiguous,
        experiment=ambiguity.distinguishing_experiments(
            [effect.name for effect in effects], ambiguous, {state.condition for _, state, _ in recordings}
        ),
        ambiguities=(),
        ranking=joint.ranking,
        share=description.share_of_found(judged),
        parts=tuple(one.as_part for one in judged),
        errors=ModelErrors(*(totals[name] for name in MODELS)),
        of_one_rig=of_one_rig,
        by_recording=entries,
        reference=None,
        remaining=tuple(item for one in judged for item in description.left(one)),
        unseen=(),
        warnings=(
            *warnings.guessed_curves(rigs.recalibrated.start, [effect.name for effect in effects]),
            *(text for one in judged for text in one.warnings),
        ),
        profiles=(),
        rig_recalibrated=rigs.recalibrated.rig,
        rig_extended=rigs.last.rig,
        own=(),
        base_friction_removed=False,
        recalibrated=joint.base,
        extended=joint.model,
        compared=(),
        seconds=timings.seconds,
        notes=rigs.last.notes,
        held=rigs.last.held,
        decided=_choice(rigs, of_one_rig),
    )


def _names(judged: Judged) -> tuple[str, ...]:
    """The recordings of a part."""
    (experiment,) = judged.group.experiments
    assert isinstance(experiment, ModelPart)
    return tuple(dict.fromkeys(run.name for run in experiment.runs))


def _calibrations(base: FromPressures) -> tuple[FoundCalibration, ...]:
    """Zero and delay of the encoder that all values say, where they are clear; the rig file has them."""
    values, stds = base.final[0].values, base.final[0].stds
    named = (("encoder_zero", ZERO, "rad"), ("delay_angle", DELAY, "s"))
    each = [(name, values.get(key, 0.0), stds.get(key, 0.0), unit) for name, key, unit in named]
    return tuple(
        FoundCalibration(name, value, std, unit, math.nan, {}) for name, value, std, unit in each
        if abs(value) > CLEAR * std
    )  # fmt: skip


def _entry(number: int, given: Given, rigs: _Rigs) -> RecordingEntry:
    """A recording with the errors of the models on what was held out of it."""
    _, state, name = given
    lock_angle = state.lock_angle if state.condition == "locked" else None

    def of(found: FromPressures) -> HeldRecording | None:
        return next((item for item in found.held if item.number == number), None)

    first = of(rigs.recalibrated)
    if first is None:
        return RecordingEntry(name, state.condition, lock_angle, "fitted", None)
    reports = [item.reports[rig] for found, rig in rigs.columns.values() if (item := of(found)) is not None]
    free = state.condition == "free"
    return RecordingEntry(
        name, state.condition, lock_angle, "both" if first.from_s > 0.0 else "held out", first.from_s,
        errors=ModelErrors(*(_errors(report.model_alone, free) for report in reports)),
        ukf=ModelErrors(*(_errors(report.ukf, free) for report in reports)),
        held_out_s=((first.from_s, given[0].duration_s),),
    )  # fmt: skip


def _errors(found: ModelAloneErrors, free: bool) -> Errors:
    return Errors(found.angle if free else None, found.torque, found.pressure.rmse_pa)


def _total(parts: Sequence[Errors], samples: Sequence[int]) -> Errors:
    return total_of(parts, samples) if parts else Errors(None, None, (math.nan, math.nan))


def _choice(rigs: _Rigs, errors: Mapping[str, RigErrors]) -> RigChoice:
    """The rig file to use: with the effects, or recalibrated, whichever is best on held-out data; it may be neither."""
    best, start = rigs.proposed, rigs.recalibrated.start
    if best is None or refusal(best.rig):
        return RigChoice((), None, "")
    kind = "extended" if best is rigs.extended else "recalibrated"
    names = ", ".join(name for name, _ in best.fitted)
    source = " ".join(f"extended by close_loop from {names}; started from: {start.source.strip()}".split())
    rig = best.rig.replaced(
        name=f"{start.name.removesuffix('_identified')}_extended", source=source, identified=names,
        fitted={**start.fitted, **best.saw},
    )  # fmt: skip
    file = RigFile(f"rig_{kind}.yaml", rig, None, errors["as_configured"], errors[kind])
    return RigChoice((file,), file, "")


def _sentence(judged: Sequence[Judged], rigs: _Rigs) -> str:
    """The result in words."""
    found = [sentences.in_words(effect, False) + _explains(one, effect.law is not None, effect.holdout_gain)
             for one in judged for effect in one.effects]  # fmt: skip
    unexplained = [one.group.name for one in judged if one.verdict == UNEXPLAINED]
    if found:
        what = "; ".join(found)
        out = what[0].upper() + what[1:] + "."
    elif unexplained:
        out = f"No effect of the catalogue explains what is left in {' and in '.join(unexplained)}. "
        out += "No law that was learned does."
    else:
        out = "The model explains the recordings; no effect is missing."
    now, base = rigs.proposed, rigs.recalibrated
    if now is None:
        return f"{out} Keep the rig file that you have: {rigs.last.rejected or 'no other is better on held-out data.'}"
    before, values, after = base.pooled("as_configured"), base.pooled("identified"), now.pooled("identified")
    by = "with these values"
    if now is rigs.extended and math.isfinite(values):
        by = f"with {'these effects' if len(found) > 1 else 'this effect'}"
        by += f", {number(values)}° with recalibrated values alone"
    return (
        f"{out} The filter's angle error on held-out data is {number(before)}° as configured and {number(after)}° {by}."
    )


def _explains(judged: Judged, is_law: bool, share: float | None) -> str:
    """What goes of the excess of a part with an effect, behind the effect in words."""
    gone, whose = percent(share or 0.0), f"of the excess over noise of {judged.group.name}"
    if is_law:
        return f"; with it {gone} {whose} is explained on held-out data"
    return f", which explains {gone} {whose} on held-out data"


_OF_THE_WHOLE = {
    "identified": "the filter errs",
    "model_alone": "the model alone",
    "pressures_alone": "the joint along the pressures",
}


def _contradicts(base: FromPressures, extended: FromPressures) -> bool:
    """Whether a model with effects of its parts is worse in all that held-out data show of the whole joint."""
    pairs = [(base.pooled(name), extended.pooled(name)) for name in _OF_THE_WHOLE]
    return all(not after <= _AS_GOOD * before for before, after in pairs if math.isfinite(before))


def _doubted(judged: Judged, base: FromPressures, extended: FromPressures) -> Judged:
    """A verdict on a part of the model whose effects the whole joint contradicts."""
    names = " and ".join(effect.name for effect in judged.effects)
    errors = ", ".join(
        f"{words} by {number(extended.pooled(name))}° in place of {number(base.pooled(name))}°"
        for name, words in _OF_THE_WHOLE.items()
        if math.isfinite(base.pooled(name))
    )
    note = (
        f"{names} would explain {percent(judged.share)} of what is left in {judged.group.name}. It is not the cause: "
        f"with it {errors} on held-out data."
    )
    verdict: Verdict = UNEXPLAINED if judged.base.has_significant_excess else NONE
    return replace(
        judged, verdict=verdict, share=None, model=judged.base, effects=(), values={}, firmness={}, warnings=(note,)
    )


def _with_effects(judged: Judged) -> Fit:
    """The values of a part of the model with its effects, fitted once more with the identification's own weights."""
    (experiment,), (found,) = judged.model.experiments, judged.model.fits
    assert isinstance(experiment, ModelPart)
    extra = [_with_prior(free) for free in found.free]
    unknown = [*experiment.start.unknowns, *extra]
    known = [item.coordinate(found.point.effects[free.path]) for item, free in zip(extra, found.free, strict=True)]
    begin, runs, rig = np.concatenate([found.point.theta, known]), experiment.runs, experiment.rig
    if experiment.part == JOINT:
        residual = joint_stage.residual_of(rig, runs, unknown, math.inf)
    else:
        residual = air_stage.residual_of(rig, runs, 0.0, air_stage.HORIZONS[-1], unknown)
    last = fitted(unknown, residual, begin, _EVALUATIONS, experiment.jobs)
    return within_bounds(last, residual, _EVALUATIONS, experiment.jobs, {item.name for item in extra})


def _with_values(judged: Judged, fit: Fit) -> Judged:
    """A verdict with the effects' values of the last fit, which the rig file has."""
    values = fit.parameters
    return replace(
        judged,
        effects=tuple(
            replace(effect, parameters={
                name: size._replace(value=values.get(parameter_path(effect.name, name), size.value))
                for name, size in effect.parameters.items()
            })
            for effect in judged.effects
        ),
    )  # fmt: skip


def _with_prior(free: Unknown) -> Unknown:
    if free.item.is_size:
        return replace(free, std=_SIZE_STD * free.item.scale, unit=0.0)
    return replace(free, start=free.bounded(free.item.scale), std=_SHAPE_STD, unit=0.0)
