"""Whether a law is worth taking: the part of a model in which it acts, and evidence where nothing was fitted."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.law_forms import LawForm
from pam_antagonist.diagnosis.models import Model, further_share, likelier, share_of_all
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import held_residual, refit
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE
from pam_antagonist.model.effects.places import TABLE
from pam_antagonist.rig.learned import Law, with_law

Floats = NDArray[np.float64]


def with_it(model: Model, *laws: Law) -> Model:
    """A model with laws, everything else fitted anew."""
    # A sealed joint is diagnosed about what was identified of it, and not about the rig as configured.
    own = tuple(_of_laws(one, laws) for one in model.experiments)
    # The derivatives without the laws serve for the first steps.
    return replace(model, experiments=own).map(lambda one, fit: refit(one, fit.point, fit.free, fit.base))


def _of_laws(experiment: Experiment, laws: Sequence[Law]) -> Experiment:
    """A recording of a rig with laws, and with the errors of readings that some of them are."""
    errors = [law for law in laws if law.is_of_readings]
    if errors:
        judged = tuple(_of_laws(other, errors) for other in experiment.judged)
        experiment = replace(experiment, misread=partial(misread, errors), judged=judged)
    return functools.reduce(
        lambda one, law: one if law in errors else one.of_rig(with_law(one.rig, law)), laws, experiment
    )


def misread(laws: Sequence[Law], readings: Floats, dt: float) -> Floats:
    """By how much sensors read too high, by laws of their readings (N, 4), in the order of ``CHANNELS``.

    `readings`: in that order (N, 4), NaN where there are none.
    """
    angle, torque, first, second = np.nan_to_num(readings).T
    seen = {"pressure_1": first, "pressure_2": second, "pressure_difference": first - second, "angle": angle,
            "torque": torque, "time": dt * np.arange(len(readings))}  # fmt: skip
    high = np.zeros(readings.shape)
    for law in laws:
        group = LawForm.of(law)
        column = {"angle": ANGLE, "torque": TORQUE, "pressure": PRESSURE_1}[TABLE[group.kind].reads]
        for muscle in group.muscles:
            high[:, column + muscle - 1] += np.interp(group.argument_of(seen, muscle, dt), law.nodes, law.values)
    return high


def evidence_held_out(before: Model, after: Model) -> float:
    """Twice the log likelihood ratio of two models of the same recordings where nothing was fitted."""
    pairs = zip(before.pairs, after.pairs, strict=True)
    return sum(likelier(old.scale, held_residual(a, old), held_residual(b, new)) for (a, old), (b, new) in pairs)


def parts(model: Model) -> list[Model]:
    """The parts of a model, as laws are judged; those along a measured motion first, which say most of friction."""
    seen = {view: (one, fitted) for one, fitted in model.pairs for view in one.for_laws if view.law_places}
    out = []
    for places in dict.fromkeys(view.law_places for view in sorted(seen, key=lambda view: not view.is_kept_near)):
        here = {view: pair for view, pair in seen.items() if view.law_places == places}
        fits = (fit if view is one else refit(view, fit.point, fit.free) for view, (one, fit) in here.items())
        out.append(Model(tuple(here), tuple(fits), model.effects))
    return out


def is_better(base: Model, before: Model, after: Model, law: Law) -> bool:
    """Whether a model with a law does better where nothing was fitted, by the rules of a further effect.

    `base`: without effects. `before`: with what was found without the law.
    """
    base, before, after = all_acting(law, base, before, after)
    if after.experiments[0].is_kept_near:
        # The motion keeps such a model near, and most of the excess of a sealed joint is its Coulomb friction.
        removes_enough = share_of_all(before, after) >= thresholds.EXPLAINED
    else:
        removes_enough = further_share(base, before, after) >= thresholds.FURTHER_SHARE
    if law.argument == "time":
        # A table by time follows whatever is slow. It says little of the rig unless it is the explanation.
        removes_enough = removes_enough and share_of_all(base, after) >= thresholds.EXPLAINED
    takes_enough = largest_share_of_a_channel(before, after) >= thresholds.SHARE_OF_CHANNEL
    return evidence_held_out(before, after) >= thresholds.STRONG and removes_enough and takes_enough


def largest_share_of_a_channel(before: Model, after: Model) -> float:
    """Share of the error over noise that is gone on held-out data, in the channel where that is most."""
    left = [_errors_over_noise(model) for model in (before, after)]
    return max((1.0 - left[1][name] / value for name, value in left[0].items() if value > 0.0), default=0.0)


def _errors_over_noise(model: Model) -> dict[str, float]:
    """Root mean square of what a model leaves of held-out data, less the noise, by channel and in its noise."""
    found: dict[str, list[Floats]] = {}
    for experiment, fitted in model.pairs:
        parts = held_residual(experiment, fitted) / experiment.noise
        for channel, values in zip(experiment.titles, parts.T, strict=True):
            found.setdefault(channel.title, []).append(values)
    squares = {name: np.concatenate(parts) ** 2 for name, parts in found.items()}
    return {name: max(float(np.mean(each)) - 1.0, 0.0) ** 0.5 for name, each in squares.items() if len(each)}


def acting(law: Law, model: Model) -> Model:
    """The part in which a law acts, as laws are judged; all of a model that has no such place."""
    here = [one for one in parts(model) if any(LawForm(at).kind == law.place for at in one.experiments[0].law_places)]
    return here[0] if here else model


def all_acting(law: Law, *models: Model) -> list[Model]:
    """Likewise of several models; all of each where they do not judge the same recordings alike."""
    alike = len({tuple(one.law_places for one in model.experiments) for model in models}) == 1
    return [acting(law, model) for model in models] if alike else list(models)
