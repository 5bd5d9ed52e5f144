"""The uncertainty of fitted parameters as the few directions that a filter considers (Schmidt-Kalman)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.errors import NoResult
from pam_antagonist.estimation import EstimateRun, Estimator
from pam_antagonist.inference.free_parameters import Direction, FreeParameter, moved
from pam_antagonist.inference.trial import PRESSURE_1, Trial
from pam_antagonist.model import equilibrium
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

SETTLE_S = 1.0
"""[s] Time after the start of the filter that is not judged: its first covariance is a guess."""
_PART_S = 20.0
_APART_S = 0.01
"""[s] Time between the estimates that are used."""
_MOST_CONSIDERED = 10
"""Most directions, with the parameters that are declared uncertain and not fitted: each adds two sigma points."""
_EXPLAINED = 0.99
_LEAST_SHARE = 1e-12
"""Share of the largest variance of a combination of parameters: smaller variances are rounding errors."""
_GRID = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
"""Pressures at which the joint may come to rest, as shares of the supply's gauge pressure."""


@dataclass(frozen=True)
class ConsideredDirection(Direction):
    """Parameters that are uncertain together; its amount counts in standard deviations.

    Attributes:
        angle: RMS effect on the estimated angle [rad].
        torque: RMS effect on the estimated torque [N m].
        share: its share of the effect of all directions.
    """

    angle: float
    torque: float
    share: float


def with_directions(rig: Rig, directions: Sequence[ConsideredDirection], scale: float) -> Rig:
    """The rig with these directions, all of them times a scale.

    Args:
        rig: without them.
        directions: that the filter considers.
        scale: factor of all changes.
    """
    scaled = {item.name: {name: scale * step for name, step in item.changes.items()} for item in directions}
    return rig.replaced(directions=scaled)


def run_filter(rig: Rig, trial: Trial) -> EstimateRun:
    """The estimator over a trial."""
    estimator = Estimator(rig, joint=trial.joint, lock_angle=trial.lock_angle)
    stamps = np.arange(1, len(trial) + 1, dtype=np.int64) * round(trial.dt * 1e9)
    return estimator.run(stamps, trial.measured[:, PRESSURE_1:], trial.voltage)


