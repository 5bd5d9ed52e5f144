"""The fit of unknown numbers to residuals in known units, within their bounds.

It stays inside the bounds of the rig file's schema.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pam_antagonist.estimation.metrics import correlation_length
from pam_antagonist.inference.threads import side_by_side
from pam_antagonist.inference.unknown import Unknown, parameters
from pam_antagonist.model.lane_values import LANES

Floats = NDArray[np.float64]
Values = Mapping[str, float]
"""Of the unknowns, by their names."""
Residual = Callable[[Sequence[Values]], Sequence[Floats]]
"""What values leave of the data, in standard deviations, for each of several (N,): they run side by side. Not finite
where a simulation diverged."""
Errors = Callable[[Sequence[Values]], Sequence[Mapping[str, Floats]]]
"""The same in units of the data, by kind."""
OfAmounts = Callable[[Sequence[Floats]], list[Floats]]
"""The same for each of several amounts of the unknowns (F,)."""

_STEP = 1e-3
"""Step of the derivatives, in standard deviations of the priors."""
_ROBUST = 20.0
"""Residuals beyond so many units count less and less."""
_AT_BOUND = 1e-3
NARROWED = 0.5
"""A value is determined where the data leave less than this share of its prior's standard deviation."""
FAR = 3.0
"""Distance from the rig file's value, in standard deviations of the prior, that contradicts the prior."""
_NORMAL = 1.96
SPREAD = 0.01
"""Relative standard deviation of a recording's own deviation from the common value."""
_ROUNDS = 2
_WIDE_STEP = 0.05
"""Least first step, in standard deviations of the priors: small steps make the uncertainty look smaller than it is."""
_SHARES = (1.0, 0.5, 0.25)
"""Of a step that are tried."""
_FAILED = 1e3
"""Residual of a simulation that is not finite."""


class Pulled(NamedTuple):
    """A value that one recording pulls away from the others."""

    name: str
    recording: str
    without: float  # value without that recording, in the unknown's unit
    far: float  # by how many standard errors it differs


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit."""

    unknowns: tuple[Unknown, ...]
    amounts: Floats  # found values in standard deviations of the priors (F,)
    covariance: Floats  # of the amounts (F, F), from the curvature with the priors, or with its errors
    cost: float
    # factor of each kind of residual, see :func:`scale_of`; empty for the stage's own.
    scale: Mapping[str, float] = field(default_factory=dict)
    # whether the fit stayed so far from the data that its values and their standard errors mean nothing.
    lost: bool = False
    # value of each unknown that met a bound and was put back to its start, by name.
    kept: Mapping[str, float] = field(default_factory=dict)
    pulled: tuple[Pulled, ...] = ()  # the farthest first

    @property
    def moved(self) -> Fit:
        """The fit without the unknowns that were put back to the rig file's values."""
        left = [k for k, item in enumerate(self.unknowns) if item.name not in self.kept]
        unknowns = tuple(self.unknowns[k] for k in left)
        covariance = self.covariance[np.ix_(left, left)]
        return replace(self, unknowns=unknowns, amounts=self.amounts[left], covariance=covariance, kept={})

    @property
    def values(self) -> dict[str, float]:
        """Value of each unknown, by name."""
        return {item.name: item.value(float(amount)) for item, amount in zip(self.unknowns, self.amounts, strict=True)}

    @property
    def parameters(self) -> dict[str, float]:
        """Value of each parameter, by dotted path."""
        return parameters(self.unknowns, self.values)

    @property
    def stds(self) -> dict[str, float]:
        """Standard error of each unknown, by name, in its unit."""
        found = self.values
        return {
            item.name: item.scale * math.sqrt(variance) * (abs(found[item.name]) if item.positive else 1.0)
            for item, variance in zip(self.unknowns, np.diag(self.covariance), strict=True)
        }

    @property
    def reasons(self) -> dict[str, str]:
        """Why the data do not determine each unknown, in few words, by name; empty where they do."""
        if self.lost:
            return dict.fromkeys((item.name for item in self.unknowns), "the fit does not explain the data")
        kept = dict.fromkeys(self.kept, "met a bound, so the value of the rig file is kept")
        return {
            item.name: kept.get(item.name)
            or _reason(item, float(amount), math.sqrt(variance), item.name in self.at_bounds)
            for item, amount, variance in zip(self.unknowns, self.amounts, np.diag(self.covariance), strict=True)
        }

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Names of the unknowns that stand at a bound, or met one."""
        return tuple(
            item.name
            for item, amount in zip(self.unknowns, self.amounts, strict=True)
            if item.name in self.kept or min(abs(amount - bound) for bound in item.bounds) < _AT_BOUND
        )


def _reason(item: Unknown, amount: float, std: float, at_bound: bool) -> str:
    """Why the data do not determine an unknown, from its amount and the amount's standard error."""
    if at_bound:
        return "none is seen" if item.is_none(amount) else "met a bound"
    if std >= NARROWED:
        return "stays near its prior" if abs(amount) <= 1.0 else "moved, but uncertain"
    if not item.positive and item.start and _NORMAL * std * item.scale >= abs(item.value(amount)):
        return "uncertain by more than its value"
    return "contradicts its prior" if abs(amount) > FAR else ""


