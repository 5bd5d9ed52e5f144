"""The verdict on a group of recordings, by a table of rules in order.

The motion of a joint that sticks and slips differs from that of any model after seconds. So what no effect explains in
a free run is tested again along the measured motion, where all effects compete on equal terms
(:mod:`~pam_antagonist.inference.measured_motion`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from typing_extensions import override

from pam_antagonist.diagnosis import (
    agreement,
    calibrations,
    change_point,
    disguise,
    disturbance,
    findings,
    held_out,
    law_search,
    onset,
    remaining,
    splits,
    thresholds,
    warnings,
)
from pam_antagonist.diagnosis.hypotheses import Ranking, TriedCandidate, Work
from pam_antagonist.diagnosis.judged import Judged
from pam_antagonist.diagnosis.models import (
    Model,
    explains,
    explains_in_part,
    held_share,
    in_threads,
    likelier,
    share_of_all,
)
from pam_antagonist.diagnosis.preparation import Group, Prepared
from pam_antagonist.diagnosis.search import CatalogueEffect, Score, score_all, search
from pam_antagonist.diagnosis.verdicts import EFFECT, NONE, UNEXPLAINED, Verdict
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, refit, relinearised
from pam_antagonist.inference.measured_motion import MeasuredMotion, along_motion
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.starts import STARTS, best_of_starts
from pam_antagonist.model.effects import DISTURBANCE

_FRICTION = "friction"
_RIVALS = 4
"""Other effects that are fitted beside friction: those with the best scores."""


class FrictionAlongMotion(CatalogueEffect):
    """Friction, where it is the best effect along the measured motion of a joint that sticks."""

    @override
    def propose(self, now: Ranking, number: int, work: Work) -> list[TriedCandidate]:
        base = base_along_motion(now.base)
        if base is None:
            return []
        work.progress("where the joint sticks: the balance of its torques along the measured motion")
        fits, stuck = base.fits, [r for r, one in enumerate(base.experiments) if isinstance(one, MeasuredMotion)]
        scores = dict(zip(stuck, base.of(stuck).each(score_all), strict=True))
        total = {name: sum(max(scores[r][name].gain, 0.0) for r in stuck) for name in scores[stuck[0]]}
        if _FRICTION not in total:  # the rig declares it
            return []
        rivals = sorted((name for name in total if name != _FRICTION), key=lambda name: -total[name])[:_RIVALS]
        names = (_FRICTION, *(name for name in rivals if total[name] > thresholds.LEAST_SCORE))
        tasks = [(name, r) for name in names for r in stuck]
        fitted_with = in_threads(_with_effect, ((*base.pairs[r], scores[r][name]) for name, r in tasks), base.jobs)
        done = dict(zip(tasks, fitted_with, strict=True))

        def tried(name: str) -> TriedCandidate:
            every = [done.get((name, r)) for r in range(len(fits))]
            return TriedCandidate(name, number, total[name], base=base).fitted(base, base, every, (name,))

        best, *others = sorted((tried(name) for name in names), key=lambda one: -one.standing)
        if best.effect != _FRICTION or best.model is None:
            return []
        return [replace(best, model=best.model.map(relinearised)), *others]

    @override
    def is_worth_taking(self, tried: TriedCandidate) -> bool:
        return tried.effect == _FRICTION and tried.is_worth_taking


def friction_along_motion(found: Ranking, work: Work) -> Ranking | None:
    """Friction that explains what no effect explains in a free run; None if it does not, or if no joint sticks."""
    ranking = search(found.base, work, (FrictionAlongMotion(),), most=1)
    model = ranking.model
    return ranking if model.effects and (explains(ranking.base, model) or ranking.leader) else None


def base_along_motion(base: Model) -> Model | None:
    """The base parameters, along the measured motion where a joint sticks; None where none does."""
    experiments = tuple(_along_motion(*pair) for pair in base.pairs)
    stuck = [r for r, experiment in enumerate(experiments) if isinstance(experiment, MeasuredMotion)]
    moving, fits = Model(experiments, base.fits), list(base.fits)
    for r, fitted in zip(stuck, in_threads(_without_effects, moving.of(stuck).pairs, base.jobs), strict=True):
        fits[r] = fitted
    return replace(moving, fits=tuple(fits)) if stuck else None


def _along_motion(experiment: Experiment, fitted: Fitted) -> Experiment:
    """A recording along its measured motion, with its calibrations corrected, if the joint sticks; others as is."""
    calibrated = along_motion(experiment.corrected(fitted.point)[0])
    return calibrated if isinstance(calibrated, MeasuredMotion) else experiment


def _without_effects(experiment: Experiment, _: Fitted) -> Fitted:
    """The base parameters at their most probable values, with the usual blocks per independent error.

    If every block counted, as for a model that is right, the data could move a base parameter by many standard
    deviations, and it would imitate the effect.
    """
    return relinearised(experiment, refit(experiment, experiment.origin))


def _with_effect(experiment: Experiment, base: Fitted, score: Score) -> Fitted:
    """An effect beside the base parameters; friction without the numbers that do not pay."""
    start = Point(base.point.theta, {**base.point.effects, **score.start})
    fitted = refit(experiment, start, (*base.free, *score.candidate.free), base.base, renewals=2, beside=base)
    # With as many blocks per error as without the effect: else the weight of the priors would look like evidence.
    fitted = best_of_starts(experiment, fitted, STARTS, finer=False)
    return findings.pruned(experiment, base, fitted, score.candidate.effect)


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
        return EFFECT if explains(self.ranking.base, self.ranking.model) else self.without_effects

    @property
    def without_effects(self) -> Verdict:
        """The verdict if no effect is found."""
        return UNEXPLAINED if self.ranking.base.has_significant_excess or self.stretches else NONE

    @cached_property
    def _points(self) -> list[tuple[Experiment, Point]]:
        """The recordings with their models without effects; those that were held out as a whole as configured."""
        own = [(experiment, fitted.point) for experiment, fitted in self.ranking.base.pairs]
        return [*own, *((other, other.origin) for other in self.group.held_out)]

    @cached_property
    def stretches(self) -> tuple[change_point.Stretch, ...]:
        """Stretches, fitted or held out, where the model without effects leaves more than noise.

        None is looked for where the excess is significant anyway.
        """
        base = self.ranking.base
        if base.has_significant_excess:
            return ()
        self.work.progress("whether all data are at their noise")
        return change_point.stretches_above_noise(self._points, base.jobs)

    @cached_property
    def with_a_law(self) -> Model | None:
        """The model with the best law of what is no event; by the time a law would be one. None if there is none."""
        base = self.ranking.base
        found = law_search.better(base, base, base, self.work.progress)
        if found is None or any(law.is_of_readings or law.argument == "time" for law in found[0].laws):
            return None
        return found[1]

    @property
    def left(self) -> tuple[remaining.RemainingResidual, ...]:
        """These stretches, described."""
        recorded = {pair[0].trial.name: pair for pair in self._points}
        return tuple(remaining.of_stretch(*recorded[one.recording], one) for one in self.stretches)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Warnings about the model without effects."""
        base = self.ranking.base
        return (
            *warnings.above_noise(() if self.so_far == EFFECT else self.stretches),
            *warnings.implausible(base),
            *agreement.base_contradictions(base, self.group.held_out if self.prepared.holds_out_recordings else ()),
        )

    @cached_property
    def along_motion(self) -> Judged | None:
        """The verdict by friction of a joint that sticks; None if it does not explain what is left.

        Beside a learned law it is not asked: it judges other errors than those of which the law removes its share.
        """
        if self.ranking.start is not None:
            return None
        found = friction_along_motion(self.ranking, self.work)
        if found is None:
            return None
        held = tuple(along_motion(other) for other in self.group.held_out)
        moving = replace(self, group=replace(self.group, held_out=held), ranking=found)
        judged = _by_effects(moving, (warnings.along_motion(found.base, found.model), *self.notes))
        return judged if judged.verdict == EFFECT else None

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
    if found is None or not explains(found.base, found.model) or _a_law_does_better(case, found.model):
        return None
    changing = replace(case, ranking=found)
    return _by_effects(changing, changing.notes)


