"""The filter's step against the bare model, and against filterpy's UKF around the same model."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from pam_antagonist._jit import in_place
from pam_antagonist.estimation import Estimator, simulate_model, ukf
from pam_antagonist.estimation.estimator import parameter_sets
from pam_antagonist.model import dynamics, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.model.parameters import BASE_STATES as STATES
from pam_antagonist.rig import Rig
from pam_antagonist.simulation.excitation import profile

_SAMPLES, _SAMPLES_FILTERPY, _ROUNDS = 4000, 1000, 15

_rk4_step = integration.rk4_step_within
_predict, _innovate, _update = ukf.predict, ukf.innovate, ukf.update


@in_place
def _bare_steps(states, voltages, parameter_sets, points, dt, scratch):
    """As many Runge-Kutta steps a sample as a filter has sigma points, from states around the sample's."""
    sets = parameter_sets.shape[0]
    for k in range(states.shape[0]):
        for j in range(points.shape[0]):
            for i in range(points.shape[1]):
                points[j, i] = states[k, i] * (1.0 + 1e-4 * (j - 4))
            _rk4_step(points[j], voltages[k], parameter_sets[j if j < sets else 0], dt, points[j], scratch)


@in_place
def _filter_steps(
    pressures, voltages, x, covariance, cross, parameter_sets, dt, process, measurement, kappa, effects, work,
    innovation, innovation_covariance,
):  # fmt: skip
    """Predict and update, and nothing else."""
    for k in range(voltages.shape[0]):
        _predict(x, covariance, cross, voltages[k], parameter_sets, dt, process, 0.0, kappa, effects, work)
        _innovate(x, covariance, pressures[k], measurement, innovation, innovation_covariance)
        _update(x, covariance, cross, innovation, measurement, measurement, True, True, work)


class _Case:
    """One tuning over one simulated recording."""

    def __init__(self, rig: Rig, tuning: str) -> None:
        self.rig, self.tuning = rig, rig.tuning(tuning)
        self.voltage = profile("steps", _SAMPLES * rig.sample_period, rig.sample_period, seed=1)[:_SAMPLES]
        run = simulate_model(rig, self.voltage, np.array([450e3, 450e3]))
        self.states = np.column_stack([run.angle, run.velocity, run.pressure])
        noise = np.random.default_rng(1).normal(0.0, rig.sensors.pressure_std, run.pressure.shape)
        self.pressure = run.pressure + noise
        self.stamps = 10**18 + np.arange(_SAMPLES, dtype=np.int64) * round(rig.sample_period * 1e9)
        self.parameter_sets = parameter_sets(rig, self.tuning)
        self.considered = (len(self.parameter_sets) - 1) // 2
        self.effects = None if np.all(self.parameter_sets[:, par.PLAIN] != 0.0) else dynamics.WITH_EFFECTS
        self.sigma_points = 1 + 2 * (STATES + self.considered)
        self._points = np.zeros((self.sigma_points, STATES))
        self._work = ukf.make_work(STATES, self.parameter_sets)
        self.estimator = Estimator(rig, tuning)

    def bare(self) -> None:
        """2n+1 Runge-Kutta steps a sample."""
        _bare_steps(
            self.states, self.voltage, self.parameter_sets, self._points, self.rig.sample_period, self._work.stages
        )

    def filter(self) -> None:
        """Predict and update."""
        tuning = self.tuning
        _filter_steps(
            self.pressure, self.voltage, self.states[0].copy(), np.diag(tuning.initial),
            np.zeros((STATES, self.considered)), self.parameter_sets, self.rig.sample_period, np.array(tuning.process),
            np.array(tuning.measurement), tuning.kappa, self.effects, self._work, np.empty(2), np.empty((2, 2)),
        )  # fmt: skip

    def sample(self) -> None:
        """The whole sample: time, gate, predict, update, torque and its covariance, σ, stiffness."""
        self.estimator.reset()
        self.estimator.run(self.stamps, self.pressure, self.voltage)

    def live(self) -> None:
        """The same, one call from Python a sample."""
        self.estimator.reset()
        step, columns = self.estimator.step_in_place, (self.stamps, self.pressure, self.voltage)
        for stamp, (p1, p2), (u1, u2) in zip(*(column.tolist() for column in columns), strict=True):
            step(stamp, p1, p2, u1, u2)


def _in_turn(first: Callable[[], object], second: Callable[[], object], rounds: int = _ROUNDS) -> tuple[float, float]:
    """Median times [s] of two callables that are timed in turn, so that a machine that slows down slows both."""
    first()
    second()
    times = np.empty((rounds, 2))
    for k in range(rounds):
        begin = time.perf_counter()
        first()
        middle = time.perf_counter()
        second()
        times[k] = middle - begin, time.perf_counter() - middle
    one, other = np.median(times, axis=0)
    return float(one), float(other)


def measure(rig: Rig) -> dict[str, float]:
    """Times of the filter's step with the tunings ``published`` (n = 4) and ``default`` of a rig, and their ratios."""
    micro, out = 1e6 / _SAMPLES, {}
    cases = {"n4": _Case(rig, "published"), "default": _Case(rig, "default")}
    for label, case in cases.items():
        step, bare = _in_turn(case.filter, case.bare)
        live, whole = _in_turn(case.live, case.sample)
        out[f"UKF step, {label} [us]"] = step * micro
        out[f"UKF step, {label}, against {case.sigma_points} bare RK4 steps [x]"] = step / bare
        out[f"whole sample in a recording, {label} [us]"] = whole * micro
        out[f"one call from Python, {label} [us]"] = live * micro
        out[f"one call from Python, {label}, above the kernel [us]"] = (live - whole) * micro
    plain = cases["n4"]
    theirs, ours = _in_turn(lambda: _filterpy(rig, plain), plain.filter, rounds=5)
    out["step of filterpy's UKF around the same RK4 step, against ours, n4 [x]"] = (
        theirs / ours * _SAMPLES / _SAMPLES_FILTERPY
    )
    return out


def _filterpy(rig: Rig, case: _Case) -> None:
    from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter

    p = case.parameter_sets[0]

    def advance(x: np.ndarray, dt: float, u: np.ndarray) -> np.ndarray:
        result = np.empty(STATES)
        integration.rk4_step(x, u, p, dt, result)
        return result

    points = JulierSigmaPoints(STATES, kappa=case.tuning.kappa)
    other = UnscentedKalmanFilter(STATES, 2, rig.sample_period, lambda x: x[2:4], advance, points)
    other.x, other.P = case.states[0].copy(), np.diag(case.tuning.initial)
    other.Q, other.R = np.diag(case.tuning.process), np.diag(case.tuning.measurement)
    for k in range(_SAMPLES_FILTERPY):
        other.predict(u=case.voltage[k])
        other.update(case.pressure[k])
