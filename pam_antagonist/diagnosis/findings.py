"""From the models of the recordings to named effects: which muscle, how large, and whether the recordings agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.diagnosis.select import (
    STRONG,
    Model,
    evidence,
    price,
    refitted_without,
)
from pam_antagonist.diagnosis.shares import further_share, left_by
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.free_parameters import FreeEffectParameter
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, refit

_SMALL = 0.1
"""A muscle whose size is less than this share of the other's is not the one."""
_DIFFERENT = 0.25
"""Sizes that differ by more than this and by three standard deviations are not one effect's."""


@dataclass(frozen=True)
class Sized:
    """A number of an effect in one recording."""

    recording: int
    value: float
    std: float


def pruned(experiment: Experiment, before: Fitted, fitted: Fitted, effect: str) -> Fitted:
    """A model without the sizes of an effect that do not pay for themselves.

    Args:
        experiment: the recording.
        before: the model without the effect.
        fitted: the model with it.
        effect: its name.
    """
    while True:
        here = [u for u in fitted.free if u.path.startswith(f"effects.{effect}.") and u.item.is_size]
        if len(here) < 2:
            return fitted
        std = dict(zip(fitted.free, np.sqrt(np.diag(fitted.effect_covariance)), strict=True))
        weakest = min(here, key=lambda u: _strength(fitted, u, std[u]))
        left = tuple(u for u in fitted.free if u is not weakest)
        effects = {path: value for path, value in fitted.point.effects.items() if path not in weakest.paths}
        smaller = refit(
            experiment,
            Point(fitted.point.theta, effects),
            left,
            fitted.base,
            renewals=1,
            blocks_per_error=fitted.scale.blocks_per_error,
        )
        scale = before.scale
        lost = scale.share * (
            cost_of(experiment, smaller.point, smaller.residual, scale)
            - cost_of(experiment, fitted.point, fitted.residual, scale)
        )
        if lost > price(experiment, before, 1):
            return fitted
        fitted = smaller


def _strength(fitted: Fitted, unknown: FreeEffectParameter, std: float) -> float:
    value = unknown.coordinate(fitted.point.effects.get(unknown.path, 0.0))
    return abs(value) / std if std > 0.0 else 0.0


def without_idle(experiments: Sequence[Experiment], base: Model, model: Model, jobs: int) -> Model:
    """A model without effects and sizes that do not pay beside the others: the backward step.

    Args:
        experiments: the recordings.
        base: the model without effects.
        model: the model.
        jobs: threads.
    """
    names = model.effects[:-1]
    while names:
        without = refitted_without(experiments, model, names, jobs)
        idle = [evidence_of(experiments, smaller, model) < STRONG for smaller in without]
        if not any(idle):
            break
        # What was tried after the first idle one still had it.
        first = idle.index(True)
        model, names = without[first], names[first + 1 :]

    def leaner(experiment: Experiment, before: Fitted, fitted: Fitted) -> Fitted:
        for effect in model.effects:
            fitted = pruned(experiment, before, fitted, effect)
        return fitted

    fits = Parallel(n_jobs=jobs, prefer="threads")(
        delayed(leaner)(*each) for each in zip(experiments, base.fits, model.fits, strict=True)
    )
    return Model(model.effects, tuple(fits))


def found(
    experiments: Sequence[Experiment], base: Model, model: Model, jobs: int
) -> tuple[tuple[FoundEffect, ...], dict[str, float], list[str]]:
    """The effects of a model, each with what would be lost without it; see :func:`found_effects`."""
    gains, shares = {}, {}
    whole, before = (left_by(experiments, m.fits) for m in (model, base))
    several = len(model.effects) > 1
    smaller = refitted_without(experiments, model, model.effects, jobs) if several else [base] * len(model.effects)
    for effect, without in zip(model.effects, smaller, strict=True):
        gains[effect] = evidence_of(experiments, without, model)
        lost = left_by(experiments, without.fits) if several else before
        shares[effect] = further_share(experiments, before, lost, whole, fitted=False)
    return found_effects(experiments, model, gains, shares)


