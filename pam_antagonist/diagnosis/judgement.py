"""The verdict on a group of recordings: effects, a disturbance torque, nothing, or something unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pam_antagonist.diagnosis import (
    agreement,
    calibrations,
    disturbance_search,
    explained,
    findings,
    found_calibrations,
    held_out,
    onset,
    splits,
    sticking,
    thresholds,
    warnings,
)
from pam_antagonist.diagnosis.candidates import Model
from pam_antagonist.diagnosis.preparation import Group, Prepared, Settings
from pam_antagonist.diagnosis.result import Judged, Splits, Verdict
from pam_antagonist.diagnosis.selection import Selection
from pam_antagonist.diagnosis.stretches import Stretch, above_noise


def judge(prepared: Prepared, group: Group, selection: Selection, settings: Settings) -> Judged:
    """The verdict on a group: effects, a disturbance torque, nothing, or something unexplained."""
    judged = _judged(prepared, group, selection, settings)
    found = calibrations.found(
        group.experiments, (judged.model, selection.model), selection.calibrations, selection.rivals
    )
    notes = (*found_calibrations.differences(found), *warnings.at_bounds(judged.group.experiments, judged.model))
    return replace(judged, calibrations=found, warnings=(*judged.warnings, *notes))


def _judged(prepared: Prepared, group: Group, selection: Selection, settings: Settings) -> Judged:
    jobs, progress = settings.jobs, settings.progress
    verdict, share = _verdict(group, selection)
    models, store = (selection.recalibrated, selection.model), settings.checkpoint
    changing = onset.search(group, *models, jobs, progress, store, to_noise=_explained_well(group, selection))
    if changing is not None and _verdict(changing.group, changing.selection)[0] == "effect":
        group, selection = changing.group, changing.selection
        verdict, share = _verdict(group, selection)
    else:
        changing = None
    experiments, base, chosen = group.experiments, selection.recalibrated, selection.model
    stretches = _above_noise(group, base, settings) if verdict == "none" else ()
    if stretches:
        verdict = "unexplained"
    base_warnings = (
        *warnings.above_noise(stretches),
        *warnings.implausible(experiments, base),
        *agreement.base_contradictions(experiments, base),
    )
    found = None
    if changing is None:
        found = disturbance_search.search(experiments, base, chosen, verdict, jobs, progress)
    if found is not None:
        # A law that predicts held-out data has priority over a torque that may have any course.
        stuck = _stuck(prepared, group, selection, base_warnings, settings) if verdict == "unexplained" else None
        if stuck is not None and not explained.explains_in_part(stuck.group.experiments, stuck.base, stuck.model):
            return stuck
        removed = share if verdict == "effect" else found.share
        notes = (*base_warnings, *found.warnings)
        return Judged(group, base, selection, "effect", removed, found.model, found.effects, found.values, notes)
    if verdict == "effect":
        judged = _by_effects(prepared, group, selection, share, base_warnings, settings)
        return judged if changing is None else onset.dated(judged, changing)
    if verdict == "unexplained":
        stuck = _stuck(prepared, group, selection, base_warnings, settings)
        if stuck is not None:
            return stuck
        parts = onset.parts_above_noise(group, base, jobs)
        base_warnings = (*warnings.changes(parts), *base_warnings)
        first = explained.leader(selection.tried)
        if first is not None and first.model is not None:
            one = replace(selection, model=first.model)
            judged = _by_effects(prepared, group, one, _share(group, one), base_warnings, settings)
            if judged.verdict == "effect":
                return judged
    return Judged(group, base, selection, verdict, share, base, warnings=base_warnings)


def _stuck(
    prepared: Prepared, group: Group, selection: Selection, base_warnings: Sequence[str], settings: Settings
) -> Judged | None:
    """The verdict by friction of a joint that sticks, if it explains what no effect does in a free run; else None."""
    found = sticking.search(group, selection, settings)
    if found is None:
        return None
    moving, tried = found
    note = warnings.along_motion(moving.experiments, tried.recalibrated, tried.model)
    judged = _by_effects(prepared, moving, tried, _share(moving, tried), (note, *base_warnings), settings)
    return judged if judged.verdict == "effect" else None


def _explained_well(group: Group, selection: Selection) -> bool:
    """Whether effects that act throughout explain the recordings well.

    If so, effects that begin or end are accepted only if they leave nothing but noise. The residual of an effect of
    another form may come and go as well.
    """
    models = selection.recalibrated, selection.model
    explains = explained.explains(group.experiments, *models)
    return explains and not explained.explains_in_part(group.experiments, *models)


def _verdict(group: Group, selection: Selection) -> tuple[Verdict, float]:
    """The verdict by effects alone, and the share of the held-out excess that they remove."""
    experiments, base, chosen = group.experiments, selection.recalibrated, selection.model
    share = _share(group, selection)
    if explained.explains(experiments, base, chosen):
        return "effect", share
    return ("unexplained" if explained.has_significant_excess(experiments, base.fits) else "none"), share


def _share(group: Group, selection: Selection) -> float:
    """The share of the held-out excess that the chosen effects remove."""
    models = selection.recalibrated, selection.model
    before, after = (explained.remaining_residuals(group.experiments, model.fits) for model in models)
    return explained.held_share(group.experiments, before, after) if selection.model.effects else 0.0


def _above_noise(group: Group, base: Model, settings: Settings) -> tuple[Stretch, ...]:
    """Stretches of any recording, fitted or held out, in which the model without effects leaves more than noise."""
    settings.progress("whether all data are at their noise")
    points = [fitted.point for fitted in base.fits]
    found = above_noise(group.experiments, points, settings.jobs)
    return (*found, *above_noise(group.held_out, [other.origin for other in group.held_out], settings.jobs))


def _by_effects(
    prepared: Prepared,
    group: Group,
    selection: Selection,
    share: float,
    base_warnings: Sequence[str],
    settings: Settings,
) -> Judged:
    """The verdict by the effects that are needed. Where pressures alone were measured, the innovations must agree."""
    experiments, base, jobs = group.experiments, selection.recalibrated, settings.jobs
    settings.progress("which effects are needed")
    needed = findings.backward_elimination(experiments, base, selection.model, jobs)
    model, found, firm, notes = _firm(group, base, needed, settings)
    dropped = len(model.effects) < len(needed.effects)
    if dropped:
        before, after = (explained.remaining_residuals(experiments, m.fits) for m in (base, model))
        share = explained.held_share(experiments, before, after)
    if not found.effects or (dropped and not explained.explains(experiments, base, model)):
        return Judged(group, base, selection, "unexplained", 0.0, base, warnings=(*notes, *base_warnings))
    notes += found.contradictions
    gained = held_out.deciding_evidence(prepared, group, base, model, found.values, jobs)
    if gained is not None:
        taken = gained >= thresholds.STRONG
        notes.append(warnings.decided_by_innovations(selection.model.effects, gained, taken))
        if not taken:
            return Judged(group, base, selection, "unexplained", 0.0, base, warnings=(*notes, *base_warnings))
    if explained.explains_in_part(experiments, base, model):
        notes.insert(0, warnings.explained_in_part([effect.name for effect in found.effects]))
    contradictions = agreement.effect_contradictions(experiments, model, found.effects, found.values, jobs)
    return Judged(
        group, base, selection, "effect", share, model, found.effects, found.values,
        (*notes, *base_warnings, *contradictions), firm,
    )  # fmt: skip


def _firm(
    group: Group, base: Model, model: Model, settings: Settings
) -> tuple[Model, findings.Findings, dict[str, splits.Firmness], list[str]]:
    """The effects that most splits support: their model, what they are, what the splits say, and what was dropped."""
    experiments, jobs, notes = group.experiments, settings.jobs, []
    while True:
        found, without = findings.found(experiments, base, model, jobs)
        settings.progress("whether other splits agree")
        firm = splits.firmness(experiments, model, without, jobs)
        weakest = min(firm, key=lambda name: (firm[name].agree, sum(firm[name].evidence)))
        if firm[weakest].is_firm:
            break
        notes.append(warnings.not_firm(weakest, firm[weakest]))
        model = without[weakest]
        if not model.effects:
            return base, findings.Findings((), {}, []), {}, notes
    effects = tuple(replace(effect, splits=Splits(firm[effect.name].agree, splits.SPLITS)) for effect in found.effects)
    return model, found._replace(effects=effects), firm, notes
