"""What a fit does not know of the parameters, as a few directions that the filter considers (Schmidt-Kalman)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.estimation import EstimateRun, Estimator
from pam_antagonist.identification.change import moved
from pam_antagonist.identification.freedom import FreeParameter
from pam_antagonist.identification.trial import PRESSURE_1, Trial
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

SETTLE_S = 1.0
"""[s] after the start of the filter that are not judged: its first covariance is a guess."""
_PART_S = 20.0
_MOST_CONSIDERED = 5
"""Directions, with the single parameters that were declared uncertain and not fitted."""
_EXPLAINED = 0.99


@dataclass(frozen=True)
class Direction:
    """Parameters that are uncertain together.

    Attributes:
        name: in the rig file.
        changes: by parameter, for one standard deviation.
        angle: RMS effect on the estimated angle [rad].
        torque: RMS effect on the estimated torque [N m].
        share: of the whole effect.
    """

    name: str
    changes: dict[str, float]
    angle: float
    torque: float
    share: float


def with_directions(rig: Rig, directions: Sequence[Direction], scale: float) -> Rig:
    """The rig with these directions, all of them times a scale."""
    scaled = {item.name: {name: scale * step for name, step in item.changes.items()} for item in directions}
    return rig.replaced(directions=scaled)


def run_filter(rig: Rig, trial: Trial) -> EstimateRun:
    """The estimator over a trial."""
    estimator = Estimator(rig, joint=trial.joint, lock_angle=trial.lock_angle)
    stamps = np.arange(1, len(trial) + 1, dtype=np.int64) * round(trial.dt * 1e9)
    return estimator.run(stamps, trial.measured[:, PRESSURE_1:], trial.voltage)


def short_part(trial: Trial) -> Trial:
    """As much of a recording as is used to look for Q and for directions."""
    return trial.part(0.0, min(_PART_S, len(trial) * trial.dt))


def considered_directions(
    rig: Rig, trials: Sequence[Trial], free: Sequence[FreeParameter], covariance: Floats, jobs: int
) -> tuple[Direction, ...]:
    """The combinations of parameters whose uncertainty moves the estimate most.

    The estimate is run anew with each eigenvector of the parameters' covariance added; a singular value decomposition
    of what that does to angle and torque gives independent combinations in the order of their effect.

    Args:
        rig: with the fitted values and noise.
        trials: recordings.
        free: the parameters that were fitted.
        covariance: theirs (F, F), in units of the priors.
        jobs: threads.
    """
    values, vectors = np.linalg.eigh(covariance)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))
    plain = rig.replaced(tunings={**rig.tunings, "default": rig.tuning("default").replaced(consider=False)})
    settle = round(SETTLE_S / rig.sample_period)

    def estimate(step: Floats) -> Floats:
        now = moved(
            plain,
            {item.name: rig.value(item.name) + item.prior_std * float(s) for item, s in zip(free, step, strict=True)},
        )
        parts = []
        for trial in trials:
            rows = run_filter(now, trial).rows[settle::10]
            parts.append(np.column_stack([rows["angle"], rows["torque"]]))
        return np.concatenate(parts)

    # A tenth of a standard deviation: far enough for the slope, near enough to stay with it.
    near = 0.1
    steps = [np.zeros(len(free)), *(near * roots.T)]
    runs = Parallel(n_jobs=jobs, prefer="threads")(delayed(estimate)(step) for step in steps)
    effect = np.stack([(run - runs[0]) / near for run in runs[1:]], axis=2)
    size = np.sqrt(np.mean(np.sum(effect**2, axis=2), axis=0))
    scaled = (effect / np.where(size > 0.0, size, 1.0)[None, :, None]).reshape(-1, len(free))
    _, strength, turned = np.linalg.svd(scaled, full_matrices=False)
    share = strength**2 / max(float(np.sum(strength**2)), 1e-300)
    count = min(int(np.searchsorted(np.cumsum(share), _EXPLAINED)) + 1, max(_MOST_CONSIDERED - len(rig.uncertainty), 1))
    out = []
    for k in range(count):
        if share[k] <= 1e-6:
            break
        step = roots @ turned[k]
        moves = np.sqrt(np.mean((effect @ turned[k]) ** 2, axis=0))
        changes = {item.name: float(item.prior_std * s) for item, s in zip(free, step, strict=True)}
        out.append(Direction(f"mode_{k + 1}", changes, float(moves[0]), float(moves[1]), float(share[k])))
    return tuple(out)
