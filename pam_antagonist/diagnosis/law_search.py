"""The missing law of a model: every table at every place, by derivatives of the model.

A law is first fitted to first order, beside the base parameters, and judged on stretches of the fitted part that its
values were not fitted to. The best laws of the best places are then fitted to the recordings. They are judged so again,
and on what was held out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import law_forms, thresholds
from pam_antagonist.diagnosis.law_arguments import arguments
from pam_antagonist.diagnosis.law_evidence import acting, evidence_held_out, parts, with_it
from pam_antagonist.diagnosis.law_forms import SMOOTH, LawForm, hats, nodes_of, roughness
from pam_antagonist.diagnosis.models import Model, likelier, without
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, held_residual
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, continued
from pam_antagonist.model.effects import parameter_path
from pam_antagonist.model.effects.places import SENSORS, TABLE
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, numbers_of, with_law

Floats = NDArray[np.float64]

_FOLDS = 8
"""Stretches of the fitted part, each judged by values that were fitted to the others."""
_FINER = 8
"""So many of the best laws are tried with a finer table."""
_WITH_MEMORY = 5
"""At so many of the best places laws with memory are tried."""
_FINALISTS, _IN_REACH = 4, 0.3
"""Most places whose laws are fitted to the recordings, and their least evidence as a share of the best one's."""
_BY_ANOTHER = 2
"""At so many places a law by a second argument is fitted."""
_ROUNDS = 2
"""Solutions of a law, each weighed by what the one before leaves."""
_STEPS, _STEP_LENGTHS = 3, (1.0, 0.3, 0.1)
"""Most steps of a finalist's fit, and shares of a step that are tried."""
_ENOUGH = 1.0
"""A step is the last one that lowers −2 log posterior by less."""
_MOST_ALTERNATIVES = 3
_FIRST = ("angle", "velocity", "speed", "length", "length_rate", "time")
"""Of arguments that move together, those that are named first."""


class LikelyPlace(NamedTuple):
    """A place, and the evidence for the best law there."""

    name: str
    gain: float


@dataclass(frozen=True, eq=False)
class FittedLaw:
    """A law with its evidence."""

    group: LawForm
    law: Law
    gain: float  # on stretches that it was not fitted to, twice the log likelihood ratio
    covariance: Floats  # of its values (N, N)
    smooth: float  # precision of the table's second differences, as a share of what the data know of its values
    held_out: float = 0.0  # evidence on what was held out; 0 of a law to first order

    @property
    def evidence(self) -> float:
        """All evidence."""
        return self.gain + self.held_out

    @property
    def is_plain(self) -> bool:
        """Whether it has no memory."""
        return self.group.operator == "none"


@dataclass(frozen=True, eq=False)
class LawSearch:
    """What was found."""

    places: tuple[LikelyPlace, ...]  # the likeliest first
    found: FittedLaw | None = None  # the law; None if none is taken
    alternatives: tuple[Law, ...] = ()  # laws that do as well

    @property
    def law(self) -> Law | None:
        """The law that is taken, with the standard deviations of its values."""
        if self.found is None:
            return None
        variances = np.maximum(np.diag(self.found.covariance), 0.0)
        return replace(self.found.law, std=tuple(map(float, np.sqrt(variances))))

    def in_rig(self, rig: Rig) -> Rig:
        """A rig with the law; as it is, where none was taken or it is an error of readings."""
        if self.found is None or self.law is None or self.law.is_of_readings:
            return rig
        return with_law(rig, self.law, covariance=self.found.covariance)


