"""The best of fits from several starts: what has shapes may have more than one minimum."""

from __future__ import annotations

import zlib

import numpy as np

from pam_antagonist.inference.calibration import is_calibration
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, refit
from pam_antagonist.inference.point import Point

AT_NOISE = 1.1
"""A channel is at its noise whose residual is at most so many times as large: a minute shows it to a few per cent."""
MAY_BE_NOISE = 4.0
"""A channel may be down to its noise by a further fit whose residual is at most so many times as large."""
STARTS = 2
"""Starts of a fit that are drawn, beside the first."""
_TRIED = 2
_HOPELESS = 40.0
"""A start is not followed that is so much behind after these steps, in −2 log posterior."""
_SPREAD = float(np.log(6.0))
"""Shapes are drawn up to so far from their scale in the catalogue, in logarithms."""


def best_of_starts(experiment: Experiment, fitted: Fitted, starts: int = STARTS, finer: bool = True) -> Fitted:
    """The best of fits from several starts; one that may be down to noise alone is fitted as a model that is right.

    Its derivatives by the base coordinates may be those of a point nearby;
    :func:`~pam_antagonist.inference.gauss_newton.relinearised` renews them.

    `finer`: whether a fit that ends at the noise of every channel may count every block.
    """
    best = min((fitted, *_from_elsewhere(experiment, fitted, starts)), key=lambda found: found.cost)
    if finer and np.max(experiment.times_noise(best.residual)) <= MAY_BE_NOISE:
        every = refit(
            experiment, best.point, best.free, best.base, renewals=2, blocks_per_error=1.0, careful=0, beside=best
        )  # fmt: skip
        best = every if np.max(experiment.times_noise(every.residual)) < AT_NOISE else best
    return best


def _from_elsewhere(experiment: Experiment, fitted: Fitted, starts: int) -> list[Fitted]:
    """Fits from other starts: after a few steps the best of those that are drawn, to its end if it may get there."""
    if starts == 0 or all(is_calibration(parameter.path) for parameter in fitted.free):
        return []
    # Each model has draws of its own, whatever was fitted before it and on which thread.
    name = zlib.crc32(" ".join(parameter.path for parameter in fitted.free).encode())
    rng = np.random.default_rng([experiment.seed, name])
    drawn = [
        refit(
            experiment,
            _drawn(fitted, rng),
            fitted.free,
            fitted.base,
            rounds=_TRIED,
            renewals=0,
            careful=0,
            beside=fitted,
            exact=False,
        )
        for _ in range(starts)
    ]
    best = min(drawn, key=lambda found: found.cost)
    if best.cost > fitted.cost + _HOPELESS:
        return []
    return [refit(experiment, best.point, best.free, best.base, renewals=0, beside=fitted)]


def _drawn(fitted: Fitted, rng: np.random.Generator) -> Point:
    """Another start: sizes of another magnitude, also where one was 0, and any shape that makes sense."""
    effects = dict(fitted.point.effects)
    for parameter in fitted.free:
        value, item = effects.get(parameter.path, parameter.item.neutral), parameter.item
        if is_calibration(parameter.path):
            continue
        if item.is_size:
            drawn = (value if value and rng.random() < 0.5 else item.scale) * float(np.exp(rng.normal()))
            drawn = -drawn if item.low < 0.0 and rng.random() < 0.25 else drawn
        else:
            drawn = item.scale * float(np.exp(rng.uniform(-_SPREAD, _SPREAD)))
        effects.update(dict.fromkeys(parameter.paths, parameter.bounded(drawn)))
    return Point(fitted.point.theta, effects)
