"""Warnings for the user: what recordings cannot show, and what looks wrong in them or in the rig file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.change_point import Stretch
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.diagnosis.preparation import Prepared
from pam_antagonist.diagnosis.result import RecordingEntry, SizeProfile
from pam_antagonist.diagnosis.splits import Firmness
from pam_antagonist.inference.angle_driven import BALANCE, sweeps
from pam_antagonist.inference.expected import guesses_curves
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.gauss_newton import Fitted
from pam_antagonist.inference.likelihood import LinearProblem
from pam_antagonist.inference.measured_motion import MeasuredMotion
from pam_antagonist.inference.point import Point, Span
from pam_antagonist.inference.trial import ANGLE, TORQUE
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE, Effect
from pam_antagonist.rig import Rig

_WITH_VALVES = tuple(effect for effect in CATALOGUE.values() if "valve" in effect.tested_with)
"""What is tested here: effects of joints with regulators alone are no candidates."""
_OF_STEADY_PRESSURES = {"voltage_shift", "open_rate_shift", "supply_change", "mass_loss", "sensor_reading"}
"""Hooks of effects that change the steady pressure of a voltage, as another valve curve does."""


def like_a_curve(rig: Rig, effects: Iterable[str]) -> tuple[str, ...]:
    """Effects that look like a valve curve of another slope, if the rig file calls its curves guessed.

    The prior of a guessed curve covers its shift only, so no fit moves its slope.
    """
    if not guesses_curves(rig):
        return ()
    alike = {name for name, effect in CATALOGUE.items() if not _OF_STEADY_PRESSURES.isdisjoint(effect.hooks)}
    return tuple(dict.fromkeys(name for name in effects if name in alike))


def guessed_curves(rig: Rig, effects: Iterable[str]) -> list[str]:
    """A warning if a guessed curve may look like a found effect."""
    alike = " or ".join(like_a_curve(rig, effects))
    if not alike:
        return []
    return [
        f"rig {rig.name} only guesses the valves' curves, and a curve of another slope looks like {alike}: measure "
        "the curves before you trust this result"
    ]


def implausible(model: Model) -> list[str]:
    """Base parameters that had to leave their prior: a wrong number in the rig file, or an effect in disguise."""
    warnings = []
    for experiment, fitted in model.pairs:
        for direction, amount in zip(experiment.directions, fitted.point.theta, strict=False):
            if abs(amount) > thresholds.IMPLAUSIBLE * direction.prior:
                warnings.append(
                    f"recalibration moves {direction.name} by {direction.in_words(amount)} in "
                    f"{experiment.trial.name}, {abs(amount) / direction.prior:.0f} standard deviations of its prior: "
                    "a number in the rig file is wrong, or an effect that the model lacks looks like it"
                )
    return warnings


def explained_in_part(effects: Sequence[str]) -> str:
    """A warning of effects that explain much of the excess and not all."""
    which = " and ".join(dict.fromkeys(effects))
    return (
        f"{which} does not explain all: much of the residual is still above the sensors' noise. The effect may have "
        "another form than the catalogue's law, or there is a smaller effect as well (section What is left)"
    )


def at_bounds(model: Model) -> list[str]:
    """Parameters of effects that ended at a bound: the recording asks for more than makes sense."""
    out = []
    for experiment, fitted in model.pairs:
        for free in fitted.free:
            value = fitted.point.effects.get(free.path, free.item.neutral)
            # In the number's own scale: a leak of 1e-9 m² is not next to 0.
            near = 1e-5 * free.item.scale
            ends = any(np.isclose(value, bound, atol=near) for bound in (free.item.low, free.item.high))
            # An effect of size 0 is not there.
            if not ends or value == 0.0:
                continue
            name = free.path.split(".", 1)[1]
            meaning = (
                "the effect is larger than this bound, or it is another effect"
                if free.item.is_size
                else "the recording does not show how much further the value is; the standard error has no meaning"
            )
            what = f"{name} ends at its bound, {value:g} {free.item.unit}, in {experiment.trial.name}"
            out.append(f"{what} ({free.item.meaning}): {meaning}")
    return out


def above_noise(stretches: Sequence[Stretch]) -> list[str]:
    """Where the recalibrated model leaves more than noise, one sentence a recording."""
    return [
        f"{s.recording}: the residual of {s.channel.lower()} is {s.times_noise:.2g} times its noise from "
        f"{s.begin_s:.0f} to {s.end_s:.0f} s, and no base parameters change that (evidence {s.evidence:.0f} against "
        "noise)"
        for s in stretches
    ]


def changes(above_noise: Mapping[str, Sequence[Span]]) -> list[str]:
    """When recordings leave their noise, where no effect explains it.

    `above_noise`: the parts of each recording, by its name; one that lasts throughout says nothing.
    """
    out = []
    for name, spans in above_noise.items():
        edges = ([("begins", span.begin_s), ("ends", span.end_s)] for span in spans)
        acts = [" and ".join(f"{what} at {time:.1f} s" for what, time in pair if np.isfinite(time)) for pair in edges]
        if all(acts):
            part = "that part" if len(acts) == 1 else "these parts"
            out.append(
                f"{name}: something that the model lacks {', then '.join(acts)}; outside of {part} the residuals are "
                "as small as the sensors' noise allows"
            )
    return out


def along_motion(base: Model, model: Model) -> str:
    """The note on a verdict that rests on the model along the measured motion."""
    each = []
    for experiment, *fits in zip(model.experiments, base.fits, model.fits, strict=True):
        if isinstance(experiment, MeasuredMotion):
            old, new = (100.0 * experiment.right(fitted.point) for fitted in fits)
            each.append(f"{experiment.trial.name}: {old:.0f} % before, {new:.0f} % with the effect")
    return (
        "the joint sticks and slips, and no model predicts that for long. So the verdict rests on the balance of "
        "torques along the measured motion. Share of the held-out time in which the torques balance: "
        f"{'; '.join(each)}. The errors in this report are those of the model that gets the commands only"
    )


def not_firm(effect: str, firm: Firmness) -> str:
    """A warning of an effect that was selected and that most splits do not support."""
    return (
        f"{effect} was selected, but only {firm.in_words()}: the result depends on which part of the recording is "
        "held out, so the effect is not reported as found"
    )


def decided_by_innovations(effects: Sequence[str], evidence: float, taken: bool) -> str:
    """What the innovations said where pressures alone were measured.

    `evidence`: twice the log likelihood ratio of the held-out innovations with and without them.
    """
    which = " and ".join(effects)
    if taken:
        return f"only pressures were measured; the estimator's innovations support {which} as well ({evidence:+.0f})"
    return (
        f"the pressures suggest {which}, but the estimator's innovations on the held-out part do not "
        f"({evidence:+.0f}), so it is not reported as found; to decide, measure the angle or the torque as well"
    )


def flat_profiles(profiles: Sequence[SizeProfile]) -> list[str]:
    """Sizes that the recordings do not determine."""
    flat = [item.parameter for item in profiles if item.flat]
    return [f"these recordings do not determine {', '.join(flat)}: the likelihood is flat"] if flat else []


def estimator_worse(entries: Sequence[RecordingEntry]) -> list[str]:
    """Recordings in which the estimator does worse with what was found than as configured.

    `entries`: of the report, one a recording; those without the estimator's errors say nothing.
    """
    warnings = []
    for entry in entries:
        if entry.ukf is None:
            continue
        start, end = entry.ukf.as_configured, entry.ukf.extended
        for what, unit, before, after in (
            ("angle", "°", start.angle, end.angle), ("torque", " N m", start.torque, end.torque),
        ):  # fmt: skip
            if before and after and after.rmse > thresholds.ESTIMATOR_WORSE * before.rmse:
                warnings.append(
                    f"the estimator is worse in {entry.recording} with the values fitted here ({what} "
                    f"{after.rmse:.2g}{unit}) than with the rig as configured ({before.rmse:.2g}{unit}): the base "
                    "parameters were fitted to something that no effect explains"
                )
    return warnings


def slides(prepared: Prepared) -> tuple[int, int]:
    """How often a joint that is driven by its angle slides in the fitted and in the held-out part."""
    cuts = {number: e.fitted for g in prepared.groups for number, e in zip(g.numbers, g.experiments, strict=True)}
    trials = [(prepared.trials[number], cut) for number, cut in cuts.items()]
    return sum(sweeps(one, 0, cut) for one, cut in trials), sum(sweeps(one, cut, len(one)) for one, cut in trials)


def few_sweeps(prepared: Prepared) -> list[str]:
    """A warning where a joint that is driven by its angle slides too seldom: all samples of a sweep share one error."""
    if not prepared.angle_driven:
        return []
    counts = slides(prepared)
    if min(counts) >= thresholds.FEW_SWEEPS:
        return []
    fitted, held = ("once" if count == 1 else f"{count} times" for count in counts)
    return [
        f"the joint slides only {fitted} in the fitted part and {held} in the held-out part; all samples of one sweep "
        "have nearly the same error, so the errors rest on few independent values; record for minutes, at several "
        "amplitudes"
    ]


def unseen(prepared: Prepared, bases: Iterable[Model]) -> tuple[str, ...]:
    """What no analysis of these recordings can show, one sentence each.

    `bases`: models without effects, with all recordings.
    """
    trials = prepared.trials[: prepared.fitted]
    if prepared.angle_driven:
        hidden = [effect for effect in _WITH_VALVES if effect.sealed.part is None]
        reasons = "; ".join(f"{effect.name} ({effect.sealed.reason})" for effect in hidden)
        balance = _listed(effect for effect in _WITH_VALVES if effect.sealed.part == BALANCE)
        torque = (
            "The external torque is the one that the drive was commanded to apply, not a measured one. It includes the "
            "drive's friction."
            if any(trial.has(TORQUE) for trial in trials)
            else f"No torque from outside was recorded: {balance} cannot be seen."
        )
        zeros = (
            "Zeros of the encoder and of the torque cannot be seen: the charge of the muscles and the difference of "
            "their forces look the same."
        )
        return f"These effects cannot be seen on a sealed joint: {reasons}.", torque, zeros
    out = []
    free = [trial for trial in trials if trial.joint == "free"]
    if not free:
        moving = _listed(effect for effect in _WITH_VALVES if effect.needs_motion)
        out.append(f"The joint was locked throughout: {moving} cannot be seen.")
    if len(free) == len(trials):
        out.append(
            "The joint was never locked, so an error of the force is hard to distinguish from friction and load. A "
            "recording with the joint locked distinguishes them."
        )
    if any(trial.has(TORQUE) for trial in trials):
        out.append(
            "An error of a few per cent in the torque meter's scale cannot be seen: muscles, inertia and friction that "
            "are larger by the same factor look the same."
        )
    else:
        out.append("No torque was measured: an error of the force shows only in the joint's motion.")
    if free and not any(trial.has(ANGLE) for trial in free):
        hardly = _listed(effect for effect in _WITH_VALVES if effect.needs_angle)
        out.append(
            f"No angle was measured: the motion shows only through the pressures, and {hardly} can hardly be seen."
        )
    if not any(trial.has(TORQUE) or trial.has(ANGLE) for trial in trials):
        out.append(
            "Pressures alone decide here. The estimator's innovations have to support what they suggest. Only effects "
            "of the air, the valves and the pressure sensors can be found."
        )
    small = [name for base in bases for name in invisible(base)]
    if small:
        out.append(
            f"Not seen in these recordings, even at their usual size: {', '.join(small)}. So the joint may have them."
        )
    return tuple(out)


def _listed(effects: Iterable[Effect]) -> str:
    *others, last = (effect.title for effect in effects)
    return f"{', '.join(others)} and {last}"


def invisible(base: Model) -> tuple[str, ...]:
    """Effects that would not show in these recordings, even if nothing else were wrong.

    An effect shows where one of its sizes, neither small nor large, moves what was measured beyond the sensors' noise
    in a way that the base parameters cannot imitate, by strong evidence.
    """
    names = [candidate.effect for candidate in base.experiments[0].candidates({})]
    shown = set().union(*base.each(lambda *pair: _shown(names, *pair)))
    out = [name for name in names if name not in shown]
    if not any(ANGLE in experiment.channels for experiment in base.experiments):
        out.append(DISTURBANCE)
    return tuple(out)


def _shown(names: Iterable[str], experiment: Experiment, fitted: Fitted) -> set[str]:
    """Which of these effects show in a recording."""
    there, points = [], []
    for candidate in map(Candidate, names):
        shapes = {shape.path: shape.item.neutral for shape in candidate.shapes}
        for size in candidate.sizes:
            values = dict.fromkeys(size.paths, size.bounded(size.item.scale))
            there.append(candidate.effect)
            points.append(Point(fitted.point.theta, {**fitted.point.effects, **shapes, **values}))
    counted = experiment.blocks_per_error
    scale, none = fitted.scale, np.zeros((*fitted.residual.shape, 0))
    out = set()
    for name, change in zip(there, experiment.differences(fitted.point, fitted.residual, points), strict=True):
        # As a fit would see it if all else were noise.
        step = LinearProblem.of(change, fitted.base, none).solved(
            scale, experiment.prior, np.zeros(experiment.size), rounds=1, first=scale.noise**2,
            length=np.full(len(scale.noise), counted),
        )  # fmt: skip
        rise = np.log1p(step.squares / scale.noise**2)
        independent = len(change) / counted
        if independent * float(rise.sum()) - float(np.log(change.size / counted)) > thresholds.STRONG:
            out.add(name)
    return out
