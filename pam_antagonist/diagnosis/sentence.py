"""The verdict in a sentence, with its evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pam_antagonist.diagnosis.result import FoundEffect, Ranked
from pam_antagonist.model.effects import CATALOGUE


def in_words(effect: FoundEffect, sealed: bool = False) -> str:
    """What an effect means."""
    values = {name: value for name, (value, _, _) in effect.parameters.items()}
    return CATALOGUE[effect.name].in_words(effect.muscle, values, sealed)


def sentence(
    verdict: str,
    found: Sequence[FoundEffect],
    share: float,
    errors: Mapping[str, Mapping[str, Any]],
    ranking: Sequence[Ranked],
    recordings: int,
) -> str:
    """The verdict in a sentence.

    Args:
        verdict: ``effect``, ``none`` or ``unexplained``.
        found: the effects.
        share: of the held-out excess that they explain.
        errors: of the three models.
        ranking: all candidates.
        recordings: how many could show an effect; where not all do, those that do are named.
    """
    if verdict == "none":
        return (
            "Nothing is wrong with the model beyond its parameters: recalibrated, it leaves what the sensors' noise "
            f"explains ({_errors(errors, 'recalibrated')} on data held out from the fit)."
        )
    if verdict == "effect":
        everywhere = all(len(effect.recordings) == recordings for effect in found)
        what = "; and ".join(
            in_words(effect) + ("" if everywhere else f" in {' and '.join(effect.recordings)}") for effect in found
        )
        return (
            f"{what[0].upper()}{what[1:]}: with it the model's errors on data that no fit has seen fall from "
            f"{_errors(errors, 'recalibrated')} to {_errors(errors, 'extended')}, and {100 * share:.0f} % of what was "
            "beyond the sensors' noise is gone."
        )
    tried = [item for item in ranking if item.holdout_gain is not None and item.round == 1]
    best = max(tried, key=lambda item: item.holdout_gain or 0.0, default=None)
    closest = (
        f" The closest, {best.name}, takes away {100 * max(best.holdout_gain or 0.0, 0.0):.0f} % of that, "
        "which is not enough."
        if best is not None
        else ""
    )
    return (
        "Something is wrong that no effect of the catalogue explains: recalibrated, the model leaves "
        f"{_errors(errors, 'recalibrated')} on held-out data, well beyond the sensors' noise.{closest}"
    )


def _errors(errors: Mapping[str, Mapping[str, Any]], model: str) -> str:
    own = errors[model]
    said = []
    if own["angle"]:
        said.append(f"{own['angle']['rmse_deg']:.2g}°")
    if own["torque"]:
        said.append(f"{own['torque']['rmse_nm']:.2g} N m")
    said.append("{:.2g} and {:.2g} kPa".format(*(value / 1e3 for value in own["pressure"]["rmse_pa"])))
    return ", ".join(said)
