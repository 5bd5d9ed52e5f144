"""Which calibrations of their sensors and clocks recordings need: weighed as effects are, and named apart from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis import explained, thresholds
from pam_antagonist.diagnosis.candidates import Model, TriedCandidate, evidence
from pam_antagonist.inference import calibration
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.free_parameters import Candidate, FreeEffectParameter
from pam_antagonist.inference.gauss_newton import Fitted, best_of_starts, refit, relinearised


@dataclass(frozen=True)
class FoundCalibration:
    """A calibration that recordings need.

    Attributes:
        name: in :data:`~pam_antagonist.inference.calibration.CALIBRATIONS`.
        value: in SI units.
        std: its standard deviation.
        unit: of both.
        delta_bic: evidence for it.
        by_recording: value and standard deviation in each recording that shows it, by its name.
        rivals: effects and calibrations that the recordings cannot tell from it.
    """

    name: str
    value: float
    std: float
    unit: str
    delta_bic: float
    by_recording: Mapping[str, tuple[float, float]]
    rivals: tuple[str, ...] = ()


def tried(
    experiments: Sequence[Experiment], first: Sequence[explained.Residuals], model: Model, number: int, jobs: int
) -> list[TriedCandidate]:
    """Calibrations beside a model, the best first: each is one number, and fitted in every recording above its noise.

    Args:
        experiments: the recordings.
        first: what the model without effects leaves.
        model: the model.
        number: of the round.
        jobs: threads.
    """
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
    out = []
    for name in dict.fromkeys(name for name, _ in tasks):
        each = [done.get((name, r)) for r in range(len(experiments))]
        candidate = TriedCandidate(name, number, np.nan)
        out.append(explained.with_fits(candidate, experiments, first, before, model, model.effects, each))
    return sorted(out, key=lambda candidate: -candidate.standing)


def _with(
    experiment: Experiment, fitted: Fitted, values: Mapping[str, float], free: Sequence[FreeEffectParameter]
) -> Fitted:
    """A model with further calibrations, fitted from where it was."""
    point = Point(fitted.point.theta, {**fitted.point.effects, **values})
    return best_of_starts(experiment, refit(experiment, point, (*fitted.free, *free), fitted.base, renewals=2), 0)


def taken(
    experiments: Sequence[Experiment], base: Model, model: Model, best: Model, name: str, jobs: int
) -> tuple[Model, Model]:
    """The model without effects and the chosen one, both with a calibration that is worth taking.

    Recordings that do not show it get its value, where that costs them nothing: the sensors are the same.

    Args:
        experiments: the recordings.
        base: the model without effects.
        model: the chosen model before.
        best: the same with the calibration.
        name: of the calibration.
        jobs: threads.
    """
    dotted = calibration.path(name)
    shown = [fitted for fitted in best.fits if dotted in fitted.point.effects]
    value = _mean([_value(fitted, dotted) for fitted in shown])[0]

    def given(experiment: Experiment, fitted: Fitted) -> Fitted:
        if dotted in fitted.point.effects:
            return relinearised(experiment, fitted)
        point = Point(fitted.point.theta, {**fitted.point.effects, dotted: value})
        pace = fitted.scale.blocks_per_error
        other = refit(experiment, point, fitted.free, renewals=2, blocks_per_error=pace)
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
    """The model without effects and the chosen one, without calibrations and effects that do not pay beside the others.

    Args:
        experiments: the recordings.
        base: the model without effects.
        model: the chosen model.
        jobs: threads.
    """
    while model.effects:
        names = calibrations_of(model)
        if not names:
            break
        prefixes = [*(calibration.path(name) for name in names), *(f"effects.{name}." for name in model.effects)]
        smaller = [without(experiments, model, prefix, jobs) for prefix in prefixes]
        lost = [explained.evidence_of(experiments, other, model) for other in smaller]
        least = int(np.argmin(lost))
        if lost[least] >= thresholds.STRONG:
            break
        model = smaller[least]
        if least < len(names):
            base = without(experiments, base, prefixes[least], jobs)
    return base, model if model.effects else base


def without(experiments: Sequence[Experiment], model: Model, prefix: str, jobs: int) -> Model:
    """A model without the parameters whose dotted paths begin like this, everything else fitted anew.

    Args:
        experiments: the recordings.
        model: the model.
        prefix: beginning of the paths.
        jobs: threads.
    """

    def one(experiment: Experiment, fitted: Fitted) -> Fitted:
        kept = {name: value for name, value in fitted.point.effects.items() if not name.startswith(prefix)}
        if len(kept) == len(fitted.point.effects):
            return fitted
        free = tuple(free for free in fitted.free if not free.path.startswith(prefix))
        return refit(experiment, Point(fitted.point.theta, kept), free)

    pairs = zip(experiments, model.fits, strict=True)
    fits = Parallel(n_jobs=jobs, prefer="threads")(delayed(one)(*pair) for pair in pairs)
    names = tuple(name for name in model.effects if not prefix.startswith(f"effects.{name}."))
    return Model(names, tuple(fits))


def calibrations_of(model: Model) -> tuple[str, ...]:
    """Names of the calibrations that any recording's model has free."""
    free = (one.path for fitted in model.fits for one in fitted.free if calibration.is_calibration(one.path))
    return tuple(dict.fromkeys(dotted.split(".")[1] for dotted in free))


def common(model: Model) -> dict[str, float]:
    """Values that suit all recordings, by dotted path.

    Args:
        model: the recordings' models.
    """
    return {calibration.path(name): _mean(list(_seen(model, name).values()))[0] for name in calibrations_of(model)}


def found(
    experiments: Sequence[Experiment],
    model: Model,
    weighed: Sequence[TriedCandidate],
    rivals: Mapping[str, tuple[str, ...]],
) -> tuple[FoundCalibration, ...]:
    """The calibrations of a model, each with its value.

    Args:
        experiments: the recordings.
        model: their models.
        weighed: all calibrations that were tried.
        rivals: for each that was taken, what the recordings cannot tell from it.
    """
    out = []
    for name in calibrations_of(model):
        seen = _seen(model, name)
        gain = next(item.delta_bic or 0.0 for item in weighed if item.effect == name and item.taken)
        by_recording = {experiments[r].trial.name: value for r, value in seen.items()}
        unit = calibration.CALIBRATIONS[name].unit
        out.append(FoundCalibration(name, *_mean(list(seen.values())), unit, gain, by_recording, rivals.get(name, ())))
    return tuple(out)


def _seen(model: Model, name: str) -> dict[int, tuple[float, float]]:
    """Value and standard deviation of a calibration in each recording in which it is free."""
    dotted = calibration.path(name)
    free = {r: fitted for r, fitted in enumerate(model.fits) if any(one.path == dotted for one in fitted.free)}
    return {r: _value(fitted, dotted) for r, fitted in free.items()}


def _value(fitted: Fitted, dotted: str) -> tuple[float, float]:
    k = next(k for k, one in enumerate(fitted.free) if one.path == dotted)
    return fitted.point.effects[dotted], float(np.sqrt(fitted.effect_covariance[k, k])) * fitted.free[k].item.scale


def _mean(seen: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Weighted mean, and its standard deviation; where values differ by more than theirs, what they scatter."""
    values, stds = np.array(seen).T
    weights = 1.0 / np.maximum(stds, 1e-12) ** 2
    mean, std = float(weights @ values / weights.sum()), float(weights.sum() ** -0.5)
    chi = float(np.sqrt(weights @ (values - mean) ** 2 / max(len(values) - 1, 1)))
    return mean, std * max(chi, 1.0)