def _a_law_does_better(case: Case, changing: Model) -> bool:
    """Whether a law explains more than an effect that begins or ends: it acts where the joint seldom is."""
    base, law = case.ranking.base, case.with_a_law
    if law is None:
        return False
    left = [[one.residual(fit.point, whole=True) for one, fit in model.pairs] for model in (changing, law)]
    gains = (likelier(fit.scale, *both) for fit, *both in zip(base.fits, *left, strict=True))
    return sum(gains) >= thresholds.STRONG


def _in_disguise(case: Case) -> Judged | None:
    if case.ranking.start is not None or case.ranking.base.has_significant_excess:
        return None
    if not warnings.implausible(case.ranking.base) and not case.stretches:
        return None
    ranking = disguise.unmasked(case.ranking.base, case.work)
    if ranking is None:
        return None
    found, _ = findings.found(ranking.base, ranking.model)
    model, notes = ranking.model, (*found.contradictions, *case.notes)
    return Judged(case.group, ranking.base, ranking, EFFECT, None, model, found.effects, found.values, notes)


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
    return _by_disturbance(case, disturbance.beside_effects(case.ranking.model, case.work), case.ranking.share)


def _effects(case: Case) -> Judged:
    return _by_effects(case, case.notes)


def _friction_explains(case: Case) -> Judged | None:
    judged = case.along_motion
    return None if judged is None or explains_in_part(judged.base, judged.model) else judged


def _disturbance(case: Case) -> Judged | None:
    if _sticks_beside_a_law(case):
        return None
    found = disturbance.instead_of_effects(case.ranking, case.work)
    if found is not None and case.ranking.start is None and (law := case.with_a_law) is not None:
        # What predicts held-out data comes before a torque of any course, the more so if that needs other effects.
        least = thresholds.EXPLAINED_WELL if len(found[1].effects) == 1 else thresholds.EXPLAINED
        if share_of_all(case.ranking.base, law) >= least:
            return None
    shares = (effect.holdout_gain for effect in found[1].effects if effect.name == DISTURBANCE) if found else ()
    return _by_disturbance(case, found, next(iter(shares), None))


