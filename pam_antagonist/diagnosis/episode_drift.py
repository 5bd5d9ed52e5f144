"""Drift of a joint's parameters over many episodes, and the best number of last episodes to fit a model to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pam_antagonist.inference.bootstrap import CHANCE, Interval
from pam_antagonist.inference.episodes import EpisodeModel, Squares
from pam_antagonist.inference.held_episodes import Held, thinned
from pam_antagonist.inference.pressure_driven import PressureDriven

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

WINDOWS = (1.0, 0.5, 0.25, 0.125, 0.0625)
"""Windows for a model of later episodes: shares of the fitted episodes, the last of them."""
PARTS = 8
_FITTED, _JUDGED, _ROUNDS = 150, 100, 8
"""Most episodes of a part that are fitted, most that judge a forecast, and most simulations of a fit."""
_ON_LINES, _GROUPS = 600, 12
"""Most episodes that are fitted by straight lines, and groups of neighbouring ones with the same parameters."""
_LINE_ROUNDS, _ENOUGH = 15, 1e-4


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


def course(joint: PressureDriven, held: Held, everything: EpisodeModel) -> Drift:
    """The model's parameters and errors over the recording, each part fitted by itself.

    `held`: which episodes are held out; the interleaved ones are not used.
    """
    best: list[dict[str, float]] = []
    spread = []
    errors = []
    for number, part in enumerate(np.array_split(np.union1d(held.pool, held.later), PARTS)):
        here = joint.take(thinned(part, _FITTED))
        found = here.fit(everything, _ROUNDS)
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


def forecast(joint: PressureDriven, pool: Indices, model: EpisodeModel, window: float) -> float:
    """Error [deg] on the episodes that follow a window: the last three eighths of the pool, one after the other.

    `pool`: that may be fitted (E,).
    """
    eighths = np.array_split(pool, PARTS)
    sums, counts = 0.0, 0.0
    for number in (5, 6, 7):
        before = pool[: sum(len(part) for part in eighths[:number])]
        length = max(1, round(len(pool) * window))
        fitted = joint.take(thinned(before[-length:], _FITTED))
        test = joint.take(thinned(eighths[number], _JUDGED))
        found = test.squares(test.residual(fitted.fit(model, _ROUNDS)))
        sums, counts = sums + found.sums.sum(), counts + found.counts.sum()
    return float(np.degrees(np.sqrt(sums / counts)))


class StraightLines:
    """A model whose parameters follow straight lines over a recording: it shows what drift costs a constant model.

    Each parameter has a value at the last fitted episode and a slope over the episodes. After the last fitted episode
    it stays constant, since nothing says that the drift goes on. All episodes that may be fitted are.
    """

    def __init__(self, joint: PressureDriven, held: Held, model: EpisodeModel) -> None:
        self._model = model
        self._last = float(held.pool[-1])
        groups = self._groups(joint, thinned(held.pool, _ON_LINES))
        at = joint.coordinates(model)
        count = len(at)

        def residual(z: Floats) -> Floats:
            models = [joint.moved(model, z[:count] + t * z[count:]) for _, t in groups]
            return np.concatenate([one.residual(here).ravel() for (one, _), here in zip(groups, models, strict=True)])

        def jacobian(z: Floats) -> Floats:
            rows = []
            for one, t in groups:
                here = joint.moved(model, z[:count] + t * z[count:])
                slopes = one.slopes(here, one.residual(here))
                rows.append(np.hstack([slopes, t * slopes]))
            return np.vstack(rows)

        found = least_squares(
            residual, np.concatenate([at, np.zeros(count)]), jac=jacobian, x_scale="jac", ftol=_ENOUGH, xtol=_ENOUGH,
            max_nfev=_LINE_ROUNDS,
        )  # fmt: skip
        self._at, self._slope = found.x[:count], found.x[count:]

    def _groups(self, joint: PressureDriven, episodes: Indices) -> list[tuple[PressureDriven, float]]:
        """Groups of episodes, each with its time: 0 at the last fitted one, in units of all of these."""
        parts = [part for part in np.array_split(episodes, _GROUPS) if len(part)]
        return [(joint.take(part), min(0.0, part.mean() / self._last - 1.0)) for part in parts]

    def between(self, joint: PressureDriven, episodes: Indices) -> Squares:
        """Squared errors of episodes among the fitted ones. `episodes`: numbers of some (K,), in order."""
        found = [self._squares(one, t) for one, t in self._groups(joint, episodes)]
        sums, counts = zip(*found, strict=True)
        return Squares(np.concatenate(sums), np.concatenate(counts))

    def later(self, unseen: PressureDriven) -> Squares:
        """Squared errors of episodes after the fitted ones."""
        return self._squares(unseen, 0.0)

    def _squares(self, joint: PressureDriven, t: float) -> Squares:
        return joint.squares(joint.residual(joint.moved(self._model, self._at + t * self._slope)))
