"""Laws about a model, to first order: the derivatives of its residual by their tables, and the tables that fit best."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.law_arguments import arguments
from pam_antagonist.diagnosis.law_forms import LawForm, hats, roughness
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, continued
from pam_antagonist.model.effects import parameter_path
from pam_antagonist.model.effects.places import SENSORS, TABLE
from pam_antagonist.rig.learned import Law, numbers_of

Floats = NDArray[np.float64]
Columns = NDArray[np.float32] | NDArray[np.float64]

_FOLDS = 8
"""Stretches of the fitted part, each judged by values that were fitted to the others."""
_ROUNDS = 2
"""Solutions of laws, each weighed by what the one before leaves."""


@dataclass(frozen=True, eq=False)
class FittedRecording:
    """A recording about a model of it."""

    experiment: Experiment
    fitted: Fitted
    base: Floats  # derivatives of the residual by the base coordinates (B, C, K)
    sampled: Mapping[str, Floats]  # what a law may depend on, at each sample (N,), by name
    means: Mapping[str, Floats]  # its means over the blocks that are fitted (B,)

    @classmethod
    def of(cls, experiment: Experiment, fitted: Fitted) -> FittedRecording:
        """A recording with its derivatives."""
        sampled, count = arguments(experiment, fitted.point), len(fitted.residual)
        means = _means(experiment, np.column_stack(list(sampled.values())))[:count]
        base = experiment.jacobian(fitted.point, fitted.residual)
        return cls(experiment, fitted, base, sampled, dict(zip(sampled, means.T, strict=True)))

    def weight(self, squares: Floats) -> Floats:
        """Of each channel (C,): one over the variance of what is left and the blocks of a counted value.

        `squares`: sums of the squares of what is left (C,).
        """
        scale = self.fitted.scale
        return np.asarray(1.0 / (scale.variances_of(squares / len(self.fitted.residual)) * scale.blocks_per_error))

    def misfit(self, squares: Floats) -> float:
        """−2 log likelihood as evidence counts it. `squares`: sums of the squares of what is left (C,)."""
        scale, count = self.fitted.scale, len(self.fitted.residual)
        return scale.share * float(scale.misfits_of(squares / count, count).sum())

    @property
    def folds(self) -> NDArray[np.int64]:
        """Number of the stretch that a block belongs to (B,)."""
        return np.arange(len(self.fitted.residual)) * _FOLDS // len(self.fitted.residual)

    def products(self, a: Columns, b: Columns) -> Floats:
        """Sums of products of columns over each stretch (F, C, N, M). `a`, `b`: (B, C, N) and (B, C, M)."""
        ends = np.searchsorted(self.folds, np.arange(_FOLDS + 1))
        parts = ((a[b0:b1].astype(np.float64), b[b0:b1].astype(np.float64)) for b0, b1 in itertools.pairwise(ends))
        return np.stack([left.transpose(1, 2, 0) @ right.swapaxes(0, 1) for left, right in parts])

    @cached_property
    def of_base(self) -> tuple[Floats, Floats, Floats]:
        """Products of the base's columns (F, C, K, K), theirs with the residual (F, C, K), and its squares (F, C)."""
        residual = self.fitted.residual[:, :, None]
        slopes, squares = (self.products(one, residual)[..., 0] for one in (self.base, residual))
        return self.products(self.base, self.base), slopes, squares[..., 0]

    def argument_of(self, group: LawForm, muscle: int) -> Floats:
        """What a law depends on at a muscle (B,), with its memory."""
        return group.argument_of(self.means, muscle, self.experiment.trial.block_s)

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


@dataclass(frozen=True, eq=False)
class LawColumns:
    """Derivatives of the residuals of some recordings by one law's values, as sums over stretches."""

    here: Sequence[FittedRecording]
    own: list[Floats]  # products of the columns (F, C, N, N), of each recording
    by_base: list[Floats]  # products of the base's columns with these (F, C, K, N)
    by_residual: list[Floats]  # products of the columns with the residual (F, C, N, 1)
    each: list[Columns]  # the columns of every recording (B, C, N); empty where they are not kept
    _by: dict[LawColumns, list[Floats]] = field(default_factory=dict)

    @classmethod
    def of(cls, here: Sequence[FittedRecording], each: Sequence[Floats], kept: bool = True) -> LawColumns:
        """The sums of columns of every recording (B, C, N)."""
        # As they are kept: sums of columns and sums with other laws then belong to the same ones.
        short: list[Columns] = [one.astype(np.float32) for one in each]
        pairs = list(zip(here, short, strict=True))
        return cls(
            here,
            [one.products(own, own) for one, own in pairs],
            [one.products(one.base, own) for one, own in pairs],
            [one.products(own, one.fitted.residual[:, :, None]) for one, own in pairs],
            short if kept else [],
        )  # fmt: skip

    @property
    def size(self) -> int:
        """Values of the law."""
        return int(self.own[0].shape[2])

    def meet(self, others: Sequence[LawColumns], made: Callable[[], Sequence[Floats]]) -> None:
        """Work out the products with the columns of others. `made` makes its own, where they are not kept."""
        new = [other for other in others if other not in self._by]
        each = [one.astype(np.float32) for one in made()] if new and not self.each else self.each
        for other in new:
            trios = zip(self.here, other.each, each, strict=True)
            self._by[other] = [one.products(theirs, own) for one, theirs, own in trios]

    def by(self, other: LawColumns) -> list[Floats]:
        """Products of another law's columns with these (F, C, M, N), of each recording."""
        self.meet([other], lambda: ())
        return self._by[other]


