"""The search for learned laws in episodes: scored to first order on episodes that decide, then simulated.

One simulation gives the first order of all tables (:mod:`~pam_antagonist.inference.law_responses`). With it each law is
fitted beside all numbers of the model to the fitted episodes, and scored on the others. The best ones of a round are
fitted by simulation, and only what that removes counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.bootstrap import Interval, ratio
from pam_antagonist.inference.episodes import EpisodeModel, Episodes
from pam_antagonist.inference.held_episodes import thinned
from pam_antagonist.inference.law_candidates import LawCandidate
from pam_antagonist.model.effects.learned import LAWS

if TYPE_CHECKING:
    from pam_antagonist.inference.episode_search import Folds, Models

Floats = NDArray[np.float64]

LEAST_OF_LAW, _LEAST_OF_ALL = 0.01, 0.002
"""Least shares of the squared error of unseen episodes that a law has to remove: of what the others leave, and of the
error without any effect. Each is a fifth of what an effect of the catalogue has to remove, since a law is one of many
that are tested together."""
_AS_GOOD = 0.9
"""A law without a memory is taken where it removes so large a share of what the best one removes."""
_AT_ONCE = 3
"""Most laws that one round adds before a fit."""
_SCORED = 150
"""Most episodes of a fold's part by which laws are scored."""
_KEPT = 80
"""Laws that are scored again beside those that the round added: the best ones of its first scores."""
_ROUNDS = 4
"""Simulations with derivatives of a round's fit."""
_RIDGE = 1e-3
"""Added to the products of each column with itself, as a share: what episodes hardly determine stays small."""
_LARGEST = 3.0
"""Bound of a law's first values, in their scale: the first order overestimates large ones."""


@dataclass(frozen=True)
class Learned:
    """A law that a round scored."""

    candidate: LawCandidate
    round: int
    score: float  # share of the squared error that it would remove from unseen episodes, to first order
    removed: Interval | None = None  # that all laws of the round removed together, by simulation
    taken: bool = False


class _Linear:
    """Episodes to first order: columns of all numbers of a model and, last, the residual, with their products."""

    def __init__(self, joint: Episodes, model: EpisodeModel) -> None:
        self.joint, self.model = joint, model
        left = joint.residual(model)
        self._columns = np.column_stack([joint.slopes(model, left), left.ravel()])
        self.products = self._columns.T @ self._columns

    def beside(self, law: Floats) -> Floats:
        """The products with a law's columns (N, V) before the others."""
        cross = law.T @ self._columns
        return np.block([[law.T @ law, cross], [cross.T, self.products]])

    def add(self, law: Floats) -> None:
        """Put a law's columns before the others."""
        self.products = self.beside(law)
        self._columns = np.column_stack([law, self._columns])


def _solved(products: Floats) -> Floats:
    """The step with the least squared error, and 1 for the residual."""
    gram = products[:-1, :-1]
    gram = gram + _RIDGE * np.diag(np.diag(gram)) + 1e-12 * np.eye(len(gram))
    return np.append(-np.linalg.solve(gram, products[:-1, -1]), 1.0)


def _left(pairs: Sequence[tuple[Floats, Floats]]) -> float:
    """Squared error of judged episodes after steps that were fitted to others; products of both, by fold."""
    steps = [(_solved(fitted), judged) for fitted, judged in pairs]
    return float(sum(step @ judged @ step for step, judged in steps))


