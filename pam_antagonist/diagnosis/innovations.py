"""What the estimator's innovations say of a model, where nothing but pressures was measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis import errors, rigs
from pam_antagonist.diagnosis.heldout import Compared
from pam_antagonist.identification.tuning import innovation_likelihood
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.trial import ANGLE, TORQUE
from pam_antagonist.recording import Recording


def decide(experiments: Sequence[Experiment]) -> bool:
    """Whether they have to: neither an angle nor a torque can be compared in any recording."""
    return not any(channel in experiment.channels for experiment in experiments for channel in (ANGLE, TORQUE))


def evidence(recordings: Sequence[Recording], parts: Sequence[Compared], jobs: int) -> float:
    """Twice the logarithm of how much likelier the innovations on the held-out parts are with the extended model.

    Both filters have the tuning of the rig as configured. No unknown has a price: nothing was fitted there.

    Args:
        recordings: as read, in the order of `parts`.
        parts: the same with their models.
        jobs: threads.
    """

    def of(recording: Recording, part: Compared, model: str) -> float:
        rig = rigs.own_rig(part.experiment, part.points[model])
        run, late = errors.filtered(recording, rig, part.experiment)
        return innovation_likelihood(run, int(np.argmax(late)))[0] if late.any() else 0.0

    tasks = [
        (sign, recording, part, model)
        for recording, part in zip(recordings, parts, strict=True)
        if part.judges
        for sign, model in ((1.0, "extended"), (-1.0, "recalibrated"))
    ]
    found = Parallel(n_jobs=jobs, prefer="threads")(delayed(of)(*task) for _, *task in tasks)
    return 2.0 * sum(sign * value for (sign, *_), value in zip(tasks, found, strict=True))
