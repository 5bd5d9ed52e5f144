"""What recordings cannot tell apart: candidates that do nearly as well as the chosen one, and rivals on equal terms.

A candidate whose evidence is within strong evidence of the chosen one's is ambiguous with it. A joint that is driven by
its angle hides two more rivals, which are compared on what its sensors resolve:

*A loop.* Coulomb friction and hysteresis differ in how the torque turns round: at once, or over a width. While the
drive sticks the encoder shows no motion, so a loop that turns round within its step cannot be seen. Both are compared
where the joint slides; the hysteresis may be as narrow as that.

*A loss.* A leak goes on at a constant rate, as long as the pressure hardly falls. Gas that still cools from having been
charged, and tubes that still give way, lose pressure at a rate that dies out.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.candidates import Model
from pam_antagonist.diagnosis.preparation import DRIVEN
from pam_antagonist.diagnosis.result import Ambiguity, FoundEffect
from pam_antagonist.diagnosis.selection import Selection
from pam_antagonist.inference.angle_driven import AIR, BALANCE, AngleDriven
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.free_parameters import FreeEffectParameter
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, refit
from pam_antagonist.model.effects import CATALOGUE, experiment_between, parameter_path

Floats = NDArray[np.float64]

_LOOPS = ("friction", "hysteresis")
_TURN = 4.0
"""Widths in which a loop by Bouc and Wen turns round to 95 %: one until it is at 0, three more from there."""
_RATES = (0.125, 0.25, 0.5, 1.0)
"""Time constants of a loss that dies out, in durations of what was fitted."""


def near_candidates(selection: Selection) -> tuple[str, ...]:
    """Candidates of the first round that do as well as the chosen one, by evidence and on held-out data."""
    if not selection.model.effects:
        return ()
    first = [tried for tried in selection.tried if tried.round == 1 and tried.shares is not None]
    best = next((tried for tried in first if tried.effect == selection.model.effects[0]), None)
    if best is None:
        return ()
    return tuple(
        tried.effect for tried in first if tried is not best and tried.shares is not None
        and best.standing - tried.standing < thresholds.STRONG and tried.shares[0] >= thresholds.FIRST_SHARE
    )  # fmt: skip


def ambiguities(experiments: Sequence[Experiment], base: Model, model: Model) -> tuple[Ambiguity, ...]:
    """Comparisons of found effects with their rivals on equal terms.

    Args:
        experiments: the recordings.
        base: the recalibrated model.
        model: with the effects.
    """
    driven = [experiment for experiment in experiments if isinstance(experiment, AngleDriven)]
    part = driven[0].part if driven else None
    if part == BALANCE:
        compared = loops(driven, model.fits, model.effects)
    else:
        compared = losses(driven, base.fits, model.effects) if part == AIR else None
    if compared is None:
        return ()
    return (replace(compared, ambiguous=compared.evidence < thresholds.STRONG),)


def distinguishing_experiments(
    found: Sequence[str], ambiguous: Sequence[str], conditions: Collection[str]
) -> dict[str, str]:
    """For each effect that is as likely as a found one, what to record.

    Args:
        found: effects in the model.
        ambiguous: effects that do as well.
        conditions: of the joint in the recordings at hand.
    """
    out = {}
    for other in ambiguous:
        effect = CATALOGUE[other]
        if DRIVEN in conditions:
            out[other] = effect.sealed.experiment or effect.experiment
            continue
        out[other] = (experiment_between(other, found[0]) if found else None) or effect.experiment
        if len(set(conditions)) == 1:
            missing = "locked" if "free" in conditions else "free"
            out[other] += f"; or add a recording with the joint {missing}"
    return out


def with_compared_size(effect: FoundEffect, compared: Sequence[Ambiguity]) -> FoundEffect:
    """An effect whose size has an error that holds the difference to its size where it was compared with a rival.

    Friction may have any torque up to its bound while the joint sticks, which moves its size there.

    Args:
        effect: as it was found.
        compared: with rivals.
    """
    for item in compared:
        if item.found == effect.name and item.parameter in effect.parameters and np.isfinite(item.size):
            value, std, unit = effect.parameters[item.parameter]
            spread = (value, float(np.hypot(std, value - item.size)), unit)
            return replace(effect, parameters={**effect.parameters, item.parameter: spread})
    return effect


def loops(experiments: Sequence[AngleDriven], fits: Sequence[Fitted], found: Sequence[str]) -> Ambiguity | None:
    """Friction beside hysteresis where the joint slides; None where neither was found.

    Args:
        experiments: balances of the recordings.
        fits: their models.
        found: names of the effects in them.
    """
    here = next((name for name in found if name in _LOOPS), None)
    if here is None or set(_LOOPS) <= set(found):
        return None
    other = _LOOPS[1 - _LOOPS.index(here)]
    evidence, squares, count, width = 0.0, np.zeros(2), 0, np.nan
    sizes = []
    for experiment, fitted in zip(experiments, fits, strict=True):
        clear = replace(experiment, resolved=True)
        slides = np.isfinite(clear.measured[: len(fitted.residual), 0])
        rest = {path: value for path, value in fitted.point.effects.items() if path.split(".")[1] not in _LOOPS}
        left = []
        for name in (here, other):
            best = min(
                (refit(clear, Point(fitted.point.theta, {**rest, **start}), unknowns, rounds=20)
                 for start, unknowns in _starts(experiment, name)),
                key=lambda one: one.cost,
            )  # fmt: skip
            left.append(float(np.sum(best.residual[slides, 0] ** 2)))
            if name == here:
                sizes.append(best.point.effects[best.free[0].path])
            if name == "hysteresis":
                width = best.point.effects[parameter_path("hysteresis", "width")]
        independent = max(slides.sum() / fitted.scale.counted, np.e)
        price = (1.0 if other == "hysteresis" else -1.0) * np.log(independent)
        evidence += float(independent * np.log(left[1] / left[0]) + price)
        squares += left
        count += int(slides.sum())
    rms = np.sqrt(squares / max(count, 1))
    step = np.degrees(np.sqrt(12.0) * experiments[0].rig.sensors.angle_std)
    about = (
        f"where the joint slides; a hysteresis may turn round within a step of the encoder, {step:.2g}°. Both have "
        "one size only, since all turns of the joint are alike"
    )
    residual, size = (float(rms[0]), float(rms[1])), float(np.mean(sizes))
    parameter = "coulomb" if here == "friction" else ""
    return Ambiguity(here, other, evidence, residual, "N m", float(width), about, size, parameter)


def _starts(experiment: AngleDriven, name: str) -> list[tuple[dict[str, float], tuple[FreeEffectParameter, ...]]]:
    if name == "friction":
        path = parameter_path("friction", "coulomb")
        return [({path: 0.2}, (FreeEffectParameter((path,), CATALOGUE["friction"].parameters[0]),))]
    rig = experiment.rig
    narrow = float(np.sqrt(12.0)) * rig.sensors.angle_std * rig.geometry.radius / _TURN
    items = {item.name: item for item in CATALOGUE["hysteresis"].parameters}
    sizes = tuple(parameter_path("hysteresis", f"amplitude_{number}") for number in (1, 2))
    width = parameter_path("hysteresis", "width")
    unknowns = (
        FreeEffectParameter(sizes, items["amplitude_1"]),
        FreeEffectParameter((width,), replace(items["width"], low=min(narrow, items["width"].low))),
    )
    force = 0.1 / rig.geometry.radius
    return [({**dict.fromkeys(sizes, force), width: start}, unknowns) for start in (narrow, 4.0 * narrow, 2e-4)]


def losses(experiments: Sequence[AngleDriven], base: Sequence[Fitted], found: Sequence[str]) -> Ambiguity | None:
    """A leak beside a loss that dies out, in the mean of the pressures; None where no leak was found.

    Args:
        experiments: airs of the recordings.
        base: their models without effects.
        found: names of the effects that were found.
    """
    if "leak" not in found:
        return None
    tried = []
    counted = [len(fitted.residual) / fitted.scale.counted for fitted in base]
    steady = [_left(fitted, _time(fitted)) for fitted in base]
    for rate in _RATES:
        dying = [_left(fitted, np.exp(-_time(fitted) / rate)) for fitted in base]
        gain = sum(n * np.log(new / old) for n, old, new in zip(counted, steady, dying, strict=True))
        # Its time constant is one more unknown.
        tried.append((float(gain + np.log(max(sum(counted), np.e))), rate, dying))
    evidence, rate, dying = min(tried, key=lambda one: one[0])
    seconds = rate * np.mean([e.fitted * e.trial.dt for e in experiments])
    rms = tuple(float(np.sqrt(np.mean(part))) / 1e3 for part in (steady, dying))
    about = (
        "in the mean of the pressures, on what was fitted: gas that still cools from having been charged, or "
        "tubes that still give way, lose pressure at a rate that dies out"
    )
    return Ambiguity("leak", "thermal", evidence, (rms[0], rms[1]), "kPa", float(seconds), about)


def either_muscle(experiments: Sequence[AngleDriven], fits: Sequence[Fitted], effect: str) -> int | None:
    """The muscle that alone would do nearly as well as both alike; None where both are needed, or are not alike.

    Args:
        experiments: airs of the recordings.
        fits: their models.
        effect: one of both muscles.
    """
    lost = {1: 0.0, 2: 0.0}
    for experiment, fitted in zip(experiments, fits, strict=True):
        both = next((u for u in fitted.free if u.path.startswith(f"effects.{effect}.") and len(u.paths) == 2), None)
        if both is None:
            return None
        others = tuple(unknown for unknown in fitted.free if unknown is not both)
        for number, path in enumerate(both.paths, 1):
            effects = {name: value for name, value in fitted.point.effects.items() if name not in both.paths}
            start = Point(fitted.point.theta, {**effects, path: 2.0 * fitted.point.effects[path]})
            alone = refit(
                experiment,
                start,
                (*others, FreeEffectParameter((path,), both.item)),
                blocks_per_error=fitted.scale.blocks_per_error,
            )
            gap = cost_of(experiment, alone.point, alone.residual, fitted.scale) - fitted.cost
            lost[number] += fitted.scale.share * gap
    best = min(lost, key=lambda number: lost[number])
    return best if lost[best] < thresholds.STRONG else None


def _time(fitted: Fitted) -> Floats:
    return np.asarray(np.linspace(0.0, 1.0, len(fitted.residual)))


def _left(fitted: Fitted, course: Floats) -> float:
    """Mean square of the mean pressure's residual that base parameters and a course in time leave."""
    columns = np.column_stack([fitted.base[:, 0, :], course, np.ones(len(course))])
    used = columns[:, np.any(columns != 0.0, axis=0)]
    scaled = used / np.sqrt(np.mean(used**2, axis=0))
    residual = fitted.residual[:, 0]
    left = residual - scaled @ np.linalg.lstsq(scaled, residual, rcond=1e-9)[0]
    return float(np.mean(left**2))