def scale_of(errors: Mapping[str, Floats], least: Mapping[str, float]) -> dict[str, float]:
    """Factors that turn errors into independent standard deviations.

    A model errs by its sensor's noise or by more, and its errors last. So each kind of error counts by its own size,
    and values that follow from each other count as one.

    `errors`: of each kind (N,).
    """
    out = {}
    for kind, values in errors.items():
        if np.isfinite(values).sum() > 2:
            size = max(float(np.sqrt(np.nanmean(values**2))), least[kind])
            out[kind] = 1.0 / (size * math.sqrt(correlation_length(values)))
    return out


def deviations(
    ways: Mapping[str, Mapping[str, float]], unknowns: Sequence[Unknown], names: Sequence[str]
) -> list[Unknown]:
    """Deviations of single recordings from what they have in common.

    A rig is not exactly the same in two recordings: valves warm up, muscles settle. If all values were common, the
    recording with more samples would decide.

    `ways`: change of the parameters by a relative deviation of 1, by the name of the way; of free ones only.
    """
    free = {path for item in unknowns for path in (*item.paths, *item.adds)}
    return [
        Unknown(f"{name}: {way}", (), 0.0, SPREAD, adds=changes, recording=name)
        for name in names if len(names) > 1
        for way, changes in ways.items() if free.issuperset(changes)
    ]  # fmt: skip


def refined(
    fit: Fit,
    extra: Sequence[Unknown],
    errors: Errors,
    least: Mapping[str, float],
    evaluations: int,
    jobs: int = 1,
) -> Fit:
    """A fit again, with errors weighed by their size, so that its standard errors are those of the values.

    `extra`: further unknowns, that begin at the middle of their priors.
    """
    unknowns, amounts = [*fit.unknowns, *extra], np.concatenate([fit.amounts, np.zeros(len(extra))])
    scale: dict[str, float] = {}
    for _ in range(_ROUNDS):
        (left,) = errors([{item.name: item.value(float(a)) for item, a in zip(unknowns, amounts, strict=True)}])
        scale = scale_of(left, least)

        def residual(points: Sequence[Values], scale: Mapping[str, float] = scale) -> list[Floats]:
            return [
                np.concatenate([np.zeros(0), *(factor * now[kind] for kind, factor in scale.items())])
                for now in errors(points)
            ]

        fit = _with_wide_step(fitted(unknowns, residual, amounts, evaluations, jobs), residual, jobs)
        amounts = fit.amounts
    return replace(fit, scale=scale)


def fitted(
    unknowns: Sequence[Unknown],
    residual: Residual,
    begin: Floats | None = None,
    evaluations: int = 20,
    jobs: int = 1,
) -> Fit:
    """Find the unknowns that explain the data best, with their priors, within their bounds.

    `begin`: first amounts (F,); None: the priors' middles.
    """
    if not unknowns:
        return Fit((), np.zeros(0), np.zeros((0, 0)), 0.5 * float(np.sum(residual([{}])[0] ** 2)))
    low, high = _bounds(unknowns)
    of_data, prior = robust(unknowns, residual, jobs), priors(unknowns)

    def whole(amounts: Floats) -> Floats:
        return np.concatenate([*of_data([amounts]), prior * amounts])

    def jacobian(amounts: Floats) -> Floats:
        steps = np.where(amounts + _STEP <= high, _STEP, -_STEP)
        base, *moved = of_data([amounts, *(amounts + np.diag(steps))])
        return np.vstack([(np.column_stack(moved) - base[:, None]) / steps, np.diag(prior)])

    first = np.zeros(len(unknowns)) if begin is None else begin
    inside = np.clip(first, low + 1e-6, high - 1e-6)
    found = least_squares(whole, inside, jacobian, bounds=(low, high), max_nfev=evaluations, xtol=1e-4, ftol=1e-4)
    information = found.jac.T @ found.jac
    return Fit(tuple(unknowns), found.x, np.linalg.inv(information), float(found.cost))


def within_bounds(
    fit: Fit,
    residual: Residual,
    evaluations: int = 20,
    jobs: int = 1,
    stay: Collection[str] = (),
) -> Fit:
    """A fit in which what met a bound has the rig file's value, and the others are fitted again.

    A value that would leave its bounds stands for something else that the model lacks. Numbers that no rig file has,
    such as an encoder's zero, have no other value and stay.

    `stay`: names of further unknowns that stay at their bounds.
    """
    met = {
        k: item.value(float(amount))
        for k, (item, amount) in enumerate(zip(fit.unknowns, fit.amounts, strict=True))
        if item.paths and item.name in fit.at_bounds and item.name not in stay
        and not item.is_none(float(amount))
    }  # fmt: skip
    if not met:
        return fit
    start = {fit.unknowns[k].name: fit.unknowns[k].start for k in met}
    rest = np.array([k for k in range(len(fit.unknowns)) if k not in met], dtype=int)

    def of_rest(points: Sequence[Values]) -> Sequence[Floats]:
        return residual([{**values, **start} for values in points])

    first = fitted([fit.unknowns[k] for k in rest], of_rest, fit.amounts[rest], evaluations, jobs)
    again = within_bounds(first, of_rest, evaluations, jobs, stay)
    amounts, covariance = np.zeros(len(fit.amounts)), np.eye(len(fit.amounts))
    amounts[rest], covariance[np.ix_(rest, rest)] = again.amounts, again.covariance
    kept = {**{fit.unknowns[k].name: value for k, value in met.items()}, **again.kept}
    return replace(fit, amounts=amounts, covariance=covariance, cost=again.cost, kept=kept)


