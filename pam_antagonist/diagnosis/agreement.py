"""Whether recordings contradict each other: in the rig that they are of, and in what is wrong with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.diagnosis.rigs import farthest_apart
from pam_antagonist.diagnosis.select import STRONG, Model, evidence
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.gauss_newton import Fitted, refit
from pam_antagonist.model.effects import DISTURBANCE

Floats = NDArray[np.float64]


def of_base(experiments: Sequence[Experiment], base: Model) -> list[str]:
    """Base parameters in which recordings of the same joint condition differ more than one rig does from day to day."""
    said = []
    pairs = list(zip(experiments, base.fits, strict=True))
    for k, (one, fitted) in enumerate(pairs):
        for other, theirs in pairs[:k]:
            if one.trial.joint != other.trial.joint:
                continue
            apart = farthest_apart(one, fitted, theirs)
            if apart is not None:
                said.append(
                    f"the recordings contradict each other: {apart[0]} is {100 * apart[1]:+.0f} % in {one.trial.name} "
                    f"from that in {other.trial.name}; are they of one rig?"
                )
    return said


def of_effects(
    experiments: Sequence[Experiment],
    model: Model,
    found: Sequence[FoundEffect],
    values: Mapping[str, float],
    jobs: int,
) -> list[str]:
    """Effects that some recordings show and others rule out.

    An effect that a recording does not show may be one that it cannot show. It is ruled out where the recording loses
    strong evidence when it is given the others' value, its base parameters fitted anew.

    Args:
        experiments: the recordings.
        model: their models.
        found: the effects.
        values: of their parameters, by dotted path.
        jobs: threads.
    """
    names = [effect.name for effect in found]
    tasks = [
        (effect, r)
        for effect in found
        if effect.name != DISTURBANCE and names.count(effect.name) == 1
        for r, experiment in enumerate(experiments)
        if experiment.trial.name not in effect.recordings
    ]
    losses = Parallel(n_jobs=jobs, prefer="threads")(
        delayed(_loss)(experiments[r], model.fits[r], _of(effect.name, values)) for effect, r in tasks
    )
    return [
        f"the recordings contradict each other: {' and '.join(effect.recordings)} shows {effect.name}, "
        f"{experiments[r].trial.name} rules it out (evidence {loss:.0f} against it)"
        for (effect, r), loss in zip(tasks, losses, strict=True)
        if loss > STRONG
    ]


def _of(effect: str, values: Mapping[str, float]) -> dict[str, float]:
    return {path: value for path, value in values.items() if path.startswith(f"effects.{effect}.")}


def _loss(experiment: Experiment, fitted: Fitted, values: Mapping[str, float]) -> float:
    effect = next(iter(values)).rsplit(".", 1)[0] + "."
    own = {path: value for path, value in fitted.point.effects.items() if not path.startswith(effect)}
    before, after = (
        refit(experiment, Point(fitted.point.theta, effects), blocks_per_error=fitted.scale.blocks_per_error)
        for effects in (own, {**own, **values})
    )
    return -evidence(experiment, before, after)
