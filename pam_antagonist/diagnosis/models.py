"""A model of all recordings, its evidence, and how much of the excess over noise it explains.

The *excess* of a residual is what is above the sensors' noise; each experiment says how it is measured
(:meth:`~pam_antagonist.inference.experiment.Experiment.excess_removed`). The *share* of it that another model removes
is negative where the excess has grown.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.inference.calibration import is_calibration
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, effect_jacobian, held_residual, refit
from pam_antagonist.inference.likelihood import Scale
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.standard_errors import settled
from pam_antagonist.inference.starts import best_of_starts

Floats = NDArray[np.float64]
_Result = TypeVar("_Result")


def in_threads(work: Callable[..., _Result], tasks: Iterable[Sequence[Any]], jobs: int) -> list[_Result]:
    """The results of a function for several tuples of arguments."""
    return list(Parallel(n_jobs=jobs, prefer="threads")(delayed(work)(*task) for task in tasks))


class Residuals(NamedTuple):
    """What a model leaves of a recording: of the held-out part, and of the fitted part (B, C)."""

    held: Floats
    fitted: Floats


@dataclass(frozen=True, eq=False)
class Model:
    """One explanation of all recordings: each as it is compared, with its fit."""

    experiments: tuple[Experiment, ...] = ()
    fits: tuple[Fitted, ...] = ()
    effects: tuple[str, ...] = ()  # names of the effects in it, in the order in which they came

    @property
    def pairs(self) -> list[tuple[Experiment, Fitted]]:
        """Each recording with its fit."""
        return list(zip(self.experiments, self.fits, strict=True))

    @property
    def jobs(self) -> int:
        """Threads that its recordings may have."""
        return max((experiment.jobs for experiment in self.experiments), default=1)

    def each(self, work: Callable[..., _Result], *more: Iterable[Any]) -> list[_Result]:
        """A function of every recording, its fit and one of each of the further arguments, in threads."""
        return in_threads(work, zip(self.experiments, self.fits, *more, strict=True), self.jobs)

    def map(self, work: Callable[..., Fitted], *more: Iterable[Any]) -> Model:
        """The model with other fits, see :meth:`each`."""
        return replace(self, fits=tuple(self.each(work, *more)))

    def of(self, recordings: Sequence[int]) -> Model:
        """The model of some of the recordings."""
        experiments, fits = self.experiments, self.fits
        return replace(
            self, experiments=tuple(experiments[r] for r in recordings), fits=tuple(fits[r] for r in recordings)
        )

    @property
    def left(self) -> list[Residuals]:
        """What it leaves of each recording."""
        return [Residuals(held_residual(e, f), f.residual) for e, f in self.pairs]

    @property
    def is_at_noise(self) -> bool:
        """Whether every residual is at the sensors' noise."""
        return all(float(np.max(e.times_noise(f.residual))) < thresholds.AT_NOISE for e, f in self.pairs)

    @property
    def is_enough(self) -> bool:
        """Whether nothing more is looked for: it is at the noise, or has effects and no more than tolerated errors."""
        tolerated = (float(np.max(_times_tolerated(e, f))) < thresholds.AT_NOISE for e, f in self.pairs)
        return self.is_at_noise or (bool(self.effects) and all(tolerated))

    @property
    def has_significant_excess(self) -> bool:
        """Whether an effect that explained all of the excess would pay for its parameters."""
        total = 0.0
        for experiment, fitted in self.pairs:
            times = _times_tolerated(experiment, fitted)
            if np.max(times) < thresholds.AT_NOISE:
                continue
            gain = len(fitted.residual) / fitted.scale.counted * np.sum(np.log(np.maximum(times**2, 1.0)))
            total += max(float(gain) - price(fitted, thresholds.LEAST_PARAMETERS), 0.0)
        return total >= thresholds.STRONG


def all_of(models: Iterable[Model]) -> Model:
    """Several models of different recordings as one."""
    columns = zip(*((model.experiments, model.fits, model.effects) for model in models), strict=True)
    return Model(*(tuple(itertools.chain(*each)) for each in columns))


def _times_tolerated(experiment: Experiment, fitted: Fitted) -> Floats:
    return experiment.times_noise(fitted.residual) * experiment.noise / experiment.tolerated


# Evidence.


def price(before: Fitted, parameters: int) -> float:
    """What the Bayesian information criterion charges: k log n, with the independent values counted."""
    return parameters * float(np.log(max(before.scale.values(before.residual), np.e)))


