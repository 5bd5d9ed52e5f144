"""The filter's step against the bare model, and against filterpy's UKF around the same model."""

from __future__ import annotations

import numpy as np

from pam_antagonist._jit import in_place
from pam_antagonist.estimation import Estimator, simulate_model, ukf
from pam_antagonist.estimation.estimator import parameter_sets
from pam_antagonist.model import dynamics, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.model.parameters import BASE_STATES as STATES
from pam_antagonist.rig import Rig
from pam_antagonist.simulation.excitation import profile
from validation.benchmark import lanes
from validation.benchmark.figure import Figure, at_least, at_most, pairwise

_SAMPLES = 4000
_SAMPLES_FILTERPY = 1000
_REFERENCE_NINE_STEPS = 8.0e-6
"""[s] What nine Runge-Kutta steps take on the machine that the bound on the default tuning speaks of."""

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
        _predict(x, covariance, cross, voltages[k], parameter_sets, dt, process, kappa, effects, work)
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
        _filter_steps(
            self.pressure,
            self.voltage,
            self.states[0].copy(),
            np.diag(self.tuning.initial),
            np.zeros((STATES, self.considered)),
            self.parameter_sets,
            self.rig.sample_period,
            np.array(self.tuning.process),
            np.array(self.tuning.measurement),
            self.tuning.kappa,
            self.effects,
            self._work,
            np.empty(2),
            np.empty((2, 2)),
        )

    def sample(self) -> None:
        """The whole sample: time, gate, predict, update, torque and its covariance, σ, stiffness."""
        self.estimator.reset()
        self.estimator.run(self.stamps, self.pressure, self.voltage)

    def live(self) -> None:
        """The same, one call from Python a sample."""
        self.estimator.reset()
        step = self.estimator.step_in_place
        for stamp, (p1, p2), (u1, u2) in zip(
            self.stamps.tolist(), self.pressure.tolist(), self.voltage.tolist(), strict=True
        ):
            step(stamp, p1, p2, u1, u2)


def measure(rig: Rig) -> list[Figure]:
    """Measure the filter's step.

    Args:
        rig: whose model and tunings ``published`` (n = 4) and ``default`` are used.
    """
    plain, default = _Case(rig, "published"), _Case(rig, "default")
    figures = []
    for case, label in ((plain, "n4"), (default, "default")):
        count = case.sigma_points
        ratio, ukf_s, bare_s = pairwise(case.filter, case.bare)
        parts = {
            "ukf_us": ukf_s / _SAMPLES * 1e6,
            "rk4_steps_us": bare_s / _SAMPLES * 1e6,
            "sigma_points": float(count),
        }
        figures.append(
            at_most(
                f"ukf_step_{label}",
                f"a UKF step (predict, update; {count} sigma points) against {count} bare RK4 steps",
                ratio,
                1.0,
                "×",
                parts,
            )
        )
        ratio, whole_s, bare_s = pairwise(case.sample, case.bare)
        parts = {"sample_us": whole_s / _SAMPLES * 1e6, "rk4_steps_us": bare_s / _SAMPLES * 1e6}
        figures.append(
            Figure(
                f"sample_{label}",
                f"a whole sample (time, gate, step, torque with covariance, σ) against {count} bare RK4 steps",
                ratio,
                "",
                None,
                "×",
                parts,
            )
        )
    ratio, live_s, bare_s = pairwise(plain.live, plain.bare)
    figures.append(
        at_most(
            "python_call_n4",
            "one call of Estimator.step_in_place from Python (n = 4) against nine bare RK4 steps",
            ratio,
            3.0,
            "×",
            {"call_us": live_s / _SAMPLES * 1e6, "rk4_steps_us": bare_s / _SAMPLES * 1e6},
        )
    )
    ratio, live_s, nine_s = pairwise(default.live, plain.bare)
    share = ratio * _REFERENCE_NINE_STEPS / rig.sample_period
    figures.append(
        at_most(
            "default_share_of_period",
            "one call of Estimator.step_in_place with the default tuning, as a share of the sample period on a machine "
            "where nine RK4 steps take 8 µs",
            share,
            0.2,
            "",
            {"call_us": live_s / _SAMPLES * 1e6, "nine_rk4_steps_us": nine_s / _SAMPLES * 1e6},
        )
    )
    for case, label in ((plain, "n4"), (default, "default")):
        ratio, live_s, run_s = pairwise(case.live, case.sample)
        parts = {"call_us": live_s / _SAMPLES * 1e6, "kernel_us": run_s / _SAMPLES * 1e6}
        meaning = "one call of Estimator.step_in_place from Python, above what the kernel takes of it in a recording"
        above = (ratio - 1.0) * parts["kernel_us"]
        figures.append(at_most(f"call_above_kernel_{label}", meaning, above, 3.0, "µs", parts))
    figures.append(_against_filterpy(rig, plain))
    return [*figures, *lanes.measure(rig)]


def _against_filterpy(rig: Rig, case: _Case) -> Figure:
    from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter

    p = case.parameter_sets[0]

    def advance(x: np.ndarray, dt: float, u: np.ndarray) -> np.ndarray:
        result = np.empty(STATES)
        integration.rk4_step(x, u, p, dt, result)
        return result

    def observe(x: np.ndarray) -> np.ndarray:
        return x[2:4]

    def run() -> None:
        other = UnscentedKalmanFilter(
            STATES, 2, rig.sample_period, observe, advance, JulierSigmaPoints(STATES, kappa=case.tuning.kappa)
        )
        other.x = case.states[0].copy()
        other.P = np.diag(case.tuning.initial)
        other.Q = np.diag(case.tuning.process)
        other.R = np.diag(case.tuning.measurement)
        for k in range(_SAMPLES_FILTERPY):
            other.predict(u=case.voltage[k])
            other.update(case.pressure[k])

    ratio, theirs_s, ours_s = pairwise(run, case.filter, rounds=7)
    ratio *= _SAMPLES / _SAMPLES_FILTERPY
    return at_least(
        "filterpy_n4",
        "a step of filterpy's UKF around the same compiled RK4 step against a step of this one (n = 4)",
        ratio,
        60.0,
        "×",
        {"filterpy_us": theirs_s / _SAMPLES_FILTERPY * 1e6, "ukf_us": ours_s / _SAMPLES * 1e6},
    )
