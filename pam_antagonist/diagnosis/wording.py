"""The verdict in a sentence, with its evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pam_antagonist.diagnosis.candidates import TriedCandidate
from pam_antagonist.diagnosis.result import FoundEffect, Verdict
from pam_antagonist.model.effects import CATALOGUE


def in_words(effect: FoundEffect, sealed: bool = False) -> str:
    """What an effect means.

    Args:
        effect: that was found.
        sealed: whether the joint is sealed.
    """
    values = {name: value for name, (value, _, _) in effect.parameters.items()}
    return CATALOGUE[effect.name].in_words(effect.muscle, values, sealed)


def sentence(
    verdict: Verdict,
    effects: Sequence[str],
    ambiguous: Sequence[str],
    share: float,
    errors: Mapping[str, Mapping[str, Any]],
    ranking: Sequence[TriedCandidate],
    reference: Mapping[str, float] | None,
    mean_pressure: bool,
) -> str:
    """The verdict in a sentence.

    Args:
        verdict: on the joint.
        effects: what was found, each in words.
        ambiguous: names of the effects that would do as well.
        share: of the held-out excess that the effects remove.
        errors: of the three models.
        ranking: all candidates.
        reference: errors of maps that know no physics.
        mean_pressure: whether the mean of the pressures is what the model is compared by, not each of them.
    """
    recalibrated, extended = (_errors(errors[name], mean_pressure) for name in ("recalibrated", "extended"))
    if verdict == "none":
        return (
            "Nothing is wrong with the model beyond its parameters: recalibrated, it leaves what the sensors' noise "
            f"explains ({recalibrated} on data held out from the fit)."
        )
    if verdict == "effect":
        what = "; and ".join(effects)
        text = (
            f"{what[0].upper()}{what[1:]}: with it the model's errors on data that no fit has seen fall from "
            f"{recalibrated} to {extended}, and {100 * share:.0f} % of what was beyond the sensors' noise is gone."
        )
        if reference is not None:
            text += f" A straight-line map of angle and pressures errs by {reference['angle_and_pressures']:.2g} N m."
        doubts = "; ".join(_instead(name) for name in ambiguous)
        return text + (f" Not told apart: {doubts}." if doubts else "")
    tried = [item for item in ranking if item.shares is not None and item.round == 1]
    best = max(tried, key=lambda item: item.shares[0] if item.shares else 0.0, default=None)
    closest = ""
    if best is not None and best.shares is not None:
        gone = f"{100 * max(best.shares[0], 0.0):.0f} %"
        closest = f" The closest, {best.effect}, takes away {gone} of that, which is not enough."
    return (
        "Something is wrong that no effect of the catalogue explains: recalibrated, the model leaves "
        f"{recalibrated} on held-out data, well beyond the sensors' noise.{closest}"
    )


def _instead(name: str) -> str:
    effect = CATALOGUE[name]
    return effect.sealed.instead or f"{effect.title} would do as well"


def _errors(own: Mapping[str, Any], mean_pressure: bool) -> str:
    parts = []
    if own["angle"]:
        parts.append(f"{own['angle']['rmse_deg']:.2g}°")
    if own["torque"]:
        parts.append(f"{own['torque']['rmse_nm']:.2g} N m")
    if mean_pressure:
        return ", ".join([*parts, f"{own['pressure']['mean_rmse_pa'] / 1e3:.2g} kPa (mean pressure)"])
    parts.append("{:.2g} and {:.2g} kPa".format(*(value / 1e3 for value in own["pressure"]["rmse_pa"])))
    return ", ".join(parts)