def evidence(experiment: Experiment, before: Fitted, after: Fitted) -> float:
    """Evidence for a model with more free parameters in one recording (ΔBIC), on the scale of the one with fewer."""
    scale = before.scale
    gain = cost_of(experiment, before.point, before.residual, scale)
    gain -= cost_of(experiment, after.point, after.residual, scale)
    visible, known = (int(np.any(fit.effect, axis=(0, 1)).sum()) for fit in (after, before))
    return scale.share * gain - price(before, visible - known)


def held_out_evidence(experiment: Experiment, before: Fitted, after: Fitted) -> float:
    """Evidence for a model on the held-out part of a recording. Nothing was fitted there: no parameter has a price."""
    return likelier(before.scale, *(held_residual(experiment, fitted) for fitted in (before, after)))


def likelier(scale: Scale, before: Floats, after: Floats) -> float:
    """Twice the log likelihood ratio of two residuals (B, C) where nothing was fitted, the model with more last."""
    return scale.share * float(scale.misfits(before).sum() - scale.misfits(after).sum())


def evidence_of(without: Model, model: Model) -> float:
    """Evidence for a model against one without some of its effects, over all recordings."""
    pairs = zip(model.experiments, without.fits, model.fits, strict=True)
    return sum(evidence(experiment, old, new) for experiment, old, new in pairs if new is not old)


# Shares of the excess.

HELD, FITTED = slice(1), slice(1, 2)
"""The held-out and the fitted part, in the order of :class:`Residuals`."""


def share_of(parts: Sequence[tuple[float, float]]) -> float:
    """Share of the excess that is gone, from the removed and the original excess of each part."""
    gone, there = np.sum(parts, axis=0)
    return float(gone) / float(there) if there > 0.0 else 0.0


def removed(experiment: Experiment, base: Residuals, before: Residuals, after: Residuals) -> list[tuple[float, float]]:
    """What goes with one effect among others of the base model's excess, and that: of the held-out and fitted part."""
    parts = zip(base, before, after, strict=True)
    return [(experiment.excess_removed(w, a)[0], experiment.excess_removed(b, b)[1]) for b, w, a in parts]


def further_share(base: Model, before: Model, after: Model, parts: slice = slice(None)) -> float:
    """Share of the base model's excess that goes with one effect among others.

    `parts`: which count: the held-out, the fitted one, or both.
    """
    each = zip(after.experiments, base.left, before.left, after.left, strict=True)
    return share_of([part for recording in each for part in removed(*recording)[parts]])


def held_share(before: Model, after: Model) -> float:
    """Share of the held-out excess that is gone."""
    return further_share(before, before, after, HELD)


def share_of_all(before: Model, after: Model) -> float:
    """Share of the excess of both parts together that is gone."""
    return further_share(before, before, after)


def explains(base: Model, model: Model) -> bool:
    """Whether a model with effects leaves so little of the excess that they are the explanation."""
    if not model.effects:
        return False
    return share_of_all(base, model) >= thresholds.EXPLAINED or model.is_at_noise


def explains_in_part(base: Model, model: Model) -> bool:
    """Whether effects that are the explanation leave something that is worth a warning."""
    return share_of_all(base, model) < thresholds.EXPLAINED_WELL and not model.is_at_noise


# Models from others.


def recalibrated(experiments: Sequence[Experiment], known: Model | None = None) -> Model:
    """The base parameters of every recording at their most probable values.

    The fits are continued until they have converged: all that a base could still gain, each candidate beside it would
    gain as well, and it would pass for evidence.

    `known`: model of the recordings whose calibrations are fitted as well.
    """

    def one(experiment: Experiment, like: Fitted | None) -> Fitted:
        effects = {} if like is None else like.point.effects
        point = Point(experiment.origin.theta, {path: value for path, value in effects.items() if is_calibration(path)})
        free = () if like is None else tuple(free for free in like.free if is_calibration(free.path))
        return settled(experiment, best_of_starts(experiment, refit(experiment, point, free)))

    fits = known.fits if known is not None else [None] * len(experiments)
    jobs = Model(tuple(experiments)).jobs
    return Model(tuple(experiments), tuple(in_threads(one, zip(experiments, fits, strict=True), jobs)))


def as_configured(experiment: Experiment, fitted: Fitted) -> Fitted:
    """The model with its base as configured, as a place to take steps from.

    `fitted`: a model whose effects and calibrations are kept.
    """
    point = Point(experiment.origin.theta, fitted.point.effects)
    residual = experiment.residual(point)
    return replace(
        fitted, point=point, residual=residual, base=experiment.jacobian(point, residual),
        effect=effect_jacobian(experiment, point, residual, fitted.free), scale=Scale.of(residual, experiment.noise),
        cost=np.inf, covariance=np.zeros((0, 0)),
    )  # fmt: skip