def found_effects(
    experiments: Sequence[Experiment],
    model: Model,
    gains: Mapping[str, float],
    shares: Mapping[str, float],
) -> tuple[tuple[FoundEffect, ...], dict[str, float], list[str]]:
    """The effects of a model.

    Args:
        experiments: the recordings.
        model: their models.
        gains: evidence for each effect.
        shares: share of the held-out excess that goes with each.

    Returns:
        The effects, values for one rig, and contradictions between recordings.
    """
    names = [experiment.trial.name for experiment in experiments]
    found: list[FoundEffect] = []
    values: dict[str, float] = {}
    contradictions: list[str] = []
    for effect in model.effects:
        sized = {unknown: _sizes(model, unknown) for unknown in unknowns_of(model, effect)}
        if not any(seen for unknown, seen in sized.items() if unknown.item.is_size):
            # Size and shape may stand for one another, so that neither is certain and both together are.
            sized = {unknown: _sizes(model, unknown, certain=False) for unknown in sized}
        sized = {unknown: seen for unknown, seen in sized.items() if seen}
        shapes = {u: seen for u, seen in sized.items() if not u.item.is_size}
        groups: dict[int | None, dict[FreeEffectParameter, list[Sized]]] = {}
        for unknown, seen in sized.items():
            if unknown.item.is_size:
                groups.setdefault(unknown.muscle, {})[unknown] = seen
        in_recording = [
            {
                muscle
                for muscle, group in groups.items()
                if any(s.recording == r for seen in group.values() for s in seen)
            }
            for r in range(len(experiments))
        ]
        visible = [muscles for muscles in in_recording if muscles]
        apart = len(visible) > 1 and any(a.isdisjoint(b) for a in visible for b in visible)
        notes: list[str] = []
        if apart:
            said = "; ".join(
                f"{name}: muscle {' and '.join(str(m) for m in sorted(muscles, key=str))}"
                for name, muscles in zip(names, in_recording, strict=True)
                if muscles
            )
            contradictions.append(f"the recordings show {effect} on different muscles ({said})")
        together = {} if apart else {u: seen for group in groups.values() for u, seen in group.items()}
        muscles = sorted((m for m in groups if m is not None), key=int)
        parts = (
            [(m, {**groups[m]}) for m in muscles]
            if apart
            else [(muscles[0] if len(muscles) == 1 and None not in groups else None, together)]
        )
        for muscle, group in parts:
            parameters = {}
            where = {s.recording for seen in group.values() for s in seen}
            for unknown, seen in {**group, **shapes}.items():
                mine = [s for s in seen if s.recording in where]
                if not mine:
                    continue
                value, std, agree = _mean(mine)
                if unknown.item.is_size and not agree:
                    said = ", ".join(f"{names[s.recording]}: {s.value:.3g}" for s in mine)
                    contradictions.append(f"the recordings differ in {effect}'s {unknown.item.name} ({said})")
                for path in unknown.paths:
                    parameters[path.split(".")[2]] = (value, std, unknown.item.unit)
                    values[path] = value
            found.append(
                FoundEffect(
                    effect, muscle, parameters, gains[effect], shares[effect],
                    tuple(names[r] for r in sorted(where)), tuple(notes),
                )
            )  # fmt: skip
    return tuple(found), values, contradictions


def unknowns_of(model: Model, effect: str) -> tuple[FreeEffectParameter, ...]:
    """Numbers of an effect that are free in any recording, in the order of the catalogue and its sizes first."""
    path = f"effects.{effect}."
    return tuple(dict.fromkeys(u for fitted in model.fits for u in fitted.free if u.path.startswith(path)))


def _sizes(model: Model, unknown: FreeEffectParameter, certain: bool = True) -> list[Sized]:
    """Value of a number in every recording in which it is free, not 0, and not a shadow of its sibling.

    Args:
        model: the recordings' models.
        unknown: the number.
        certain: whether a size must be more than two standard deviations.
    """
    seen = []
    for r, fitted in enumerate(model.fits):
        if unknown not in fitted.free:
            continue
        k = fitted.free.index(unknown)
        if not np.any(fitted.effect[:, :, k]):
            continue
        value = fitted.point.effects.get(unknown.path, unknown.item.neutral)
        std = float(np.sqrt(fitted.effect_covariance[k, k])) * unknown.slope(value)
        if unknown.item.is_size:
            stem = unknown.path.rstrip("12")
            siblings = [abs(v) for path, v in fitted.point.effects.items() if path.startswith(stem)]
            if abs(value) <= max(_SMALL * max(siblings, default=0.0), 2.0 * std if certain else 0.0):
                continue
        seen.append(Sized(r, value, std))
    return seen


def _mean(seen: Sequence[Sized]) -> tuple[float, float, bool]:
    """Weighted mean, its standard deviation with the spread between recordings, and whether they agree."""
    values = np.array([s.value for s in seen])
    floor = 0.02 * float(np.max(np.abs(values)))
    weights = 1.0 / (np.array([s.std for s in seen]) ** 2 + floor**2)
    mean = float(weights @ values / weights.sum())
    spread = float(np.ptp(values))
    std = float(np.sqrt(1.0 / weights.sum())) if len(seen) > 1 else seen[0].std
    apart = spread > _DIFFERENT * abs(mean) and spread > 3.0 * float(np.hypot.reduce([s.std for s in seen]))
    return mean, max(std, spread / 2.0), not apart


def evidence_of(experiments: Sequence[Experiment], without: Model, model: Model) -> float:
    """Evidence for a model against one without some of its effects, over all recordings."""
    return sum(
        evidence(experiment, old, new)
        for experiment, old, new in zip(experiments, without.fits, model.fits, strict=True)
        if new is not old
    )
