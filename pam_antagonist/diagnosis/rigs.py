"""Rig files of what was found: one for each recording, and one for all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.select import Model
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.gauss_newton import Fitted
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_OWN = 0.01
"""Relative scatter between recordings that a weighted mean expects."""
_FAR = 5.0
"""Parameters of one rig are not so many standard deviations of their priors apart,"""
_CERTAIN = 5.0
"""if that is so many standard deviations of the fits."""


def own_rig(experiment: Experiment, point: Point) -> Rig:
    """The rig with the base parameters and effects of one recording."""
    return with_effects(moved(experiment.rig, experiment.changes(point)), point.effects)


def common_rig(experiments: Sequence[Experiment], model: Model, effects: Mapping[str, float]) -> Rig:
    """The rig with base parameters that suit all recordings, each weighted by how well it tells them.

    Args:
        experiments: the recordings.
        model: their models.
        effects: values of the effects' parameters by dotted path.
    """
    if len(experiments) == 1:
        return own_rig(experiments[0], model.fits[0].point)
    return own_rig(experiments[0], common_point(experiments, model, effects))


def common_point(experiments: Sequence[Experiment], model: Model, effects: Mapping[str, float]) -> Point:
    """The same as a point, of which a recording needs its own start only.

    Args:
        experiments: the recordings.
        model: their models.
        effects: values of the effects' parameters by dotted path.
    """
    first = experiments[0]
    count = len(first.directions)
    theta = np.zeros(first.size)
    if len(experiments) == 1:
        theta[:count] = model.fits[0].point.theta[:count]
        return Point(theta, dict(model.fits[0].point.effects))
    information, pull = np.diag(first.prior[:count]), np.zeros(count)
    for fitted in model.fits:
        covariance = fitted.covariance[:count, :count] + _OWN**2 * np.eye(count)
        weight = np.linalg.inv(covariance)
        # The prior is in every recording's covariance; it counts once.
        weight -= np.linalg.inv(np.diag(1.0 / first.prior[:count]) + _OWN**2 * np.eye(count))
        information += weight
        pull += weight @ fitted.point.theta[:count]
    theta[:count] = np.linalg.solve(information, pull)
    return Point(theta, dict(effects))


def farthest_apart(experiment: Experiment, one: Fitted, other: Fitted) -> tuple[str, float] | None:
    """Where two models of the same joint condition are of different rigs: name and relative difference, else None.

    Args:
        experiment: one of the two, whose directions they share.
        one: its model.
        other: that of the other.
    """
    count = len(experiment.directions)
    apart = one.point.theta[:count] - other.point.theta[:count]
    variances = np.diag(one.covariance)[:count] + np.diag(other.covariance)[:count]
    bound = np.maximum(
        _FAR * np.array([direction.prior for direction in experiment.directions]), _CERTAIN * np.sqrt(variances)
    )
    worst = int(np.argmax(np.abs(apart) / bound))
    return (experiment.directions[worst].name, float(apart[worst])) if abs(apart[worst]) > bound[worst] else None


def with_effects(rig: Rig, effects: Mapping[str, float]) -> Rig:
    """A rig with effects; those without size are left out, with their shapes."""
    chosen: dict[str, dict[str, float]] = {}
    for path, value in effects.items():
        _, effect, name = path.split(".")
        chosen.setdefault(effect, {})[name] = float(value)
    kept = {}
    for effect, values in chosen.items():
        sizes = {item.name for item in CATALOGUE[effect].parameters if item.is_size}
        if any(values.get(name) for name in sizes):
            kept[effect] = {name: value for name, value in values.items() if name not in sizes or value != 0.0}
    return rig.replaced(effects={**rig.effects, **kept})
