"""Calibrations of sensors and clocks that recordings need: tested as effects are, and reported separately."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from typing_extensions import override

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.hypotheses import Hypothesis, Ranking, TriedCandidate, Work
from pam_antagonist.diagnosis.models import (
    Model,
    as_configured,
    contradict,
    evidence,
    evidence_of,
    given,
    in_threads,
    of_calibration,
    without,
)
from pam_antagonist.diagnosis.result import FoundCalibration
from pam_antagonist.inference import calibration
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, effect_jacobian, prior_cost, refit, relinearised
from pam_antagonist.inference.likelihood import LinearProblem
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.standard_errors import settled, well_known
from pam_antagonist.inference.starts import best_of_starts
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.recording.corrections import Corrections

_FIXED = ("torque_scale",)
"""Calibrations that are the same in all recordings. A zero may be set anew between two of them, and so may a clock."""
_IMITATED = ("torque_scale",)
"""Calibrations that base parameters imitate exactly: muscles, inertia and friction larger by the same factor."""
_EDGE = 1e-3
"""A calibration nearer to a bound than this share of its range is at the bound."""
_STAMP_STD = 12.0**-0.5
"""[sample periods] Standard deviation of a stamp's error, which is uniform over one sample period."""
_TRIED = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Values that are tried beside the base as configured, in scales of the calibration, in either direction."""
_NEAR = 0.05
"""Tolerance of the best value at which a fit begins, in scales of the calibration."""
_FITTED = 2
"""Calibrations of a recording that are fitted from there, those with the best scores."""
_ALTERNATIVES = {
    "encoder_zero": (
        "a zero of the encoder",
        "hold the joint at an angle that is known without the encoder (a gauge block, a stop), and read it",
    ),
    "torque_zero": (
        "a zero of the torque meter", "read the torque meter with both muscles vented and nothing on the joint",
    ),
    "torque_scale": (
        "another scale of the torque meter", "hang a known weight on the joint and read the torque meter",
    ),
}  # fmt: skip
"""What a report calls a calibration that does as well as what was found, and how to measure it without a model."""
_CLOCK = (
    "stamp everything by one clock, or record a step of a voltage at 1 kHz: late stamps shift the whole response, a "
    "slow valve or sensor rounds its beginning"
)
"""Likewise how to measure any of the clocks."""


class CalibrationHypothesis(Hypothesis):
    """A zero or scale of a sensor, or stamps that are late. Each is one number, in every recording."""

    is_effect = False

    @override
    def propose(self, now: Ranking, number: int, work: Work) -> list[TriedCandidate]:
        found = _hidden(now.model, number) if now.model.is_at_noise else _tried(now, number)
        found = [self._compared(now, one) if self.is_worth_taking(one) else one for one in found]
        return sorted(found, key=lambda candidate: -candidate.standing)

    @override
    def is_worth_taking(self, tried: TriedCandidate) -> bool:
        return not tried.apart and (tried.shares is None or tried.is_worth_taking or tried.ends_at_noise)

    def _compared(self, now: Ranking, tried: TriedCandidate) -> TriedCandidate:
        """A candidate with its values in all recordings, if it must be the same in all and is not."""
        if tried.effect not in _FIXED:
            return tried
        model = self.take(now, tried)[1]
        seen = {**_seen(model, tried.effect), **_seen_alone(model, tried.effect)}
        if not contradict(list(seen.values()), of_calibration(list(seen.values()))[0]):
            return tried
        return replace(tried, apart={model.experiments[r].trial.name: own for r, own in seen.items()})

    @override
    def take(self, now: Ranking, best: TriedCandidate) -> tuple[Model, Model]:
        """Both models with a calibration.

        The sensors are the same in all recordings. So recordings that do not show the calibration get its value too,
        where that costs nothing.
        """
        assert best.model is not None
        dotted = calibration.path(best.effect)
        shown = [fitted for fitted in best.model.fits if dotted in fitted.point.effects]
        value = of_calibration([_value(fitted, dotted) for fitted in shown])[0]

        def everywhere(experiment: Experiment, fitted: Fitted) -> Fitted:
            known = dotted in fitted.point.effects
            return relinearised(experiment, fitted) if known else given(experiment, fitted, {dotted: value})

        chosen = replace(best.model.map(everywhere), effects=now.model.effects)
        if not chosen.effects:
            return chosen, chosen

        def alone(experiment: Experiment, fitted: Fitted, extended: Fitted) -> Fitted:
            values = {p: v for p, v in extended.point.effects.items() if p == dotted}
            return _with(experiment, fitted, values, [free for free in extended.free if free.path == dotted])

        return replace(now.base.map(alone, chosen.fits), effects=()), chosen

    @override
    def knows(self, name: str) -> bool:
        return name in calibration.CALIBRATIONS

    @override
    def sentence(self, name: str, muscle: int | None, values: Mapping[str, float], sealed: bool = False) -> str:
        return FoundCalibration(name, values[name], 0.0, "", 0.0, {}).in_words()

    @override
    def instead(self, name: str) -> str:
        clock = f"stamps of the {name.removeprefix('delay_')} that are early or late"
        return f"{_ALTERNATIVES.get(name, (clock,))[0]} would explain the data as well"

    @override
    def experiment(self, name: str, found: str | None = None, sealed: bool = False) -> str:
        return _ALTERNATIVES[name][1] if name in _ALTERNATIVES else _CLOCK


def _tried(now: Ranking, number: int) -> list[TriedCandidate]:
    """Calibrations fitted beside a model, in every recording above its noise."""
    model = now.model
    noisy = [
        r for r, ((experiment, _), left) in enumerate(zip(model.pairs, model.left, strict=True))
        if max(experiment.times_noise(np.concatenate(left))) >= thresholds.AT_NOISE
    ]  # fmt: skip
    can = [experiment.calibrations(fitted.point.effects) for experiment, fitted in model.pairs]
    tasks = {(candidate.effect, r): candidate for r in noisy for candidate in can[r]}

    def near(which: tuple[str, int]) -> Fitted:
        experiment, before = model.pairs[which[1]]
        free = tasks[which].free
        return _with(experiment, before, {one.path: 0.0 for one in free}, free)

    done = dict(zip(tasks, in_threads(near, ((which,) for which in tasks), model.jobs), strict=True))
    far = in_threads(_from_afar, ((*model.pairs[r], can[r]) for r in noisy), model.jobs)
    for r, each in zip(noisy, far, strict=True):
        for name, fit in each.items():
            gains = [evidence(*model.pairs[r], one) for one in (done[name, r], fit)]
            done[name, r] = fit if gains[1] > gains[0] else done[name, r]
    within = {which: fit for which, fit in done.items() if _is_within(fit, which[0])}
    out = []
    for name in dict.fromkeys(name for name, _ in tasks):
        fits = [within.get((name, r)) for r in range(len(model.fits))]
        out.append(TriedCandidate(name, number, np.nan).fitted(now.first, model, fits, model.effects))
    return out


class _Score(NamedTuple):
    cost: float
    value: float
    candidate: Candidate


def _from_afar(experiment: Experiment, fitted: Fitted, candidates: Sequence[Candidate]) -> dict[str, Fitted]:
    """The calibrations that do best beside the base as configured, fitted from there, by name.

    A zero of 2°, or a clock that is 50 ms early, biases base parameters that are fitted without it. A fit that begins
    there may not find the way back. So each calibration is tried in several sizes beside the base as configured.
    """
    start = as_configured(experiment, fitted)
    none = _cost(experiment, start, start.point, start.residual)
    scores = (_score(experiment, start, candidate) for candidate in candidates)
    chosen = sorted((score for score in scores if score.cost < none), key=lambda score: score.cost)[:_FITTED]

    def fit(score: _Score) -> Fitted:
        point = _moved(start.point, score.candidate, _refined(experiment, start, score))
        found = refit(experiment, point, (*fitted.free, *score.candidate.free), start.base, renewals=2, beside=start)
        return best_of_starts(experiment, found, 0)

    return {score.candidate.effect: fit(score) for score in chosen}


def _score(experiment: Experiment, start: Fitted, candidate: Candidate) -> _Score:
    """The best of the tried values of a calibration."""
    (number,) = candidate.free
    values = [way * size * number.item.scale for size in _TRIED for way in (-1.0, 1.0)]
    points = {
        value: _moved(start.point, candidate, value) for value in values if number.item.low <= value <= number.item.high
    }
    changes = experiment.differences(start.point, start.residual, points.values())
    scores = (
        _Score(_cost(experiment, start, point, start.residual + change), value, candidate)
        for (value, point), change in zip(points.items(), changes, strict=True)
    )
    return min(scores, key=lambda score: score.cost)


def _refined(experiment: Experiment, start: Fitted, score: _Score) -> float:
    """The best value between the neighbours of the one that was tried."""
    low, high = sorted((0.5 * score.value, 2.0 * score.value))

    def cost(value: float) -> float:
        point = _moved(start.point, score.candidate, float(value))
        return _cost(experiment, start, point, experiment.near(point, start.point, start.residual))

    found = minimize_scalar(
        cost, bounds=(low, high), method="bounded", options={"xatol": _NEAR * score.candidate.free[0].item.scale}
    )
    return float(found.x) if found.fun < score.cost else score.value


def _moved(point: Point, candidate: Candidate, value: float) -> Point:
    return Point(point.theta, {**point.effects, **{free.path: value for free in candidate.free}})


def _cost(experiment: Experiment, start: Fitted, point: Point, residual: NDArray[np.float64]) -> float:
    """What is left to first order once the base parameters have moved to their best: twice a negative log posterior."""
    theta, scale = point.theta, start.scale
    step = LinearProblem.of(residual, start.base, start.effect).solved(scale, experiment.prior, theta, rounds=4)
    return float(scale.misfits_of(step.squares, len(residual)).sum()) + prior_cost(experiment, theta + step.theta)


def _hidden(model: Model, number: int) -> list[TriedCandidate]:
    """Calibrations that biased parameters of a model at the noise hide.

    The residual is noise, so every block of it counts, or as many as its memory leaves. The evidence includes the
    priors: with the calibration, base parameters move back to them.
    """
    tasks = [
        (r, candidate)
        for r, (experiment, now) in enumerate(model.pairs)
        for candidate in experiment.calibrations(now.point.effects)
        if candidate.effect not in _IMITATED
    ]
    gains = in_threads(_first_order, ((*model.pairs[r], candidate) for r, candidate in tasks), model.jobs)
    tasks = [task for task, gain in zip(tasks, gains, strict=True) if gain > thresholds.STRONG]

    def fitted(r: int, more: Sequence[Unknown]) -> Fitted:
        experiment, now = model.pairs[r]
        point = Point(now.point.theta, {**now.point.effects, **{free.path: 0.0 for free in more}})
        return refit(
            experiment, point, (*now.free, *more), renewals=3, blocks_per_error=now.scale.blocks_per_error, beside=now
        )  # fmt: skip

    # The gain of a further fit without a calibration is no evidence for one.
    noted = list(dict.fromkeys(r for r, _ in tasks))
    plain = dict(zip(noted, in_threads(fitted, ((r, ()) for r in noted), model.jobs), strict=True))
    fits = in_threads(fitted, ((r, candidate.free) for r, candidate in tasks), model.jobs)
    done = {(candidate.effect, r): fit for (r, candidate), fit in zip(tasks, fits, strict=True)}
    out = []
    for name in dict.fromkeys(name for name, _ in done):
        chosen, total, held = list(model.fits), 0.0, 0.0
        for r, (experiment, _) in enumerate(model.pairs):
            new = done.get((name, r))
            if new is None or not _is_within(new, name):
                continue
            value, std = _value(new, calibration.path(name))
            if not abs(value) >= thresholds.CERTAIN_CALIBRATION * std:
                continue
            gain, later = _posterior_gain(experiment, plain[r], new)
            if gain > 0.0:
                chosen[r], total, held = new, total + gain, held + later
        if total + held >= thresholds.TAKEN and min(total, held) >= thresholds.POSITIVE:
            changed = replace(model, fits=tuple(chosen))
            out.append(TriedCandidate(name, number, np.nan, total, held, model=changed))
    return out


def _first_order(experiment: Experiment, fitted: Fitted, candidate: Candidate) -> float:
    """Twice the gain in log posterior by a calibration beside a model at the noise, to first order."""
    theta, scale = fitted.point.theta, fitted.scale
    column = effect_jacobian(experiment, fitted.point, fitted.residual, candidate.free)
    effect = np.concatenate([fitted.effect, column], axis=2)
    step = LinearProblem.of(fitted.residual, fitted.base, effect).solved(scale, experiment.prior, theta, rounds=2)
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


def _with(experiment: Experiment, fitted: Fitted, values: Mapping[str, float], free: Sequence[Unknown]) -> Fitted:
    """A model with further calibrations, fitted from where it was."""
    point = Point(fitted.point.theta, {**fitted.point.effects, **values})
    found = refit(experiment, point, (*fitted.free, *free), fitted.base, renewals=2, beside=fitted)
    return best_of_starts(experiment, found, 0)


def without_needless(base: Model, model: Model) -> tuple[Model, Model]:
    """Both models without calibrations at a bound, and without what is not significant beside the others."""
    for name in calibrations_of(model):
        if not all(_is_within(fitted, name) for fitted in (*base.fits, *model.fits)):
            base, model = (without(each, calibration.path(name), finer=True) for each in (base, model))
    while model.effects and (names := calibrations_of(model)):
        prefixes = [*(calibration.path(name) for name in names), *(f"effects.{name}." for name in model.effects)]
        smaller = [without(model, prefix, finer=True) for prefix in prefixes]
        lost = [_lost(other, model) for other in smaller[: len(names)]]
        lost += [evidence_of(other, model) for other in smaller[len(names) :]]
        least = int(np.argmin(lost))
        if lost[least] >= thresholds.STRONG:
            break
        model = smaller[least]
        if least < len(names):
            base = without(base, prefixes[least], finer=True)
    return base, model if model.effects else base


def _lost(smaller: Model, model: Model) -> float:
    """Evidence for a model against one without a calibration; it includes the priors where both leave only noise."""
    if not (smaller.is_at_noise and model.is_at_noise):
        return evidence_of(smaller, model)
    pairs = zip(model.experiments, smaller.fits, model.fits, strict=True)
    return sum(_posterior_gain(*each)[0] for each in pairs if len(each[1].free) < len(each[2].free))


def converged(model: Model) -> Model:
    """A model fitted to convergence: calibrations are so certain that the last steps of a fit matter."""
    calibrated = [any(calibration.is_calibration(free.path) for free in fitted.free) for fitted in model.fits]
    return model.map(lambda experiment, fitted, needs: settled(experiment, fitted) if needs else fitted, calibrated)


def calibrations_of(model: Model) -> tuple[str, ...]:
    """Names of the calibrations that any recording's model has free."""
    free = (one.path for fitted in model.fits for one in fitted.free if calibration.is_calibration(one.path))
    return tuple(dict.fromkeys(dotted.split(".")[1] for dotted in free))