@dataclass(frozen=True, eq=False)
class _Recording:
    """A recording about a model of it."""

    experiment: Experiment
    fitted: Fitted
    base: Floats  # derivatives of the residual by the base coordinates (B, C, K)
    sampled: Mapping[str, Floats]  # what a law may depend on, at each sample (N,), by name
    seen: Mapping[str, Floats]  # its means over the blocks that are fitted (B,)

    @classmethod
    def of(cls, experiment: Experiment, fitted: Fitted) -> _Recording:
        """A recording with its derivatives."""
        sampled, count = arguments(experiment, fitted.point), len(fitted.residual)
        means = _means(experiment, np.column_stack(list(sampled.values())))[:count]
        base = experiment.jacobian(fitted.point, fitted.residual)
        return cls(experiment, fitted, base, sampled, dict(zip(sampled, means.T, strict=True)))

    def weight(self, left: Floats) -> Floats:
        """Of each channel (C,): one over the variance of what is left (B, C) and the blocks of a counted value."""
        scale = self.fitted.scale
        return np.asarray(1.0 / (scale.variances(left) * scale.blocks_per_error))

    @property
    def folds(self) -> NDArray[np.int64]:
        """Number of the stretch that a block belongs to (B,)."""
        return np.arange(len(self.fitted.residual)) * _FOLDS // len(self.fitted.residual)

    def argument_of(self, group: LawForm, muscle: int) -> Floats:
        """What a law depends on at a muscle (B,), with its memory."""
        return group.argument_of(self.seen, muscle, self.experiment.trial.block_s)

    def columns(self, group: LawForm, law: Law, number: int) -> Floats:
        """Derivatives of the residual by a law's values, in units of its place, at its values (B, C, N)."""
        unit, nodes = TABLE[group.kind].step, np.array(law.nodes)
        if TABLE[group.kind].part == SENSORS:
            return self._columns_of_readings(group, nodes) * unit

        def with_values(values: Floats) -> Point:
            numbers = numbers_of(replace(law, values=tuple(values)), number).items()
            effects = {parameter_path("learned", name): value for name, value in numbers}
            return Point(self.fitted.point.theta, {**self.fitted.point.effects, **effects})

        def slopes(unit: float, rows: Floats) -> Floats:
            moved = [with_values(np.array(law.values) + unit * row) for row in rows]
            return np.stack(self.experiment.differences(self.fitted.point, self.fitted.residual, moved), axis=2)

        rows = np.eye(len(nodes))
        out = slopes(unit, rows)
        # Air flows towards the lower pressure only: a flow the other way shows nothing.
        hidden = ~out.any(axis=(0, 1))
        if hidden.any() and not hidden.all():
            out[:, :, hidden] = -slopes(-unit, rows[hidden])
        if group.rests_at_zero:
            out = out - out.sum(axis=2, keepdims=True) * hats(np.zeros(1), nodes)[:, 0]
        return np.asarray(out)

    def _columns_of_readings(self, group: LawForm, nodes: Floats) -> Floats:
        """Likewise of a law by which a sensor reads too high, per SI unit."""
        out = np.zeros((*self.fitted.residual.shape, len(nodes)))
        first = {"angle": ANGLE, "torque": TORQUE, "pressure": PRESSURE_1}[TABLE[group.kind].reads]
        for muscle in group.muscles:
            channel = first + muscle - 1
            if channel in self.experiment.channels:
                # A table is not linear: its mean over a block is not its value at a mean.
                each = hats(group.argument_of(self.sampled, muscle, self.experiment.trial.dt), nodes).T
                out[:, self.experiment.channels.index(channel)] -= _means(self.experiment, each)[: len(out)]
        return out


def _means(experiment: Experiment, columns: Floats) -> Floats:
    """Means of columns (N, C) over the blocks that may be fitted (B, C)."""
    return experiment.fitted_rows(continued(experiment.trial.blocks(columns)))


