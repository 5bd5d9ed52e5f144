"""The search for effects in many short episodes: effects must reduce the error of episodes that their fit has not seen.

It is the same for the mechanics of a joint and for its regulators.

One half of the episodes is fitted, and the other half decides. With few episodes, cross-validation is used: each part
is judged by fits to the rest. Effects are added as long as the error exceeds the noise of the readings. A new effect
has to remove a share of the squared error, by the lower end of its interval by episode, and its size has to differ
from 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.bootstrap import Interval, ratio
from pam_antagonist.inference.episodes import ROUNDS, EpisodeModel, Episodes
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.held_episodes import thinned

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Models = tuple[EpisodeModel, ...]
"""One for each fold."""

MOST = 6
"""Largest number of effects; each signal on which friction depends counts as one."""
LEAST_REMOVED = 0.05
"""Least share of the squared error of unseen episodes that an effect has to remove, as for joints with valves."""
ABOVE_NOISE = 1.5
"""An effect is added only while the squared error exceeds so many times the error that noise alone would leave, by the
lower end of the interval. Set on simulated joints of 24 episodes: six without an effect had at most 1.2, six with creep
that leaves 0.09° had at least 1.75."""
LEAST_OF_ALL = 0.01
"""Least share of the squared error without effects that an effect has to remove. A small remaining error may come from
the form of the other effects: on a simulated joint, absent creep removed 5 % of an error that was nearly 0."""
_FITTED, _SCORED = 300, 400
"""Largest number of episodes in a fit, and in its judgement: more would take longer and add little."""
_FEW, _FOLDS = 60, 4
"""With fewer episodes than this, each quarter is judged by fits to the other three: a half is too little for a fit."""
_REFITTED = 3
"""Number of candidates of a round that are fitted: those with the best scores."""


@dataclass(frozen=True)
class Tried:
    """An effect in one round of the search."""

    name: str
    round: int
    # share of the squared error of the fitted episodes that it would remove, to first order; None where all offered
    # effects are fitted.
    score: float | None
    # share of the squared error that it removed from unseen episodes, with an interval that is corrected for the number
    # of offered effects; None where the score was too low for a fit.
    removed: Interval | None = None
    taken: bool = False


class Begun(NamedTuple):
    """A candidate before it is fitted."""

    name: str
    score: float | None  # as of :class:`Tried`
    starts: tuple[EpisodeModel, ...]


@dataclass(frozen=True, eq=False)
class Folds:
    """Folds of a cross-validation: episodes that are fitted, and episodes that judge the fit."""

    fitted: tuple[Episodes, ...]
    judged: tuple[Episodes, ...]
    order: Indices  # puts the judged episodes into the order of the recording

    @classmethod
    def of(cls, joint: Episodes, pool: Indices, few: int) -> Folds:
        """Halves of many episodes, quarters of few."""
        pairs = [(thinned(pool[::2], _FITTED), thinned(pool[1::2], _SCORED))]
        if len(pool) < few:
            pairs = [(np.delete(pool, np.s_[k::_FOLDS]), pool[k::_FOLDS]) for k in range(_FOLDS)]
        order = np.argsort(np.concatenate([judged for _, judged in pairs]))
        return cls(tuple(joint.take(one) for one, _ in pairs), tuple(joint.take(one) for _, one in pairs), order)

    def fit(self, before: Models, start: EpisodeModel, rounds: int = ROUNDS) -> Models:
        """A fit of each fold with the effects of a start, from where the fold was; a start elsewhere is one for all."""
        if not np.array_equal(start.theta, before[0].theta):
            return tuple(one.fit(start, rounds) for one in self.fitted)
        return tuple(
            one.fit(EpisodeModel(model.theta, {**start.effects, **model.effects}, start.free), rounds)
            for one, model in zip(self.fitted, before, strict=True)
        )

    def best_fit(self, before: Models, starts: Sequence[EpisodeModel]) -> Models:
        """The fits from the start with the least squared error of the fitted episodes."""
        fits = [self.fit(before, start) for start in starts]
        return fits[0] if len(fits) == 1 else min(fits, key=self._left_of_fitted)

    def _left_of_fitted(self, models: Models) -> float:
        pairs = zip(self.fitted, models, strict=True)
        return float(sum(one.squares(one.residual(model)).sums.sum() for one, model in pairs))

    def in_steps_that_serve(self, models: Models) -> tuple[Folds, Models]:
        """The folds with shorter steps if the models need them, and the models fitted with these steps."""
        step = self.fitted[0].step_that_serves(models[0])
        if step == self.longest_step:
            return self, models
        fitted, judged = (tuple(replace(one, longest_step=step) for one in part) for part in (self.fitted, self.judged))
        finer = replace(self, fitted=fitted, judged=judged)
        return finer, finer.fit(models, models[0])

    @property
    def longest_step(self) -> float:
        """Longest integration step of the models [s]."""
        return self.fitted[0].longest_step

    def squares(self, models: Models) -> Floats:
        """Squared errors of the judged episodes (E,)."""
        sums = [one.squares(one.residual(model)).sums for one, model in zip(self.judged, models, strict=True)]
        return np.asarray(np.concatenate(sums)[self.order])

    def squares_of_noise(self, models: Models) -> Floats:
        """Squared errors (E,) that right models would have from the noise of the readings, in start, input and fit."""
        sums = []
        for fitted, judged, model in zip(self.fitted, self.judged, models, strict=True):
            refitted, seen = fitted.as_if(model).fit(model), judged.as_if(model)
            sums.append(seen.squares(seen.residual(refitted)).sums)
        return np.asarray(np.concatenate(sums)[self.order])


@dataclass(frozen=True, eq=False)
class Searched:
    """Result of a search for effects."""

    base: EpisodeModel
    model: EpisodeModel
    tried: tuple[Tried, ...]
    # variants of the extended model, in which another effect that may explain as much replaces a taken one; by the
    # names of the other and of the taken effect.
    replaced: Mapping[tuple[str, str], EpisodeModel]
    left: Interval  # squared error of the extended model over the error that noise alone would leave
    longest_step: float  # longest step [s] that is accurate enough for the extended model


def search(
    joint: Episodes, pool: Indices, progress: Callable[[str], None],
    begin: Callable[[Episodes, EpisodeModel, Mapping[str, Sequence[Candidate]]], list[Begun]] | None = None,
    few: int = _FEW,
) -> Searched:  # fmt: skip
    """Add effects to the base model, one in each round, as long as the error exceeds the noise.

    `begin`: chooses the candidates to fit and their start models; default: those with the best scores. `few`: with
    fewer episodes than this, each quarter is judged by fits to the rest.
    """
    begin = begin or by_score
    folds = Folds.of(joint, pool, few)
    configured = joint.as_configured
    folds, models = folds.in_steps_that_serve(folds.fit((configured,) * len(folds.fitted), configured))
    base, whole, noise = models[0], float(folds.squares(models).sum()), np.zeros(0)
    tried: list[Tried] = []
    rivals: dict[tuple[str, str], tuple[EpisodeModel, EpisodeModel]] = {}
    for number in range(1, MOST + 1):
        offered = joint.candidates(models[0].effects)
        if not offered:
            noise = folds.squares_of_noise(models)
            break
        progress(f"round {number}: {', '.join(offered)}")
        before = folds.squares(models)
        found: list[tuple[Tried, Models | None]] = []
        for name, score, starts in begin(folds.fitted[0], models[0], offered):
            refitted = folds.best_fit(models, starts) if starts else None
            removed = None
            if refitted is not None:
                removed = ratio(before - folds.squares(refitted), before, len(offered))
            found.append((Tried(name, number, score, removed), refitted))
        noise = folds.squares_of_noise(models)
        near = []
        if ratio(before, noise).low > ABOVE_NOISE:
            both = replace(joint.take(thinned(pool, _FITTED)), longest_step=folds.longest_step)
            near = _best(folds, both, found, float(before.sum()), whole)
        best = near[0][0] if near else None
        tried += [replace(item, taken=item is best) for item, _ in found]
        if best is None:
            break
        rivals |= {(item.name, best.name): (near[0][1][0], other[0]) for item, other in near[1:]}
        folds, models = folds.in_steps_that_serve(near[0][1])

    also = [item.name for item in tried if item.taken]
    replaced = {
        names: _exchanged(models[0], taken, other) for names, (taken, other) in rivals.items() if names[0] not in also
    }
    left = ratio(folds.squares(models), noise)
    return Searched(base, models[0], tuple(tried), replaced, left, folds.longest_step)


def _exchanged(model: EpisodeModel, taken: EpisodeModel, other: EpisodeModel) -> EpisodeModel:
    """The model with the effect of ``taken`` replaced by that of ``other``, a rival of the same round."""
    out = model.without([path for path in taken.effects if path not in other.effects])
    free = [item for item in other.free if item not in out.free]
    return EpisodeModel(out.theta, {**other.effects, **out.effects}, (*out.free, *free))


def _best(
    folds: Folds,
    both: Episodes,
    found: Sequence[tuple[Tried, Models | None]],
    left: float,
    whole: float,
) -> list[tuple[Tried, Models]]:
    """Effects that pass the thresholds and may remove as much as the best one, those with fewest parameters first."""
    worth = [
        (item, refitted, folds.squares(refitted))
        for item, refitted in found
        if item.removed is not None and refitted is not None
        and item.removed.low > 0.0 and item.removed.value >= LEAST_REMOVED
        and item.removed.value * left >= LEAST_OF_ALL * whole
        and _has_a_size(both, refitted[0])
    ]  # fmt: skip
    if not worth:
        return []
    first = min(worth, key=lambda entry: entry[2].sum())
    near = [entry for entry in worth if entry is first or ratio(entry[2], first[2], len(found)).low <= 1.0]
    near.sort(key=lambda entry: (len(entry[1][0].free), entry[2].sum()))
    return [(item, refitted) for item, refitted, _ in near]


def _has_a_size(joint: Episodes, model: EpisodeModel) -> bool:
    """Whether the size of the last added effect differs from 0, by its interval by episode.

    An effect with several sizes always passes, because single sizes that can replace each other, such as both parts of
    a friction, are not determined.
    """
    effect = model.free[-1].paths[0].rsplit(".", 1)[0]
    sizes = [item.paths[0] for item in model.free if item.item.is_size and item.paths[0].startswith(f"{effect}.")]
    if len(sizes) != 1:
        return True
    size = joint.intervals(joint.fit(model))[sizes[0]]
    return size.low > 0.0 or size.high < 0.0


def with_effect(
    model: EpisodeModel,
    forms: Sequence[Candidate],
    shape: Mapping[str, float],
    sizes: Mapping[str, float] | None = None,
) -> EpisodeModel | None:
    """A model with the simplest form of a candidate at the scale of its sizes, or at given sizes.

    `forms`: of the candidate, the simplest first; without forms the result is None. `shape`: values of its shapes, by
    dotted path; others are neutral.
    """
    if not forms:
        return None
    candidate = forms[0]
    values = dict(candidate.constants)
    values |= {path: (sizes or {}).get(free.path, free.item.scale) for free in candidate.sizes for path in free.paths}
    values |= {path: shape.get(free.path, free.item.neutral) for free in candidate.shapes for path in free.paths}
    return EpisodeModel(model.theta, {**model.effects, **values}, (*model.free, *candidate.free))


def by_score(joint: Episodes, model: EpisodeModel, offered: Mapping[str, Sequence[Candidate]]) -> list[Begun]:
    """Candidates by the share of the squared error that each would remove to first order, the largest first."""
    here = joint.residual(model)
    left = here.ravel()
    basis = np.linalg.qr(joint.slopes(model, here))[0]
    rest = left - basis @ (basis.T @ left)
    total = float(left @ left)
    out = []
    for name, forms in offered.items():
        best, start = 0.0, None
        for candidate in forms:
            for shape in candidate.grid():
                columns = []
                for size in candidate.sizes:
                    only = {other.path: size.item.scale * (other == size) for other in candidate.sizes}
                    point = with_effect(model, (candidate,), shape, only)
                    assert point is not None
                    column = joint.residual(point).ravel() - left
                    columns.append(column - basis @ (basis.T @ column))
                matrix = np.column_stack(columns)
                step = np.linalg.lstsq(matrix, -rest, rcond=None)[0]
                gain = float(rest @ rest - np.sum((rest + matrix @ step) ** 2)) / total
                if gain > best * 1.05:
                    # The first order overestimates the gain of a large size.
                    sizes = {
                        size.path: size.bounded(size.item.scale * float(np.clip(part, -3.0, 3.0)))
                        for size, part in zip(candidate.sizes, step, strict=True)
                    }
                    best, start = gain, with_effect(model, (candidate,), shape, sizes)
        out.append(Begun(name, best, () if start is None else (start,)))
    out.sort(key=lambda begun: -(begun.score or 0.0))
    return [begun._replace(starts=begun.starts if place < _REFITTED else ()) for place, begun in enumerate(out)]
