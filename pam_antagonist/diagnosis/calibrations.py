"""Calibrations of sensors and clocks that recordings need: tested as effects are, and reported separately."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis import explained, far_calibrations, thresholds
from pam_antagonist.diagnosis.candidates import Model, TriedCandidate, evidence
from pam_antagonist.diagnosis.common_values import of_calibration
from pam_antagonist.diagnosis.found_calibrations import FoundCalibration
from pam_antagonist.inference import calibration
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import Candidate, FreeEffectParameter
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, effect_jacobian, prior_cost, refit, relinearised
from pam_antagonist.inference.likelihood import Equations
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.standard_errors import settled, well_known
from pam_antagonist.inference.starts import best_of_starts

_IMITATED = ("torque_scale",)
"""Calibrations that base parameters imitate exactly: muscles, inertia and friction larger by the same factor."""
_EDGE = 1e-3
"""A calibration nearer to a bound than this share of its range is at the bound."""
_STAMP_STD = 12.0**-0.5
"""[sample periods] Standard deviation of a stamp's error, which is uniform over one sample period."""


def tried(
    experiments: Sequence[Experiment], first: Sequence[explained.Residuals], model: Model, number: int, jobs: int
) -> list[TriedCandidate]:
    """Calibrations fitted beside a model, in every recording above its noise; the best first. Each is one number."""
    in_threads = Parallel(n_jobs=jobs, prefer="threads")
    before = explained.remaining_residuals(experiments, model.fits)
    noisy = [
        max(e.times_noise(np.concatenate(left))) >= thresholds.AT_NOISE
        for e, left in zip(experiments, before, strict=True)
    ]
    can = [
        experiment.calibrations(fitted.point.effects)
        for experiment, fitted in zip(experiments, model.fits, strict=True)
    ]
    tasks = {(candidate.effect, r): candidate for r, each in enumerate(can) for candidate in each if noisy[r]}

    def fitted(r: int, candidate: Candidate) -> Fitted:
        start = {free.path: 0.0 for free in candidate.free}
        return _with(experiments[r], model.fits[r], start, candidate.free)

    fits = in_threads(delayed(fitted)(r, candidate) for (_, r), candidate in tasks.items())
    done = dict(zip(tasks, fits, strict=True))
    far = [r for r, is_noisy in enumerate(noisy) if is_noisy]
    others = in_threads(delayed(far_calibrations.fits)(experiments[r], model.fits[r], can[r]) for r in far)
    for r, other in zip(far, others, strict=True):
        for name, fit in other.items():
            gains = [evidence(experiments[r], model.fits[r], one) for one in (done[name, r], fit)]
            done[name, r] = fit if gains[1] > gains[0] else done[name, r]
    done = {(name, r): fit for (name, r), fit in done.items() if _is_within(fit, name)}
    out = []
    for name in dict.fromkeys(name for name, _ in tasks):
        each = [done.get((name, r)) for r in range(len(experiments))]
        candidate = TriedCandidate(name, number, np.nan)
        out.append(explained.with_fits(candidate, experiments, first, before, model, model.effects, each))
    return sorted(out, key=lambda candidate: -candidate.standing)


