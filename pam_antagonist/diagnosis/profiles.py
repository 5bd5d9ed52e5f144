"""Profile likelihood of each size that was found: the others at their best while it is held."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from joblib import Parallel, delayed

from pam_antagonist.diagnosis.candidates import UNKNOWN_INPUT, Unknown
from pam_antagonist.diagnosis.experiment import Experiment, Point
from pam_antagonist.diagnosis.findings import unknowns_of
from pam_antagonist.diagnosis.refit import Fitted, cost_of, refit
from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.diagnosis.select import Model

_SHARES = (0.0, 0.5, 0.8, 0.9, 1.1, 1.2, 1.5)
_THRESHOLD = 3.84
"""95 % of a chi-square with one degree of freedom: a profile that does not rise so far at half the size is flat."""


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
        For each: parameter, recording, value, unit, values (P,), rise of −2 log posterior (P,), whether it is flat.
    """
    names = [experiment.trial.name for experiment in experiments]
    result = []
    for effect in found:
        if effect.name == UNKNOWN_INPUT:
            continue
        free = [unknown for unknown in unknowns_of(model, effect.name) if unknown.item.is_size]
        sizes = [unknown for unknown in free if unknown.path.split(".")[2] in effect.parameters]
        for unknown in sizes:
            r = _where(model, unknown, [names.index(name) for name in effect.recordings])
            if r is None:
                continue
            said(f"profile of {unknown.path}")
            fitted, experiment = model.fits[r], experiments[r]
            best = fitted.point.effects[unknown.path]
            values = [unknown.bounded(best * share) for share in _SHARES]
            costs = Parallel(n_jobs=jobs, prefer="threads")(
                delayed(_held)(experiment, fitted, unknown, value) for value in values
            )
            rises = [scale_rise(fitted, cost) for cost in costs]
            points = sorted([*zip(values, rises, strict=True), (best, 0.0)])
            half = rises[_SHARES.index(0.5)]
            result.append(
                {
                    "parameter": unknown.path.removeprefix("effects."),
                    "recording": names[r],
                    "value": best,
                    "unit": unknown.item.unit,
                    "values": [value for value, _ in points],
                    "rise": [rise for _, rise in points],
                    "flat": half < _THRESHOLD,
                }
            )
    return tuple(result)


def scale_rise(fitted: Fitted, cost: float) -> float:
    """Rise of −2 log posterior above the best, with independent values counted."""
    return (
        max(fitted.scale.share * (cost - fitted.cost), 0.0) if fitted.scale.pace > 1.0 else max(cost - fitted.cost, 0.0)
    )


def _where(model: Model, unknown: Unknown, recordings: Sequence[int]) -> int | None:
    shown = [
        r for r in recordings if unknown in model.fits[r].unknowns and model.fits[r].point.effects.get(unknown.path)
    ]
    return shown[0] if shown else None


def _held(experiment: Experiment, fitted: Fitted, unknown: Unknown, value: float) -> float:
    """Least cost with one number held at a value."""
    effects = {**fitted.point.effects, **dict.fromkeys(unknown.paths, value)}
    others = tuple(u for u in fitted.unknowns if u != unknown)
    moved = refit(
        experiment, Point(fitted.point.theta, effects), others, fitted.base, rounds=5, renewals=0,
        pace=fitted.scale.pace,
    )  # fmt: skip
    return cost_of(experiment, moved.point, moved.residual, fitted.scale)
