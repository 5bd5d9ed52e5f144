"""From the models of the recordings to named effects: which are needed, on which muscle, how large, how certain."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.models import HELD, Model, contradict, evidence_of, further_share, of_size, price, without
from pam_antagonist.diagnosis.result import FoundEffect, Size, SizeProfile
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, refit
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.profile import effect_profile
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE

_Seen = dict[int, tuple[float, float]]
"""Value and standard deviation of a parameter in each recording that shows it, by its number."""
_Numbers = dict[Unknown, _Seen]
_Part = tuple[int | None, _Numbers]


class ModelEffects(NamedTuple):
    """The effects of a model."""

    effects: tuple[FoundEffect, ...]
    values: dict[str, float]
    contradictions: list[str]


def pruned(experiment: Experiment, before: Fitted, fitted: Fitted, effect: str) -> Fitted:
    """A model without the sizes of an effect whose gain is less than their price."""
    while True:
        here = [u for u in fitted.free if u.path.startswith(f"effects.{effect}.") and u.item.is_size]
        if len(here) < 2:
            return fitted
        std = dict(zip(fitted.free, np.sqrt(np.diag(fitted.effect_covariance)), strict=True))
        values = {u: u.coordinate(fitted.point.effects.get(u.path, 0.0)) for u in here}
        weakest = min(here, key=lambda u: abs(values[u]) / std[u] if std[u] > 0.0 else 0.0)
        left = tuple(u for u in fitted.free if u is not weakest)
        effects = {path: value for path, value in fitted.point.effects.items() if path not in weakest.paths}
        smaller = refit(
            experiment, Point(fitted.point.theta, effects), left, fitted.base, renewals=1,
            blocks_per_error=fitted.scale.blocks_per_error, beside=fitted,
        )  # fmt: skip
        scale = before.scale
        costs = [cost_of(experiment, fit.point, fit.residual, scale) for fit in (smaller, fitted)]
        lost = scale.share * (costs[0] - costs[1])
        if lost > price(before, 1):
            return fitted
        fitted = smaller


def backward_elimination(base: Model, model: Model) -> Model:
    """A model without the effects and sizes that are not significant beside the others."""
    names = model.effects[:-1]
    while names:
        smaller = [without(model, f"effects.{name}.") for name in names]
        unneeded = [evidence_of(one, model) < thresholds.STRONG for one in smaller]
        if not any(unneeded):
            break
        # The later models still contain the first unneeded effect.
        first = unneeded.index(True)
        model, names = smaller[first], names[first + 1 :]

    def leaner(experiment: Experiment, fitted: Fitted, before: Fitted) -> Fitted:
        for effect in model.effects:
            fitted = pruned(experiment, before, fitted, effect)
        return fitted

    return model.map(leaner, base.fits)


def found(base: Model, model: Model) -> tuple[ModelEffects, dict[str, Model]]:
    """The effects of a model, and the model without each; see :func:`found_effects`."""
    several = len(model.effects) > 1
    smaller = {name: without(model, f"effects.{name}.") if several else base for name in model.effects}
    gains = {name: evidence_of(one, model) for name, one in smaller.items()}
    shares = {name: further_share(base, one, model, HELD) for name, one in smaller.items()}
    return found_effects(model, gains, shares), smaller


def found_effects(model: Model, gains: Mapping[str, float], shares: Mapping[str, float]) -> ModelEffects:
    """The effects of a model."""
    names = [experiment.trial.name for experiment in model.experiments]
    values: dict[str, float] = {}
    contradictions: list[str] = []
    effects: list[FoundEffect] = []
    for effect in model.effects:
        sizes, shapes = _sizes_and_shapes(model, effect)
        if not sizes:
            # No recording needs any of it: all of its sizes are 0. What is in no catalogue may have no size.
            if effect not in CATALOGUE:
                effects.append(FoundEffect(effect, None, {}, gains[effect], shares[effect], tuple(names)))
            continue
        where = {muscle: {r for seen in group.values() for r in seen} for muscle, group in sizes.items()}
        shown = [{muscle for muscle in where if r in where[muscle]} for r in range(len(names))]
        visible = [muscles for muscles in shown if muscles]
        apart = len(visible) > 1 and any(a.isdisjoint(b) for a in visible for b in visible)
        if apart:
            which = "; ".join(
                f"{name}: muscle {' and '.join(str(m) for m in sorted(muscles, key=str))}"
                for name, muscles in zip(names, shown, strict=True)
                if muscles
            )
            contradictions.append(f"the recordings show {effect} on different muscles ({which})")
        muscles = sorted(m for m in sizes if m is not None)
        if apart:
            parts: list[_Part] = [(muscle, sizes[muscle]) for muscle in muscles]
        else:
            alone = muscles[0] if len(muscles) == 1 and None not in sizes else None
            parts = [(alone, {free: seen for group in sizes.values() for free, seen in group.items()})]
        for muscle, group in parts:
            recordings = {r for seen in group.values() for r in seen}
            every = (group | shapes).items()
            numbers = {free: {r: pair for r, pair in seen.items() if r in recordings} for free, seen in every}
            parameters: dict[str, Size] = {}
            for free, seen in numbers.items():
                if seen:
                    mean, std = of_size(list(seen.values()))
                    size = Size(mean, std, free.item.unit)
                    parameters |= dict.fromkeys((path.split(".")[2] for path in free.paths), size)
                    values |= dict.fromkeys(free.paths, mean)
            contradictions += _differences(effect, numbers, names)
            there = tuple(names[r] for r in sorted(recordings))
            effects.append(FoundEffect(effect, muscle, parameters, gains[effect], shares[effect], there))
    return ModelEffects(tuple(effects), values, contradictions)


def _sizes_and_shapes(model: Model, effect: str) -> tuple[dict[int | None, _Numbers], _Numbers]:
    """An effect's sizes in the recordings that show them, by muscle, and its shapes there."""
    free = free_of(model, effect)
    sized = {one: _sizes(model, one) for one in free}
    if not any(seen for one, seen in sized.items() if one.item.is_size):
        # Size and shape may compensate each other: neither is certain then, but both together are. And where friction
        # that is anything above a level balances all torques, the derivative is 0, and with it the certainty.
        sized = {one: _sizes(model, one, certain=False) for one in free}
    by_muscle: dict[int | None, _Numbers] = {}
    for one, seen in sized.items():
        if seen and one.item.is_size:
            by_muscle.setdefault(one.muscle, {})[one] = seen
    return by_muscle, {one: seen for one, seen in sized.items() if seen and not one.item.is_size}