def without(model: Model, prefix: str, finer: bool = False) -> Model:
    """A model without the parameters whose dotted paths have a prefix, everything else fitted anew.

    `finer`: whether a fit that ends at the noise may count every block.
    """

    def one(experiment: Experiment, fitted: Fitted) -> Fitted:
        kept = {name: value for name, value in fitted.point.effects.items() if not name.startswith(prefix)}
        if len(kept) == len(fitted.point.effects):
            return fitted
        free = tuple(free for free in fitted.free if not free.path.startswith(prefix))
        smaller = refit(experiment, Point(fitted.point.theta, kept), free, beside=fitted)
        return best_of_starts(experiment, smaller, 0) if finer else smaller

    names = tuple(name for name in model.effects if f"effects.{name}." != prefix)
    return replace(model.map(one), effects=names)


def shared(model: Model) -> Model:
    """A model whose recordings also have the effects of the others, where that costs them nothing.

    A rig has an effect in all recordings, even if one of them hardly shows it. That one takes over the values, with its
    base parameters fitted anew. A recording does not get an effect that it rules out.
    """

    def one(experiment: Experiment, fitted: Fitted) -> Fitted:
        for effect in model.effects:
            path = f"effects.{effect}."
            if any(name.startswith(path) for name in fitted.point.effects):
                continue
            shows = max(model.fits, key=lambda other: _certainty(other, path))
            values = {name: value for name, value in shows.point.effects.items() if name.startswith(path)}
            fitted = given(experiment, fitted, values)
        return fitted

    return model.map(one)


def given(experiment: Experiment, fitted: Fitted, values: dict[str, float]) -> Fitted:
    """A fit with values that other recordings show, by dotted path; as it is where they cost it too much."""
    point = Point(fitted.point.theta, {**fitted.point.effects, **values})
    pace = fitted.scale.blocks_per_error
    other = refit(experiment, point, fitted.free, renewals=2, blocks_per_error=pace, beside=fitted)
    return other if evidence(experiment, fitted, other) >= -thresholds.POSITIVE else fitted


def _certainty(fitted: Fitted, path: str) -> float:
    """How many standard deviations the sizes of an effect are; 0 where it is not free."""
    std = np.sqrt(np.diag(fitted.effect_covariance))
    here = [k for k, f in enumerate(fitted.free) if f.path.startswith(path) and f.item.is_size and std[k] > 0.0]
    return max((abs(fitted.point.effects.get(fitted.free[k].path, 0.0)) / std[k] for k in here), default=0.0)


# One number in several recordings, from its value and standard deviation in each.

_SCATTER = 0.02
"""Scatter of a size between recordings that its mean expects, as a share of the largest one."""


def of_calibration(seen: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Weighted mean and its standard deviation, enlarged where the values scatter by more than their own.

    A calibration belongs to a sensor or a clock, which is the same in all recordings: more scatter says that the
    standard deviations are too small.
    """
    values, stds = np.array(seen).T
    weights = 1.0 / np.maximum(stds, 1e-12) ** 2
    mean, std = float(weights @ values / weights.sum()), float(weights.sum() ** -0.5)
    chi = float(np.sqrt(weights @ (values - mean) ** 2 / max(len(values) - 1, 1)))
    return mean, std * max(chi, 1.0)


def of_size(seen: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Weighted mean, and its standard deviation with the spread between recordings.

    The size of an effect may really differ from recording to recording: no recording decides alone, however certain.
    """
    values, stds = np.array(seen).T
    floor = _SCATTER * float(np.max(np.abs(values)))
    weights = 1.0 / (stds**2 + floor**2)
    std = float(np.sqrt(1.0 / weights.sum())) if len(seen) > 1 else float(stds[0])
    return float(weights @ values / weights.sum()), max(std, float(np.ptp(values)) / 2.0)


def contradict(seen: Sequence[tuple[float, float]], mean: float) -> bool:
    """Whether the number cannot be the same in all recordings."""
    values, stds = np.array(seen).T
    spread = float(np.ptp(values))
    certain = spread > thresholds.SIZES_DIFFER_STD * float(np.hypot.reduce(stds))
    return certain and spread > thresholds.SIZES_DIFFER * abs(mean)
