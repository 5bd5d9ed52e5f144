"""Parameters and tuning of a joint whose muscles are sealed, from its motion, its pressures and the torque applied.

No air flows, so what the staged identification of a valve-driven joint rests on is not there. Instead the chambers are
closed: each pressure follows the muscle's volume alone (equation (4) without flow), and at the measured angle it tells
how the volume changes. The torque that moves the joint from outside then tells what holds against it (equations (8) to
(10)), wherever the joint slides. The muscles' volume at ψ = 0, the polytropic index and the force map stay as the rig
file declares them: a sealed joint tells only their product, and nothing of how the force grows with pressure.

What the pressures do not follow is not the sensors' noise but a slow drift of the readings, which no white noise
describes: it is a state of its own (effect ``pressure_sensor``). R is the sensors' noise as the pressures show it. The
size of the drift, Q and the random walk of the unknown torque are those under which the filter's errors of the measured
angle are most likely, on the part that is fitted, while the innovations are as large as the filter expects.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.ukf import OUTPUTS
from pam_antagonist.inference.angle_driven import SLIDING, chamber_directions
from pam_antagonist.inference.free_parameters import Direction, moved, values_along
from pam_antagonist.inference.trial import BLOCK_S
from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_CLUSTER_S = 1.0
"""[s] Residuals closer than this are taken to depend on each other."""
_LEAST_RANGE = np.radians(1.0)
_FEWEST_BLOCKS = 100


@dataclass(frozen=True, eq=False)
class SealedTrial:
    """Block means of a recording, K of them.

    Attributes:
        name: of the recording.
        time: (K,) [s].
        angle: (K,) [rad].
        velocity: (K,) [rad/s].
        acceleration: (K,) [rad/s²].
        pressure: (K, 2) [Pa].
        external: torque applied from outside (K,) [N m], None where it was not recorded.
    """

    name: str
    time: Floats
    angle: Floats
    velocity: Floats
    acceleration: Floats
    pressure: Floats
    external: Floats | None

    @property
    def states(self) -> Floats:
        """Angle, velocity and pressures (K, 4)."""
        return np.column_stack([self.angle, self.velocity, self.pressure])


@dataclass(frozen=True)
class SealedStage:
    """A step of the identification.

    Attributes:
        name: what it identifies.
        values: parameters found, by name.
        std: their standard deviations.
        residual: RMS of what is left, in ``unit``.
        unit: Pa or N m.
        note: what is to be known about it.
    """

    name: str
    values: dict[str, float]
    std: dict[str, float]
    residual: float
    unit: str
    note: str


def sealed_trial(recording: Recording, name: str, share: float = 1.0) -> SealedTrial:
    """Prepare the first ``share`` of a recording.

    Blocks are those of the stamps, not of the samples of an even grid as :class:`~pam_antagonist.inference.trial.Trial`
    has them: nothing is simulated over time here, so that a gap is no harm.

    Args:
        recording: of a sealed joint.
        name: for messages.
        share: of its duration, from 0 to 1.

    Raises:
        BadInput: no measured angle, an angle that hardly moves, or too few samples.
    """
    if recording.angle is None or not np.isfinite(recording.angle).any():
        raise BadInput(f"{name}: no measured angle; a sealed joint tells its volume only together with one")
    time = (recording.stamp_ns - recording.stamp_ns[0]) * 1e-9
    block = np.floor(time / BLOCK_S).astype(np.int64)
    kept = time < share * time[-1] + 1e-9
    columns = [time, recording.angle, recording.pressure[:, 0], recording.pressure[:, 1]]
    if recording.external_torque is not None:
        columns.append(recording.external_torque)
    values = np.column_stack(columns)[kept]
    good = np.isfinite(values).all(axis=1)
    number, place = np.unique(block[kept][good], return_inverse=True)
    if len(number) < _FEWEST_BLOCKS:
        raise BadInput(f"{name}: {len(number) * BLOCK_S:.1f} s with angle and pressures, expected at least "
                       f"{_FEWEST_BLOCKS * BLOCK_S:g} s")  # fmt: skip
    means = np.zeros((len(number), values.shape[1]))
    np.add.at(means, place, values[good])
    means /= np.bincount(place)[:, None]
    if np.ptp(means[:, 1]) < _LEAST_RANGE:
        raise BadInput(f"{name}: the angle moves by {np.degrees(np.ptp(means[:, 1])):.2f} deg only, expected at least "
                       f"{np.degrees(_LEAST_RANGE):g} deg")  # fmt: skip
    velocity = np.gradient(means[:, 1], means[:, 0])
    return SealedTrial(
        name,
        means[:, 0],
        means[:, 1],
        velocity,
        np.gradient(velocity, means[:, 0]),
        means[:, 2:4],
        means[:, 4] if values.shape[1] > 4 else None,
    )


def closed_chambers(trials: Sequence[SealedTrial], rig: Rig, muscle: int) -> SealedStage:
    """How a muscle's volume changes with its length, and its pressure at ψ = 0.

    The slope of the volume is moved about its value at ψ = 0, which stays as declared.

    Args:
        trials: recordings of one charge.
        rig: start values.
        muscle: 0 or 1.
    """
    number = muscle + 1
    mean = float(np.mean(np.concatenate([trial.pressure[:, muscle] for trial in trials])))
    start = moved(rig, {f"valves.charge_{number}": mean})
    directions = chamber_directions(start, number)

    def named(theta: Floats) -> dict[str, float]:
        return values_along(start, directions, theta)

    def residual(theta: Floats) -> Floats:
        p = rig.parameters(changes=named(theta))
        parts = []
        for trial in trials:
            model = np.array([equilibrium.closed_pressure(muscle, angle, p) for angle in trial.angle])
            parts.append(model - trial.pressure[:, muscle])
        return np.concatenate(parts)

    solution = least_squares(residual, np.zeros(2), x_scale=[0.1, 1e-3])
    std = _robust_std(solution.jac, solution.fun)
    values = named(solution.x)
    volume = f"muscle_{number}.volume.d2"
    spread = {volume: abs(rig.value(volume)) * std[0], f"valves.charge_{number}": mean * std[1]}
    return SealedStage(
        f"closed chamber of muscle {number}",
        values,
        spread,
        float(np.sqrt(np.mean(solution.fun**2))),
        "Pa",
        "the volume at angle 0 and the polytropic index stay as declared: pressures tell only k_2 (dV/dl)/V",
    )


def balance(trials: Sequence[SealedTrial], rig: Rig) -> SealedStage:
    """What holds against the torque from outside: stiffness, friction, and the difference of the muscles' forces.

    Args:
        trials: recordings; those without a torque from outside are left out.
        rig: with the volumes already found.

    Raises:
        BadInput: no recording has a torque from outside, or the joint slides too seldom.
    """
    used = [trial for trial in trials if trial.external is not None]
    sliding = [np.abs(trial.velocity) > SLIDING for trial in used]
    count = int(sum(mask.sum() for mask in sliding))
    if count < _FEWEST_BLOCKS:
        raise BadInput(
            f"{count * BLOCK_S:.1f} s of sliding under a known torque, expected at least "
            f"{_FEWEST_BLOCKS * BLOCK_S:g} s: record measured/external_torque while the joint is driven to and fro"
        )
    names = ("joint.stiffness", "joint.viscous_friction", "friction.shaft")
    forces = {f"muscle_{number}.force.w2": way for number, way in ((1, 1.0), (2, -1.0))}
    directions = [Direction(name, {name: rig.value(name)}) for name in names]
    directions.append(Direction("difference of the muscles' forces", forces))

    def named(theta: Floats) -> dict[str, float]:
        return values_along(rig, directions, theta)

    def residual(theta: Floats) -> Floats:
        p = rig.parameters(changes=named(theta))
        parts = []
        for trial, mask in zip(used, sliding, strict=True):
            assert trial.external is not None
            rows = zip(trial.states[mask], trial.acceleration[mask], strict=True)
            needed = np.array([dynamics.torque_needed(x, bending, np.sign(x[1]), p) for x, bending in rows])
            parts.append(needed - trial.external[mask])
        return np.concatenate(parts)

    start = [0.0, 0.0, 0.0, 0.0]
    solution = least_squares(
        residual, start, bounds=([-0.999, -0.999, -0.999, -np.inf], np.inf), x_scale=[0.3, 0.3, 0.3, 5.0]
    )
    std = _robust_std(solution.jac, solution.fun)
    values = named(solution.x)
    spread = {name: rig.value(name) * std[k] for k, name in enumerate(names)}
    spread |= {f"muscle_{number}.force.w2": std[3] for number in (1, 2)}
    return SealedStage(
        "balance of torques",
        values,
        spread,
        float(np.sqrt(np.mean(solution.fun**2))),
        "N m",
        f"over {count * BLOCK_S:.1f} s in which the joint slides; where it sticks, friction may be anything up to its "
        "bound",
    )


def _robust_std(jacobian: Floats, residual: Floats) -> Floats:
    """Standard deviations that allow for residuals which depend on each other over a cluster of time."""
    length = max(1, round(_CLUSTER_S / BLOCK_S))
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    scores = [
        jacobian[first : first + length].T @ residual[first : first + length]
        for first in range(0, len(residual), length)
    ]
    clusters, size = len(scores), jacobian.shape[1]
    scatter = sum(np.outer(score, score) for score in scores) * clusters / max(clusters - size, 1)
    return np.asarray(np.sqrt(np.diag(inverse @ scatter @ inverse)))


_EVALUATIONS = 60
_LEAST_MOVE = 0.05
"""[V] Valves that move more are not those of sealed chambers."""
_BOUNDS = ((0.0, 3.5), (-1.7, 1.5), (-2.0, 1.0), (-10.0, 1.0), (-3.0, 4.0))
"""Of the logarithms of the drift's standard deviation [Pa] and time constant [s], of the torque's random walk
[N m/s^0.5], and of Q of velocity [rad²/s²] and of a pressure [Pa²]."""
_DIFFERENCE, _GAIN = 6, 924.0
"""The sixth difference of white noise has 924 times its variance; of a motion of a few hertz it keeps nothing."""
_LEAST_NOISE = 0.1
"""[Pa] Least noise of a pressure: below it the filter's arithmetic would count."""
_BEGINS = (0.0, 0.5)
"""Shares of the fitted part at which the filter is started. When it slips hangs on little things: one start more tells
a tuning that was lucky from a good one."""
_DRIFT = 100.0
"""[Pa] Where the search for the size of a drift begins."""


