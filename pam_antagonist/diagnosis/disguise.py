"""An effect in disguise: one that base parameters imitate, which have to leave what the rig file allows for it.

A fit may move a base parameter by many standard deviations of its prior, if enough data ask for it. Then nothing is
left to explain, and the effect is not looked for. So it is looked for once more beside a base that is held near the
file.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.hypotheses import Ranking, Work
from pam_antagonist.diagnosis.models import Model, held_out_evidence, likelier, price, recalibrated
from pam_antagonist.diagnosis.search import hypotheses, search
from pam_antagonist.diagnosis.warnings import implausible
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, refit
from pam_antagonist.inference.point import Point

_HELD = 5.0
"""The priors of a base that is held are narrower by this factor."""
_FREEDOM = 4.0
"""Degrees of freedom of Student's distribution."""


def unmasked(base: Model, work: Work) -> Ranking | None:
    """What explains the recordings with a base that the rig file allows; None if nothing does.

    `base`: model without effects that explains what was fitted: not as the file allows, or not what was held out.
    """
    if not all(experiment.runs_by_itself for experiment in base.experiments):
        return None
    work.progress("whether an effect explains what the rig file's numbers hardly can")
    held = tuple(replace(experiment, narrower=_HELD) for experiment in base.experiments)
    ranking = search(recalibrated(held), work, hypotheses())
    model = _free(ranking.model)
    if not model.effects or not model.is_at_noise or implausible(model):
        return None
    gain = sum(_evidence(*one) for one in zip(base.experiments, base.fits, model.fits, strict=True))
    return replace(ranking, base=_free(ranking.base), model=model) if gain >= thresholds.STRONG else None


def _evidence(experiment: Experiment, before: Fitted, after: Fitted) -> float:
    """Evidence for a model in one recording."""
    data = likelier(before.scale, before.residual, after.residual) + held_out_evidence(experiment, before, after)
    prior = _far(experiment, before.point) - _far(experiment, after.point)
    return data + prior - price(before, len(after.free) - len(before.free))


def _far(experiment: Experiment, point: Point) -> float:
    """How far base parameters are from the rig file, as twice a log likelihood of Student's distribution.

    A single number of a file is wrong by far more often than by a Gaussian prior: a supply that was set anew. One joint
    was in view, whose supply was 6 % off: both sensors' gains would have explained as much.
    """
    away = [amount / direction.prior for direction, amount in zip(experiment.directions, point.theta, strict=False)]
    return float(np.sum((_FREEDOM + 1.0) * np.log1p(np.square(away) / _FREEDOM)))


def _free(model: Model) -> Model:
    """A model whose base has the priors of the rig file again."""
    free = tuple(replace(experiment, narrower=1.0) for experiment in model.experiments)
    return replace(model, experiments=free).map(lambda experiment, fitted: refit(experiment, fitted.point, fitted.free))
