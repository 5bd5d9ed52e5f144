"""The missing law of a model that measured inputs drive: every table at every place, by derivatives of the model.

Such models are those of a sealed joint, and of one that sticks. They do not drift away, so what they leave is
nearly linear in the values of a table, and no residual equations are needed. A law is judged on stretches of the fitted
part that its values were not fitted to.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import law_regression, thresholds
from pam_antagonist.diagnosis.law_regression import FOLDS, SMOOTH, LawForm, LikelyPlace, hats, nodes_of, roughness
from pam_antagonist.diagnosis.law_search import LawSearch
from pam_antagonist.diagnosis.law_simulation import Simulated
from pam_antagonist.diagnosis.models import Model, further_share, likelier, share_of_all, without
from pam_antagonist.diagnosis.residual_equations import measured_arguments
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, held_residual, refit
from pam_antagonist.inference.point import Point
from pam_antagonist.model.effects import parameter_path
from pam_antagonist.model.effects.places import TABLE
from pam_antagonist.rig.learned import Law, numbers_of, with_law

Floats = NDArray[np.float64]

_FINER = 4
"""So many of the best laws are tried with a finer table."""
_WITH_MEMORY = 3
"""At so many of the best places laws with memory are tried."""
_ROUNDS = 2
"""Solutions of a law, each weighed by what the one before leaves."""
_MOST_ALTERNATIVES = 3
_FIRST = ("angle", "velocity", "speed", "length", "length_rate", "time")
"""Of arguments that move together, those that are named first."""


@dataclass(frozen=True, eq=False)
class _Recording:
    """A part of a joint in a recording, about the model as it is."""

    experiment: Experiment
    fitted: Fitted
    base: Floats  # derivatives of the residual by the base coordinates (B, C, K)
    course: Mapping[str, Floats]  # what a law may depend on, block means of the fitted part (B,), by name

    def weight(self, left: Floats) -> Floats:
        """Of each channel (C,): one over the variance of what is left (B, C) and the blocks of a counted value."""
        scale = self.fitted.scale
        return np.asarray(1.0 / (scale.variances(left) * scale.blocks_per_error))

    @property
    def folds(self) -> NDArray[np.int64]:
        """Number of the stretch that a block belongs to (B,)."""
        return np.arange(len(self.fitted.residual)) * FOLDS // len(self.fitted.residual)

    def argument_of(self, group: LawForm, muscle: int) -> Floats:
        """What a law depends on at a muscle (B,), with its memory."""
        number = 3 - muscle if group.argument == "other_pressure" else muscle
        name = group.argument.replace("other_", "")
        values = self.course.get(f"{name}_{number}", self.course.get(name, np.zeros(len(self.folds))))
        first = np.arange(len(values)) == 0
        return law_regression.operated(values, group.operator, group.amount, self.experiment.trial.block_s, first)


@dataclass(frozen=True, eq=False)
class _Tried:
    """A law, linear about the model as it is."""

    group: LawForm
    law: Law
    gain: float  # evidence on stretches that it was not fitted to, twice the log likelihood ratio
    covariance: Floats  # of its values (N, N)


def search(model: Model, number: int, progress: Callable[[str], None]) -> LawSearch:
    """Look for one law that a model lacks; it gets a number in the rig.

    `model`: all parts of all recordings, with what was found so far.
    """
    progress("a law that nobody wrote: every place of the model")
    tried: list[_Tried] = []
    for own in parts(model):
        if own.has_significant_excess:
            tried += _tried(_prepared(own), number)
    tried.sort(key=lambda one: -one.gain)
    places: dict[str, float] = {}
    for one in tried:
        places.setdefault(one.group.place, one.gain)
    found = LawSearch(
        tuple(LikelyPlace(*item) for item in places.items()), _simulated(None, np.zeros((0, 0))), None, (),
        tried[0].gain if tried else 0.0, 0.0, thresholds.STRONG,
    )  # fmt: skip
    if not tried or tried[0].gain < thresholds.STRONG:
        return found
    # What remembers imitates much: the best law without memory is tried on held-out data as well.
    plain = next((one for one in tried if _is_plain(one)), tried[0])
    leading = [_as_good(tried, one)[0] for one in (tried[0], plain) if one.gain >= thresholds.STRONG]
    best = max(dict.fromkeys(leading), key=lambda one: one.gain + _held_out_evidence(model, one.law))
    others = {(one.law.at, one.law.argument): one for one in reversed(_as_good(tried, best))}
    others.pop((best.law.at, best.law.argument), None)
    simplest = list(others.values())[::-1][:_MOST_ALTERNATIVES]
    best = _with_friction(best, model, number)
    alternatives = tuple(_simulated(one.law, one.covariance) for one in simplest)
    return replace(found, found=_simulated(best.law, best.covariance), alternatives=alternatives)


def _is_plain(one: _Tried) -> bool:
    return one.group.operator == "none"


def _as_good(tried: Sequence[_Tried], best: _Tried) -> list[_Tried]:
    """Laws that data cannot tell from one, none of them with more of a memory, the simplest first."""
    near = [one for one in tried if abs(best.gain - one.gain) < thresholds.STRONG]
    return sorted((one for one in near if _is_plain(one) or not _is_plain(best)), key=_simplicity)


def _held_out_evidence(model: Model, law: Law) -> float:
    """Twice the log likelihood ratio of a law where nothing was fitted."""
    before = acting(law, model)
    return evidence_held_out(before, with_it(before, law))


def with_it(model: Model, law: Law, covariance: Floats | None = None) -> Model:
    """A model with a law, everything else fitted anew."""
    # A sealed joint is diagnosed about what was identified of it, and not about the rig as configured.
    own = tuple(one.of_rig(with_law(one.rig, law, covariance=covariance)) for one in model.experiments)
    return replace(model, experiments=own).map(lambda experiment, fitted: refit(experiment, fitted.point, fitted.free))


def evidence_held_out(before: Model, after: Model) -> float:
    """Twice the log likelihood ratio of two models of the same recordings where nothing was fitted."""
    pairs = zip(before.pairs, after.pairs, strict=True)
    return sum(likelier(old.scale, held_residual(a, old), held_residual(b, new)) for (a, old), (b, new) in pairs)


def _with_friction(best: _Tried, model: Model, number: int) -> _Tried:
    """A law of friction with the constant friction that was found: a friction below zero would be none."""
    if best.law.place != "friction" or "friction" not in model.effects:
        return best
    here = _prepared(acting(best.law, without(model, "effects.friction.")))
    return _fitted(here, best.group, number, _without(here)) or best


def _simplicity(one: _Tried) -> tuple[bool, int, int, float]:
    """Order of laws that data cannot tell apart: without memory, with a short table, by what is seen of the motion."""
    group = one.group
    rank = _FIRST.index(group.argument) if group.argument in _FIRST else len(_FIRST)
    return group.operator != "none", group.number, rank, -one.gain


def _simulated(law: Law | None, covariance: Floats) -> Simulated:
    return Simulated(law, np.zeros((0, 4)), 0.0, (), covariance)


def parts(model: Model) -> list[Model]:
    """The parts of a model that is driven by measured inputs, as laws are judged; none of another model."""
    out = []
    for places in dict.fromkeys(one.law_places for one in model.experiments if one.law_places):
        pairs = [_for_laws(e, f) for e, f in model.pairs if e.law_places == places]
        out.append(Model(tuple(one for one, _ in pairs), tuple(fit for _, fit in pairs), model.effects))
    return out


def is_better(base: Model, before: Model, after: Model, law: Law) -> bool:
    """Whether a model with a law does better where nothing was fitted, by the rules of a further effect.

    `base`: without effects. `before`: with what was found without the law.
    """
    base, before, after = all_acting(law, base, before, after)
    if after.experiments[0].law_places:
        # What drives such a model keeps it near, and most of the excess of a sealed joint is its Coulomb friction.
        removes_enough = share_of_all(before, after) >= thresholds.EXPLAINED
    else:
        removes_enough = further_share(base, before, after) >= thresholds.FURTHER_SHARE
    takes_enough = largest_share_of_a_channel(before, after) >= thresholds.SHARE_OF_CHANNEL
    return evidence_held_out(before, after) >= thresholds.STRONG and removes_enough and takes_enough


def largest_share_of_a_channel(before: Model, after: Model) -> float:
    """Share of the error over noise that is gone on held-out data, in the channel where that is most."""
    left = [_errors_over_noise(model) for model in (before, after)]
    return max((1.0 - left[1][name] / value for name, value in left[0].items() if value > 0.0), default=0.0)


def _errors_over_noise(model: Model) -> dict[str, float]:
    """Root mean square of what a model leaves of held-out data, less the noise, by channel and in its noise."""
    found: dict[str, list[Floats]] = {}
    for experiment, fitted in model.pairs:
        parts = held_residual(experiment, fitted) / experiment.noise
        for channel, values in zip(experiment.titles, parts.T, strict=True):
            found.setdefault(channel.title, []).append(values)
    squares = {name: np.concatenate(parts) ** 2 for name, parts in found.items()}
    return {name: max(float(np.mean(each)) - 1.0, 0.0) ** 0.5 for name, each in squares.items() if len(each)}


def acting(law: Law, model: Model) -> Model:
    """The part in which a law acts, as laws are judged; all of a model that runs by itself."""
    here = [one for one in parts(model) if any(LawForm(at).kind == law.place for at in one.experiments[0].law_places)]
    return here[0] if here else model


def all_acting(law: Law, *models: Model) -> list[Model]:
    """Likewise of several models; all of each where they do not judge the same recordings alike."""
    alike = len({tuple(one.law_places for one in model.experiments) for model in models}) == 1
    return [acting(law, model) for model in models] if alike else list(models)


def _for_laws(experiment: Experiment, fitted: Fitted) -> tuple[Experiment, Fitted]:
    clear = experiment.for_laws
    return clear, fitted if clear is experiment else refit(clear, fitted.point, fitted.free)


def _prepared(model: Model) -> list[_Recording]:
    return [_about(experiment, fitted) for experiment, fitted in model.pairs]


def _about(experiment: Experiment, fitted: Fitted) -> _Recording:
    residual = fitted.residual
    shown = experiment.signals(fitted.point)
    pressure = np.column_stack([shown["pressure 1"], shown["pressure 2"]])
    course = measured_arguments(pressure, shown["angle"], shown["velocity"], experiment.parameters(fitted.point))
    course["time"] = np.asarray(np.arange(0.5, len(residual)) * experiment.trial.block_s, dtype=np.float64)
    rows = {name: experiment.fitted_rows(values)[: len(residual)] for name, values in course.items()}
    return _Recording(experiment, fitted, experiment.jacobian(fitted.point, residual), rows)


def _tried(here: Sequence[_Recording], number: int) -> list[_Tried]:
    """All laws of a part, those with memory at its best places."""
    before = _without(here)
    plain = law_regression.plain_groups(here[0].experiment.law_places)
    found = [one for group in plain if (one := _fitted(here, group, number, before))]
    found.sort(key=lambda one: -one.gain)
    # What rubs or engages somewhere on the way does so within a short part of it.
    finer = [one for k, one in enumerate(found) if k < _FINER or one.group.argument == "angle"]
    groups = [replace(one.group, number=law_regression.FINE) for one in finer if one.group.argument != "none"]
    places = list(dict.fromkeys(one.group.place for one in found))[:_WITH_MEMORY]

    def span(group: LawForm) -> float:
        return float(max(np.ptp(one.argument_of(group, muscle)) for one in here for _, muscle in group.sides))

    groups += law_regression.groups_with_memory(places, span)
    return found + [one for group in groups if (one := _fitted(here, group, number, before))]


def _without(here: Sequence[_Recording]) -> list[Floats]:
    return _solved(here, [np.zeros((*one.fitted.residual.shape, 0)) for one in here])[2]


def _fitted(here: Sequence[_Recording], group: LawForm, number: int, before: Sequence[Floats]) -> _Tried | None:
    """A law's values, base parameters fitted beside them; None if its argument does not move or it shows nowhere.

    `before`: what each recording's stretches leave without a law (B, C).
    """
    seen = np.concatenate([one.argument_of(group, muscle) for one in here for _, muscle in group.sides])
    nodes = np.zeros(1) if group.argument == "none" else nodes_of(seen, group.number)
    if len(nodes) == 1 and group.argument != "none":
        return None
    zero = group.law(nodes, np.zeros(len(nodes)))
    if replace(zero, values=tuple(np.ones(len(nodes)))).complaint():
        return None
    unit = TABLE[group.kind].step
    columns = [_columns(one, group, zero, unit, number) for one in here]
    if not any(item.any() for item in columns):
        return None
    values, covariance, after = _solved(here, columns)
    gain = sum(likelier(one.fitted.scale, b, a) for one, b, a in zip(here, before, after, strict=True))
    if not values.any():
        return None
    law = group.law(nodes, values * unit)
    return _Tried(group, law, gain, covariance * unit**2)


def _columns(one: _Recording, group: LawForm, zero: Law, unit: float, number: int) -> Floats:
    """Derivatives of the residual by a law's values, in units (B, C, N)."""
    count = len(zero.nodes)

    def with_values(values: Floats) -> Point:
        numbers = numbers_of(replace(zero, values=tuple(values)), number).items()
        effects = {parameter_path("learned", name): value for name, value in numbers}
        return Point(one.fitted.point.theta, {**one.fitted.point.effects, **effects})

    residual = one.fitted.residual
    moved = [with_values(unit * row) for row in np.eye(count)]
    out = np.stack(one.experiment.differences(one.fitted.point, residual, moved), axis=2)
    if group.rests_at_zero:
        at_rest = hats(np.zeros(1), np.array(zero.nodes))[:, 0]
        out = out - out.sum(axis=2, keepdims=True) * at_rest
    return np.asarray(out)