def hidden(experiments: Sequence[Experiment], model: Model, number: int, jobs: int) -> list[TriedCandidate]:
    """Calibrations that biased parameters of a model at the noise hide, the best first.

    The residual is noise, so every block of it counts, or as many as its memory leaves. The evidence includes the
    priors: with the calibration, base parameters move back to them.
    """
    pairs = list(zip(experiments, model.fits, strict=True))
    tasks = [
        (r, candidate)
        for r, (experiment, now) in enumerate(pairs)
        for candidate in experiment.calibrations(now.point.effects)
        if candidate.effect not in _IMITATED
    ]
    in_threads = Parallel(n_jobs=jobs, prefer="threads")
    gains = in_threads(delayed(_first_order)(*pairs[r], candidate) for r, candidate in tasks)
    tasks = [task for task, gain in zip(tasks, gains, strict=True) if gain > thresholds.STRONG]

    def fitted(r: int, candidate: Candidate | None) -> Fitted:
        experiment, now = pairs[r]
        more = () if candidate is None else candidate.free
        point = Point(now.point.theta, {**now.point.effects, **{free.path: 0.0 for free in more}})
        return refit(
            experiment, point, (*now.free, *more), renewals=3, blocks_per_error=now.scale.blocks_per_error, beside=now
        )  # fmt: skip

    # The gain of a further fit without a calibration is no evidence for one.
    noted = list(dict.fromkeys(r for r, _ in tasks))
    plain = dict(zip(noted, in_threads(delayed(fitted)(r, None) for r in noted), strict=True))
    done = dict(zip(((c.effect, r) for r, c in tasks), in_threads(delayed(fitted)(*t) for t in tasks), strict=True))
    out = []
    for name in dict.fromkeys(name for name, _ in done):
        fits, total, held = list(model.fits), 0.0, 0.0
        for r, (experiment, _) in enumerate(pairs):
            new = done.get((name, r))
            if new is None or not _is_within(new, name) or not _is_certain(new, name):
                continue
            gain, later = _posterior_gain(experiment, plain[r], new)
            if gain > 0.0:
                fits[r], total, held = new, total + gain, held + later
        if total + held >= thresholds.TAKEN and min(total, held) >= thresholds.POSITIVE:
            now = Model(model.effects, tuple(fits))
            out.append(TriedCandidate(name, number, np.nan, total, held, (0.0, 0.0), now))
    return sorted(out, key=lambda candidate: -candidate.standing)


def _first_order(experiment: Experiment, fitted: Fitted, candidate: Candidate) -> float:
    """Twice the gain in log posterior by a calibration beside a model at the noise, to first order."""
    theta, scale = fitted.point.theta, fitted.scale
    column = effect_jacobian(experiment, fitted.point, fitted.residual, candidate.free)
    effect = np.concatenate([fitted.effect, column], axis=2)
    step = Equations.of(fitted.residual, fitted.base, effect).solved(scale, experiment.prior, theta, rounds=2)
    left = scale.misfits_of(step.squares, len(fitted.residual))
    gain = float(np.sum(scale.misfits(fitted.residual) - left))
    gain += prior_cost(experiment, theta) - prior_cost(experiment, theta + step.theta)
    return gain * scale.blocks_per_error / float(scale.length.max())


def _posterior_gain(experiment: Experiment, before: Fitted, after: Fitted) -> tuple[float, float]:
    """Evidence of the fitted and of the held-out part at the noise, with blocks weighted by the residual's memory."""
    scale = before.scale
    length = float(scale.length.max())
    old, new = (cost_of(experiment, f.point, f.residual, scale) for f in (before, after))
    price = float(np.log(before.residual.size / length))
    left = (experiment.held(experiment.residual(f.point, whole=True)) for f in (before, after))
    later = [float(scale.misfits(part).sum()) for part in left]
    share = scale.blocks_per_error / length
    return share * (old - new) - price, share * (later[0] - later[1])


def _is_within(fitted: Fitted, name: str) -> bool:
    """Whether a model has a calibration within its bounds. At a bound it stands for something else."""
    item, value = calibration.CALIBRATIONS[name], fitted.point.effects.get(calibration.path(name), 0.0)
    edge = _EDGE * (item.high - item.low)
    return item.low + edge < value < item.high - edge


def _is_certain(fitted: Fitted, name: str) -> bool:
    value, std = _value(fitted, calibration.path(name))
    return abs(value) >= thresholds.CERTAIN_CALIBRATION * std


def _with(
    experiment: Experiment, fitted: Fitted, values: Mapping[str, float], free: Sequence[FreeEffectParameter]
) -> Fitted:
    """A model with further calibrations, fitted from where it was."""
    point = Point(fitted.point.theta, {**fitted.point.effects, **values})
    found = refit(experiment, point, (*fitted.free, *free), fitted.base, renewals=2, beside=fitted)
    return best_of_starts(experiment, found, 0)