@dataclass(frozen=True, eq=False)
class SealedIdentified:
    """What was found.

    Attributes:
        start: the rig as it was configured.
        rig: the identified one.
        stages: steps, in their order.
        held_from: for each recording, the time from which on it was held out [s].
        likelihood: mean logarithm of the likelihood of an angle's error, less the square of ln(NIS/2), with the start's
            tuning and with the new one.
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
        progress: called with what is being done.

    Raises:
        BadInput: recordings from which nothing can be learned, or valves that moved.
    """
    progress = progress or (lambda text: None)
    refuse_moving_valves(recordings, rig)
    share = 1.0 - holdout
    trials = [sealed_trial(recording, name, share) for recording, name in recordings]
    stages: list[SealedStage] = []
    now = rig
    for muscle in (0, 1):
        progress(f"closed chamber of muscle {muscle + 1}")
        stages.append(closed_chambers(trials, now, muscle))
        now = moved(now, stages[-1].values)
    progress("balance of torques")
    stages.append(balance(trials, now))
    now = moved(now, stages[-1].values)
    best, likelihood, evaluations = tuned(now, recordings, share, progress)
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
    progress: Callable[[str], None],
    evaluations: int = _EVALUATIONS,
) -> tuple[Rig, tuple[float, float], int]:
    """The tuning under which the errors of the measured angle are most likely, with innovations as large as expected.

    Args:
        rig: whose default tuning is the start.
        recordings: each with its name.
        share: of each, from its start, that may be used.
        progress: called with what is being done.
        evaluations: at most so many tunings are tried.

    Returns:
        The rig with that tuning, what was maximised before and after, and how many tunings were tried.
    """
    ends = [(recording, share * _duration(recording)) for recording, _ in recordings]
    parts = [recording.slice(begin * end, end) for recording, end in ends for begin in _BEGINS]
    std = pressure_noise(parts)
    step = rig.sensors.pressure_step
    rig = rig.replaced(sensors=rig.sensors.replaced(pressure_std=std))
    tuning = rig.tuning("default").replaced(measurement=(std**2 + step**2 / 12.0,) * 2)
    walk = rig.value("effects.external_torque.noise")
    drift = rig.effects.get("pressure_sensor", {})
    time = rig.value("effects.pressure_sensor.drift_time")

    def with_values(logarithm: np.ndarray) -> Rig:
        size, lasts, noise, velocity, pressure = (
            10.0 ** float(np.clip(v, *bound)) for v, bound in zip(logarithm, _BOUNDS, strict=True)
        )
        driven = drift_noise(size, lasts)
        now = {"pressure_sensor": {**drift, "drift_1": driven, "drift_2": driven, "drift_time": lasts}}
        if walk:
            now["external_torque"] = {"noise": noise}
        new = tuning.replaced(process=(tuning.process[0], velocity, pressure, pressure))
        return rig.replaced(tunings={**rig.tunings, "default": new}, effects={**rig.effects, **now})

    tried = itertools.count(1)

    def against(logarithm: np.ndarray) -> float:
        progress(f"tuning, {min(next(tried), evaluations)} of at most {evaluations}")
        return -_likelihood(with_values(logarithm), parts)

    largest = max(drift.get("drift_1", 0.0), drift.get("drift_2", 0.0))
    known = [drift_size(largest, time) if largest else _DRIFT, time, walk or 1.0, *tuning.process[1:3]]
    start = np.array([np.clip(np.log10(max(v, 1e-12)), *bound) for v, bound in zip(known, _BOUNDS, strict=True)])
    found = minimize(
        against,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": start + np.vstack([np.zeros(5), 0.5 * np.eye(5)]),
            "maxfev": evaluations,
            "xatol": 0.05,
            "fatol": 1e-3,
        },
    )
    return with_values(found.x), (-against(start), -float(found.fun)), int(found.nfev) + 1


