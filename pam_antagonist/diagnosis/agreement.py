"""One rig for all recordings, and contradictions between them.

Every recording has base parameters and effects of its own. The common rig is what all of them say together, each
weighted by how well it determines a number, and by how far the recordings differ in it. Recordings of one rig may not
differ by more than a rig does from day to day. The bound is wider than that of an identification, which compares fits
on held-out data. Here each recording is fitted by itself, before its effects are known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import calibrations, thresholds
from pam_antagonist.diagnosis.models import Model, evidence, in_threads
from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.inference import calibration
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.gauss_newton import Fitted, refit
from pam_antagonist.inference.point import Point
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE, random_part
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]


def own_rig(experiment: Experiment, point: Point, start: Rig | None = None) -> Rig:
    """The rig with the base parameters and effects of one recording."""
    here = experiment if start is None else replace(experiment, rig=start)
    return with_effects(moved(here.rig, here.changes(point)), point.effects)


def common_rig(model: Model, effects: Mapping[str, float], start: Rig | None = None) -> Rig:
    """The rig with base parameters for all recordings, each weighted by how well it determines them."""
    point = model.fits[0].point if len(model.fits) == 1 else common_point(model, effects)
    return own_rig(model.experiments[0], point, start)


def with_tuning(rig: Rig, tuned: Rig | None) -> Rig:
    """A rig with the tuning and the uncertainty of another one, and with that rig's effects that noise drives."""
    if tuned is None:
        return rig
    random = {name: {**rig.effects.get(name, {}), **values} for name, values in random_part(tuned.effects).items()}
    return rig.replaced(
        sensors=tuned.sensors, tunings=tuned.tunings, effects={**rig.effects, **random}, uncertainty=tuned.uncertainty,
        directions=tuned.directions,
    )  # fmt: skip


def common_point(model: Model, effects: Mapping[str, float]) -> Point:
    """The base parameters and effects of :func:`common_rig` as a point; a recording adds only its own start to it."""
    first = model.experiments[0]
    count = len(first.directions)
    theta = np.zeros(first.size)
    if len(model.fits) == 1:
        theta[:count] = model.fits[0].point.theta[:count]
        return Point(theta, dict(model.fits[0].point.effects))
    theta[:count] = combined(
        [fitted.point.theta[:count] for fitted in model.fits],
        [fitted.covariance[:count, :count] for fitted in model.fits],
        first.prior[:count],
    )
    return Point(theta, {**effects, **calibrations.common(model)})


def combined(values: Sequence[Floats], covariances: Sequence[Floats], prior: Floats) -> Floats:
    """What recordings with values (K,) and covariances (K, K) say together; their common prior counts once.

    They scatter about the rig as far as they differ by more than their errors, number by number.

    `prior`: precisions (K,) of the prior about 0, which is in each covariance.
    """
    scatter = np.diag(_scatter(np.array(values), np.array([np.diag(one) for one in covariances]), prior))
    information, pull = np.diag(prior), np.zeros(len(prior))
    for value, covariance in zip(values, covariances, strict=True):
        precision = np.linalg.inv(covariance)
        own = precision - np.diag(prior)  # what the recording says beside the prior
        widened = np.linalg.inv(np.eye(len(prior)) + own @ scatter)
        information += widened @ own
        pull += widened @ (precision @ value)
    return np.asarray(np.linalg.solve(information, pull))


def _scatter(values: Floats, variances: Floats, prior: Floats) -> Floats:
    """Variance (K,) by which values (N, K) differ beyond their errors, by the estimate of DerSimonian and Laird (1986).

    `variances`: of each value, with the prior in it (N, K), as is its pull in the values.
    """
    weight = 1.0 / variances - prior
    says = weight > prior  # a recording that says less than the prior follows other numbers
    weight = np.where(says, weight, 0.0)
    alone = values / np.where(says, variances * weight, 1.0)  # as it were without the prior
    total = np.maximum(weight.sum(axis=0), prior)
    off = (weight * (alone - (weight * alone).sum(axis=0) / total) ** 2).sum(axis=0)
    excess = np.maximum(off - (says.sum(axis=0) - 1), 0.0) / np.maximum(total - (weight**2).sum(axis=0) / total, prior)
    return np.asarray(np.where(says.sum(axis=0) > 1, excess, 0.0))