def taken(
    experiments: Sequence[Experiment], base: Model, model: Model, best: Model, name: str, jobs: int
) -> tuple[Model, Model]:
    """The model without effects and the chosen one, both with a calibration that is worth taking.

    The sensors are the same in all recordings. So recordings that do not show the calibration get its value too, where
    that costs nothing.
    """
    dotted = calibration.path(name)
    shown = [fitted for fitted in best.fits if dotted in fitted.point.effects]
    value = of_calibration([_value(fitted, dotted) for fitted in shown])[0]

    def given(experiment: Experiment, fitted: Fitted) -> Fitted:
        if dotted in fitted.point.effects:
            return relinearised(experiment, fitted)
        point = Point(fitted.point.theta, {**fitted.point.effects, dotted: value})
        pace = fitted.scale.blocks_per_error
        other = refit(experiment, point, fitted.free, renewals=2, blocks_per_error=pace, beside=fitted)
        return other if evidence(experiment, fitted, other) >= -thresholds.POSITIVE else fitted

    in_threads = Parallel(n_jobs=jobs, prefer="threads")
    chosen = Model(
        model.effects, tuple(in_threads(delayed(given)(*p) for p in zip(experiments, best.fits, strict=True)))
    )
    if not model.effects:
        return chosen, chosen

    def alone(experiment: Experiment, fitted: Fitted, extended: Fitted) -> Fitted:
        values = {p: v for p, v in extended.point.effects.items() if p == dotted}
        return _with(experiment, fitted, values, [free for free in extended.free if free.path == dotted])

    triples = zip(experiments, base.fits, chosen.fits, strict=True)
    return Model((), tuple(in_threads(delayed(alone)(*each) for each in triples))), chosen


def needed(experiments: Sequence[Experiment], base: Model, model: Model, jobs: int) -> tuple[Model, Model]:
    """Both models without calibrations at a bound, and without what is not significant beside the others."""
    for name in calibrations_of(model):
        if not all(_is_within(fitted, name) for fitted in (*base.fits, *model.fits)):
            prefix = calibration.path(name)
            base, model = (without(experiments, each, prefix, jobs) for each in (base, model))
    while model.effects:
        names = calibrations_of(model)
        if not names:
            break
        prefixes = [*(calibration.path(name) for name in names), *(f"effects.{name}." for name in model.effects)]
        smaller = [without(experiments, model, prefix, jobs) for prefix in prefixes]
        lost = [_lost(experiments, other, model) for other in smaller[: len(names)]]
        lost += [explained.evidence_of(experiments, other, model) for other in smaller[len(names) :]]
        least = int(np.argmin(lost))
        if lost[least] >= thresholds.STRONG:
            break
        model = smaller[least]
        if least < len(names):
            base = without(experiments, base, prefixes[least], jobs)
    return base, model if model.effects else base


def _lost(experiments: Sequence[Experiment], smaller: Model, model: Model) -> float:
    """Evidence for a model against one without a calibration; it includes the priors where both leave only noise."""
    if not (explained.at_noise(experiments, smaller) and explained.at_noise(experiments, model)):
        return explained.evidence_of(experiments, smaller, model)
    total = 0.0
    for experiment, before, after in zip(experiments, smaller.fits, model.fits, strict=True):
        if len(before.free) < len(after.free):
            total += _posterior_gain(experiment, before, after)[0]
    return total


def carried_on(experiments: Sequence[Experiment], model: Model, jobs: int) -> Model:
    """A model fitted to convergence: calibrations are so certain that the last steps of a fit matter."""

    def one(experiment: Experiment, fitted: Fitted) -> Fitted:
        needs = any(calibration.is_calibration(free.path) for free in fitted.free)
        return settled(experiment, fitted) if needs else fitted

    pairs = zip(experiments, model.fits, strict=True)
    return Model(model.effects, tuple(Parallel(n_jobs=jobs, prefer="threads")(delayed(one)(*pair) for pair in pairs)))


