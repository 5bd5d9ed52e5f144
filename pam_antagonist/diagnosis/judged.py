"""The verdicts on the parts of a joint, before they are described."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from pam_antagonist.diagnosis.hypotheses import Ranking, TriedCandidate
from pam_antagonist.diagnosis.models import Model, all_of
from pam_antagonist.diagnosis.preparation import Group, Prepared
from pam_antagonist.diagnosis.remaining import RemainingResidual
from pam_antagonist.diagnosis.result import FoundCalibration, FoundEffect, PartVerdict
from pam_antagonist.diagnosis.splits import Firmness
from pam_antagonist.diagnosis.verdicts import EFFECT, Verdict, overall
from pam_antagonist.rig.learned import Law
from pam_antagonist.shown import Shown

if TYPE_CHECKING:
    from pam_antagonist.diagnosis.law_search import LawSearch


@dataclass(frozen=True, eq=False, repr=False)
class Judged(Shown):
    """A group of experiments with the verdict on it. Its models say how the experiments were compared at last."""

    group: Group
    base: Model
    ranking: Ranking
    verdict: Verdict
    share: float | None  # of its held-out excess that the chosen model removes; None likewise
    model: Model
    effects: tuple[FoundEffect, ...] = ()  # that were found, with the experiments' names as recordings
    values: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    # what the splits say of each effect, by its name; empty where there were no splits.
    firmness: Mapping[str, Firmness] = field(default_factory=dict)
    calibrations: tuple[FoundCalibration, ...] = ()
    left: tuple[RemainingResidual, ...] = ()  # stretches above noise, where nothing more than these is unexplained

    @property
    def as_part(self) -> PartVerdict:
        """The verdict on the part of the joint that it is."""
        return PartVerdict(self.group.name, self.verdict, self.share)

    @property
    def ranked(self) -> tuple[TriedCandidate, ...]:
        """All candidates, each with its part's name and whether it is in the final model."""
        chosen, out = self.ranking.model.effects, []
        for one in self.ranking.tried:
            selected = one.model is not None and one.model.effects == chosen[: one.round]
            taken = self.verdict == EFFECT and selected and one.effect in self.model.effects
            out.append(replace(one, taken=taken, part=self.group.name))
        return tuple(out)


@dataclass(frozen=True, eq=False, repr=False)
class JudgedJoint(Shown):
    """All parts of a joint with the verdicts on them, before they are described."""

    prepared: Prepared
    parts: tuple[Judged, ...]  # the one with the strongest effect first
    base: Model  # without effects and without learned laws, of all recordings in their order
    model: Model  # with them
    ranking: tuple[TriedCandidate, ...]
    before: JudgedJoint | None = None  # the same without the laws that were learned last; None: none was
    learned: LawSearch | None = None  # the search that found these
    by: Model | None = None  # the model by which they were taken; None: `model`
    notes: tuple[str, ...] = ()
    why: str = ""  # why it has no further law, in sentences

    @classmethod
    def of(cls, prepared: Prepared, parts: Sequence[Judged]) -> JudgedJoint:
        """The joint, with its parts in any order."""
        first = sorted(parts, key=lambda one: -max((effect.delta_bic for effect in one.effects), default=0.0))
        names = [group.name for group in prepared.groups]
        in_order = sorted(parts, key=lambda one: names.index(one.group.name))
        base, model = (all_of(getattr(one, name) for one in in_order) for name in ("base", "model"))
        return cls(prepared, tuple(first), base, model, tuple(r for one in first for r in one.ranked))

    @property
    def steps(self) -> tuple[JudgedJoint, ...]:
        """The joint without laws, with those that were learned first, and so on to this one."""
        return (*(() if self.before is None else self.before.steps), self)

    @property
    def searches(self) -> tuple[LawSearch, ...]:
        """The searches that found its learned laws, in order."""
        return tuple(one.learned for one in self.steps if one.learned is not None)

    @property
    def laws(self) -> tuple[Law, ...]:
        """Its learned laws."""
        return tuple(law for search in self.searches for law in search.laws)

    @property
    def verdict(self) -> Verdict:
        """On the whole joint; a learned law is an effect."""
        return EFFECT if self.laws else overall(one.verdict for one in self.parts)

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """Of the catalogue, in all parts, with the experiments' names as recordings."""
        return tuple(effect for one in self.parts for effect in one.effects)
