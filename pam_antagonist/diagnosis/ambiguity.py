"""Effects that recordings cannot distinguish: candidates nearly as good as the chosen one, and rivals on equal terms.

A candidate is ambiguous with the chosen one if its evidence is not smaller by strong evidence. An angle-driven joint
has further ambiguities. They are compared on what its sensors resolve. The effects' own files say which effects these
are (:class:`~pam_antagonist.model.effects.base.SealedJoint`):

*A loop.* Coulomb friction and hysteresis differ in how the torque reverses: at once, or over a width. While the drive
sticks, the encoder shows no motion. So it does not show a reversal within one of its steps. Both effects are compared
where the joint slides. The hysteresis may be as narrow as one step.

*A loss.* A leak has a constant rate, as long as the pressure hardly falls. Gas that cools after it was charged, and
tubes that still stretch, lose pressure at a rate that decays.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.judged import Judged
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.diagnosis.preparation import DRIVEN
from pam_antagonist.diagnosis.result import Ambiguity, FoundEffect, Size
from pam_antagonist.diagnosis.search import about
from pam_antagonist.inference.angle_driven import AIR, BALANCE, AngleDriven
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, refit
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.unknown import of_effect
from pam_antagonist.model.effects import CATALOGUE, EffectParameter, parameter_path
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_LOOPS = {name: effect.sealed.loop for name, effect in CATALOGUE.items() if effect.sealed.loop is not None}
"""Effects with a torque loop, and the form of the loop."""
_TIME_CONSTANTS = (0.125, 0.25, 0.5, 1.0)
"""Time constants of a loss that decays, in durations of the fitted part."""


def not_told_apart(judged: Sequence[Judged], rivals: Sequence[Ambiguity]) -> tuple[str, ...]:
    """Effects and calibrations that would do as well as a found one."""
    rankings = [(j, j.ranking) for j in judged if j.verdict == "effect"]
    near: list[str] = []
    for _, ranking in rankings:
        first = [tried for tried in ranking.tried if tried.round == 1 and tried.shares is not None]
        best = next((tried for tried in first if tried.effect in ranking.model.effects[:1]), None)
        near += () if best is None else best.near(first)
    near += [name for j, ranking in rankings for e in j.effects for name in ranking.rivals.get(e.name, ())]
    near += [name for j in judged for item in j.calibrations for name in item.rivals]
    found = {name for j in judged for name in (*j.model.effects, *(item.name for item in j.calibrations))}
    names = (*near, *(rival.other for rival in rivals if rival.ambiguous))
    return tuple(name for name in dict.fromkeys(names) if name not in found)


def ambiguities(base: Model, model: Model) -> tuple[Ambiguity, ...]:
    """Comparisons of found effects with their rivals on equal terms."""
    driven = [experiment for experiment in model.experiments if isinstance(experiment, AngleDriven)]
    part = driven[0].part if driven else None
    if part == BALANCE:
        compared = _loops(driven, model.fits, model.effects)
    else:
        compared = _losses(driven, base.fits, model.effects) if part == AIR else []
    return tuple(replace(item, ambiguous=item.evidence < thresholds.STRONG) for item in compared)


def distinguishing_experiments(
    found: Sequence[str], ambiguous: Sequence[str], conditions: Collection[str], calibrated: Sequence[str] = ()
) -> dict[str, str]:
    """For each effect and calibration that is as likely as a found one, what to record."""
    out = {}
    for other in ambiguous:
        # A calibration is measured without a model, the one that was found as well as a rival.
        told = calibrated[0] if about(other).is_effect and calibrated and not found else other
        out[other] = about(told).experiment(told, next(iter(found), None), DRIVEN in conditions)
        if about(told).is_effect and DRIVEN not in conditions and len(set(conditions)) == 1:
            missing = "locked" if "free" in conditions else "free"
            out[other] += f"; or add a recording with the joint {missing}"
    return out


def with_compared_size(effect: FoundEffect, compared: Sequence[Ambiguity]) -> FoundEffect:
    """An effect whose standard deviation covers the size that it had in the comparison with a rival.

    While the joint sticks, friction may have any torque up to its bound. This changes its size there.
    """
    for item in compared:
        if item.found == effect.name and item.parameter in effect.parameters and np.isfinite(item.size):
            value, std, unit = effect.parameters[item.parameter]
            spread = Size(value, float(np.hypot(std, value - item.size)), unit)
            return replace(effect, parameters={**effect.parameters, item.parameter: spread})
    return effect


def _loops(experiments: Sequence[AngleDriven], fits: Sequence[Fitted], found: Sequence[str]) -> list[Ambiguity]:
    """Compare a found effect that has a torque loop with the others that have one, where the joint slides."""
    here = next((name for name in found if name in _LOOPS), None)
    if here is None:
        return []
    clear = [replace(experiment, resolved=True) for experiment in experiments]
    found_fits = [_with_loop(*pair, here) for pair in zip(clear, fits, strict=True)]
    slides = [np.isfinite(one.measured[: len(fit.residual), 0]) for one, fit in zip(clear, fits, strict=True)]
    # Samples with independent errors.
    values = [max(there.sum() / fit.scale.counted, np.e) for there, fit in zip(slides, fits, strict=True)]
    count = max(sum(int(there.sum()) for there in slides), 1)
    sizes = _LOOPS[here].sizes
    item = _item(here, sizes[0])
    out = []
    for other in (name for name in _LOOPS if name not in found):
        rival_fits = [_with_loop(*pair, other) for pair in zip(clear, fits, strict=True)]
        squares = np.array(
            [
                [np.sum(one.residual[at, 0] ** 2) for one, at in zip(both, slides, strict=True)]
                for both in (found_fits, rival_fits)
            ]
        )
        price = len(rival_fits[0].free) - len(found_fits[0].free)
        gains = [n * np.log(their / my) + price * np.log(n) for n, my, their in zip(values, *squares, strict=True)]
        rms = np.sqrt(squares.sum(axis=1) / count)
        widths = [fit.point.effects[parameter_path(n, _LOOPS[n].width)]
                  for n, fit in ((here, found_fits[-1]), (other, rival_fits[-1])) if _LOOPS[n].width]  # fmt: skip
        out.append(
            Ambiguity(
                found=here,
                other=other,
                evidence=float(sum(gains)),
                residual=(float(rms[0]), float(rms[1])),
                unit="N m",
                shape=float(widths[-1]) if widths else np.nan,
                about=_about_loops(experiments[0].rig, (here, other)),
                size=float(np.mean([fit.point.effects[fit.free[0].path] for fit in found_fits])),
                size_unit=item.unit,
                # One value cannot stand for several sizes that differ.
                parameter=item.name if len(sizes) == 1 else "",
            )
        )
    return out


def _about_loops(rig: Rig, names: Sequence[str]) -> str:
    step = f"{np.degrees(np.sqrt(12.0) * rig.sensors.angle_std):.2g}°"
    about = [_LOOPS[name].about.format(step=step) for name in names if _LOOPS[name].about]
    return " ".join(["while the joint slides, with one size for each.", *about])


def _item(effect: str, name: str) -> EffectParameter:
    return next(item for item in CATALOGUE[effect].parameters if item.name == name)


def _with_loop(experiment: AngleDriven, fitted: Fitted, name: str) -> Fitted:
    """The best fit with one effect that has a torque loop in place of all such effects."""
    loop, rig = _LOOPS[name], experiment.rig
    rest = {path: value for path, value in fitted.point.effects.items() if path.split(".")[1] not in _LOOPS}
    sizes, size = tuple(parameter_path(name, one) for one in loop.sizes), _item(name, loop.sizes[0])
    start = dict.fromkeys(sizes, loop.torque if size.unit == "N m" else loop.torque / rig.geometry.radius)
    free, starts = [of_effect(sizes, size)], [start]
    if loop.width:
        path, width = parameter_path(name, loop.width), _item(name, loop.width)
        # As narrow as the encoder's step: while the drive sticks, nothing shows the motion within it.
        narrow = float(np.sqrt(12.0)) * rig.sensors.angle_std * rig.geometry.radius / loop.widths_a_turn
        free.append(of_effect((path,), replace(width, low=min(narrow, width.low))))
        starts = [{**start, path: value} for value in (narrow, 4.0 * narrow, *loop.widths)]
    fits = [refit(experiment, Point(fitted.point.theta, {**rest, **one}), free, rounds=20) for one in starts]
    return min(fits, key=lambda one: one.cost)


def _losses(experiments: Sequence[AngleDriven], base: Sequence[Fitted], found: Sequence[str]) -> list[Ambiguity]:
    """Compare a found loss of pressure at a steady rate with losses whose rate decays, by the mean of the pressures."""
    here = next((name for name in found if CATALOGUE[name].sealed.loss == "steady"), None)
    rivals = [name for name, effect in CATALOGUE.items() if effect.sealed.loss == "fading"]
    if here is None or not rivals:
        return []
    tried = []
    counted = [len(fitted.residual) / fitted.scale.counted for fitted in base]
    steady = [_mean_square(fitted, _time(fitted)) for fitted in base]
    for constant in _TIME_CONSTANTS:
        fading = [_mean_square(fitted, np.exp(-_time(fitted) / constant)) for fitted in base]
        gain = sum(n * np.log(new / old) for n, old, new in zip(counted, steady, fading, strict=True))
        # The time constant is one more unknown.
        tried.append((float(gain + np.log(max(sum(counted), np.e))), constant, fading))
    evidence, constant, fading = min(tried, key=lambda one: one[0])
    seconds = constant * np.mean([e.fitted * e.trial.dt for e in experiments])
    rms = tuple(float(np.sqrt(np.mean(part))) / 1e3 for part in (steady, fading))
    return [
        Ambiguity(
            here,
            other,
            evidence,
            (rms[0], rms[1]),
            "kPa",
            float(seconds),
            f"by the mean of the fitted pressures. {CATALOGUE[other].sealed.loss_about}",
        )
        for other in rivals
    ]


def either_muscle(experiments: Sequence[AngleDriven], fits: Sequence[Fitted], effect: str) -> int | None:
    """The muscle that alone explains nearly as much as both with one size; None if both are needed or differ."""
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
                (*others, of_effect((path,), both.item)),
                blocks_per_error=fitted.scale.blocks_per_error,
            )
            gap = cost_of(experiment, alone.point, alone.residual, fitted.scale) - fitted.cost
            lost[number] += fitted.scale.share * gap
    best = min(lost, key=lambda number: lost[number])
    return best if lost[best] < thresholds.STRONG else None


def _time(fitted: Fitted) -> Floats:
    return np.asarray(np.linspace(0.0, 1.0, len(fitted.residual)))


def _mean_square(fitted: Fitted, course: Floats) -> float:
    """Mean square of the mean pressure's residual after a fit of the base parameters and a course in time."""
    columns = np.column_stack([fitted.base[:, 0, :], course, np.ones(len(course))])
    used = columns[:, np.any(columns != 0.0, axis=0)]
    scaled = used / np.sqrt(np.mean(used**2, axis=0))
    residual = fitted.residual[:, 0]
    rest = residual - scaled @ np.linalg.lstsq(scaled, residual, rcond=1e-9)[0]
    return float(np.mean(rest**2))