class _ModelPart:
    """A part of a model, as laws are judged: about the model without a further law."""

    def __init__(self, model: Model, number: int) -> None:
        self.model, self.number = model, number
        self.recordings = [_Recording.of(*pair) for pair in model.pairs]

    @cached_property
    def left(self) -> list[Floats]:
        """What each recording's stretches leave (B, C)."""
        nothing = [np.zeros((*one.fitted.residual.shape, 0)) for one in self.recordings]
        return _solved(self.recordings, nothing, 0.0)[2]

    def gain(self, left: Sequence[Floats]) -> float:
        """Evidence of what a law's stretches leave, of each recording (B, C)."""
        return sum(likelier(one.fitted.scale, b, a) for one, b, a in zip(self.recordings, self.left, left, strict=True))

    def span(self, group: LawForm) -> float:
        """Range of the argument of a law."""
        return float(max(np.ptp(one.argument_of(group, side)) for one in self.recordings for side in group.muscles))

    def fitted(self, group: LawForm) -> FittedLaw | None:
        """A law to first order; None if its argument does not move, or it shows nowhere."""
        seen = np.concatenate([one.argument_of(group, side) for one in self.recordings for side in group.muscles])
        nodes = np.zeros(1) if group.argument == "none" else nodes_of(seen, group.number)
        if len(nodes) == 1 and group.argument != "none":
            return None
        zero = group.law(nodes, np.zeros(len(nodes)))
        if not zero.is_of_readings and replace(zero, values=tuple(np.ones(len(nodes)))).complaint():
            return None
        columns = [one.columns(group, zero, self.number) for one in self.recordings]
        if not any(item.any() for item in columns):
            return None
        unit, found = TABLE[group.kind].step, []
        for smooth in SMOOTH if len(nodes) > 1 else SMOOTH[:1]:
            values, covariance, left = _solved(self.recordings, columns, smooth)
            if values.any():
                law = group.law(nodes, values * unit)
                found.append(FittedLaw(group, law, self.gain(left), covariance * unit**2, smooth))
        return max(found, key=lambda one: one.gain, default=None)

    def every_law(self) -> list[FittedLaw]:
        """All laws to first order, the best first; those with a memory at the best places."""
        places = self.model.experiments[0].law_places
        found = [one for group in law_forms.plain_groups(places) if (one := self.fitted(group))]
        found.sort(key=lambda one: -one.gain)
        # What rubs or engages somewhere on the way does so within a short part of it.
        finer = [one.group for k, one in enumerate(found) if k < _FINER or one.group.argument == "angle"]
        groups = [replace(group, number=law_forms.FINE) for group in finer if group.argument != "none"]
        likely = list(dict.fromkeys(one.group.place for one in found))[:_WITH_MEMORY]
        # A sensor may be late and read right at rest; its columns need no simulation.
        likely += [place for place in places if TABLE[LawForm(place).kind].part == SENSORS and place not in likely]
        groups += law_forms.groups_with_memory(likely, self.span)
        found += [one for group in groups if (one := self.fitted(group))]
        return sorted(found, key=lambda one: -one.gain)

    def refined(self, one: FittedLaw) -> FittedLaw:
        """A law fitted to the recordings, as far as that makes it likelier; it is judged about that fit."""
        if one.law.is_of_readings:
            # No rig can hold it. The diagnosis of corrected recordings will tell; till then it is taken to hold.
            held = sum(len(held_residual(*pair)) for pair in self.model.pairs)
            return replace(one, held_out=one.gain * held / sum(len(fit.residual) for fit in self.model.fits))
        now = [(law := _scaled(one.law, share), with_it(self.model, law)) for share in _STEP_LENGTHS]
        law, model = min(now, key=lambda pair: _cost(pair[1]))
        gained = math.inf
        for number in range(_STEPS + 1):
            step, covariance, left = self._step(one, law, model)
            if number == _STEPS or gained < _ENOUGH:
                break
            moved = next(
                ((there, after) for share in _STEP_LENGTHS
                 if _cost(after := with_it(self.model, there := _moved(law, share * step))) < _cost(model)), None,
            )  # fmt: skip
            if moved is None:
                break
            gained = _cost(model) - _cost(moved[1])
            law, model = moved
        held_out = evidence_held_out(self.model, model)
        return FittedLaw(one.group, law, self.gain(left), covariance, one.smooth, held_out)

    def _step(self, one: FittedLaw, law: Law, model: Model) -> tuple[Floats, Floats, list[Floats]]:
        """Step of a law's values (N,), their covariance (N, N), and what each recording's stretches leave (B, C)."""
        here = [_Recording.of(*pair) for pair in model.pairs]
        columns = [each.columns(one.group, law, self.number) for each in here]
        step, covariance, left = _solved(here, columns, one.smooth)
        unit = TABLE[one.group.kind].step
        return step * unit, covariance * unit**2, left


