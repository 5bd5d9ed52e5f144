"""From recordings of a sealed joint to its rig: the steps of :mod:`~pam_antagonist.identification.sealed`, then tuning.

What the pressures do not follow are not the sensors' noise but slow strays of the muscles, which no white process noise
describes. So measurement and process variance and the random walk of the unknown torque are those under which the
filter's errors of the measured angle are most likely, on the part that is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.identification.sealed import SealedStage, balance, closed_chambers, sealed_trial
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

_EVALUATIONS = 50
STEPS = 3 + _EVALUATIONS + 2
"""How often :func:`identify_sealed` tells about its progress, at most."""
_LEAST_MOVE = 0.05
"""[V] Valves that move more are not those of sealed chambers."""
_BOUNDS = ((2.0, 8.0), (-3.0, 4.0), (-2.0, 1.0))
"""Of the logarithms of R [Pa²], Q of a pressure [Pa²] and the torque's random walk [N m/s^0.5]."""


@dataclass(frozen=True, eq=False)
class SealedIdentified:
    """What was found.

    Attributes:
        start: the rig as it was configured.
        rig: the identified one.
        stages: steps, in their order.
        held_from: for each recording, the time from which on it was held out [s].
        likelihood: mean logarithm of the likelihood of an angle's error, with the start's tuning and with the new one.
        evaluations: how many tunings were tried.
    """

    start: Rig
    rig: Rig
    stages: tuple[SealedStage, ...]
    held_from: tuple[float, ...]
    likelihood: tuple[float, float]
    evaluations: int


def identify_sealed(
    recordings: Sequence[tuple[Recording, str]],
    rig: Rig,
    holdout: float = 1.0 / 3.0,
    progress: Callable[[str], None] | None = None,
) -> SealedIdentified:
    """Identify a sealed joint.

    Args:
        recordings: of one charge, each with its name.
        rig: start values; ``valves.sealed``.
        holdout: share at the end of each recording that is not fitted.
        progress: told what is being done.

    Raises:
        BadInput: recordings that tell nothing, or valves that moved.
    """
    tell = progress or (lambda text: None)
    refuse_moving_valves(recordings, rig)
    share = 1.0 - holdout
    trials = [sealed_trial(recording, name, share) for recording, name in recordings]
    stages: list[SealedStage] = []
    now = rig
    for muscle in (0, 1):
        tell(f"closed chamber of muscle {muscle + 1}")
        stages.append(closed_chambers(trials, now, muscle))
        now = moved(now, stages[-1].values)
    tell("balance of torques")
    stages.append(balance(trials, now))
    now = moved(now, stages[-1].values)
    best, likelihood, evaluations = tuned(now, recordings, share, tell)
    held = tuple(share * float(recording.stamp_ns[-1] - recording.stamp_ns[0]) * 1e-9 for recording, _ in recordings)
    return SealedIdentified(rig, best, tuple(stages), held, likelihood, evaluations)


def refuse_moving_valves(recordings: Sequence[tuple[Recording, str]], rig: Rig) -> None:
    """Refuse recordings whose valves moved.

    Args:
        recordings: each with its name.
        rig: the sealed one.

    Raises:
        BadInput: a valve moves.
    """
    for recording, name in recordings:
        swing = float(np.nanmax(np.nanmax(recording.voltage, axis=0) - np.nanmin(recording.voltage, axis=0)))
        if swing > _LEAST_MOVE:
            raise BadInput(f"{name}: a valve moves by {swing:.2f} V, but the chambers of rig {rig.name} are sealed")


def tuned(
    rig: Rig,
    recordings: Sequence[tuple[Recording, str]],
    share: float,
    tell: Callable[[str], None],
    evaluations: int = _EVALUATIONS,
) -> tuple[Rig, tuple[float, float], int]:
    """The tuning under which the errors of the measured angle are most likely.

    Args:
        rig: whose default tuning is the start.
        recordings: each with its name.
        share: of each, from its start, that may be used.
        tell: told what is being done.
        evaluations: at most so many tunings are tried.

    Returns:
        The rig with that tuning, the mean log likelihood before and after, and how many tunings were tried.
    """
    tuning = rig.tuning("default")
    walk = rig.value("effects.external_torque.noise")
    parts = [recording.slice(0.0, share * _duration(recording)) for recording, _ in recordings]

    def with_values(logarithm: np.ndarray) -> Rig:
        r, q, noise = (10.0 ** float(np.clip(v, *bound)) for v, bound in zip(logarithm, _BOUNDS, strict=True))
        new = tuning.replaced(measurement=(r, r), process=(*tuning.process[:2], q, q))
        effects = {**rig.effects, "external_torque": {"noise": noise}} if walk else rig.effects
        return rig.replaced(tunings={**rig.tunings, "default": new}, effects=effects)

    def against(logarithm: np.ndarray) -> float:
        tell("tuning")
        return -_angle_likelihood(with_values(logarithm), parts)

    start = np.log10([tuning.measurement[0], max(tuning.process[2], 1e-3), walk or 1.0])
    steps = np.vstack([np.zeros(3), 0.7 * np.eye(3)])
    found = minimize(
        against,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": start + steps, "maxfev": evaluations, "xatol": 0.05, "fatol": 1e-3},
    )
    return with_values(found.x), (-against(start), -float(found.fun)), int(found.nfev) + 1


def _duration(recording: Recording) -> float:
    return float(recording.stamp_ns[-1] - recording.stamp_ns[0]) * 1e-9


def _angle_likelihood(rig: Rig, recordings: Sequence[Recording]) -> float:
    """Mean logarithm of the likelihood of the measured angles' errors [rad], without its constant."""
    noise = rig.sensors.error("angle") ** 2
    total, count = 0.0, 0
    for recording in recordings:
        run = Estimator(rig).run(recording.stamp_ns, recording.pressure, recording.voltage)
        assert recording.angle is not None  # sealed_trial has refused a recording without
        error = run.rows["angle"] - recording.angle[run.index]
        variance = run.rows["covariance"][:, 0, 0] + noise
        good = np.isfinite(error)
        total += float(np.sum(-0.5 * error[good] ** 2 / variance[good] - 0.5 * np.log(variance[good])))
        count += int(good.sum())
    return total / count if count else math.nan
