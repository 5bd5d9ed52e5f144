"""The verdict on a group of recordings, by a table of rules in order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from pam_antagonist.diagnosis import (
    agreement,
    calibrations,
    change_point,
    disturbance_search,
    findings,
    found_calibrations,
    held_out,
    onset,
    splits,
    sticking,
    thresholds,
    warnings,
)
from pam_antagonist.diagnosis.hypotheses import Ranking, Work
from pam_antagonist.diagnosis.models import Model, explains, explains_in_part, held_share
from pam_antagonist.diagnosis.preparation import Group, Prepared
from pam_antagonist.diagnosis.result import Judged, Splits, Verdict
from pam_antagonist.inference.measured_motion import MeasuredMotion, along_motion


@dataclass(frozen=True, eq=False)
class Case:
    """A group of recordings, and what the search for effects that act throughout found in them."""

    prepared: Prepared
    group: Group
    ranking: Ranking
    work: Work

    @cached_property
    def so_far(self) -> Verdict:
        """The verdict by effects that act throughout alone."""
        if explains(self.ranking.base, self.ranking.model):
            return "effect"
        wrong = self.ranking.base.has_significant_excess or bool(self.stretches)
        return "unexplained" if wrong else "none"

    @cached_property
    def stretches(self) -> tuple[change_point.Stretch, ...]:
        """Stretches, fitted or held out, in which a model without effects that need none leaves more than noise."""
        base = self.ranking.base
        if explains(base, self.ranking.model) or base.has_significant_excess:
            return ()
        self.work.progress("whether all data are at their noise")
        own = ((experiment, fitted.point) for experiment, fitted in base.pairs)
        others = ((other, other.origin) for other in self.group.held_out)
        return tuple(s for pairs in (own, others) for s in change_point.stretches_above_noise(pairs, base.jobs))

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Warnings about the model without effects."""
        base = self.ranking.base
        return (
            *warnings.above_noise(self.stretches),
            *warnings.implausible(base),
            *agreement.base_contradictions(base),
        )

    @cached_property
    def along_motion(self) -> Judged | None:
        """The verdict by friction of a joint that sticks; None if it does not explain what is left.

        Beside a learned law it is not asked: it judges other errors than those of which the law removes its share.
        """
        if self.ranking.start is not None:
            return None
        found = sticking.friction_along_motion(self.ranking, self.work)
        if found is None:
            return None
        held = tuple(along_motion(other) for other in self.group.held_out)
        moving = replace(self, group=replace(self.group, held_out=held), ranking=found)
        judged = _by_effects(moving, (warnings.along_motion(found.base, found.model), *self.notes))
        return judged if judged.verdict == "effect" else None

    def judged(self, verdict: Verdict, share: float | None, notes: Sequence[str] = ()) -> Judged:
        """A verdict without effects."""
        base = self.ranking.base
        return Judged(self.group, base, self.ranking, verdict, share, base, warnings=(*notes, *self.notes))


# The rules.


def _begins_or_ends(case: Case) -> Judged | None:
    if case.ranking.start is not None:
        # What a table cannot follow comes and goes with the motion. It looks like an effect that begins and ends.
        return None
    found = onset.begin_and_end(case.group, case.ranking, case.work)
    if found is None or not explains(found.base, found.model):
        return None
    changing = replace(case, ranking=found)
    return _by_effects(changing, changing.notes)


def _nothing(case: Case) -> Judged:
    return case.judged("none", case.ranking.share)


def _sticks_beside_a_law(case: Case) -> bool:
    """Whether a joint with a learned law sticks: it goes elsewhere after the least error of the table, as if pushed."""
    if case.ranking.start is None:
        return False
    return any(isinstance(along_motion(experiment), MeasuredMotion) for experiment in case.ranking.base.experiments)


def _disturbance_beside(case: Case) -> Judged | None:
    if _sticks_beside_a_law(case):
        return None
    return _by_disturbance(case, disturbance_search.beside_effects(case.ranking.model, case.work), case.ranking.share)


def _effects(case: Case) -> Judged:
    return _by_effects(case, case.notes)


def _friction_explains(case: Case) -> Judged | None:
    judged = case.along_motion
    return None if judged is None or explains_in_part(judged.base, judged.model) else judged


def _disturbance(case: Case) -> Judged | None:
    if _sticks_beside_a_law(case):
        return None
    found = disturbance_search.instead_of_effects(case.ranking, case.work)
    return _by_disturbance(case, found, None if found is None else found.share)


def _friction_in_part(case: Case) -> Judged | None:
    return case.along_motion


def _leader(case: Case) -> Judged | None:
    first = case.ranking.leader
    if first is None or first.model is None:
        return None
    notes = (*_changes(case), *case.notes)
    judged = _by_effects(replace(case, ranking=replace(case.ranking, model=first.model)), notes)
    return judged if judged.verdict == "effect" else None


def _unexplained(case: Case) -> Judged:
    return case.judged("unexplained", case.ranking.share, _changes(case))


