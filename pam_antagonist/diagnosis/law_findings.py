"""What is said of learned laws: each as an effect beside the others, with the catalogue's effects that name it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.hypotheses import TriedCandidate
from pam_antagonist.diagnosis.judged import Judged, JudgedJoint
from pam_antagonist.diagnosis.law_evidence import all_acting, with_it
from pam_antagonist.diagnosis.law_search import LawSearch
from pam_antagonist.diagnosis.models import Model, held_share, likelier, price, share_of_all
from pam_antagonist.diagnosis.result import FoundEffect, PartVerdict, Size
from pam_antagonist.diagnosis.verdicts import EFFECT
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.model.effects.places import TABLE
from pam_antagonist.rig.learned import Law


@dataclass(frozen=True, eq=False)
class LawFindings:
    """The learned laws of a joint, and what the catalogue says of them; empty where it has none."""

    effects: tuple[FoundEffect, ...]  # the laws
    named: tuple[FoundEffect, ...]  # that were found before a law, act where it does, and name it
    wrong: tuple[str, ...]  # names of effects that explained most without laws, where none of them names one
    parts: tuple[PartVerdict, ...]  # on all parts of the joint
    share: float | None  # the smallest share of a held-out excess that laws explain in a part; None without laws
    warnings: tuple[str, ...]  # where the laws leave more than imperfect tables do
    ranking: tuple[TriedCandidate, ...]  # of all steps; taken is what the report has

    @classmethod
    def of(cls, joint: JudgedJoint, found: Sequence[Sequence[FoundEffect]]) -> LawFindings:
        """What is said of a joint. `found`: effects of the catalogue in each of its steps."""
        first, *_ = joint.steps
        names = [trial.name for trial in joint.prepared.trials[: joint.prepared.fitted]]
        base, model = first.base, joint.by or joint.model
        laws = law_effects(base, model, joint.searches, names, first.ranking)
        shares, in_part, effects = {}, False, []
        for one, law in zip(laws, joint.laws, strict=True):
            both = all_acting(law, base, model)
            in_part = in_part or share_of_all(*both) < thresholds.EXPLAINED_WELL
            shown = {experiment.trial.name for experiment in both[1].experiments}
            here = [part.group.name for part in joint.parts if _is_of(part, shown) or len(joint.parts) == 1]
            shares.update(dict.fromkeys(here, held_share(*both)))
            effects.append(replace(one, part=next(iter(here), "")))
        beside = {one.name for one in found[-1]}
        earlier = {one.name: one for step in found[:-1] for one in step if one.name not in beside}
        # One law has one name: a second effect there only imitates what its form leaves.
        named = {one.name: one for effect in effects for one in _namers(effect, earlier.values())[:1]}
        who = "both laws explain" if len(laws) > 1 else "the law explains"
        return cls(
            tuple(effects),
            tuple(named.values()),
            () if named or not laws else tuple(one.name for one in found[0]),
            tuple(
                replace(part, verdict=EFFECT, share_explained=shares[part.name]) if part.name in shares else part
                for part in (one.as_part for one in joint.parts)
            ),
            min(shares.values(), default=None),
            (f"{who} the recordings in part only",) if in_part else (),
            tuple(
                item if step is joint else replace(item, taken=item.taken and item.effect in named)
                for step in joint.steps for item in step.ranking
            ),
        )  # fmt: skip


def _is_of(part: Judged, shown: set[str]) -> bool:
    return any(experiment.trial.name in shown for experiment in part.group.experiments)


def _namers(law: FoundEffect, others: Iterable[FoundEffect]) -> list[FoundEffect]:
    """Effects that may name a law, the best first: they act where it does, at its muscle."""
    like_it = (one for one in others if one.name in law.like and one.muscle in (None, law.muscle))
    return sorted(like_it, key=lambda one: -one.delta_bic)


def law_effects(
    base: Model, model: Model, searches: Sequence[LawSearch], names: Sequence[str], ranking: Sequence[TriedCandidate]
) -> list[FoundEffect]:
    """Learned laws as effects of a diagnosis, each beside the others; its numbers have their price in the evidence.

    `base`, `model`: without effects, and with the laws. `searches`: that found them. `names`: of the recordings that
    are fitted. `ranking`: all candidates without the laws.
    """
    out, found = [], [(law, search) for search in searches for law in search.laws]
    for law, search in found:
        others = [other for other, _ in found if other is not law]
        before, after = all_acting(law, with_it(base, *others) if others else base, model)
        pairs = list(zip(before.fits, after.fits, strict=True))
        gain = sum(likelier(old.scale, old.residual, new.residual) for old, new in pairs)
        gain -= price(pairs[0][0], len(law.values) + int(law.operator != "none"))
        sizes = {
            ("everywhere" if len(law.nodes) == 1 else f"at {law.shown(node, 4)}"): Size(value, std, law.unit)
            for node, value, std in zip(law.nodes, law.values, law.std, strict=True)
        }
        out.append(FoundEffect(
            "learned", law.muscle if isinstance(law.muscle, int) else None, sizes, gain, held_share(before, after),
            tuple(names), law=law, like=like(law, ranking),
            alternatives=tuple(other.in_words() for other in search.alternatives),
        ))  # fmt: skip
    return out


def like(law: Law, ranking: Sequence[TriedCandidate]) -> tuple[str, ...]:
    """Effects of the catalogue that act where a law does and explain something of the recordings, the best first."""
    scores = {
        item.effect: item.muscles[law.muscle - 1] if item.muscles and isinstance(law.muscle, int) else item.score
        for item in ranking if item.round == 1 and item.effect in CATALOGUE
    }  # fmt: skip
    acts = [name for name in scores if set(TABLE[law.place].alike) & set(CATALOGUE[name].hooks)]
    return tuple(sorted((n for n in acts if scores[n] >= thresholds.LEAST_SCORE), key=lambda name: -scores[name]))
