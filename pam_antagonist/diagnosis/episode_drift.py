"""Drift of a joint's parameters over many episodes, and the best number of last episodes to fit a model to.

All of it is worked out to first order, from products of the model's derivatives by episode. Errors are those of
simulations, but for forecasts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.bootstrap import CHANCE, Interval
from pam_antagonist.inference.episodes import EpisodeModel, Squares
from pam_antagonist.inference.held_episodes import Held, last, thinned
from pam_antagonist.inference.pressure_driven import PressureDriven

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

WINDOWS = (1.0, 0.5, 0.25, 0.125, 0.0625)
"""Windows for a model of later episodes: shares of the fitted episodes, the last of them."""
PARTS = 8
_FITTED = 100
"""Most episodes of a part that are fitted."""
_POINTS = (1, 2, 3, 5, 9)
"""Numbers of points through which the lines of drifting numbers may go; of one, nothing drifts."""
_GROUPS = 24
"""Groups of neighbouring episodes, each simulated with its own numbers."""
_RIDGE = 1e-3
"""Added to the products of each number with itself, as a share: what few episodes hardly determine stays as it is."""
_LINE_ROUNDS = 2
"""Steps of a fit that begins near its end, each with derivatives of its own."""


@dataclass(frozen=True, eq=False)
class Drift:
    """Parameters and errors of a model over a recording."""

    # its parameters in each part of the recording, fitted to the part alone, with 95 % intervals by episode, by dotted
    # path.
    values: Mapping[str, tuple[Interval, ...]]
    # of each from the first to the last part along a straight line, with an interval that is corrected for the number
    # of parameters.
    changes: Mapping[str, Interval]
    # error [deg] in each part, of the model fitted to all that may be fitted, and of that fitted to the part.
    errors: tuple[tuple[float, float], ...]


class Linear:
    """Episodes to first order around a model."""

    def __init__(self, joint: PressureDriven, model: EpisodeModel) -> None:
        self._at, self._model, self._joint = joint.coordinates(model), model, joint
        left = joint.residual(model)
        slopes, parts = joint.slopes(model, left), joint.spans
        self.grams = np.stack([slopes[a:b].T @ slopes[a:b] for a, b in parts])  # by episode (E, K, K)
        self.pulls = np.stack([slopes[a:b].T @ left[a:b].ravel() for a, b in parts])  # likewise (E, K)
        self.sums, self.counts = joint.squares(left)

    def fitted(self, weights: Floats) -> EpisodeModel:
        """The model with the least squared error. `weights`: of the episodes (E,)."""
        step = solved(np.tensordot(weights, self.grams, 1), weights @ self.pulls)
        return self._joint.moved(self._model, self._at + step)

    def left(self, steps: Floats) -> Floats:
        """Squared errors (E,) after steps of the coordinates (E, K)."""
        found = self.sums + 2.0 * np.sum(self.pulls * steps, axis=1)
        return np.asarray(found + np.einsum("ek,ekl,el->e", steps, self.grams, steps))


def solved(gram: Floats, pull: Floats) -> Floats:
    """The step with the least squared error."""
    return np.asarray(-np.linalg.solve(gram + _RIDGE * np.diag(np.diag(gram)) + 1e-12 * np.eye(len(gram)), pull))


def course(joint: PressureDriven, held: Held, everything: EpisodeModel) -> Drift:
    """The model's parameters and errors over the recording, each part fitted by itself.

    `held`: which episodes are held out; the interleaved ones are not used.
    """
    best: list[dict[str, float]] = []
    spread = []
    errors = []
    for number, part in enumerate(np.array_split(np.union1d(held.pool, held.later), PARTS)):
        here = joint.take(thinned(part, _FITTED))
        found = everything
        for _ in range(_LINE_ROUNDS):
            found = Linear(here, found).fitted(np.ones(len(here)))
        best.append(here.shown(found))
        spread.append(here.draws(found, number))
        pair = (np.degrees(here.squares(here.residual(m)).rmse) for m in (everything, found))
        errors.append((float(next(pair)), float(next(pair))))
    line = np.linspace(-0.5, 0.5, PARTS)
    line /= line @ line
    values, changes = {}, {}
    for name in best[0]:
        at, drawn = np.array([one[name] for one in best]), np.array([one[name] for one in spread])
        values[name] = tuple(Interval.of(value, row) for value, row in zip(at, drawn, strict=True))
        changes[name] = Interval.of(line @ at, line @ drawn, CHANCE / len(best[0]))
    return Drift(values, changes, tuple(errors))


def forecasts(pool: Linear) -> tuple[float, ...]:
    """Errors [deg] of all windows on the episodes that follow them: the last three eighths, one after the other.

    `pool`: episodes that may be fitted.
    """
    count = len(pool.sums)
    edges = [round(count * share / PARTS) for share in (5, 6, 7, 8)]
    out = []
    for window in WINDOWS:
        total = 0.0
        for begin, end in zip(edges[:-1], edges[1:], strict=True):
            fitted = last(np.arange(begin), min(1.0, max(1, round(count * window)) / begin))
            step = solved(pool.grams[fitted].sum(axis=0), pool.pulls[fitted].sum(axis=0))
            total += float(pool.left(np.tile(step, (count, 1)))[begin:end].sum())
        out.append(float(np.degrees(np.sqrt(max(total, 0.0) / pool.counts[edges[0] :].sum()))))
    return tuple(out)


class Lines:
    """A model whose parameters follow lines through some points over a recording.

    The number of points is that with which every other fitted episode tells most of the rest. After the last fitted
    episode the parameters stay, since nothing says that the drift goes on.
    """

    def __init__(self, joint: PressureDriven, pool: Indices, model: EpisodeModel, linear: Linear) -> None:
        """`pool`: episodes that are fitted. `linear`: they to first order."""
        self._joint, self._model, self._last = joint, model, float(pool[-1])
        count = len(linear.pulls)
        other = np.arange(count) % 2 == 1
        left = []
        for points in _POINTS:
            hats = self._hats(pool, points)
            steps = hats @ _along(hats[~other], linear.grams[~other], linear.pulls[~other])
            left.append(linear.left(steps)[other].sum())
        self.points = _POINTS[int(np.argmin(left))]
        self._at = np.tile(joint.coordinates(model), (self.points, 1))
        for _ in range(_LINE_ROUNDS):
            parts = [Linear(one, here) for one, here in self._groups(pool)]
            grams, pulls = np.concatenate([one.grams for one in parts]), np.concatenate([one.pulls for one in parts])
            self._at = self._at + _along(self._hats(pool, self.points), grams, pulls)

    def _hats(self, episodes: Indices, points: int) -> Floats:
        """Shares of the points in the parameters of episodes (E, P)."""
        at = np.minimum(episodes / self._last, 1.0) * max(points - 1, 1)
        return np.maximum(1.0 - np.abs(at[:, None] - np.arange(points)), 0.0) if points > 1 else np.ones((len(at), 1))

    def _groups(self, episodes: Indices) -> list[tuple[PressureDriven, EpisodeModel]]:
        """Groups of neighbouring episodes with their models."""
        parts = [part for part in np.array_split(episodes, _GROUPS) if len(part)]
        middles = self._hats(np.array([part.mean() for part in parts]), self.points) @ self._at
        models = [self._joint.moved(self._model, at) for at in middles]
        return [(self._joint.take(part), model) for part, model in zip(parts, models, strict=True)]

    def between(self, episodes: Indices) -> Squares:
        """Squared errors of episodes among the fitted ones. `episodes`: numbers of some (K,), in order."""
        sums, counts = zip(*(one.squares(one.residual(here)) for one, here in self._groups(episodes)), strict=True)
        return Squares(np.concatenate(sums), np.concatenate(counts))

    def later(self, unseen: PressureDriven) -> Squares:
        """Squared errors of episodes after the fitted ones."""
        return unseen.squares(unseen.residual(self._joint.moved(self._model, self._at[-1])))


def _along(hats: Floats, grams: Floats, pulls: Floats) -> Floats:
    """Steps at the points of lines (P, K) with the least squared error, from products by episode."""
    points, count = hats.shape[1], pulls.shape[1]
    gram = np.einsum("ep,eq,ekl->pkql", hats, hats, grams, optimize=True).reshape(points * count, points * count)
    return solved(gram, (hats.T @ pulls).ravel()).reshape(points, count)