def drift_noise(size: float, time: float) -> float:
    """Noise that drives a drift, ``drift_1`` and ``drift_2`` of the effect ``pressure_sensor`` [Pa/s^1.5].

    Args:
        size: standard deviation of the drift [Pa].
        time: its time constant [s].
    """
    return 2.0 * size / time**1.5


def drift_size(noise: float, time: float) -> float:
    """Standard deviation of a drift [Pa], the inverse of :func:`drift_noise`."""
    return 0.5 * noise * time**1.5


def pressure_noise(recordings: Sequence[Recording]) -> float:
    """White noise of the recorded pressures, one standard deviation [Pa]; what moves slowly is not in it."""
    squares = [np.diff(recording.pressure, _DIFFERENCE, axis=0) ** 2 / _GAIN for recording in recordings]
    return max(float(np.sqrt(np.nanmean(np.concatenate(squares)))), _LEAST_NOISE)


def _duration(recording: Recording) -> float:
    return float(recording.stamp_ns[-1] - recording.stamp_ns[0]) * 1e-9


def _likelihood(rig: Rig, recordings: Sequence[Recording]) -> float:
    """Mean logarithm of the likelihood of an angle's error [rad], less the square of ln(NIS/2); without constants.

    The angle alone would let the innovations be anything. They alone would choose a drift that is rarely large, as
    while the joint sticks, and too small an interval of the angle.
    """
    noise = rig.sensors.error("angle") ** 2
    total, count, nis = 0.0, 0, []
    for recording in recordings:
        run = Estimator(rig).run(recording.stamp_ns, recording.pressure, recording.voltage)
        assert recording.angle is not None  # sealed_trial has refused a recording without
        error = run.rows["angle"] - recording.angle[run.index]
        variance = run.rows["covariance"][:, 0, 0] + noise
        good = np.isfinite(error)
        total -= 0.5 * float(np.sum(error[good] ** 2 / variance[good] + np.log(variance[good])))
        count += int(good.sum())
        nis.append(run.rows["nis"])
    mean = float(np.nanmean(np.concatenate(nis)))
    return total / count - math.log(mean / OUTPUTS) ** 2 if count else math.nan