def _scaled(law: Law, share: float) -> Law:
    return replace(law, values=tuple(share * value for value in law.values))


def _moved(law: Law, step: Floats) -> Law:
    return replace(law, values=tuple(map(float, np.array(law.values) + step)))


def _cost(model: Model) -> float:
    return sum(fit.cost for fit in model.fits)


def search(model: Model, number: int, progress: Callable[[str], None]) -> LawSearch:
    """Look for one law that a model lacks; it gets a number in the rig.

    `model`: all parts of all recordings, with what was found so far. One that was searched last is not searched again.
    """
    asked = model.experiments, model.fits, number
    last = _LAST.get("search")
    if last is None or last[0] != asked:
        last = _LAST["search"] = asked, _searched(model, number, progress)
    return last[1]


def _searched(model: Model, number: int, progress: Callable[[str], None]) -> LawSearch:
    progress("a law that nobody wrote: every place of the model")
    own = [_ModelPart(part, number) for part in parts(model) if part.has_significant_excess]
    every = sorted(((one, part) for part in own for one in part.every_law()), key=lambda pair: -pair[0].gain)
    places: dict[str, float] = {}
    for one, _ in every:
        places.setdefault(one.group.place, one.gain)
    found = LawSearch(tuple(LikelyPlace(*item) for item in places.items()))
    least = max(thresholds.STRONG, _IN_REACH * every[0][0].gain) if every else 0.0
    standing = [pair for pair in every if pair[0].gain >= least]
    if not standing:
        return found
    progress("a law that nobody wrote: the best of them, fitted to the recordings")
    kept_near = model.experiments[0].is_kept_near
    fitted = [part.refined(one) for one, part in _finalists(standing, kept_near)]
    best = _as_good(fitted, max(fitted, key=lambda one: one.evidence), kept_near, lambda one: one.evidence)[0]
    if best.gain < thresholds.STRONG:
        return found
    near = _as_good([*fitted, *(one for one, _ in standing)], best, kept_near)
    others = {(one.law.at, one.law.argument): one.law for one in reversed(near)}
    others.pop((best.law.at, best.law.argument), None)
    alternatives = tuple(list(others.values())[::-1][:_MOST_ALTERNATIVES])
    return replace(found, found=_with_friction(best, model, number), alternatives=alternatives)


_LAST: dict[str, tuple[tuple[Any, ...], LawSearch]] = {}
"""What was found last: a rule of the verdict asks for the law that the diagnosis tries afterwards."""


def _finalists(standing: Sequence[tuple[FittedLaw, _ModelPart]], kept_near: bool) -> list[tuple[FittedLaw, _ModelPart]]:
    """Of the best places the best law each, the simplest as good one, and the best one without a memory.

    What remembers imitates much. At the very best places the best one by another argument is tried as well: angle and
    pressures of a joint move together.
    """
    out: dict[FittedLaw, _ModelPart] = {}
    for number, place in enumerate(list(dict.fromkeys(one.group.place for one, _ in standing))[:_FINALISTS]):
        own = {one: part for one, part in standing if one.group.place == place}
        best = next(iter(own))
        plain = next((one for one in own if one.is_plain), best)
        tried = [best, _as_good(list(own), best, kept_near)[0], plain]
        if number < _BY_ANOTHER:
            others = (one for one in own if one.is_plain and one.group.argument != plain.group.argument)
            tried.append(next(others, best))
        for one in tried:
            out[one] = own[one]
    return list(out.items())


