"""The verdict on a sealed joint in words, and what to record where it is open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.diagnosis.sealed_base import sweeps
from pam_antagonist.diagnosis.sentence import in_words
from pam_antagonist.inference.trial import Trial
from pam_antagonist.model.effects import CATALOGUE, Effect


def experiments(ambiguous: Sequence[str]) -> dict[str, str]:
    """For each effect that would do as well as a found one, what to record."""
    return {name: CATALOGUE[name].sealed.experiment or CATALOGUE[name].experiment for name in ambiguous}


def few_sweeps(trials: Sequence[Trial], cuts: Sequence[int], least: int) -> list[str]:
    """A warning where little of independent motion was held out: all samples of a sweep err alike."""
    fitted = sum(sweeps(trial, 0, cut) for trial, cut in zip(trials, cuts, strict=True))
    held = sum(sweeps(trial, cut, len(trial)) for trial, cut in zip(trials, cuts, strict=True))
    if min(fitted, held) >= least:
        return []
    return [
        f"the joint slides {_times(fitted)} in what was fitted and {_times(held)} in what was held out, and all "
        "samples of a sweep err alike: errors on held-out data are those of so few; record for minutes, at several "
        "amplitudes"
    ]


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _instead(effect: Effect) -> str:
    return effect.sealed.instead or f"{effect.title} would do as well"


def unseen(with_torque: bool) -> tuple[str, ...]:
    """What no analysis of these recordings can show."""
    why = {name: effect.sealed.reason for name, effect in CATALOGUE.items() if effect.sealed.part is None}
    *others, last = (effect.title for effect in CATALOGUE.values() if effect.sealed.part == "balance")
    said = [
        "Of a sealed joint cannot be seen: " + "; ".join(f"{name} ({reason})" for name, reason in why.items()) + "."
    ]
    said.append(
        "The torque from outside is what the drive was told to apply, not what a sensor measured: friction of the "
        "drive is in it."
        if with_torque
        else f"No torque from outside was recorded: {', '.join(others)} and {last} cannot be seen."
    )
    return tuple(said)


def sentence(
    verdict: str,
    found: Sequence[FoundEffect],
    ambiguous: Sequence[str],
    errors: Mapping[str, Mapping[str, Any]],
    reference: Mapping[str, float] | None,
) -> str:
    """The verdict in a sentence, with its evidence."""
    if verdict == "none":
        return (
            "Nothing is wrong with the model beyond its parameters: recalibrated, it leaves what the sensors explain "
            f"({_errors(errors, 'recalibrated')} on data held out from the fit)."
        )
    if verdict == "unexplained":
        return (
            "Something is wrong that no effect of the catalogue explains: recalibrated, the model leaves "
            f"{_errors(errors, 'recalibrated')} on held-out data, well beyond the sensors' noise."
        )
    what = "; and ".join(in_words(effect, sealed=True) for effect in found)
    before, after = errors["recalibrated"], errors["extended"]
    changes = []
    if after["torque"] is not None:
        old, new = before["torque"]["rmse_nm"], after["torque"]["rmse_nm"]
        changes.append(f"that of the torque from {old:.2g} to {new:.2g} N m")
        if reference is not None:
            changes[0] += f" (a straight-line map of angle and pressures: {reference['angle_and_pressures']:.2g})"
    means = [item["pressure"]["mean_rmse_pa"] / 1e3 for item in (before, after)]
    changes.append("that of the mean pressure from {:.2g} to {:.2g} kPa".format(*means))
    doubts = "; ".join(_instead(CATALOGUE[name]) for name in ambiguous)
    text = f"{what[0].upper()}{what[1:]}. On data that no fit has seen the error falls: {', '.join(changes)}."
    return text + (f" Not told apart: {doubts}." if doubts else "")


def _errors(errors: Mapping[str, Mapping[str, Any]], model: str) -> str:
    own = errors[model]
    said = [f"{own['torque']['rmse_nm']:.2g} N m"] if own["torque"] else []
    said.append("{:.2g} and {:.2g} kPa".format(*(value / 1e3 for value in own["pressure"]["rmse_pa"])))
    return ", ".join(said)
