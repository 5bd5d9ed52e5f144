"""What a fit does not know of the parameters, as a few directions that the filter considers (Schmidt-Kalman)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.estimation import EstimateRun, Estimator
from pam_antagonist.inference.free_parameters import FreeParameter, moved
from pam_antagonist.inference.trial import PRESSURE_1, Trial
from pam_antagonist.model import rest
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

SETTLE_S = 1.0
"""[s] after the start of the filter that are not judged: its first covariance is a guess."""
_PART_S = 20.0
_MOST_CONSIDERED = 10
"""Directions, with the single parameters that were declared uncertain and not fitted: each is two sigma points more."""
_EXPLAINED = 0.99
_GRID = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
"""Of what the supply has beyond the atmosphere: pressures at which the joint may come to rest."""


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
    """The combinations of parameters whose uncertainty moves the estimate most, beside what the filter does not know.

    The estimate is run anew with each eigenvector of the parameters' covariance added; a singular value decomposition
    of what that does to angle and torque, in standard deviations of the estimate at that moment, gives independent
    combinations in the order of their effect. What they do to the angle of rest at other pressures counts as much: a
    joint goes on to where it never was, and there other combinations matter.

    Args:
        rig: with the fitted values and noise.
        trials: recordings; parts of them will do.
        free: the parameters that were fitted.
        covariance: theirs (F, F), in units of the priors.
        jobs: threads.
    """
    values, vectors = np.linalg.eigh(covariance)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))
    plain = rig.replaced(tunings={**rig.tunings, "default": rig.tuning("default").replaced(consider=False)})
    settle = round(SETTLE_S / rig.sample_period)

    def changed(step: Floats) -> Rig:
        values = {i.name: rig.value(i.name) + i.prior_std * float(s) for i, s in zip(free, step, strict=True)}
        return moved(plain, values)

    def estimate(step: Floats) -> tuple[Floats, Floats]:
        now = changed(step)
        rows = np.concatenate([run_filter(now, trial).rows[settle::10] for trial in trials])
        variances = rows["covariance"][:, (0, 2), (0, 2)]
        return np.column_stack([rows["angle"], rows["torque"]]), variances

    low, high = rig.value("atmosphere.pressure"), rig.value("supply.pressure")
    grid = [low + share * (high - low) for share in _GRID]

    def at_rest(step: Floats) -> Floats:
        p = changed(step).parameters("free", 0.0)
        return np.array([rest.rest_angle(first, second, p) for first in grid for second in grid])

    # A tenth of a standard deviation: far enough for the slope, near enough to stay with it.
    near = 0.1
    steps = [np.zeros(len(free)), *(near * roots.T)]
    runs = Parallel(n_jobs=jobs, prefer="threads")(delayed(estimate)(step) for step in steps)
    effect = np.stack([(run - runs[0][0]) / near for run, _ in runs[1:]], axis=2)
    before = at_rest(steps[0])
    stands = np.stack([(at_rest(step) - before) / near for step in steps[1:]], axis=1)
    scaled = np.vstack(
        [
            _relative(effect.reshape(-1, len(free)), np.maximum(runs[0][1], 0.0).ravel()),
            _relative(stands, np.zeros(len(stands))),
        ]
    )
    _, strength, turned = np.linalg.svd(scaled, full_matrices=False)
    share = strength**2 / max(float(np.sum(strength**2)), 1e-300)
    count = min(int(np.searchsorted(np.cumsum(share), _EXPLAINED)) + 1, max(_MOST_CONSIDERED - len(rig.uncertainty), 1))
    out = []
    for k in range(count):
        if share[k] <= 1e-6:
            break
        step = roots @ turned[k]
        moves = np.sqrt(np.nanmean((effect @ turned[k]) ** 2, axis=0))
        changes = {item.name: float(item.prior_std * s) for item, s in zip(free, step, strict=True)}
        out.append(Direction(f"mode_{k + 1}", changes, float(moves[0]), float(moves[1]), float(share[k])))
    return tuple(out)


def _relative(effect: Floats, variance: Floats) -> Floats:
    """Effects (K, F) in standard deviations of what they make together with a variance (K,) beside them.

    The whole counts as one, however many rows it has.
    """
    total = np.sqrt(variance + np.sum(effect**2, axis=1))
    known = np.isfinite(total) & (total > 0.0)
    out = effect[known] / total[known, None]
    return np.asarray(out / math.sqrt(max(float(np.sum(out**2)), 1e-300)))
