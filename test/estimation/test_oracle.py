"""The compiled filter against filterpy's UKF, which shares no line with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter, unscented_transform
from recordings import trial

from pam_antagonist.estimation import Estimator
from pam_antagonist.model import dynamics, equilibrium, integration
from pam_antagonist.model.effects import ADDED_STATES
from pam_antagonist.rig import Rig, load_rig

SCALE = np.array([0.1, 1.0, 1e5, 1e5])


def _oracle(
    rig: Rig, tuning: str, recording, joint: str = "free", added: Sequence[tuple[str, str]] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """States (N, n) and covariances of angle and velocity (N, 2, 2). `added`: effect and name of each added state."""
    chosen, p, n = rig.tuning(tuning), rig.parameters(joint), 4 + len(added)
    held = np.array([0.0, 0.0, *[1.0] * (n - 2)]) if joint == "locked" else np.ones(n)
    # filterpy's Cholesky needs a definite matrix: a locked joint gets a variance far below any rounding.
    tiny = 1e-30 * (1.0 - held)
    by_name = {state.name: state for _, state in ADDED_STATES}

    def advance(x: np.ndarray, _dt: float, u: np.ndarray) -> np.ndarray:
        result = np.empty(n)
        integration.rk4_step(x, u, p, rig.sample_period, result)
        return result

    ukf = UnscentedKalmanFilter(
        dim_x=n,
        dim_z=2,
        dt=rig.sample_period,
        fx=advance,
        hx=lambda x: np.array([dynamics.reading(i, x[2 + i], p) for i in (0, 1)]),
        points=JulierSigmaPoints(n, kappa=chosen.kappa),
    )
    first = [dynamics.pressure_behind(i, recording.pressure[0, i], p) for i in (0, 1)]
    angle = 0.0 if joint == "locked" else equilibrium.rest_angle(*first, p)
    ukf.x = equilibrium.initial_state(angle, *first, recording.voltage[0], p)
    noise = [rig.value("effects.external_torque.noise") if effect == "external_torque" else by_name[state].noise
             for effect, state in added]  # fmt: skip
    ukf.P = np.diag(np.array([*chosen.initial, *(by_name[state].initial_std ** 2 for _, state in added)]) * held + tiny)
    ukf.Q = np.diag(np.array([*chosen.process, *(value**2 * rig.sample_period for value in noise)]) * held + tiny)
    ukf.R = np.diag(chosen.measurement)
    states, covariances = [ukf.x.copy()], [ukf.P[:2, :2].copy()]
    for y, u in zip(recording.pressure[1:], recording.voltage[1:], strict=True):
        before = ukf.x.copy()
        ukf.predict(u=u)
        if chosen.change:
            for i in (2, 3):
                ukf.P[i, i] += (chosen.change * (ukf.x[i] - before[i])) ** 2
            ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
        ukf.update(y)
        states.append(ukf.x.copy())
        covariances.append(ukf.P[:2, :2].copy())
    return np.array(states), np.array(covariances)


def _without_consider(rig: Rig, change: float = 0.0) -> Rig:
    # A gate that never closes: filterpy has none.
    open_gate = {name: tuning.replaced(consider=False, gate=1e9, change=change) for name, tuning in rig.tunings.items()}
    return rig.replaced(tunings=open_gate)


@pytest.mark.parametrize(
    ("tuning", "joint", "change"),
    [("published", "free", 0.0), ("default", "free", 0.3), ("published", "locked", 0.0)],
)
def test_equals_filterpy_over_a_whole_recording(tuning: str, joint: str, change: float) -> None:
    rig = _without_consider(load_rig("shin2022"), change)
    recording = trial(10.0, seed=4, joint=joint)
    states, covariances = _oracle(rig, tuning, recording, joint)
    run = Estimator(rig, tuning, joint).run(recording.stamp_ns, recording.pressure, recording.voltage).rows
    ours = np.column_stack([run["angle"], run["velocity"], run["pressure"]])
    assert len(ours) == len(states)
    assert np.abs((ours - states) / SCALE).max() < 1e-9
    reference = covariances[:, :2, :2]
    assert np.abs(run["covariance"][:, :2, :2] - reference).max() < 1e-9 * max(np.abs(reference).max(), 1e-9)
    # An agreement that means something: the joint moved.
    assert joint == "locked" or np.ptp(run["angle"]) > 0.1


MUSCLE_AND_VALVE = {
    "hysteresis": {"amplitude_1": 3.0, "amplitude_2": -2.0, "width": 2e-3},
    "valve_lag": {"time_1": 0.01},
    "pressure_sensor": {"offset_1": 3e3, "offset_2": -1e3, "gain_2": 0.0},
    "creep": {"share_2": 0.05, "time": 1.0},
    "thermal": {"share_1": 0.05, "time": 1.0},
}


@pytest.mark.slow(4)
@pytest.mark.parametrize(
    ("effects", "order", "seconds"),
    [
        (
            MUSCLE_AND_VALVE,
            [
                ("hysteresis", "hysteresis_1"), ("hysteresis", "hysteresis_2"), ("valve_lag", "open_rate_1"),
                ("creep", "creep_2"), ("thermal", "warmth_1"),
            ],
            6.0,
        ),
        # The pressures hardly tell an outer torque from the angle: rounding grows, a hundredfold in a second.
        ({"external_torque": {"noise": 0.05}}, [("external_torque", "external_torque")], 2.0),
    ],
    ids=["muscle and valve", "external torque"],
)  # fmt: skip
def test_equals_filterpy_with_added_states(effects, order, seconds) -> None:
    rig = _without_consider(load_rig("shin2022")).replaced(effects=effects)
    recording = trial(seconds, seed=8)
    expected, _ = _oracle(rig, "default", recording, added=order)
    run = Estimator(rig).run(recording.stamp_ns, recording.pressure, recording.voltage)
    assert list(run.added) == [state for _, state in order]
    rows = run.rows
    ours = np.column_stack([rows["angle"], rows["velocity"], rows["pressure"], *run.added.values()])
    scale = {"creep": 50.0, "warmth": 1e4}
    scales = [0.1, 1.0, 1e5, 1e5, *(scale.get(state.rsplit("_", 1)[0], 1.0) for _, state in order)]
    assert np.abs((ours - expected) / scales).max() < 1e-8
    assert np.ptp(rows["angle"]) > 0.05
    assert all(np.ptp(values) > 0.0 for values in run.added.values())


@pytest.mark.slow(5)
def test_consider_parameters_equal_an_augmented_filter() -> None:
    """filterpy's sigma points and transform on the augmented vector [θ, x], with Schmidt's gain."""
    rig = load_rig("shin2022")
    chosen = rig.tuning("default")
    recording = trial(1.5, seed=5)
    names = list(rig.uncertainty)
    m, n = len(names), 4
    points = JulierSigmaPoints(n + m, kappa=chosen.kappa)

    def advance(z: np.ndarray, u: np.ndarray) -> np.ndarray:
        p = rig.parameters(
            changes={k: rig.value(k) + t * rig.uncertainty[k] for k, t in zip(names, z[:m], strict=True)}
        )
        x = np.empty(n)
        integration.rk4_step(z[m:], u, p, rig.sample_period, x)
        return np.concatenate([z[:m], x])

    first = recording.pressure[0]
    mean = np.concatenate([np.zeros(m), [equilibrium.rest_angle(*first, rig.parameters()), 0.0], first])
    cov = np.diag(np.concatenate([np.ones(m), chosen.initial]))
    noise = np.diag(np.concatenate([np.zeros(m), chosen.process]))
    pick = np.zeros((2, n + m))
    pick[0, m + 2] = pick[1, m + 3] = 1.0
    measurement = np.diag(chosen.measurement)
    expected = [mean[m:].copy()]
    deviations = [np.sqrt(np.diag(cov))[m]]
    for y, u in zip(recording.pressure[1:], recording.voltage[1:], strict=True):
        sigmas = np.array([advance(z, u) for z in points.sigma_points(mean, cov)])
        mean, cov = unscented_transform(sigmas, points.Wm, points.Wc, noise)
        gain = cov @ pick.T @ np.linalg.inv(pick @ cov @ pick.T + measurement)
        gain[:m] = 0.0
        mean = mean + gain @ (y - pick @ mean)
        keep = np.eye(n + m) - gain @ pick
        cov = keep @ cov @ keep.T + gain @ measurement @ gain.T
        expected.append(mean[m:].copy())
        deviations.append(np.sqrt(np.diag(cov))[m])
    open_gate = rig.replaced(tunings={"default": chosen.replaced(gate=1e9)})
    run = Estimator(open_gate).run(recording.stamp_ns, recording.pressure, recording.voltage).rows
    ours = np.column_stack([run["angle"], run["velocity"], run["pressure"]])
    assert np.abs((ours - np.array(expected)) / SCALE).max() < 1e-9
    assert np.allclose(np.sqrt(run["covariance"][:, 0, 0]), deviations, rtol=1e-6, atol=0.0)
    # The parameters' uncertainty is in the covariance: without them it would be far smaller.
    plain = open_gate.replaced(uncertainty={})
    bare = Estimator(plain).run(recording.stamp_ns, recording.pressure, recording.voltage).rows
    assert run["covariance"][-1, 0, 0] > 4.0 * bare["covariance"][-1, 0, 0]


def test_the_printed_gain_counts_the_measurement_noise_twice() -> None:
    """With it the first step is that of a sensor with twice the variance; the covariance says what it costs."""
    rig = load_rig("shin2022")
    recording = trial(2.0, seed=6)
    arrays = recording.stamp_ns[:2], recording.pressure[:2], recording.voltage[:2]
    published = rig.tuning("published")

    def second(**changes) -> np.void:
        return Estimator(rig.replaced(tunings={"default": published.replaced(**changes)})).run(*arrays).rows[1]

    doubled = tuple(2.0 * value for value in published.measurement)
    standard, printed, noisy = second(), second(gain="printed"), second(measurement=doubled)
    assert np.allclose(printed["pressure"], noisy["pressure"], rtol=1e-12, atol=0.0)
    assert not np.allclose(printed["pressure"], standard["pressure"], rtol=1e-6, atol=0.0)
    assert printed["nis"] == standard["nis"]
    assert printed["covariance"][2, 2] > standard["covariance"][2, 2]
