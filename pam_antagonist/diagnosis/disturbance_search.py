"""Whether a disturbance torque explains the recordings: alone, or beside effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis import explained, findings, thresholds
from pam_antagonist.diagnosis.candidates import Model, evidence, price
from pam_antagonist.diagnosis.checkpoint import Checkpoint
from pam_antagonist.diagnosis.disturbance import estimate
from pam_antagonist.diagnosis.result import FoundEffect, Size
from pam_antagonist.diagnosis.selection import recalibrate, select
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
class Explanation:
    """A disturbance as an explanation of all recordings, with effects beside it where there are any.

    Attributes:
        share: of the held-out excess that the disturbance removes; None if nothing is held out of its recordings.
    """

    model: Model
    effects: tuple[FoundEffect, ...]
    values: Mapping[str, float]
    share: float | None
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Disturbed:
    """Recordings with the disturbance as an input.

    Attributes:
        noises: size of a random walk like the disturbance, one a recording; 0 where there was none.
        left: recordings above noise in which no disturbance can show.
    """

    experiments: tuple[Experiment, ...]
    fits: tuple[Fitted, ...]
    noises: tuple[float, ...]
    effect: FoundEffect
    left: tuple[int, ...]


def explain(
    experiments: Sequence[Experiment], base: Model, chosen: Model, jobs: int, progress: Callable[[str], None]
) -> Explanation | None:
    """Explain all recordings by a disturbance, if it comes and goes and leaves little; else None.

    The disturbance is searched for beside the base model first, then beside effects. These are the effects that explain
    the recordings in which no disturbance can show, or else the chosen ones. With the disturbance as an input, effects
    may show that it had hidden.

    Args:
        chosen: the model of the forward selection, which did not explain enough.
    """
    disturbed = _find(experiments, base, jobs)
    if disturbed is not None and not disturbed.left:
        recalibrated = Model((), disturbed.fits)
        first = explained.remaining_residuals(experiments, base.fits)
        model = select(disturbed.experiments, recalibrated, jobs, progress, Checkpoint(), first).model
        return _explanation(disturbed, recalibrated, model, jobs)
    apart = None if disturbed is None else _effects_elsewhere(experiments, base, disturbed.left, jobs, progress)
    effects, known = (chosen, ()) if disturbed is None or apart is None else (apart, disturbed.left)
    disturbed = _find(experiments, effects, jobs) if effects.effects else None
    if disturbed is None or not all(r in known or _explains(experiments, base, effects, r) for r in disturbed.left):
        return None
    return _beside_effects(disturbed, effects, jobs)


def search(
    experiments: Sequence[Experiment], base: Model, chosen: Model, verdict: str, jobs: int,
    progress: Callable[[str], None],
) -> Explanation | None:  # fmt: skip
    """A disturbance that explains what effects do not, or beside effects that do; None where there is none."""
    if verdict == "none":
        return None
    progress("looking for a disturbance torque")
    if verdict == "effect":
        return beside(experiments, chosen, jobs)
    return explain(experiments, base, chosen, jobs, progress)


def beside(experiments: Sequence[Experiment], effects: Model, jobs: int) -> Explanation | None:
    """A disturbance beside effects that are the explanation already, if the evidence for it is strong; else None."""
    disturbed = _find(experiments, effects, jobs)
    if disturbed is None or disturbed.effect.delta_bic < thresholds.DISTURBANCE_BESIDE:
        return None
    return _beside_effects(disturbed, effects, jobs)


def _beside_effects(disturbed: _Disturbed, effects: Model, jobs: int) -> Explanation:
    """A disturbance that was found beside effects, and these where they are still needed."""
    return _explanation(
        disturbed, recalibrate(disturbed.experiments, jobs, effects), Model(effects.effects, disturbed.fits), jobs
    )


def _explanation(disturbed: _Disturbed, recalibrated: Model, model: Model, jobs: int) -> Explanation:
    """A disturbance, and the effects of a model beside it that are needed."""
    effects: tuple[FoundEffect, ...] = ()
    values: dict[str, float] = {}
    warnings: list[str] = []
    if model.effects:
        model = findings.backward_elimination(disturbed.experiments, recalibrated, model, jobs)
        (effects, values, warnings), _ = findings.found(disturbed.experiments, recalibrated, model, jobs)
    fits = tuple(
        _with_noise(fitted, noise) if noise else fitted
        for fitted, noise in zip(model.fits, disturbed.noises, strict=True)
    )
    return Explanation(
        Model((*model.effects, DISTURBANCE), fits),
        tuple(sorted((*effects, disturbed.effect), key=lambda effect: -effect.delta_bic)),
        {**values, _NOISE: disturbed.effect.parameters["noise"][0]},
        disturbed.effect.holdout_gain,
        (*warnings, NOTE),
    )


def _effects_elsewhere(
    experiments: Sequence[Experiment], base: Model, still: Sequence[int], jobs: int, progress: Callable[[str], None]
) -> Model | None:
    """Effects that explain the recordings in which no disturbance can show, for all recordings; None if none do."""
    apart = [experiments[r] for r in still]
    recalibrated = Model((), tuple(base.fits[r] for r in still))
    effects = select(apart, recalibrated, jobs, progress, Checkpoint()).model
    if not explained.explains(apart, recalibrated, effects):
        return None
    fits = dict(zip(still, effects.fits, strict=True))
    shows = max(zip(apart, recalibrated.fits, effects.fits, strict=True), key=lambda seen: evidence(*seen))[2]
    for r, experiment in enumerate(experiments):
        if r not in fits:
            # A disturbance biases a fit of the effects too. So their values are taken over until it is known.
            point = Point(base.fits[r].point.theta, shows.point.effects)
            fits[r] = refit(experiment, point, shows.free, rounds=0)
    return Model(effects.effects, tuple(fits[r] for r in range(len(experiments))))


def _explains(experiments: Sequence[Experiment], base: Model, effects: Model, r: int) -> bool:
    """Whether effects explain one recording by itself."""
    return explained.explains(
        experiments[r : r + 1], Model((), base.fits[r : r + 1]), Model(effects.effects, effects.fits[r : r + 1])
    )


def _find(experiments: Sequence[Experiment], model: Model, jobs: int) -> _Disturbed | None:
    """A disturbance in every recording above noise that can show one, if it explains all of them; else None."""
    noisy = [r for r, (e, f) in enumerate(zip(experiments, model.fits, strict=True)) if _is_above_noise(e, f)]
    found = Parallel(n_jobs=jobs, prefer="threads")(delayed(estimate)(experiments[r], model.fits[r]) for r in noisy)
    seen, left, gained = {}, [], 0.0
    now, fits = list(experiments), list(model.fits)
    for r, one in zip(noisy, found, strict=True):
        experiment, fitted = experiments[r], model.fits[r]
        if one is None:
            left.append(r)
            continue
        if not one.explains:
            return None
        seen[r] = one
        now[r], fits[r] = one.experiment, one.fitted
        gain = cost_of(experiment, fitted.point, fitted.residual, fitted.scale)
        gain -= cost_of(experiment, one.fitted.point, one.fitted.residual, fitted.scale)
        gained += fitted.scale.share * gain - price(fitted, thresholds.PARAMETERS_OF_EPISODE * one.episodes)
    if not seen:
        return None
    noise = float(np.sqrt(np.mean([one.noise**2 for one in seen.values()])))
    spread = float(np.ptp([one.noise for one in seen.values()])) / 2.0
    # Relative error of a root mean square over n episodes: 1/√(2 n).
    std = max(spread, noise / np.sqrt(2.0 * sum(one.episodes for one in seen.values())))
    effect = FoundEffect(
        DISTURBANCE,
        None,
        {"noise": Size(noise, std, "N m/s^0.5")},
        gained,
        min((one.shares[0] for one in seen.values() if one.shares[0] is not None), default=None),
        tuple(experiments[r].trial.name for r in seen),
        (NOTE,),
    )
    noises = tuple(seen[r].noise if r in seen else 0.0 for r in range(len(experiments)))
    return _Disturbed(tuple(now), tuple(fits), noises, effect, tuple(left))


def _is_above_noise(experiment: Experiment, fitted: Fitted) -> bool:
    return float(np.max(experiment.times_noise(fitted.residual))) >= thresholds.CLEAN


def _with_noise(fitted: Fitted, noise: float) -> Fitted:
    """A model with an unknown torque as a random walk, as an estimator has it."""
    return replace(fitted, point=Point(fitted.point.theta, {**fitted.point.effects, _NOISE: noise}))
