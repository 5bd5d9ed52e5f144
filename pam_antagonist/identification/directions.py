"""What a fit does not know of the parameters, as the few directions that a filter considers (Schmidt-Kalman)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.estimation import EstimateRun, Estimator
from pam_antagonist.inference.free_parameters import Direction, FreeParameter, moved
from pam_antagonist.inference.trial import PRESSURE_1, Trial
from pam_antagonist.model import equilibrium
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

SETTLE_S = 1.0
"""[s] after the start of the filter that are not judged: its first covariance is a guess."""
_PART_S = 20.0
_APART_S = 0.01
"""[s] between the estimates that count."""
_MOST_CONSIDERED = 10
"""Directions, with the single parameters that were declared uncertain and not fitted: each is two sigma points more."""
_EXPLAINED = 0.99
_LEAST_SHARE = 1e-12
"""Of the largest variance that a combination of parameters has: what is smaller is rounding."""
_GRID = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
"""Of what the supply has beyond the atmosphere: pressures at which the joint may come to rest."""


@dataclass(frozen=True)
class ConsideredDirection(Direction):
    """Parameters that are uncertain together; its amount counts in standard deviations.

    Attributes:
        angle: RMS effect on the estimated angle [rad].
        torque: RMS effect on the estimated torque [N m].
        share: of the whole effect.
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
    """As much of a recording as is used to look for Q and for directions."""
    return trial.part(0.0, min(_PART_S, len(trial) * trial.dt))


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """How the estimate moves with the parameters, near one set of them.

    Attributes:
        free: the parameters (F).
        steps: combinations of them as columns (F, F), in units of the priors.
        moves: for each trial, what a step of each does to angle [rad] and torque [N m] of some estimates (K, 2, F).
        rests: likewise to angles of rest [rad] at other pressures (R, F).
    """

    free: tuple[FreeParameter, ...]
    steps: Floats
    moves: tuple[Floats, ...]
    rests: Floats

    @classmethod
    def of(
        cls, rig: Rig, trials: Sequence[Trial], free: Sequence[FreeParameter], covariance: Floats, jobs: int
    ) -> Sensitivity:
        """The estimate is run anew with each eigenvector of the parameters' covariance added.

        Args:
            rig: with the fitted values and noise.
            trials: recordings; parts of them will do.
            free: the parameters that were fitted.
            covariance: theirs (F, F), in units of the priors.
            jobs: threads.
        """
        values, vectors = np.linalg.eigh(covariance)
        # No direction without a step: another covariance may have more in it.
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

        # A tenth of a standard deviation: far enough for the slope, near enough to stay with it.
        near = 0.1
        steps = [np.zeros(len(free)), *(near * roots.T)]
        (before, stands), *others = Parallel(n_jobs=jobs, prefer="threads")(delayed(moved_by)(step) for step in steps)
        moves = [np.stack([(other[k] - part) / near for other, _ in others], axis=2) for k, part in enumerate(before)]
        rests = np.stack([(rest - stands) / near for _, rest in others], axis=1)
        return cls(tuple(free), roots, tuple(moves), rests)

    def of_trial(self, index: int) -> Sensitivity:
        """The same of one trial alone."""
        return Sensitivity(self.free, self.steps, (self.moves[index],), self.rests)


def _not_considering(rig: Rig) -> Rig:
    return rig.replaced(tunings={**rig.tunings, "default": rig.tuning("default").replaced(consider=False)})


def some_estimates(rig: Rig, trial: Trial) -> np.ndarray:
    """Estimates of a trial, so far apart that they count: records of ``ESTIMATE_DTYPE``."""
    return run_filter(rig, trial).rows[trial.samples(SETTLE_S) :: trial.samples(_APART_S)]


def _angle_and_torque(rows: np.ndarray) -> Floats:
    return np.column_stack([rows["angle"], rows["torque"]])


def considered_directions(
    rig: Rig, trials: Sequence[Trial], known: Sensitivity, covariance: Floats
) -> tuple[ConsideredDirection, ...]:
    """The combinations of parameters whose uncertainty moves the estimate most, beside what the filter does not know.

    A singular value decomposition of what the parameters' uncertainty does to angle and torque, in standard deviations
    of the estimate at that moment, gives independent combinations in the order of their effect. What they do to the
    angle of rest at other pressures counts as much: a joint goes on to where it never was, and there other combinations
    matter.

    Args:
        rig: with the fitted values and noise.
        trials: recordings; parts of them will do.
        known: how the estimate of these trials moves with the parameters. Values and noise of ``rig`` may be others, as
            near as fits of the same recordings are.
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
    """Effects (K, F) in standard deviations of what they make together with a variance (K,) beside them.

    The whole counts as one, however many rows it has.
    """
    total = np.sqrt(variance + np.sum(effect**2, axis=1))
    known = np.isfinite(total) & (total > 0.0)
    out = effect[known] / total[known, None]
    return np.asarray(out / math.sqrt(max(float(np.sum(out**2)), 1e-300)))