def without(experiments: Sequence[Experiment], model: Model, prefix: str, jobs: int) -> Model:
    """A model without the parameters whose dotted paths have a prefix, everything else fitted anew."""

    def one(experiment: Experiment, fitted: Fitted) -> Fitted:
        kept = {name: value for name, value in fitted.point.effects.items() if not name.startswith(prefix)}
        if len(kept) == len(fitted.point.effects):
            return fitted
        free = tuple(free for free in fitted.free if not free.path.startswith(prefix))
        return best_of_starts(experiment, refit(experiment, Point(fitted.point.theta, kept), free, beside=fitted), 0)

    pairs = zip(experiments, model.fits, strict=True)
    fits = Parallel(n_jobs=jobs, prefer="threads")(delayed(one)(*pair) for pair in pairs)
    names = tuple(name for name in model.effects if not prefix.startswith(f"effects.{name}."))
    return Model(names, tuple(fits))


def calibrations_of(model: Model) -> tuple[str, ...]:
    """Names of the calibrations that any recording's model has free."""
    free = (one.path for fitted in model.fits for one in fitted.free if calibration.is_calibration(one.path))
    return tuple(dict.fromkeys(dotted.split(".")[1] for dotted in free))


def common(model: Model) -> dict[str, float]:
    """Values that suit all recordings, by dotted path."""
    return {
        calibration.path(name): of_calibration(list(_seen(model, name).values()))[0] for name in calibrations_of(model)
    }


def found(
    experiments: Sequence[Experiment],
    models: Sequence[Model],
    weighed: Sequence[TriedCandidate],
    rivals: Mapping[str, tuple[str, ...]],
) -> tuple[FoundCalibration, ...]:
    """The calibrations that recordings need, each with its value; uncertain ones are left out.

    Args:
        models: of the recordings, the selection's model last; the first in which a calibration is free has its value.
        rivals: for each that was taken, what the recordings cannot distinguish from it.
    """

    @cache
    def well(number: int, r: int) -> Fitted:
        """A recording's fit with its standard deviations, worked out once for all of its calibrations."""
        return well_known(experiments[r], models[number].fits[r])

    out = []
    for name in calibrations_of(models[-1]):
        number, seen = next((m, values) for m, model in enumerate(models) if (values := _seen(model, name)))
        gain = next(item.delta_bic or 0.0 for item in weighed if item.effect == name and item.taken)
        # A stamp is off by a part of a sample, whatever a fit says.
        stamped = {r: experiments[r].trial.dt * _STAMP_STD if name.startswith("delay_") else 0.0 for r in seen}
        value, std = of_calibration([(own, float(np.hypot(error, stamped[r]))) for r, (own, error) in seen.items()])
        # A calibration may turn out to be a part of an effect that begins late and was found afterwards.
        if abs(value) < thresholds.CERTAIN_CALIBRATION * std:
            continue
        errors = {r: float(np.hypot(_value(well(number, r), calibration.path(name))[1], stamped[r])) for r in seen}
        by_recording = {experiments[r].trial.name: (own, errors[r]) for r, (own, _) in seen.items()}
        # The rig's uncertainty is common to all recordings: their mean is not better than the best of them.
        std = max(of_calibration(list(by_recording.values()))[1], min(errors.values()))
        # The same test with the whole standard deviation: it may be a part of an effect whose law differs on this rig.
        if abs(value) < thresholds.CERTAIN_CALIBRATION * std:
            continue
        unit = calibration.CALIBRATIONS[name].unit
        out.append(FoundCalibration(name, value, std, unit, gain, by_recording, rivals.get(name, ())))
    return tuple(out)


def _seen(model: Model, name: str) -> dict[int, tuple[float, float]]:
    """Value and standard deviation of a calibration in each recording in which it is free."""
    dotted = calibration.path(name)
    free = {r: fitted for r, fitted in enumerate(model.fits) if any(one.path == dotted for one in fitted.free)}
    return {r: _value(fitted, dotted) for r, fitted in free.items()}


def _value(fitted: Fitted, dotted: str) -> tuple[float, float]:
    k = next(k for k, one in enumerate(fitted.free) if one.path == dotted)
    return fitted.point.effects[dotted], float(np.sqrt(fitted.effect_covariance[k, k])) * fitted.free[k].item.scale