def common(model: Model) -> dict[str, float]:
    """Values that suit all recordings, by dotted path."""
    return {
        calibration.path(name): of_calibration(list(_seen(model, name).values()))[0] for name in calibrations_of(model)
    }


def found(ranking: Ranking, judged: Model | None = None) -> tuple[FoundCalibration, ...]:
    """The calibrations that recordings need, each with its value; uncertain ones are left out.

    `judged`: the model of the verdict, which has the values where a calibration is free in it.
    """
    models = (ranking.model,) if judged is None else (judged, ranking.model)
    experiments = ranking.model.experiments

    @cache
    def well(number: int, r: int) -> Fitted:
        """A recording's fit with its standard deviations, worked out once for all of its calibrations."""
        return well_known(experiments[r], models[number].fits[r])

    out = []
    for name in calibrations_of(ranking.model):
        number, seen = next((m, values) for m, model in enumerate(models) if (values := _seen(model, name)))
        gain = next(item.delta_bic or 0.0 for item in ranking.calibrations if item.effect == name and item.taken)
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
        alone = _seen_alone(models[number], name)
        by_recording |= {experiments[r].trial.name: own for r, own in alone.items()}
        # The same test with the whole standard deviation: it may be a part of an effect whose law differs on this rig.
        if abs(value) < thresholds.CERTAIN_CALIBRATION * std:
            continue
        unit = calibration.CALIBRATIONS[name].unit
        out.append(FoundCalibration(name, value, std, unit, gain, by_recording, ranking.rivals.get(name, ())))
    return tuple(out)