def farthest_apart(experiment: Experiment, one: Fitted, other: Fitted) -> tuple[str, str] | None:
    """Name and size of the largest difference between two models if it is too large for one rig; else None.

    A fit that ran out of its priors imitates something else with its base parameters: it is no evidence.
    """
    count = len(experiment.directions)
    priors = np.array([direction.prior for direction in experiment.directions])
    if any(np.any(np.abs(fit.point.theta[:count]) > thresholds.OUT_OF_PRIORS * priors) for fit in (one, other)):
        return None
    apart = one.point.theta[:count] - other.point.theta[:count]
    variances = np.diag(one.covariance)[:count] + np.diag(other.covariance)[:count]
    bound = np.maximum(thresholds.OTHER_RIG_PRIORS * priors, thresholds.OTHER_RIG_STD * np.sqrt(variances))
    worst = int(np.argmax(np.abs(apart) / bound))
    direction = experiment.directions[worst]
    return (direction.name, direction.in_words(float(apart[worst]))) if abs(apart[worst]) > bound[worst] else None


def with_effects(rig: Rig, effects: Mapping[str, float]) -> Rig:
    """A rig with effects; those without size are left out, with their shapes."""
    chosen: dict[str, dict[str, float]] = {}
    for path, value in calibration.without(effects).items():
        _, effect, name = path.split(".")
        chosen.setdefault(effect, {})[name] = float(value)
    kept = {}
    for effect, values in chosen.items():
        sizes = {item.name for item in CATALOGUE[effect].parameters if item.is_size}
        if any(values.get(name) for name in sizes):
            kept[effect] = {name: value for name, value in values.items() if name not in sizes or value != 0.0}
    return rig.replaced(effects={**rig.effects, **kept})


def base_contradictions(base: Model, held_out: Sequence[Experiment] = ()) -> list[str]:
    """Base parameters in which recordings of the same joint condition differ more than one rig does from day to day.

    `held_out`: recordings that are held out as a whole; they are fitted here, and these fits are used for nothing else.
    """
    known = calibrations.common(base)

    def own(other: Experiment) -> Fitted:
        whole = replace(other, fitted=other.trial.whole_blocks(len(other.trial)), judged=(), seed=0)
        return refit(whole, Point(whole.origin.theta, known))

    fits = in_threads(own, ((other,) for other in held_out), base.jobs)
    pairs, warnings = [*base.pairs, *zip(held_out, fits, strict=True)], []
    for k, (one, fitted) in enumerate(pairs):
        # Two that are held out say nothing of the model that is judged by them.
        for other, theirs in base.pairs[:k]:
            if one.trial.joint != other.trial.joint:
                continue
            apart = farthest_apart(one, fitted, theirs)
            if apart is not None:
                warnings.append(
                    f"the recordings contradict each other: {apart[0]} is {apart[1]} in {one.trial.name} from that in "
                    f"{other.trial.name}; are both recordings of one rig?"
                )
    return warnings


def effect_contradictions(model: Model, found: Sequence[FoundEffect], values: Mapping[str, float]) -> list[str]:
    """Effects that some recordings show and others rule out.

    A recording that does not show an effect may be unable to show it. It rules the effect out if the others' value
    costs it strong evidence, with its base parameters fitted anew.
    """
    names = [effect.name for effect in found]
    tasks = [
        (effect, *pair)
        for effect in found
        if effect.name != DISTURBANCE and names.count(effect.name) == 1
        for pair in model.pairs
        if pair[0].trial.name not in effect.recordings
    ]
    losses = in_threads(_loss, ((*pair, f"effects.{effect.name}.", values) for effect, *pair in tasks), model.jobs)
    return [
        f"the recordings contradict each other: {' and '.join(effect.recordings)} shows {effect.name}, "
        f"{experiment.trial.name} rules it out (evidence {loss:.0f} against it)"
        for (effect, experiment, _), loss in zip(tasks, losses, strict=True)
        if loss > thresholds.STRONG
    ]


def _loss(experiment: Experiment, fitted: Fitted, prefix: str, values: Mapping[str, float]) -> float:
    """Evidence against the others' values of an effect, whose parameters have a prefix."""
    own = {path: value for path, value in fitted.point.effects.items() if not path.startswith(prefix)}
    theirs = {path: value for path, value in values.items() if path.startswith(prefix)}
    before, after = (
        refit(experiment, Point(fitted.point.theta, effects), blocks_per_error=fitted.scale.blocks_per_error)
        for effects in (own, {**own, **theirs})
    )
    return -evidence(experiment, before, after)
