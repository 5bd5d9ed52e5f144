"""When an effect is called found, when nothing is wrong, and when the answer is that it is not known.

Evidence (ΔBIC, likelihood of held-out data, noise) has its statistical reason. The shares below have none but
experience: they were set by what right and wrong explanations took away of the excess (:mod:`beyond`) in recordings of
simulated joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pam_antagonist.diagnosis.select import POSITIVE, STRONG, Model, Trial, price
from pam_antagonist.diagnosis.shares import left_by, whole_share
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import AT_NOISE, Fitted

FIRST_SHARE = 0.05
"""The first effect must remove this share of the held-out excess: a law that holds does so on data it never saw. Where
another effect is there too, it need not be much."""
FURTHER_SHARE = 0.12
"""A further one must remove this share of all of the excess, fitted and held out together: most of what the first one
leaves may be due to its form, and does not foretell. What imitated that took away 0.09 at most, a second effect that
was there 0.15."""
EXPLAINED = 0.4
"""Share of the excess, fitted and held out together, that effects must remove to be called the explanation.

That they foretell is asked before (:func:`worth`). Here a single event of a third of a recording would decide too much
if only that third counted. One effect in another form than the catalogue's removed 0.5 of it or more, but for a
friction that cannot be foretold, and two of them 0.6; those that imitate what is in no catalogue 0.26, two of them
0.35."""
MOST = 0.6
"""Where effects remove less of it, what is left is worth a warning: their form, or something else."""
_LEAST_UNKNOWNS = 2


def worth(trial: Trial) -> bool:
    """Whether a refitted candidate goes into the model.

    It pays where it was fitted and where nothing was. It is strong where nothing was, and both together are as much as
    strong evidence twice: a slow effect is seen few times in each part, and pays its price in the first one only. Or
    both together are twice that: beside something else that the model lacks, a law foretells less.

    Args:
        trial: the candidate beside the model.
    """
    if trial.delta_bic is None or trial.foretold is None or trial.shares is None or trial.model is None:
        return False
    if min(trial.delta_bic, trial.foretold) < POSITIVE:
        return False
    enough = 2.0 * STRONG if trial.foretold >= STRONG else 4.0 * STRONG
    removes = trial.shares[0] >= FIRST_SHARE if trial.round == 1 else (trial.share or 0.0) >= FURTHER_SHARE
    return trial.standing >= enough and removes


def has_significant_excess(experiments: Sequence[Experiment], fits: Sequence[Fitted]) -> bool:
    """Whether an effect that explained everything beyond the sensors' noise would pay for itself."""
    total = 0.0
    for experiment, fitted in zip(experiments, fits, strict=True):
        over = experiment.times_noise(fitted.residual)
        if np.max(over) < AT_NOISE:
            continue
        squares = over**2
        gain = len(fitted.residual) / fitted.scale.counted * np.sum(np.maximum(np.log(squares), 0.0))
        total += max(float(gain) - price(experiment, fitted, _LEAST_UNKNOWNS), 0.0)
    return total >= STRONG


def explains(experiments: Sequence[Experiment], base: Model, model: Model) -> bool:
    """Whether a model with effects leaves so little of what the one without leaves that they are the explanation."""
    if not model.effects:
        return False
    return share_of_all(experiments, base, model) >= EXPLAINED or at_noise(experiments, model)


def explains_in_part(experiments: Sequence[Experiment], base: Model, model: Model) -> bool:
    """Whether effects that are the explanation leave something that is worth a warning."""
    return share_of_all(experiments, base, model) < MOST and not at_noise(experiments, model)


def share_of_all(experiments: Sequence[Experiment], base: Model, model: Model) -> float:
    """Share of the excess, fitted and held out together, that a model removes."""
    return whole_share(experiments, *(left_by(experiments, m.fits) for m in (base, model)))


def at_noise(experiments: Sequence[Experiment], model: Model) -> bool:
    """Whether nothing is left beyond the sensors' noise."""
    return all(
        float(np.max(experiment.times_noise(fitted.residual))) < AT_NOISE
        for experiment, fitted in zip(experiments, model.fits, strict=True)
    )