def _leader(case: Case) -> Judged | None:
    first = case.ranking.leader
    if first is None or first.model is None:
        return None
    notes = (*_changes(case), *case.notes)
    judged = _by_effects(replace(case, ranking=replace(case.ranking, model=first.model)), notes)
    return judged if judged.verdict == EFFECT else None


def _unexplained(case: Case) -> Judged:
    return case.judged(UNEXPLAINED, case.ranking.share, _changes(case))


class Rule(NamedTuple):
    """A rule of the verdict."""

    so_far: Verdict | None  # verdict by effects that act throughout under which it is asked; None: under any
    verdict: Callable[[Case], Judged | None]  # by this rule; None if it does not hold, and the next one is asked
    reason: str


RULES = (
    Rule(None, _begins_or_ends, "what begins late bends the choice of what acts throughout, so it is asked first"),
    Rule(None, _in_disguise, "numbers of the rig file that are far off may imitate an effect, and leave nothing"),
    Rule("none", _nothing, "no stretch of any recording is above noise, fitted or held out"),
    Rule(EFFECT, _disturbance_beside, "what effects leave may come and go; the evidence for it has to be strong"),
    Rule(EFFECT, _effects, "those that are needed beside each other and that most splits support"),
    Rule(UNEXPLAINED, _friction_explains, "a law that predicts held-out data comes before a torque of any course"),
    Rule(UNEXPLAINED, _disturbance, "a torque that comes and goes explains all, alone or beside effects"),
    Rule(UNEXPLAINED, lambda case: case.along_motion, "as good as nothing else explains, where the joint sticks"),
    Rule(UNEXPLAINED, _leader, "one effect in another form than its law has no rival that imitates as much"),
    Rule(UNEXPLAINED, _unexplained, "nothing of the catalogue explains enough"),
)
"""The rules in order: the first one that holds decides."""
WITHOUT_EFFECTS = tuple(rule for rule in RULES if rule.verdict in (_nothing, _unexplained))
"""Those that are left where no effect of the catalogue is asked."""


def judge(prepared: Prepared, group: Group, ranking: Ranking, work: Work, catalogue: bool = True) -> Judged:
    """The verdict on a group: effects, a disturbance torque, nothing, or something unexplained."""
    case, rules = Case(prepared, group, ranking, work), RULES if catalogue else WITHOUT_EFFECTS
    asked = (rule.verdict(case) for rule in rules if rule.so_far is None or rule.so_far == case.so_far)
    judged = next(one for one in asked if one is not None)
    found = calibrations.found(judged.ranking, judged.model)
    notes = (*calibrations.differences(found, judged.ranking), *warnings.at_bounds(judged.model))
    left = case.left if judged.verdict == UNEXPLAINED else ()
    return replace(judged, calibrations=found, left=left, warnings=(*judged.warnings, *notes))


def _changes(case: Case) -> list[str]:
    if not onset.can_change(case.group):
        return []
    base = case.ranking.base
    parts = base.each(change_point.parts_above_noise)
    return warnings.changes({e.trial.name: part for e, part in zip(base.experiments, parts, strict=True) if part})


def _by_disturbance(
    case: Case, explained: tuple[Model, findings.ModelEffects] | None, share: float | None
) -> Judged | None:
    """The verdict by a disturbance torque, with effects beside it where there are any."""
    if explained is None:
        return None
    model, found = explained
    notes = (*case.notes, *found.contradictions)
    return Judged(case.group, case.ranking.base, case.ranking, EFFECT, share, model, found.effects, found.values, notes)


def _by_effects(case: Case, base_notes: Sequence[str]) -> Judged:
    """The verdict by the effects that are needed. Where pressures alone were measured, the innovations must agree."""
    group, ranking, base, share = case.group, case.ranking, case.ranking.base, case.ranking.share
    case.work.progress("which effects are needed")
    needed = findings.backward_elimination(base, ranking.model)
    model, found, firm, notes = _firm(base, needed, case.work)
    dropped = len(model.effects) < len(needed.effects)
    if dropped:
        share = held_share(base, model)
    nothing = Judged(group, base, ranking, case.without_effects, 0.0, base)
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
        group, base, ranking, EFFECT, share, model, effects, found.values,
        (*notes, *base_notes, *contradictions, *changes), firm,
    )  # fmt: skip


def _firm(
    base: Model, model: Model, work: Work
) -> tuple[Model, findings.ModelEffects, dict[str, splits.Firmness], list[str]]:
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
            return base, findings.ModelEffects((), {}, []), {}, notes
    effects = tuple(replace(effect, splits=firm[effect.name]) for effect in found.effects)
    return model, found._replace(effects=effects), firm, notes