def _proposed(folds: Folds, models: Models, number: int, least: float) -> tuple[EpisodeModel, list[Learned]] | None:
    """A model with the laws that would remove most, at their first values, and all that were scored well.

    `least`: share of the squared error that each has to remove.
    """
    offered = folds.fitted[0].laws(models[0])

    def some(joint: Episodes) -> Episodes:
        return joint.take(thinned(np.arange(len(joint)), _SCORED))

    pairs = [
        (_Linear(some(fitted), model), _Linear(some(judged), model))
        for fitted, judged, model in zip(folds.fitted, folds.judged, models, strict=True)
    ]
    before = _left([(one.products, other.products) for one, other in pairs])
    streams = [part.joint.law_slopes(part.model, offered) for pair in pairs for part in pair]
    kept: list[tuple[float, LawCandidate, list[tuple[Floats, Floats]]]] = []
    for candidate, *columns in zip(offered, *streams, strict=True):
        own = list(zip(columns[::2], columns[1::2], strict=True))
        kept.append((_beside(pairs, own), candidate, own))
        kept = sorted(kept, key=lambda item: item[0])[:_KEPT]
    scored = [Learned(candidate, number, 1.0 - left / before) for left, candidate, _ in kept[:_AT_ONCE]]
    picked: list[LawCandidate] = []
    while kept and len(picked) < min(_AT_ONCE, LAWS + 1 - offered[0].number):
        kept = sorted(((_beside(pairs, own), candidate, own) for _, candidate, own in kept), key=lambda item: item[0])
        enough = before - _AS_GOOD * (before - kept[0][0])
        plain = [item for item in kept if item[0] <= enough and item[1].law.operator == "none"]
        left, candidate, own = (plain or kept)[0]
        if left > (1.0 - least) * before:
            break
        picked.append(replace(candidate, number=candidate.number + len(picked)))
        scored = [item for item in scored if item.candidate != candidate]
        scored.append(Learned(picked[-1], number, 1.0 - left / before, taken=True))
        for pair, both in zip(pairs, own, strict=True):
            for part, law in zip(pair, both, strict=True):
                part.add(law)
        before = left
        kept = [item for item in kept if item[1] is not candidate]
    if not picked:
        return None
    step = np.clip(_solved(pairs[0][0].products), -_LARGEST, _LARGEST)
    model, at = models[0], 0
    for candidate in reversed(picked):
        effects = {**candidate.constants}
        for k, item in enumerate(candidate.free):
            effects[item.path] = item.value(float(step[at + k]))
        at += len(candidate.free)
        model = EpisodeModel(model.theta, {**model.effects, **effects}, (*model.free, *candidate.free))
    return model, scored


def _beside(pairs: Sequence[tuple[_Linear, _Linear]], own: Sequence[tuple[Floats, Floats]]) -> float:
    """Squared error of judged episodes with a law, whose columns are those of fitted and judged episodes by fold."""
    return _left([
        (one.beside(law), other.beside(same)) for (one, other), (law, same) in zip(pairs, own, strict=True)
    ])  # fmt: skip


def learn(
    folds: Folds, models: Models, begin: int, whole: float, worth: Callable[[Floats, Floats, int], bool],
    above_noise: Callable[[Floats], bool], progress: Callable[[str], None],
) -> tuple[Folds, Models, list[Learned]]:  # fmt: skip
    """Add learned laws, some in each round, as long as they remove a little from episodes that the fit has not seen.

    A single law of many is rarely significant by itself. So one test judges them all, corrected for all that were
    offered, and without it none is taken.

    Args:
        folds: episodes that are fitted, and that judge.
        models: of each fold, without laws.
        begin: number of the first round.
        whole: squared error of the episodes that judge, without any effect.
        worth: whether the squared errors by episode, before and after, make all laws worth it; of so many offered.
        above_noise: whether such squared errors are more than noise leaves.
    """
    start, tried = folds.squares(models), list[Learned]()
    now, learned, offered = folds, models, 0
    while above_noise(now.squares(learned)) and (count := len(now.fitted[0].laws(learned[0]))):
        before = now.squares(learned)
        least = max(LEAST_OF_LAW, _LEAST_OF_ALL * whole / float(before.sum()))
        if least >= 1.0:
            break
        number = begin + len({item.round for item in tried})
        offered += count
        progress(f"round {number}: tables of what strength, friction, damping and torque may depend on")
        found = _proposed(now, learned, number, least)
        if found is None:
            break
        after = now.fit(learned, found[0], _ROUNDS)
        removed = ratio(before - now.squares(after), before)
        taken = removed.value >= least
        tried += [replace(item, removed=removed, taken=taken) if item.taken else item for item in found[1]]
        if not taken:
            break
        now, learned = now.in_steps_that_serve(after)
    if learned is models or worth(start, now.squares(learned), offered):
        return now, learned, tried
    return folds, models, [replace(item, taken=False) for item in tried]
