"""Whether what no law explains is something that pushes the joint now and then, alone or beside laws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis import findings, pushes, rules
from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.diagnosis.select import STRONG, Model, evidence, price, recalibrated, select
from pam_antagonist.diagnosis.shares import left_by
from pam_antagonist.diagnosis.store import Store
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, refit
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE, parameter_path

NOTE = (
    "a push is known only afterwards: the model alone cannot foresee it, and its errors stay; the estimator has it as "
    "a state"
)
_NOISE = parameter_path(DISTURBANCE, CATALOGUE[DISTURBANCE].parameters[0].name)
_CLEAN = 2.0
"""A recording in which nothing can push is that clean, in multiples of the noise."""
_UNKNOWNS = 3
"""Begin, end and height of each push."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Pushes as an explanation of all recordings, with laws beside them where there are any.

    Attributes:
        model: with the laws, and with a torque that is not known beforehand where something pushed.
        effects: what was found, the strongest first.
        values: of the effects, for one rig.
        share: of the held-out excess that the pushes take away.
        warnings: what there is to say of them.
    """

    model: Model
    effects: tuple[FoundEffect, ...]
    values: Mapping[str, float]
    share: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Pushed:
    """Recordings with the pushes as an input.

    Attributes:
        experiments: with the torque.
        fits: their models beside it.
        noises: size of the random walk that the pushes look like, one a recording; 0 where there were none.
        effect: the pushes.
        left: which recordings have more than noise though nothing can have pushed there.
    """

    experiments: tuple[Experiment, ...]
    fits: tuple[Fitted, ...]
    noises: tuple[float, ...]
    effect: FoundEffect
    left: tuple[int, ...]


def explain(
    experiments: Sequence[Experiment], base: Model, chosen: Model, jobs: int, said: Callable[[str], None]
) -> Explanation | None:
    """Explain all recordings by pushes, if they come and go and leave little; else None.

    They are looked for beside the base model, and where they are none there, beside laws: those that explain a
    recording in which nothing can have pushed, told from it alone, or those that were chosen. With the pushes as an
    input, laws may show that they had hidden.

    Args:
        experiments: the recordings.
        base: the recalibrated model.
        chosen: the model of the forward selection, which did not explain enough.
        jobs: threads.
        said: told what is being done.
    """
    pushed = _find(experiments, base, jobs)
    if pushed is not None and not pushed.left:
        quiet = Model((), pushed.fits)
        first = left_by(experiments, base.fits)
        model = select(pushed.experiments, quiet, jobs, rules.worth, said, Store(), first).model
        return _explanation(pushed, quiet, model, jobs)
    apart = None if pushed is None else _told_apart(experiments, base, pushed.left, jobs, said)
    laws, explained = (chosen, ()) if pushed is None or apart is None else (apart, pushed.left)
    pushed = _find(experiments, laws, jobs) if laws.effects else None
    if pushed is None or not all(r in explained or _explain(experiments, base, laws, r) for r in pushed.left):
        return None
    return _with_laws(pushed, laws, jobs)


def beside(experiments: Sequence[Experiment], laws: Model, jobs: int) -> Explanation | None:
    """Pushes beside laws that are the explanation already, if what is left shows them beyond doubt; else None.

    Args:
        experiments: the recordings.
        laws: the model with effects.
        jobs: threads.
    """
    pushed = _find(experiments, laws, jobs)
    # Laws of another form leave something that comes and goes as well: here pushes must pay, as a law must.
    if pushed is None or pushed.effect.delta_bic < 2.0 * STRONG:
        return None
    return _with_laws(pushed, laws, jobs)


def _with_laws(pushed: _Pushed, laws: Model, jobs: int) -> Explanation:
    """Pushes that were found beside laws, and these where they are still needed."""
    return _explanation(pushed, recalibrated(pushed.experiments, jobs), Model(laws.effects, pushed.fits), jobs)


def _explanation(pushed: _Pushed, quiet: Model, model: Model, jobs: int) -> Explanation:
    """Pushes, and the laws of a model beside them that are needed.

    Args:
        pushed: the recordings with the pushes.
        quiet: the recalibrated model beside the pushes.
        model: likewise, with laws.
        jobs: threads.
    """
    laws: tuple[FoundEffect, ...] = ()
    values: dict[str, float] = {}
    warnings: list[str] = []
    if model.effects:
        model = findings.without_idle(pushed.experiments, quiet, model, jobs)
        laws, values, warnings = findings.found(pushed.experiments, quiet, model, jobs)
    fits = tuple(
        _restless(fitted, noise) if noise else fitted for fitted, noise in zip(model.fits, pushed.noises, strict=True)
    )
    return Explanation(
        Model((*model.effects, DISTURBANCE), fits),
        tuple(sorted((*laws, pushed.effect), key=lambda effect: -effect.delta_bic)),
        {**values, _NOISE: pushed.effect.parameters["noise"][0]},
        pushed.effect.holdout_gain,
        (*warnings, NOTE),
    )


def _told_apart(
    experiments: Sequence[Experiment], base: Model, still: Sequence[int], jobs: int, said: Callable[[str], None]
) -> Model | None:
    """Laws that explain the recordings in which nothing can push, for all recordings; None where none do."""
    apart = [experiments[r] for r in still]
    quiet = Model((), tuple(base.fits[r] for r in still))
    laws = select(apart, quiet, jobs, rules.worth, said, Store()).model
    if not rules.explains(apart, quiet, laws):
        return None
    fits = dict(zip(still, laws.fits, strict=True))
    told = max(zip(apart, quiet.fits, laws.fits, strict=True), key=lambda seen: evidence(*seen))[2]
    for r, experiment in enumerate(experiments):
        if r not in fits:
            # What pushes bends a fit of the laws as well: their values are taken over until the pushes are known.
            point = Point(base.fits[r].point.theta, told.point.effects)
            fits[r] = refit(experiment, point, told.free, rounds=0)
    return Model(laws.effects, tuple(fits[r] for r in range(len(experiments))))


def _explain(experiments: Sequence[Experiment], base: Model, laws: Model, r: int) -> bool:
    """Whether laws explain one recording by itself."""
    return rules.explains(
        experiments[r : r + 1], Model((), base.fits[r : r + 1]), Model(laws.effects, laws.fits[r : r + 1])
    )


def _find(experiments: Sequence[Experiment], model: Model, jobs: int) -> _Pushed | None:
    """Pushes that explain what a model leaves, in every recording in which it leaves something and they can be."""
    unclean = [r for r, (e, f) in enumerate(zip(experiments, model.fits, strict=True)) if _leaves(e, f)]
    found = Parallel(n_jobs=jobs, prefer="threads")(
        delayed(pushes.find)(experiments[r], model.fits[r]) for r in unclean
    )
    seen, left, evidence = {}, [], 0.0
    now, fits = list(experiments), list(model.fits)
    for r, push in zip(unclean, found, strict=True):
        experiment, fitted = experiments[r], model.fits[r]
        if push is None:
            left.append(r)
            continue
        if not push.explains:
            return None
        seen[r] = push
        now[r], fits[r] = push.experiment, push.fitted
        gain = cost_of(experiment, fitted.point, fitted.residual, fitted.scale)
        gain -= cost_of(experiment, push.fitted.point, push.fitted.residual, fitted.scale)
        evidence += fitted.scale.share * gain - price(experiment, fitted, _UNKNOWNS * push.episodes)
    if not seen:
        return None
    noise = float(np.sqrt(np.mean([push.noise**2 for push in seen.values()])))
    spread = float(np.ptp([push.noise for push in seen.values()])) / 2.0
    # A root of a mean square over so many pushes is known to its inverse root.
    std = max(spread, noise / np.sqrt(2.0 * sum(push.episodes for push in seen.values())))
    effect = FoundEffect(
        DISTURBANCE,
        None,
        {"noise": (noise, std, "N m/s^0.5")},
        evidence,
        min(push.shares[0] for push in seen.values()),
        tuple(experiments[r].trial.name for r in seen),
        (NOTE,),
    )
    noises = tuple(seen[r].noise if r in seen else 0.0 for r in range(len(experiments)))
    return _Pushed(tuple(now), tuple(fits), noises, effect, tuple(left))


def _leaves(experiment: Experiment, fitted: Fitted) -> bool:
    return float(np.max(experiment.times_noise(fitted.residual))) >= _CLEAN


def _restless(fitted: Fitted, noise: float) -> Fitted:
    """A model with a torque that is not known beforehand: an estimator's model."""
    return replace(fitted, point=Point(fitted.point.theta, {**fitted.point.effects, _NOISE: noise}))