def short_part(trial: Trial) -> Trial:
    """The part of a recording from which Q and the directions are found."""
    return trial.part(0.0, min(_PART_S, len(trial) * trial.dt))


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of the estimate by the parameters, near one set of them.

    Attributes:
        free: the parameters (F).
        steps: combinations of them as columns (F, F), in units of the priors.
        moves: for each trial, change of estimated angle [rad] and torque [N m] by each step (K, 2, F).
        rests: change of the angles of rest [rad] at other pressures by each step (R, F).
    """

    free: tuple[FreeParameter, ...]
    steps: Floats
    moves: tuple[Floats, ...]
    rests: Floats

    @classmethod
    def of(
        cls, rig: Rig, trials: Sequence[Trial], free: Sequence[FreeParameter], covariance: Floats, jobs: int
    ) -> Sensitivity:
        """Run the estimator again with each eigenvector of the parameters' covariance added.

        Args:
            rig: with the fitted values and noise.
            trials: recordings, or parts of them.
            free: the parameters that were fitted.
            covariance: of these (F, F), in units of the priors.
            jobs: threads.
        """
        values, vectors = np.linalg.eigh(covariance)
        # Every direction gets a step, however certain: it may be less certain in another covariance.
        roots = vectors * np.sqrt(np.maximum(values, _LEAST_SHARE * values[-1]))
        plain = _not_considering(rig)
        low, high = rig.value("atmosphere.pressure"), rig.value("supply.pressure")
        grid = [low + share * (high - low) for share in _GRID]

        def moved_by(step: Floats) -> tuple[list[Floats], Floats]:
            values = {i.name: rig.value(i.name) + i.prior_std * float(s) for i, s in zip(free, step, strict=True)}
            now = moved(plain, values)
            p = now.parameters("free", 0.0)
            rest = np.array([equilibrium.rest_angle(first, second, p) for first in grid for second in grid])
            return [_angle_and_torque(some_estimates(now, trial)) for trial in trials], rest

        # A tenth of a standard deviation: large enough for a derivative, small enough to stay linear.
        near = 0.1
        steps = [np.zeros(len(free)), *(near * roots.T)]
        (before, at_rest), *others = Parallel(n_jobs=jobs, prefer="threads")(delayed(moved_by)(step) for step in steps)
        for k, trial in enumerate(trials):
            if any(other[k].shape != before[k].shape for other, _ in others) or not np.isfinite(before[k]).any():
                raise NoResult(f"{trial.name}: the filter with the identified values loses the joint")
        moves = [np.stack([(other[k] - part) / near for other, _ in others], axis=2) for k, part in enumerate(before)]
        rests = np.stack([(rest - at_rest) / near for _, rest in others], axis=1)
        return cls(tuple(free), roots, tuple(moves), rests)

    def of_trial(self, index: int) -> Sensitivity:
        """The derivatives of one trial alone."""
        return Sensitivity(self.free, self.steps, (self.moves[index],), self.rests)


def _not_considering(rig: Rig) -> Rig:
    return rig.replaced(tunings={**rig.tunings, "default": rig.tuning("default").replaced(consider=False)})


def some_estimates(rig: Rig, trial: Trial) -> np.ndarray:
    """Estimates of a trial, as far apart as they are used: records of ``ESTIMATE_DTYPE``."""
    return run_filter(rig, trial).rows[trial.samples(SETTLE_S) :: trial.samples(_APART_S)]


def _angle_and_torque(rows: np.ndarray) -> Floats:
    return np.column_stack([rows["angle"], rows["torque"]])


def considered_directions(
    rig: Rig, trials: Sequence[Trial], known: Sensitivity, covariance: Floats
) -> tuple[ConsideredDirection, ...]:
    """The independent combinations of parameters whose uncertainty moves the estimate most, by their effect.

    A singular value decomposition finds them. It takes the effect of the parameters' uncertainty on angle and torque,
    in standard deviations of the estimate at that moment. The effect on the angle of rest at other pressures counts as
    much: a joint will get to pressures that were not recorded, and other combinations matter there.

    Args:
        rig: with the fitted values and noise.
        trials: recordings, or parts of them.
        known: derivatives of the estimate of these trials. They may belong to other values and another noise than
            those of ``rig``, if these come from fits of the same recordings.
        covariance: of the parameters (F, F), in units of the priors.
    """
    values, vectors = np.linalg.eigh(covariance)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))
    turn = np.linalg.solve(known.steps, roots)
    plain = _not_considering(rig)
    variances = [some_estimates(plain, trial)["covariance"][:, (0, 2), (0, 2)] for trial in trials]
    effect = np.concatenate(known.moves) @ turn
    scaled = np.vstack(
        [
            _relative(effect.reshape(-1, len(turn)), np.maximum(np.concatenate(variances), 0.0).ravel()),
            _relative(known.rests @ turn, np.zeros(len(known.rests))),
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
        changes = {item.name: float(item.prior_std * s) for item, s in zip(known.free, step, strict=True)}
        out.append(ConsideredDirection(f"mode_{k + 1}", changes, float(moves[0]), float(moves[1]), float(share[k])))
    return tuple(out)


def _relative(effect: Floats, variance: Floats) -> Floats:
    """Effects (K, F) over their total standard deviation, to which a further variance (K,) belongs.

    The result has the norm 1, however many rows it has.
    """
    total = np.sqrt(variance + np.sum(effect**2, axis=1))
    known = np.isfinite(total) & (total > 0.0)
    out = effect[known] / total[known, None]
    return np.asarray(out / math.sqrt(max(float(np.sum(out**2)), 1e-300)))