@dataclass(frozen=True, eq=False)
class LawSteps:
    """Steps of the values of some laws, in units of their places, and what they leave."""

    steps: list[Floats]  # of each law (N,)
    covariances: list[Floats]  # of each law (N, N)
    # of each recording and channel the sum of squares of what is left (C,); a stretch is left by what was fitted to the
    # others.
    squares: list[Floats]


def solved(here: Sequence[FittedRecording], laws: Sequence[LawColumns], smooth: Sequence[float]) -> LawSteps:
    """The best step of the values of laws, beside the base parameters.

    `smooth`: of each law the precision of its table's second differences, as a share of what the data know of its
    values.
    """
    ends = np.cumsum([0, *(one.base.shape[2] for one in here)])
    first = int(ends[-1])
    own = [slice(b, e) for b, e in itertools.pairwise(np.cumsum([first, *(law.size for law in laws)]))]
    bases = [slice(b, e) for b, e in itertools.pairwise(ends)]
    total = own[-1].stop if own else first
    wheres = [np.r_[base, first:total] for base in bases]
    sums = [_Sums.of(one, laws, k) for k, one in enumerate(here)]
    squares = [one.squares.sum(axis=0) for one in sums]
    for _ in range(_ROUNDS):
        gram, right = np.zeros((_FOLDS, total, total)), np.zeros((_FOLDS, total))
        prior, pulled = np.zeros((total, total)), np.zeros(total)
        for one, where, base, known, now in zip(here, wheres, bases, sums, squares, strict=True):
            weight = one.weight(now)
            gram[:, where[:, None], where] += np.einsum("c,fcnm->fnm", weight, known.products)
            right[:, where] -= np.einsum("c,fcn->fn", weight, known.slopes)
            prior[base, base] = np.diag(one.experiment.prior)
            pulled[base] = -one.experiment.prior * one.fitted.point.theta
        every = gram.sum(axis=0)
        for at, law, share in zip(own, laws, smooth, strict=True):
            usual = float(np.trace(every[at, at])) / law.size
            prior[at, at] = share * usual * roughness(law.size) + 1e-6 * max(usual, 1e-30) * np.eye(law.size)
        matrix = every + prior
        step = np.linalg.solve(matrix, right.sum(axis=0) + pulled)
        steps = np.broadcast_to(step, (_FOLDS, total))
        squares = [known.left(steps[:, where]) for known, where in zip(sums, wheres, strict=True)]
    others = np.linalg.solve(matrix - gram, (right.sum(axis=0) - right + pulled)[..., None])[..., 0]
    squares = [known.left(others[:, where]) for known, where in zip(sums, wheres, strict=True)]
    covariance = np.linalg.inv(matrix)
    return LawSteps([step[at] for at in own], [covariance[at, at] for at in own], squares)


class _Sums(NamedTuple):
    """What fits need of a recording and all columns, the base's first: sums over each stretch."""

    products: Floats  # of the columns (F, C, T, T)
    slopes: Floats  # of theirs with the residual (F, C, T)
    squares: Floats  # of the residual's (F, C)

    @classmethod
    def of(cls, one: FittedRecording, laws: Sequence[LawColumns], number: int) -> _Sums:
        """Those of a recording with its number."""
        of_base, slopes_of_base, squares = one.of_base
        ends = np.cumsum([of_base.shape[2], *(law.size for law in laws)])
        base, own = slice(0, ends[0]), [slice(b, e) for b, e in itertools.pairwise(ends)]
        products = np.zeros((*of_base.shape[:2], ends[-1], ends[-1]))
        slopes = np.zeros(products.shape[:3])
        products[:, :, base, base], slopes[:, :, base] = of_base, slopes_of_base
        for law, at in zip(laws, own, strict=True):
            products[:, :, at, at] = law.own[number]
            products[:, :, base, at] = law.by_base[number]
            products[:, :, at, base] = law.by_base[number].swapaxes(2, 3)
            slopes[:, :, at] = law.by_residual[number][..., 0]
        for (a, at), (b, there) in itertools.combinations(zip(laws, own, strict=True), 2):
            products[:, :, at, there] = both = b.by(a)[number]
            products[:, :, there, at] = both.swapaxes(2, 3)
        return cls(products, slopes, squares)

    def left(self, steps: Floats) -> Floats:
        """Sums of the squares of what steps leave (C,). `steps`: of each stretch (F, T)."""
        moved = (self.products @ steps[:, None, :, None])[..., 0]
        each = self.squares + np.sum((2.0 * self.slopes + moved) * steps[:, None], axis=2)
        return np.asarray(np.maximum(each, 0.0).sum(axis=0))
