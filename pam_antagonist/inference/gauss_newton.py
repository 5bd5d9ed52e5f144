"""The most probable base parameters and effects of a recording in full simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.driven import Driven
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.likelihood import LinearProblem, Scale, Solution
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import Mask
from pam_antagonist.inference.unknown import Unknown

Floats = NDArray[np.float64]

_ROUNDS = 14
_PART_ROUNDS = 4
"""Likewise of a fit to a part of a recording that was fitted already."""
_ENOUGH = 0.5
_ENOUGH_OF_ALL = 2e-3
"""A step is the last one that gains less than these: in −2 log posterior, and of what was gained before."""
_STEP_LENGTHS = (1.0, 0.4, 0.1)
"""Shares of a Gauss-Newton step that are tried."""
_CAREFUL = (0.01, 0.1, 1.0)
"""Damping of the steps that are tried after those."""
_LEAP = 1.0
"""A step that multiplies a time constant by more than e is a leap in the dark."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model of a recording at its best."""

    point: Point
    free: tuple[Unknown, ...]
    residual: Floats  # measured minus simulated (B, C) of the part that was fitted
    base: Floats  # its derivatives by the base coordinates (B, C, K + S)
    effect: Floats  # its derivatives by the effects' coordinates (B, C, m)
    scale: Scale
    cost: float  # −2 log posterior, up to a constant
    covariance: Floats

    @property
    def effect_covariance(self) -> Floats:
        """Covariance of the effects' coordinates (m, m)."""
        m = len(self.free)
        return self.covariance[len(self.covariance) - m :, len(self.covariance) - m :]


def prior_cost(experiment: Experiment, theta: Floats) -> float:
    """−2 log prior of the base coordinates, up to a constant."""
    return float(np.sum(experiment.prior * theta**2))


def cost_of(experiment: Experiment, point: Point, residual: Floats, scale: Scale) -> float:
    """−2 log posterior of a model, up to a constant. `residual`: it leaves (B, C)."""
    return float(scale.misfits(residual).sum()) + prior_cost(experiment, point.theta)


def effect_jacobian(
    experiment: Driven, point: Point, residual: Floats, free: Sequence[Unknown], share: float = 1.0
) -> Floats:
    """Derivatives of the residual by the coordinates of effects (B, C, m). `residual`: it leaves (B, C)."""
    result = np.zeros((*residual.shape, len(free)))
    points, steps = [], []
    for parameter in free:
        value = point.effects.get(parameter.path, parameter.item.neutral)
        step = share * parameter.step(value)
        moved = parameter.value(parameter.coordinate(value) + step)
        points.append(Point(point.theta, {**point.effects, **dict.fromkeys(parameter.paths, moved)}))
        steps.append(step)
    for k, difference in enumerate(experiment.differences(point, residual, points)):
        result[:, :, k] = difference / steps[k]
    return result


