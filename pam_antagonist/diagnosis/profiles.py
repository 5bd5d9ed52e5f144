"""Profile likelihood of each size that was found: the others at their best while it is held."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pam_antagonist.diagnosis.findings import unknowns_of
from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.diagnosis.select import Model
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import FreeEffectParameter
from pam_antagonist.inference.profile import effect_profile
from pam_antagonist.model.effects import DISTURBANCE


def profile_sizes(
    experiments: Sequence[Experiment],
    model: Model,
    found: Sequence[FoundEffect],
    jobs: int,
    said: Callable[[str], None],
) -> tuple[Mapping[str, Any], ...]:
    """Profiles of the found sizes, each in the recording that shows it first.

    Args:
        experiments: the recordings.
        model: the chosen model.
        found: its effects.
        jobs: threads.
        said: told what is being done.

    Returns:
        For each: parameter, recording, value, its standard error, unit, values (P,), rise of −2 log posterior (P,),
        whether it is flat.
    """
    names = [experiment.trial.name for experiment in experiments]
    result = []
    for effect in found:
        if effect.name == DISTURBANCE:
            continue
        for parameter in unknowns_of(model, effect.name):
            if not parameter.item.is_size or parameter.path.split(".")[2] not in effect.parameters:
                continue
            r = _where(model, parameter, [names.index(name) for name in effect.recordings])
            if r is None:
                continue
            said(f"profile of {parameter.path}")
            profile = effect_profile(experiments[r], model.fits[r], parameter, jobs)
            result.append(
                {
                    "parameter": parameter.path.removeprefix("effects."),
                    "recording": names[r],
                    "value": profile.best,
                    "std": profile.std,
                    "unit": parameter.item.unit,
                    "values": profile.value.tolist(),
                    "rise": (2.0 * profile.loss).tolist(),
                    "flat": profile.flat,
                }
            )
    return tuple(result)


def _where(model: Model, parameter: FreeEffectParameter, recordings: Sequence[int]) -> int | None:
    """The first recording that shows a size."""
    shown = (r for r in recordings if parameter in model.fits[r].free)
    return next((r for r in shown if model.fits[r].point.effects.get(parameter.path)), None)