def _with_wide_step(fit: Fit, residual: Residual, jobs: int) -> Fit:
    """A fit after a further step, by derivatives over the width of the uncertainty, if that lowers its cost.

    Where a joint sticks, small steps end before the priors have shared out what the data leave open, such as between a
    common value and its deviations.
    """
    if len(fit.at_bounds) == len(fit.unknowns):
        return fit
    of_data, (low, high) = robust(fit.unknowns, residual, jobs), _bounds(fit.unknowns)
    base, free, slopes, within = seen(fit, of_data)
    step = np.zeros(len(fit.amounts))
    prior = priors(fit.unknowns)
    step[free] = -within @ (slopes.T @ base + prior[free] * fit.amounts[free])
    for share in _SHARES:
        there = np.clip(fit.amounts + share * step, low, high)
        cost = 0.5 * float(np.sum(of_data([there])[0] ** 2) + there @ (prior * there))
        if cost < fit.cost:
            return replace(fit, amounts=there, cost=cost)
    return fit


def seen(fit: Fit, of_data: OfAmounts) -> tuple[Floats, NDArray[np.intp], Floats, Floats]:
    """What the data say at a fit: residual (N,), free amounts (F,), derivatives by them (N, F), inverse curvature."""
    bounds, (base,) = _bounds(fit.unknowns), of_data([fit.amounts])
    free = np.flatnonzero([item.name not in fit.at_bounds for item in fit.unknowns])
    within = fit.covariance[np.ix_(free, free)]
    for least in (_WIDE_STEP, _STEP):
        slopes = _slopes(of_data, fit.amounts, within, free, bounds, least)
        within = np.asarray(np.linalg.inv(slopes.T @ slopes + np.diag(priors(fit.unknowns)[free])))
    return base, free, slopes, within


def _slopes(
    of_data: OfAmounts, amounts: Floats, within: Floats, free: NDArray[np.intp], bounds: tuple[Floats, Floats],
    least: float,
) -> Floats:  # fmt: skip
    """Derivatives of the residual by the free amounts (N, F), from differences over two standard deviations."""
    sizes, turned = np.linalg.eigh(within)
    ways = np.zeros((len(free), len(amounts)))
    ways[:, free] = (turned * np.clip(np.sqrt(sizes), least, 1.0)).T
    there = [amounts + _room(sign * way, amounts, bounds) * sign * way for way in ways for sign in (1.0, -1.0)]
    left = of_data(there)
    moved = np.array([forth - back for forth, back in zip(there[::2], there[1::2], strict=True)])[:, free]
    changes = np.column_stack([forth - back for forth, back in zip(left[::2], left[1::2], strict=True)])
    return np.asarray(np.linalg.solve(moved, changes.T).T)


def _room(way: Floats, amounts: Floats, bounds: tuple[Floats, Floats]) -> float:
    """The share of a way (F,) that stays within the bounds, at most 1."""
    room = np.where(way > 0.0, bounds[1] - amounts, amounts - bounds[0])
    return float(np.min(room[way != 0.0] / np.abs(way[way != 0.0]), initial=1.0))


def _bounds(unknowns: Sequence[Unknown]) -> tuple[Floats, Floats]:
    low, high = (np.array(side) for side in zip(*(item.bounds for item in unknowns), strict=True))
    return low, high


def priors(unknowns: Sequence[Unknown]) -> Floats:
    """1 for each unknown with a prior, else 0 (F,)."""
    return np.array([float(math.isfinite(item.std)) for item in unknowns])


def robust(unknowns: Sequence[Unknown], residual: Residual, jobs: int) -> OfAmounts:
    """The residual of the data for amounts; large ones count less, also those of a simulation that diverged."""

    def together(points: Sequence[Floats]) -> list[Floats]:
        each = [{item.name: item.value(a) for item, a in zip(unknowns, point, strict=True)} for point in points]
        left = (np.nan_to_num(one, nan=_FAILED, posinf=_FAILED, neginf=-_FAILED) for one in residual(each))
        return [np.asarray(_ROBUST * np.arctan(one / _ROBUST)) for one in left]

    def of_data(points: Sequence[Floats]) -> list[Floats]:
        groups = [points[k : k + LANES] for k in range(0, len(points), LANES)]
        return list(itertools.chain.from_iterable(side_by_side(together, groups, jobs)))

    return of_data