def refit(
    experiment: Experiment,
    point: Point,
    free: Sequence[Unknown] = (),
    base: Floats | None = None,
    rounds: int = _ROUNDS,
    renewals: int = 3,
    blocks_per_error: float | None = None,
    careful: int = 12,
    near: bool = True,
    beside: Fitted | None = None,
    exact: bool = True,
) -> Fitted:
    """Gauss-Newton, with the derivatives by the base coordinates kept from step to step while they serve.

    Steps are tried with residuals that are as exact as derivatives (:meth:`Experiment.near`). The fit ends with the
    exact one, and begins again with exact ones where that is worse.

    Args:
        point: where to start; the free parameters' values in it are their starts.
        free: parameters of effects that may move beside the base parameters.
        base: derivatives by the base coordinates (B, C, K + S) from a point nearby; default: worked out here.
        renewals: how often the derivatives by the base coordinates may be worked out.
        blocks_per_error: blocks per value that is counted; default: those of a model that lacks something.
        careful: how many steps may be damped ones, which are tried where the others lead nowhere.
        beside: fit of the same part to another model, from which the first residual is worked out likewise.
        exact: whether the fit ends with the exact residual; one that is only compared with others need not.
    """
    again = (point, free, base, rounds, renewals, blocks_per_error, careful)
    residual, is_exact = _begun(experiment, point, beside if near else None)
    fresh = base is None
    if base is None:
        base = experiment.jacobian(point, residual)
        renewals -= 1
    effect = effect_jacobian(experiment, point, residual, free)
    gained, first = 0.0, 0
    for _ in range(rounds):
        scale = experiment.scale(residual, blocks_per_error)
        cost = cost_of(experiment, point, residual, scale)
        found, linear = None, LinearProblem.of(residual, base, effect)
        damped = len(_CAREFUL) if careful > 0 and (fresh or renewals <= 0) else 0
        for number in range(first, len(_STEP_LENGTHS) + damped):
            step = _step(experiment, point, free, linear, scale, number)
            trial = moved_by(point, free, step.theta, step.effect)
            moved = experiment.near(trial, point, residual) if near else experiment.residual(trial)
            new = cost_of(experiment, trial, moved, scale)
            if new < cost:
                found = trial, moved, cost - new
                # Where bold steps led nowhere they hardly will from the next point.
                first = max(number - 1, 0)
                careful -= number >= len(_STEP_LENGTHS)
                break
        else:
            first = 0
        if found is not None:
            point, residual, gain = found
            is_exact = not near
            gained += gain
            effect = effect_jacobian(experiment, point, residual, free)
            if gain > _ENOUGH + _ENOUGH_OF_ALL * gained:
                fresh = False
                continue
            if fresh:
                break
        elif fresh:
            break
        if renewals <= 0:
            break
        base = experiment.jacobian(point, residual)
        renewals -= 1
        fresh = True
    if exact and not is_exact:
        true = experiment.residual(point)
        scale = experiment.scale(residual, blocks_per_error)
        if cost_of(experiment, point, true, scale) > cost_of(experiment, point, residual, scale) + _ENOUGH:
            return refit(experiment, *again, near=False)
        residual = true
    scale = experiment.scale(residual, blocks_per_error)
    last = LinearProblem.of(residual, base, effect).solved(
        scale, experiment.prior, point.theta, rounds=1, length=scale.length
    )
    cost = cost_of(experiment, point, residual, scale)
    return Fitted(point, tuple(free), residual, base, effect, scale, cost, last.covariance)


def _begun(experiment: Experiment, point: Point, beside: Fitted | None) -> tuple[Floats, bool]:
    """The residual (B, C) with which a fit begins, from another model's where one is known; whether it is exact."""
    if beside is None:
        return experiment.residual(point), True
    if beside.point is point:
        return beside.residual, True
    return experiment.near(point, beside.point, beside.residual), False


def _step(
    experiment: Experiment,
    point: Point,
    free: Sequence[Unknown],
    linear: LinearProblem,
    scale: Scale,
    number: int,
) -> Solution:
    """A step to be tried, the more careful the higher its number.

    The first ones expect the variances that the linear model promises. Where it promises too much they lead nowhere,
    however short: careful ones weigh the channels as they are now, and turn to the steepest descent.

    `linear`: the residual with its derivatives by the base coordinates and by those. `number`: from 0.
    """
    held = _held(point, free)
    if number < len(_STEP_LENGTHS):
        bold, share = linear.solved(scale, experiment.prior, point.theta, held=held), _STEP_LENGTHS[number]
        return replace(bold, theta=share * bold.theta, effect=share * bold.effect)
    damping = _CAREFUL[number - len(_STEP_LENGTHS)]
    return linear.solved(scale, experiment.prior, point.theta, rounds=1, held=held, damping=damping)


class Near(NamedTuple):
    """A fit from a point nearby."""

    point: Point
    residual: Floats  # of all blocks (B, C)
    cost: float  # −2 log posterior of what was fitted, up to a constant


