"""A model whose parameters follow straight lines over a recording: it shows what drift costs a constant model.

Each parameter has a value at the last fitted episode and a slope over the episodes. After the last fitted episode it
stays constant, since nothing says that the drift goes on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pam_antagonist.inference.episodes import EpisodeModel, Squares
from pam_antagonist.inference.held_episodes import Held, thinned
from pam_antagonist.inference.pressure_driven import PressureDriven

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

_USED, _GROUPS = 600, 12
"""Most episodes that are fitted, and groups of neighbouring ones with the same parameters."""
_ROUNDS, _ENOUGH = 15, 1e-4


class StraightLines:
    """A model with straight lines, fitted to all episodes that may be fitted."""

    def __init__(self, joint: PressureDriven, held: Held, model: EpisodeModel) -> None:
        self._model = model
        self._last = float(held.pool[-1])
        groups = self._groups(joint, thinned(held.pool, _USED))
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
            max_nfev=_ROUNDS,
        )  # fmt: skip
        self._at, self._slope = found.x[:count], found.x[count:]

    def _groups(self, joint: PressureDriven, episodes: Indices) -> list[tuple[PressureDriven, float]]:
        """Groups of episodes, each with its time: 0 at the last fitted one, in units of all of these."""
        parts = [part for part in np.array_split(episodes, _GROUPS) if len(part)]
        return [(joint.take(part), min(0.0, part.mean() / self._last - 1.0)) for part in parts]

    def between(self, joint: PressureDriven, episodes: Indices) -> Squares:
        """Squared errors of episodes among the fitted ones.

        Args:
            episodes: numbers of some (K,), in order.
        """
        found = [self._squares(one, t) for one, t in self._groups(joint, episodes)]
        sums, counts = zip(*found, strict=True)
        return Squares(np.concatenate(sums), np.concatenate(counts))

    def later(self, unseen: PressureDriven) -> Squares:
        """Squared errors of episodes after the fitted ones."""
        return self._squares(unseen, 0.0)

    def _squares(self, joint: PressureDriven, t: float) -> Squares:
        return joint.squares(joint.residual(joint.moved(self._model, self._at + t * self._slope)))