def corrections(values: Mapping[str, float]) -> Corrections:
    """Corrections that undo calibrations, as a user enters them."""
    typed: dict[str, Any] = {**values, "torque_scale": 1.0 + values.get("torque_scale", 0.0)}
    return Corrections(**typed)


def differences(found: Sequence[FoundCalibration], ranking: Ranking | None = None) -> list[str]:
    """Calibrations in which recordings contradict each other.

    `ranking`: of the search, with calibrations that were not taken since they must be the same in all recordings.
    """
    out = [
        f"the recordings differ in their calibration ({_each(item.name, item.by_recording)}): no value suits all of "
        "them, so none is offered; correct each by itself"
        for item in found if not item.is_shared
    ]  # fmt: skip
    refused = {} if ranking is None else {one.effect: one.apart for one in ranking.calibrations if one.apart}
    out += [
        f"the recordings contradict each other in what must be the same in all of them ({_each(name, apart)}): it "
        "stands for something else, so no correction is offered"
        for name, apart in refused.items()
    ]
    return out


def _each(name: str, by_recording: Mapping[str, tuple[float, float]]) -> str:
    """A calibration in every recording, in words."""
    unit = calibration.CALIBRATIONS[name].unit
    own = ((where, FoundCalibration(name, *pair, unit, 0.0, {})) for where, pair in by_recording.items())
    return "; ".join(f"{where}: {one.in_words()}" for where, one in own)


def _seen(model: Model, name: str) -> dict[int, tuple[float, float]]:
    """Value and standard deviation of a calibration in each recording in which it is free."""
    dotted = calibration.path(name)
    free = {r: fitted for r, fitted in enumerate(model.fits) if any(one.path == dotted for one in fitted.free)}
    return {r: _value(fitted, dotted) for r, fitted in free.items()}


def _seen_alone(model: Model, name: str) -> dict[int, tuple[float, float]]:
    """Likewise by a fit of its own in each recording that can show it and does not take over the others' value."""
    dotted, out = calibration.path(name), {}
    for r, (experiment, fitted) in enumerate(model.pairs):
        offered = (one for one in experiment.calibrations(fitted.point.effects) if one.effect == name)
        if dotted not in fitted.point.effects and (candidate := next(offered, None)) is not None:
            out[r] = _value(_with(experiment, fitted, {dotted: 0.0}, candidate.free), dotted)
    return out


def _value(fitted: Fitted, dotted: str) -> tuple[float, float]:
    k = next(k for k, one in enumerate(fitted.free) if one.path == dotted)
    return fitted.point.effects[dotted], float(np.sqrt(fitted.effect_covariance[k, k])) * fitted.free[k].item.scale