@dataclass(frozen=True, eq=False)
class Linearised:
    """A model of all of a recording with its derivatives, from which fits to parts of it start."""

    experiment: Experiment
    fitted: Fitted
    residual: Floats  # it leaves (B, C)
    base: Floats  # derivatives of the residual by the base coordinates (B, C, K + S)
    effect: Floats  # likewise by the effects' coordinates (B, C, m)

    @classmethod
    def of(cls, experiment: Experiment, fitted: Fitted) -> Linearised:
        """A model with its derivatives."""
        residual = experiment.residual(fitted.point)
        effect = effect_jacobian(experiment, fitted.point, residual, fitted.free)
        return cls(experiment, fitted, residual, experiment.jacobian(fitted.point, residual), effect)

    def on(self, part: Mask, exact: bool = True) -> Near:
        """The fit to a part of the blocks.

        Each step has the derivatives of the start and is checked by a simulation. Parts differ by little, so that this
        is the most probable model or near it; a step that leads nowhere is not taken.

        `part`: which blocks are fitted (B,).
        """
        point, residual, scale = self.fitted.point, self.residual, self.fitted.scale
        cost = cost_of(self.experiment, point, residual[part], scale)
        for _ in range(_PART_ROUNDS):
            linear = LinearProblem.of(residual[part], self.base[part], self.effect[part])
            for number in range(len(_STEP_LENGTHS) + len(_CAREFUL)):
                step = _step(self.experiment, point, self.fitted.free, linear, scale, number)
                moved = moved_by(point, self.fitted.free, step.theta, step.effect)
                left = self.experiment.near(moved, point, residual)
                new = cost_of(self.experiment, moved, left[part], scale)
                if new < cost:
                    break
            else:
                break
            gain, point, residual, cost = cost - new, moved, left, new
            if gain < _ENOUGH:
                break
        if exact and point is not self.fitted.point:
            residual = self.experiment.residual(point)
            cost = cost_of(self.experiment, point, residual[part], scale)
        return Near(point, residual, cost)


def held_residual(experiment: Experiment, fitted: Fitted) -> Floats:
    """What a model leaves of held-out blocks (B, C), fitted to each split's other blocks where there are several."""
    known = _HELD.get(fitted)
    if known is None or known[0] is not experiment:
        if experiment.splits:
            linear = Linearised.of(experiment, fitted)
            parts = [linear.on(split.fitted).residual[split.held] for split in experiment.splits]
            known = experiment, np.concatenate(parts)
        else:
            known = experiment, experiment.held(experiment.residual(fitted.point, whole=True))
        _HELD[fitted] = known
    return known[1].copy()


_HELD: WeakKeyDictionary[Fitted, tuple[Experiment, Floats]] = WeakKeyDictionary()
"""What was worked out before: each model is compared with several others."""


def relinearised(experiment: Experiment, fitted: Fitted) -> Fitted:
    """A fit with the derivatives at its own point, so that one of which only the point was kept is the same again."""
    return refit(experiment, fitted.point, fitted.free, rounds=0, blocks_per_error=fitted.scale.blocks_per_error)


def moved_by(point: Point, free: Sequence[Unknown], theta: Floats, effect: Floats) -> Point:
    """A point after a step, within the bounds of the effects' parameters.

    `theta`: change of the base coordinates (K + S,). `effect`: change of the effects' coordinates (m,).
    """
    effects = dict(point.effects)
    for parameter, change in zip(free, effect, strict=True):
        value = effects.get(parameter.path, parameter.item.neutral)
        bound = np.inf if parameter.item.is_size else _LEAP
        moved = parameter.bounded(parameter.value(parameter.coordinate(value) + float(np.clip(change, -bound, bound))))
        effects.update(dict.fromkeys(parameter.paths, moved))
    return Point(point.theta + theta, effects)


def _held(point: Point, free: Sequence[Unknown]) -> list[int]:
    """Shapes of an effect without size: nothing depends on them."""
    held = []
    for k, parameter in enumerate(free):
        effect = parameter.path.rsplit(".", 1)[0] + "."
        sizes = [u for u in free if u.item.is_size and u.path.startswith(effect)]
        if not parameter.item.is_size and not any(point.effects.get(size.path, 0.0) for size in sizes):
            held.append(k)
    return held
