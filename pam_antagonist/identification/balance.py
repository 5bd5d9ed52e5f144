"""Force map and friction from the joint's balance of torques at measured pressures, without a simulation.

The steady-state characteristics depend on neither orifice areas nor polytropic indices (Proposition 1), so they can be
identified first, with the measured pressures in place of those that the model would predict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pam_antagonist.inference.free_parameters import FreeParameter
from pam_antagonist.inference.spread import USUAL_SPREAD, Variation
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, PRESSURE_2, TORQUE, Trial
from pam_antagonist.model import dynamics, sensor
from pam_antagonist.model import parameters as par

Floats = NDArray[np.float64]

_LARGEST_POINTS = 4000
_SLIDES = 0.03
"""[rad/s] A joint that moves faster than this slides."""
_FEWEST = 25


@dataclass(frozen=True, eq=False)
class Balance:
    """Points at which a torque is known, with the torque of the model.

    Attributes:
        time: of each point in its recording (K,) [s].
        trial: which recording it is from (K,).
        wanted: torque from the measurement (K,) [N m].
        before: torque of the model with the values at the fit's start (K,) [N m].
        after: torque of the model with the fitted values (K,) [N m].
    """

    time: Floats
    trial: NDArray[np.int64]
    wanted: Floats
    before: Floats
    after: Floats

    def rms(self, which: str) -> float:
        """RMS of the residual ``before`` or ``after`` the fit [N m]."""
        return float(np.sqrt(np.mean((getattr(self, which) - self.wanted) ** 2)))


@dataclass(frozen=True, eq=False)
class _Points:
    time: Floats
    trial: NDArray[np.int64]
    states: Floats
    wanted: Floats
    acceleration: Floats
    external: Floats


def fit_force_map(
    trials: Sequence[Trial],
    p: Floats,
    free: Sequence[FreeParameter],
    torque_std: float,
    ways: Sequence[Variation] = (),
) -> tuple[dict[str, float], Balance] | None:
    """Force map from measured torque, pressures and angle.

    Args:
        trials: recordings.
        p: parameter vector (P,) with the values to start from.
        free: parameters of the force map that may move.
        torque_std: noise of the torque meter [N m].
        ways: in which the recordings may deviate from each other, by a per cent or so.

    Returns:
        Fitted values and the balance; None where no torque was measured.
    """
    points = _gather(trials, p, lambda state, measured: measured[:, TORQUE])
    if points is None:
        return None

    def model(q: Floats) -> Floats:
        return np.array([dynamics.torque(state, q) for state in points.states])

    size = min(trial.block for trial in trials)
    return _solve(model, points, p, free, torque_std / np.sqrt(size), _deviations(model, points, p, ways))


def _deviations(model, points: _Points, p: Floats, ways: Sequence[Variation]) -> Floats:  # type: ignore[no-untyped-def]
    """Change of the torques if one trial deviates by the usual spread, one column a trial and way (K, D)."""
    out = []
    trials = np.unique(points.trial)
    for way in ways if len(trials) > 1 else ():
        step = {name: p[par.INDEX[name]] + USUAL_SPREAD * change for name, change in way.changes.items()}
        effect = model(par.changed(p, step)) - model(p)
        out += [np.where(points.trial == trial, effect, 0.0) for trial in trials]
    return np.column_stack(out) if out else np.zeros((len(points.time), 0))


def fit_friction(
    trials: Sequence[Trial], p: Floats, free: Sequence[FreeParameter], torque_std: float
) -> tuple[dict[str, float], Balance] | None:
    """Friction, the remainder of a sliding joint's balance of torques: τ − k_s ψ − J ψ̈ = T_f, equation (8).

    The torque of the muscles is the model's, at the measured pressures and angle.

    Args:
        trials: recordings; those of a free joint with a measured angle are used.
        p: parameter vector (P,) with the values to start from.
        free: parameters of the friction that may move.
        torque_std: how well the balance is known at best [N m].

    Returns:
        Fitted values and the balance; None where the joint hardly slid.
    """
    loose = [trial if trial.joint == "free" and trial.has(ANGLE) else None for trial in trials]
    points = _gather(loose, p, None)
    if points is None:
        return None
    sliding = np.abs(points.states[:, 1]) > _SLIDES
    if sliding.sum() < _FEWEST:
        return None
    states, outside = points.states[sliding], points.external[sliding]
    tau = np.array([dynamics.torque(state, p) for state in states]) + outside
    wanted = tau - p[par.STIFFNESS] * states[:, 0] - p[par.INERTIA] * points.acceleration[sliding]
    kept = _Points(points.time[sliding], points.trial[sliding], states, wanted, points.acceleration[sliding], outside)

    def model(q: Floats) -> Floats:
        # The law wants the velocity before friction acted; while the joint slides, that is ψ̇ + Z T_f.
        return np.array([dynamics.sliding_friction(state, np.sign(state[1]), q) for state in states])

    return _solve(model, kept, p, free, torque_std, np.zeros((len(states), 0)))


def _gather(trials, p, torque) -> _Points | None:  # type: ignore[no-untyped-def]
    """Block means of all recordings, thinned where there are more than needed."""
    parts = []
    for index, trial in enumerate(trials):
        if trial is None or (torque is not None and not trial.has(TORQUE)):
            continue
        if trial.joint == "free" and not trial.has(ANGLE):
            continue
        means = trial.blocks(trial.measured)
        step = trial.block_s
        angle = means[:, ANGLE] if trial.joint == "free" else np.full(len(means), trial.lock_angle)
        velocity = np.gradient(angle, step)
        acceleration = np.gradient(velocity, step)
        if trial.joint == "locked":
            velocity, acceleration = np.zeros(len(means)), np.zeros(len(means))
        states = np.column_stack([angle, velocity, sensor.pressures_behind(means[:, PRESSURE_1 : PRESSURE_2 + 1], p)])
        wanted = np.zeros(len(means)) if torque is None else torque(states, means)
        external = trial.blocks(trial.given[:, 2:])[:, 0]
        time = (np.arange(len(means)) + 0.5) * step
        good = np.isfinite(states).all(axis=1) & np.isfinite(wanted) & np.isfinite(acceleration)
        parts.append(
            (time[good], np.full(good.sum(), index), states[good], wanted[good], acceleration[good], external[good])
        )
    if not parts or sum(len(part[0]) for part in parts) < _FEWEST:
        return None
    joined = [np.concatenate([part[k] for part in parts]) for k in range(6)]
    thin = 1 if torque is None else -(-len(joined[0]) // _LARGEST_POINTS)
    return _Points(*(values[::thin] for values in joined))


def _solve(model, points: _Points, p: Floats, free: Sequence[FreeParameter], least: float, deviations: Floats):  # type: ignore[no-untyped-def]
    """MAP estimate of some parameters from a balance of torques; the residual's size is estimated with them."""
    names = [item.name for item in free]
    count, own = len(free), deviations.shape[1]
    start = np.array([p[par.INDEX[name]] for name in names])
    scale = np.array([item.prior_std for item in free])
    offset = np.concatenate([(start - np.array([item.start for item in free])) / scale, np.zeros(own)])
    low = np.concatenate([(np.array([item.low for item in free]) - start) / scale, np.full(own, -30.0)])
    high = np.concatenate([(np.array([item.high for item in free]) - start) / scale, np.full(own, 30.0)])

    def at(theta: Floats) -> Floats:
        torque = model(par.changed(p, dict(zip(names, start + scale * theta[:count], strict=True))))
        return torque + deviations @ theta[count:]

    def slopes(theta: Floats) -> Floats:
        # Most of these torques are linear in their parameters, so the step may be large.
        steps = 0.1 * np.eye(count + own)[:count]
        moving = [(at(theta + step) - at(theta - step)) / 0.2 for step in steps]
        return np.column_stack([*moving, deviations])

    theta = np.clip(np.zeros(count + own), low, high)
    before = at(theta)
    for loss in ("soft_l1", "linear"):
        sigma = max(float(np.sqrt(np.mean((at(theta) - points.wanted) ** 2))), least)
        theta = least_squares(
            lambda t, sigma=sigma: np.concatenate([(at(t) - points.wanted) / sigma, t + offset]),
            theta,
            jac=lambda t, sigma=sigma: np.vstack([slopes(t) / sigma, np.eye(len(t))]),
            bounds=(low, high),
            loss=loss,
        ).x
    values = {name: float(value) for name, value in zip(names, start + scale * theta[:count], strict=True)}
    return values, Balance(points.time, points.trial, points.wanted, before, at(theta))
