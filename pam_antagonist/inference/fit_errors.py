"""Standard errors of a fit that hold although the model is imperfect.

The jackknife by blocks says what chance does to the values: errors that last, of whatever size. What a model lacks does
not average out: a longer recording repeats it. So an error above the noise counts as few independent values, however
long the recordings are. And where one recording contradicts the others, the difference is an error as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from pam_antagonist.inference.fit import NARROWED, Fit, Pulled, Residual, priors, robust, seen

Floats = NDArray[np.float64]

_BLOCKS = 40
"""Parts of the data that count as independent of each other: seconds each, in recordings of a minute and more."""
_FORMS = 20.0
"""Independent values of what a model lacks: it moves with the commands, however long a recording is."""
_PULLED = 3.0
"""A recording pulls a value apart that differs by so many standard errors without it."""
_NAMED = 0.5
"""Of such values those are named whose difference is more than this share of the standard error."""


@dataclass(frozen=True, eq=False)
class Rows:
    """What the rows of a residual are."""

    recording: NDArray[np.str_]  # from which each is (N,)
    noise: Floats  # standard deviation by the sensors alone, in the residual's unit (N,)

    @classmethod
    def of(cls, parts: Iterable[tuple[str, int, float]]) -> Rows:
        """Rows in stretches: the recording, the number of rows and their noise of each."""
        names, counts, noise = zip(*parts, strict=True)
        return cls(np.repeat(names, counts), np.repeat(noise, counts))


def with_errors(
    fit: Fit,
    residual: Residual,
    jobs: int = 1,
    elsewhere: Sequence[Residual] = (),
    rows: Rows | None = None,
) -> Fit:
    """A fit with honest standard errors; its values stay.

    The unit of the residuals is a guess, and a model's errors last. So the curvature alone is no covariance. A joint
    that sticks makes the cost rough: small steps show the roughness, and a fit by them stops in any of many small
    minima. So the derivatives are differences over the width of the uncertainty. The standard errors come from

    * the priors,
    * the estimates that leave out one block of the data each (a jackknife, by one step of Gauss and Newton),
    * the step by which the fit would still move,
    * the errors of values that another stage found,
    * what the model lacks: errors above the noise, which longer recordings repeat and do not average,
    * the estimates that leave out one recording each.

    `elsewhere`: the residual with those values changed by one standard error, for each independent change. `rows`: what
    the rows of the residual are; None: errors that are no model's, of one recording.
    """
    if len(fit.at_bounds) == len(fit.unknowns):
        return fit
    amounts = fit.amounts
    base, free, slopes, within = seen(fit, robust(fit.unknowns, residual, jobs))
    prior = priors(fit.unknowns)
    moves = [within @ (slopes.T @ base + prior[free] * amounts[free])]
    there = (robust(fit.unknowns, other, jobs)([amounts])[0] for other in elsewhere)
    moves += [within @ (slopes.T @ (left - base)) for left in there]
    found = within * prior[free] @ within + _jackknife(slopes, base, within) + sum(np.outer(one, one) for one in moves)
    pulled: tuple[Pulled, ...] = ()
    if rows is not None:
        apart = _without_each(slopes, base, within, rows.recording, np.diag(found) / np.diag(within), prior[free])
        found += sum(np.outer(one.moves, one.moves) for one in apart) + _of_the_model(slopes, base, within, rows.noise)
        pulled = _named(fit, free, apart, np.sqrt(np.diag(found)))
        # Where the data say little, a step of the linear model may be far beyond what the priors allow.
        most = np.where(prior[free] > 0.0, np.maximum(1.0, np.abs(amounts[free])), np.inf)
        narrower = np.minimum(1.0, most / np.sqrt(np.diag(found)))
        found *= np.outer(narrower, narrower)
    covariance = np.eye(len(amounts))
    covariance[np.ix_(free, free)] = found
    return replace(fit, covariance=covariance, pulled=pulled)


def _of_the_model(slopes: Floats, residual: Floats, within: Floats, noise: Floats) -> Floats:
    """Covariance of the free amounts (F, F) by what the model lacks.

    `noise`: standard deviation of each row by the sensors alone (N,).
    """
    window = max(len(residual) // _BLOCKS, 1)
    size = np.maximum(uniform_filter1d(residual**2, window) - noise**2, 0.0)
    gram = (slopes * size[:, None]).T @ slopes
    return np.asarray(within @ gram @ within * (len(residual) / _FORMS))


class _Without(NamedTuple):
    """Steps of the free amounts if a recording is left out."""

    recording: str
    moves: Floats  # 0 where the others do not contradict it (F,)
    far: Floats  # size of each in standard errors of the difference (F,)


def _without_each(
    slopes: Floats, residual: Floats, within: Floats, recording: NDArray[np.str_], larger: Floats, prior: Floats
) -> list[_Without]:
    """What leaving out a recording changes, for each of several.

    `larger`: variance of each free amount over that of the curvature alone (F,). `prior`: which have a prior, 1 or 0
    (F,).
    """
    # In the unit of the residuals a prior is as wide as it is: a small error of the data does not make it narrower.
    larger = np.maximum(larger, 1.0)
    names = list(dict.fromkeys(recording.tolist()))
    information, out = np.linalg.inv(within), []
    for name in names if len(names) > 1 else ():
        rows = recording == name
        others = np.linalg.inv(information - slopes[rows].T @ slopes[rows])
        moves = others @ (slopes[rows].T @ residual[rows])
        # Without the only recording that shows a value, the prior alone is left: this is no contradiction.
        far = np.abs(moves) / np.sqrt(np.maximum(np.diag(others) - np.diag(within), 1e-12) * larger)
        # What the others hardly tell contradicts nothing: a step along it may lead anywhere.
        told = (np.diag(others) * larger < NARROWED**2) | (prior == 0.0)
        out.append(_Without(name, np.where(told & (far > _PULLED), moves, 0.0), far))
    return out


def _named(fit: Fit, free: NDArray[np.intp], apart: Sequence[_Without], std: Floats) -> tuple[Pulled, ...]:
    """The recordings that pull values apart, of each value the one that does most, the farthest first.

    `std`: of the free amounts (F,).
    """
    out = []
    for place, k in enumerate(free):
        one = max(apart, key=lambda one: float(one.far[place]), default=None)
        if one is not None and abs(one.moves[place]) > _NAMED * std[place]:
            item = fit.unknowns[k]
            there = float(np.clip(fit.amounts[k] + one.moves[place], *item.bounds))
            out.append(Pulled(item.name, one.recording, item.value(there), float(one.far[place])))
    return tuple(sorted(out, key=lambda one: -one.far))


def _jackknife(slopes: Floats, residual: Floats, within: Floats) -> Floats:
    """Covariance of the free amounts (F, F) by the data's errors, whatever their size and however long they last."""
    information = np.linalg.inv(within)
    blocks = np.array_split(np.arange(len(residual)), min(_BLOCKS, max(len(residual), 1)))
    moves = np.array([
        np.linalg.solve(information - slopes[rows].T @ slopes[rows], slopes[rows].T @ residual[rows])
        for rows in blocks
    ])  # fmt: skip
    moves -= moves.mean(axis=0)
    # Neighbours are not independent: half of their products count (Bartlett's weights, Newey and West 1987).
    nothing = np.zeros((1, moves.shape[1]))
    pairs = np.vstack([moves, nothing]) + np.vstack([nothing, moves])
    return np.asarray(0.5 * pairs.T @ pairs)