def _solved(here: Sequence[_Recording], columns: Sequence[Floats]) -> tuple[Floats, Floats, list[Floats]]:
    """Values of a law in units (N,), their covariance (N, N), and what each recording's stretches leave (B, C).

    A stretch is left by values and base parameters that were fitted to the others.
    """
    count = columns[0].shape[2]
    ends = np.cumsum([0, *(one.base.shape[2] for one in here)])
    total = int(ends[-1]) + count
    wheres = [np.r_[begin:end, total - count : total] for begin, end in itertools.pairwise(ends)]
    each = [np.concatenate([one.base, own], axis=2) for one, own in zip(here, columns, strict=True)]
    left = [one.fitted.residual for one in here]
    for _ in range(_ROUNDS):
        gram, right = np.zeros((FOLDS, total, total)), np.zeros((FOLDS, total))
        prior, pulled = np.zeros((total, total)), np.zeros(total)
        for one, both, where, now in zip(here, each, wheres, left, strict=True):
            weighted = both * one.weight(now)[None, :, None]
            for fold in range(FOLDS):
                rows = one.folds == fold
                gram[fold][np.ix_(where, where)] += np.einsum("bcn,bcm->nm", weighted[rows], both[rows])
                right[fold][where] -= np.einsum("bcn,bc->n", weighted[rows], one.fitted.residual[rows])
            own = where[: len(where) - count]
            prior[own, own] = one.experiment.prior
            pulled[own] = -one.experiment.prior * one.fitted.point.theta
        if count:
            known = float(np.trace(gram.sum(axis=0)[-count:, -count:])) / count
            prior[-count:, -count:] = SMOOTH * known * roughness(count) + 1e-6 * max(known, 1e-30) * np.eye(count)
        matrix = gram.sum(axis=0) + prior
        step = np.linalg.solve(matrix, right.sum(axis=0) + pulled)
        left = [one.fitted.residual + both @ step[where] for one, both, where in zip(here, each, wheres, strict=True)]
    for fold in range(FOLDS):
        other = np.linalg.solve(matrix - gram[fold], (right.sum(axis=0) - right[fold]) + pulled)
        for one, both, where, now in zip(here, each, wheres, left, strict=True):
            rows = one.folds == fold
            now[rows] = one.fitted.residual[rows] + both[rows] @ other[where]
    return step[total - count :], np.linalg.inv(matrix)[total - count :, total - count :], left