def _differences(effect: str, numbers: _Numbers, names: Sequence[str]) -> list[str]:
    """Sizes in which the recordings contradict each other."""
    out = []
    for free, seen in numbers.items():
        sizes = list(seen.values())
        if free.item.is_size and sizes and contradict(sizes, of_size(sizes)[0]):
            each = ", ".join(f"{names[r]}: {value:.3g}" for r, (value, _) in seen.items())
            out.append(f"the recordings differ in {effect}'s {free.item.name} ({each})")
    return out


def free_of(model: Model, effect: str) -> tuple[Unknown, ...]:
    """Parameters of an effect that are free in any recording, in the order of the catalogue, sizes first."""
    path = f"effects.{effect}."
    return tuple(dict.fromkeys(u for fitted in model.fits for u in fitted.free if u.path.startswith(path)))


def _sizes(model: Model, free: Unknown, certain: bool = True) -> _Seen:
    """Value of a parameter in every recording in which it is free, not 0, and not small beside the other muscle's.

    `certain`: whether a size must be more than two standard deviations from 0.
    """
    seen: _Seen = {}
    for r, fitted in enumerate(model.fits):
        if free not in fitted.free:
            continue
        k = fitted.free.index(free)
        shows = bool(np.any(fitted.effect[:, :, k]))
        if certain and not shows:
            continue
        value = fitted.point.effects.get(free.path, free.item.neutral)
        # Without a derivative, only the magnitude is known.
        std = float(np.sqrt(fitted.effect_covariance[k, k])) * free.slope(value) if shows else abs(value)
        if free.item.is_size:
            stem = free.path.rstrip("12")
            siblings = [abs(v) for path, v in fitted.point.effects.items() if path.startswith(stem)]
            least = thresholds.CERTAIN_SIZE * std if certain else 0.0
            if abs(value) <= max(thresholds.SMALL_SIBLING * max(siblings, default=0.0), least):
                continue
        seen[r] = value, std
    return seen


def profile_sizes(
    model: Model, found: Sequence[FoundEffect], progress: Callable[[str], None]
) -> tuple[SizeProfile, ...]:
    """Profiles of the found sizes, each in the recording that shows it first."""
    names = [experiment.trial.name for experiment in model.experiments]
    result = []
    for effect in found:
        if effect.name == DISTURBANCE:
            continue
        for parameter in free_of(model, effect.name):
            if not parameter.item.is_size or parameter.path.split(".")[2] not in effect.parameters:
                continue
            shown = (r for r in map(names.index, effect.recordings) if parameter in model.fits[r].free)
            r = next((r for r in shown if model.fits[r].point.effects.get(parameter.path)), None)
            if r is None:
                continue
            progress(f"profile of {parameter.path}")
            profile = effect_profile(*model.pairs[r], parameter, model.jobs)
            # Friction above a level may explain as much as friction at that level.
            open_ended = profile.loss[-1] < 0.5 and profile.value[-1] > profile.best + profile.std
            values, rise = tuple(profile.value.tolist()), tuple((2.0 * profile.loss).tolist())
            result.append(
                SizeProfile(
                    parameter.path.removeprefix("effects."), names[r], profile.best, profile.std, parameter.item.unit,
                    values, rise, profile.flat or bool(open_ended),
                )
            )  # fmt: skip
    return tuple(result)