class Rule(NamedTuple):
    """A rule of the verdict."""

    so_far: Verdict | None  # verdict by effects that act throughout under which it is asked; None: under any
    verdict: Callable[[Case], Judged | None]  # by this rule; None if it does not hold, and the next one is asked
    reason: str


RULES = (
    Rule(None, _begins_or_ends, "what begins late bends the choice of what acts throughout, so it is asked first"),
    Rule("none", _nothing, "no stretch of any recording is above noise, fitted or held out"),
    Rule("effect", _disturbance_beside, "what effects leave may come and go; the evidence for it has to be strong"),
    Rule("effect", _effects, "those that are needed beside each other and that most splits support"),
    Rule("unexplained", _friction_explains, "a law that predicts held-out data comes before a torque of any course"),
    Rule("unexplained", _disturbance, "a torque that comes and goes explains all, alone or beside effects"),
    Rule("unexplained", _friction_in_part, "as good as nothing else explains, where the joint sticks"),
    Rule("unexplained", _leader, "one effect in another form than its law has no rival that imitates as much"),
    Rule("unexplained", _unexplained, "nothing of the catalogue explains enough"),
)
"""The rules in order: the first one that holds decides."""


def judge(prepared: Prepared, group: Group, ranking: Ranking, work: Work) -> Judged:
    """The verdict on a group: effects, a disturbance torque, nothing, or something unexplained."""
    case = Case(prepared, group, ranking, work)
    asked = (rule.verdict(case) for rule in RULES if rule.so_far is None or rule.so_far == case.so_far)
    judged = next(one for one in asked if one is not None)
    found = calibrations.found(ranking, judged.model)
    notes = (*found_calibrations.differences(found), *warnings.at_bounds(judged.model))
    return replace(judged, calibrations=found, warnings=(*judged.warnings, *notes))


def _changes(case: Case) -> list[str]:
    if not onset.can_change(case.group):
        return []
    base = case.ranking.base
    parts = base.each(change_point.parts_above_noise)
    return warnings.changes({e.trial.name: part for e, part in zip(base.experiments, parts, strict=True) if part})


def _by_disturbance(case: Case, found: disturbance_search.Explanation | None, share: float | None) -> Judged | None:
    """The verdict by a disturbance torque, with effects beside it where there are any."""
    if found is None:
        return None
    notes = (*case.notes, *found.warnings)
    return Judged(
        case.group, case.ranking.base, case.ranking, "effect", share, found.model, found.effects, found.values, notes
    )


def _by_effects(case: Case, base_notes: Sequence[str]) -> Judged:
    """The verdict by the effects that are needed. Where pressures alone were measured, the innovations must agree."""
    group, ranking, base, share = case.group, case.ranking, case.ranking.base, case.ranking.share
    case.work.progress("which effects are needed")
    needed = findings.backward_elimination(base, ranking.model)
    model, found, firm, notes = _firm(base, needed, case.work)
    dropped = len(model.effects) < len(needed.effects)
    if dropped:
        share = held_share(base, model)
    nothing = Judged(group, base, ranking, "unexplained", 0.0, base)
    if not found.effects or (dropped and not explains(base, model)):
        return replace(nothing, warnings=(*notes, *base_notes))
    notes += found.contradictions
    gained = held_out.deciding_evidence(case.prepared, group, base, model, found.values)
    if gained is not None:
        taken = gained >= thresholds.STRONG
        notes.append(warnings.decided_by_innovations(ranking.model.effects, gained, taken))
        if not taken:
            return replace(nothing, warnings=(*notes, *base_notes))
    if explains_in_part(base, model):
        notes.insert(0, warnings.explained_in_part([effect.name for effect in found.effects]))
    contradictions = agreement.effect_contradictions(model, found.effects, found.values)
    effects = onset.dated(found.effects, model)
    changes = (onset.NOTE,) if any(one.onset_s is not None or one.end_s is not None for one in effects) else ()
    return Judged(
        group, base, ranking, "effect", share, model, effects, found.values,
        (*notes, *base_notes, *contradictions, *changes), firm,
    )  # fmt: skip


def _firm(
    base: Model, model: Model, work: Work
) -> tuple[Model, findings.Findings, dict[str, splits.Firmness], list[str]]:
    """The effects that most splits support: their model, what they are, what the splits say, and what was dropped."""
    notes: list[str] = []
    while True:
        found, without = findings.found(base, model)
        work.progress("whether other splits agree")
        firm = splits.firmness(model, without)
        weakest = min(firm, key=lambda name: (firm[name].agree, sum(firm[name].evidence)))
        if firm[weakest].is_firm:
            break
        notes.append(warnings.not_firm(weakest, firm[weakest]))
        model = without[weakest]
        if not model.effects:
            return base, findings.Findings((), {}, []), {}, notes
    effects = tuple(replace(effect, splits=Splits(firm[effect.name].agree, splits.SPLITS)) for effect in found.effects)
    return model, found._replace(effects=effects), firm, notes
