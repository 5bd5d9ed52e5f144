"""Whether a disturbance torque explains the recordings: alone, or beside effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from typing_extensions import override

from pam_antagonist.diagnosis import findings, thresholds
from pam_antagonist.diagnosis.catalogue_effects import CatalogueEffect
from pam_antagonist.diagnosis.disturbance import estimate
from pam_antagonist.diagnosis.hypotheses import Ranking, TriedCandidate, Work
from pam_antagonist.diagnosis.models import Model, evidence, explains, in_threads, price, recalibrated
from pam_antagonist.diagnosis.result import FoundEffect, Size
from pam_antagonist.diagnosis.search import search
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, refit
from pam_antagonist.inference.point import Point
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE, parameter_path

NOTE = (
    "a disturbance torque is known only afterwards: the model alone cannot foresee it, and its errors stay; the "
    "estimator has it as a state"
)
_NOISE = parameter_path(DISTURBANCE, CATALOGUE[DISTURBANCE].parameters[0].name)


@dataclass(frozen=True, eq=False)
class Disturbed(TriedCandidate):
    """Recordings with a disturbance as an input."""

    noises: tuple[float, ...] = ()  # size of a random walk like it, one a recording; 0 where there is none
    left: tuple[int, ...] = ()  # recordings above noise in which no disturbance can show
    found: FoundEffect | None = None  # what a report says of it


class DisturbanceTorque(CatalogueEffect):
    """A torque that comes and goes, in every recording above noise that can show one, if it explains all of these."""

    @override
    def propose(self, now: Ranking, number: int, work: Work) -> list[TriedCandidate]:
        work.progress("looking for a disturbance torque")
        model = now.model
        noisy = [r for r, pair in enumerate(model.pairs) if _is_above_noise(*pair)]
        every = in_threads(estimate, (model.pairs[r] for r in noisy), model.jobs)
        seen = {r: one for r, one in zip(noisy, every, strict=True) if one is not None}
        if not seen or not all(one.explains for one in seen.values()):
            return []
        gained, experiments, fits = 0.0, list(model.experiments), list(model.fits)
        for r, one in seen.items():
            experiment, fitted = model.pairs[r]
            experiments[r], fits[r] = one.experiment, one.fitted
            gain = cost_of(experiment, fitted.point, fitted.residual, fitted.scale)
            gain -= cost_of(experiment, one.fitted.point, one.fitted.residual, fitted.scale)
            gained += fitted.scale.share * gain - price(fitted, thresholds.PARAMETERS_OF_EPISODE * one.episodes)
        noise = float(np.sqrt(np.mean([one.noise**2 for one in seen.values()])))
        spread = float(np.ptp([one.noise for one in seen.values()])) / 2.0
        # Relative error of a root mean square over n episodes: 1/√(2 n).
        std = max(spread, noise / np.sqrt(2.0 * sum(one.episodes for one in seen.values())))
        shares = (one.shares[0] for one in seen.values() if one.shares[0] is not None)
        there = tuple(model.experiments[r].trial.name for r in seen)
        size = {"noise": Size(noise, std, "N m/s^0.5")}
        disturbed = replace(model, experiments=tuple(experiments), fits=tuple(fits))
        return [
            Disturbed(
                DISTURBANCE, number, np.nan, gained, model=disturbed, base=disturbed,
                noises=tuple(seen[r].noise if r in seen else 0.0 for r in range(len(fits))),
                left=tuple(r for r in noisy if r not in seen),
                found=FoundEffect(DISTURBANCE, None, size, gained, min(shares, default=None), there, (NOTE,)),
            )
        ]  # fmt: skip

    @override
    def is_worth_taking(self, tried: TriedCandidate) -> bool:
        return tried.standing >= thresholds.DISTURBANCE_BESIDE


@dataclass(frozen=True, eq=False)
class Explanation:
    """A disturbance as an explanation of all recordings, with effects beside it where there are any."""

    model: Model
    effects: tuple[FoundEffect, ...]
    values: Mapping[str, float]
    # of the held-out excess that the disturbance removes; None if nothing is held out of its recordings.
    share: float | None
    warnings: tuple[str, ...]


def _asked(model: Model, work: Work) -> Disturbed | None:
    found = DisturbanceTorque().propose(Ranking(model, model), 1, work)
    return found[0] if found and isinstance(found[0], Disturbed) else None


def instead_of_effects(found: Ranking, work: Work) -> Explanation | None:
    """Explain all recordings by a disturbance, if it comes and goes and leaves little; else None.

    The disturbance is searched for beside the base model first, then beside effects. These are the effects that explain
    the recordings in which no disturbance can show, or else the chosen ones. With the disturbance as an input, effects
    may show that it had hidden.

    `found`: by the search for effects, whose model did not explain enough.
    """
    disturbed = _asked(found.base, work)
    if disturbed is not None and not disturbed.left and disturbed.base is not None:
        beside = search(disturbed.base, Work(work.progress), first=found.base).model
        return _explanation(disturbed, disturbed.base, beside, found.base)
    apart = None if disturbed is None else _effects_elsewhere(found.base, disturbed.left, work)
    effects, known = (found.model, ()) if disturbed is None or apart is None else (apart, disturbed.left)
    disturbed = _asked(effects, work) if effects.effects else None
    if disturbed is None:
        return None
    others = [[r] for r in disturbed.left if r not in known]
    if not all(explains(found.base.of(one), effects.of(one)) for one in others):
        return None
    return _beside_effects(disturbed, effects)


def beside_effects(effects: Model, work: Work) -> Explanation | None:
    """A disturbance beside effects that are the explanation already, if the evidence for it is strong; else None."""
    disturbed = _asked(effects, work)
    if disturbed is None or not DisturbanceTorque().is_worth_taking(disturbed):
        return None
    return _beside_effects(disturbed, effects)


def _beside_effects(disturbed: Disturbed, effects: Model) -> Explanation:
    """A disturbance that was found beside effects, and these where they are still needed."""
    assert disturbed.model is not None
    return _explanation(disturbed, recalibrated(disturbed.model.experiments, effects), disturbed.model, effects)


def _explanation(disturbed: Disturbed, base: Model, model: Model, recorded: Model) -> Explanation:
    """A disturbance, and the effects of a model beside it that are needed, in the recordings as they were made."""
    assert disturbed.found is not None
    effects: tuple[FoundEffect, ...] = ()
    values: dict[str, float] = {}
    warnings: list[str] = []
    if model.effects:
        model = findings.backward_elimination(base, model)
        (effects, values, warnings), _ = findings.found(base, model)
    fits = tuple(
        _with_noise(fitted, noise) if noise else fitted
        for fitted, noise in zip(model.fits, disturbed.noises, strict=True)
    )
    return Explanation(
        Model(recorded.experiments, fits, (*model.effects, DISTURBANCE)),
        tuple(sorted((*effects, disturbed.found), key=lambda effect: -effect.delta_bic)),
        {**values, _NOISE: disturbed.found.parameters["noise"].value},
        disturbed.found.holdout_gain,
        (*warnings, NOTE),
    )


def _effects_elsewhere(base: Model, still: Sequence[int], work: Work) -> Model | None:
    """Effects that explain the recordings in which no disturbance can show, for all recordings; None if none do."""
    apart = base.of(still)
    effects = search(apart, Work(work.progress)).model
    if not explains(apart, effects):
        return None
    fits = dict(zip(still, effects.fits, strict=True))
    triples = zip(apart.experiments, apart.fits, effects.fits, strict=True)
    shows = max(triples, key=lambda seen: evidence(*seen))[2]
    for r, experiment in enumerate(base.experiments):
        if r not in fits:
            # A disturbance biases a fit of the effects too. So their values are taken over until it is known.
            point = Point(base.fits[r].point.theta, shows.point.effects)
            fits[r] = refit(experiment, point, shows.free, rounds=0)
    return Model(base.experiments, tuple(fits[r] for r in range(len(base.fits))), effects.effects)


def _is_above_noise(experiment: Experiment, fitted: Fitted) -> bool:
    return float(np.max(experiment.times_noise(fitted.residual))) >= thresholds.CLEAN


def _with_noise(fitted: Fitted, noise: float) -> Fitted:
    """A model with an unknown torque as a random walk, as an estimator has it."""
    return replace(fitted, point=Point(fitted.point.theta, {**fitted.point.effects, _NOISE: noise}))