def _as_good(
    tried: Sequence[FittedLaw], best: FittedLaw, kept_near: bool,
    of: Callable[[FittedLaw], float] = lambda one: one.gain,
) -> list[FittedLaw]:  # fmt: skip
    """Laws that data cannot tell from one, none of them with more of a memory, the simplest first.

    `kept_near`: whether measured inputs keep the model near; then what the motion tells best comes first. `of`: the
    evidence that is compared.
    """

    def order(one: FittedLaw) -> tuple[bool, int, float]:
        argument = one.group.argument
        rank = _FIRST.index(argument) if kept_near and argument in _FIRST else len(_FIRST)
        return not one.is_plain, rank, -of(one)

    near = [one for one in tried if abs(of(best) - of(one)) < thresholds.STRONG]
    return sorted((one for one in near if one.is_plain or not best.is_plain), key=order)


def _with_friction(best: FittedLaw, model: Model, number: int) -> FittedLaw:
    """A law of friction with the constant friction that was found: a friction below zero would be none."""
    if best.law.place != "friction" or "friction" not in model.effects:
        return best
    return _ModelPart(acting(best.law, without(model, "effects.friction.")), number).fitted(best.group) or best


def _solved(
    here: Sequence[_Recording], columns: Sequence[Floats], smooth: float
) -> tuple[Floats, Floats, list[Floats]]:
    """Step of a law's values in units (N,), their covariance (N, N), and what each recording's stretches leave (B, C).

    A stretch is left by values and base parameters that were fitted to the others.
    """
    count = columns[0].shape[2]
    ends = np.cumsum([0, *(one.base.shape[2] for one in here)])
    total = int(ends[-1]) + count
    wheres = [np.r_[begin:end, total - count : total] for begin, end in itertools.pairwise(ends)]
    each = [np.concatenate([one.base, own], axis=2) for one, own in zip(here, columns, strict=True)]
    left = [one.fitted.residual for one in here]
    for _ in range(_ROUNDS):
        gram, right = np.zeros((_FOLDS, total, total)), np.zeros((_FOLDS, total))
        prior, pulled = np.zeros((total, total)), np.zeros(total)
        for one, both, where, now in zip(here, each, wheres, left, strict=True):
            weighted = both * one.weight(now)[None, :, None]
            for fold in range(_FOLDS):
                rows = one.folds == fold
                gram[fold][np.ix_(where, where)] += np.einsum("bcn,bcm->nm", weighted[rows], both[rows])
                right[fold][where] -= np.einsum("bcn,bc->n", weighted[rows], one.fitted.residual[rows])
            own = where[: len(where) - count]
            prior[own, own] = one.experiment.prior
            pulled[own] = -one.experiment.prior * one.fitted.point.theta
        if count:
            known = float(np.trace(gram.sum(axis=0)[-count:, -count:])) / count
            prior[-count:, -count:] = smooth * known * roughness(count) + 1e-6 * max(known, 1e-30) * np.eye(count)
        matrix = gram.sum(axis=0) + prior
        step = np.linalg.solve(matrix, right.sum(axis=0) + pulled)
        left = [one.fitted.residual + both @ step[where] for one, both, where in zip(here, each, wheres, strict=True)]
    for fold in range(_FOLDS):
        other = np.linalg.solve(matrix - gram[fold], (right.sum(axis=0) - right[fold]) + pulled)
        for one, both, where, now in zip(here, each, wheres, left, strict=True):
            rows = one.folds == fold
            now[rows] = one.fitted.residual[rows] + both[rows] @ other[where]
    return step[total - count :], np.linalg.inv(matrix)[total - count :, total - count :], left
