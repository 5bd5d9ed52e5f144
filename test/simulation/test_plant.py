"""The simulated joint: the model's physics, scattered, behind noisy sensors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import simulate
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant, scattered


def drive(samples: int) -> np.ndarray:
    """Slow and fast changes of both voltages."""
    time = np.arange(samples) * 1e-3
    return 5.5 + 4.5 * np.column_stack((np.sin(2.0 * time), -np.sin(2.5 * time)))


def record(plant: Plant, voltages: np.ndarray):
    samples = [plant.step(u) for u in voltages]
    measured = np.array([[*s.pressure, s.angle, s.torque] for s in samples])
    return measured, np.array([s.truth for s in samples])


def test_exact_plant_is_the_model_alone(rig):
    """No mismatch, no noise, one step a sample: bit for bit ``simulate``, whose row 0 is the start."""
    u = drive(800)
    measured, truth = record(Plant(rig, substeps=1, noise=False, initial_angle=0.1), u)
    start = np.array([0.1, 0.0, 450e3, 450e3])
    states, torques, _ = simulate(start, np.vstack((u[:1], u)), rig.parameters(), rig.sample_period, 1)
    assert np.array_equal(truth, states[1:])
    assert np.array_equal(measured, np.column_stack((states[1:, 2:], states[1:, 0], torques[1:])))
    assert np.ptp(truth[:, 0]) > 0.01


def test_finer_steps_agree_with_the_model_alone(rig):
    """... as far as a step of 1 ms and a friction law of 1 ms are exact: 0.05°, 100 Pa."""
    u = drive(3000)
    _, fine = record(Plant(rig, substeps=8, noise=False), u)
    _, coarse = record(Plant(rig, substeps=1, noise=False), u)
    assert np.ptp(fine[:, 0]) > math.radians(5.0)
    assert fine[:, 0] == pytest.approx(coarse[:, 0], abs=math.radians(0.05))
    assert fine[:, 2:] == pytest.approx(coarse[:, 2:], abs=100.0)
    assert not np.array_equal(fine, coarse)


def test_its_friction_law_has_its_own_step(rig):
    """T_stp of equation (10) is the step that is integrated, not the sample period."""
    u = drive(300)
    _, truth = record(Plant(rig, substeps=4, noise=False, initial_angle=0.1), u)
    p = par.changed(rig.parameters(), {"friction.time_step": rig.sample_period / 4})
    start = np.array([0.1, 0.0, 450e3, 450e3])
    states, _, _ = simulate(start, np.vstack((u[:1], u)), p, rig.sample_period, 4)
    assert np.array_equal(truth, states[1:])


def test_a_seed_makes_it_reproducible(rig):
    u = drive(50)
    runs = [record(Plant(rig, seed=seed, mismatch=0.02), u) for seed in (3, 3, 4)]
    for same, other in zip(runs[0], runs[1], strict=True):
        assert np.array_equal(same, other)
    assert not np.array_equal(runs[0][1], runs[2][1])


def test_noise_does_not_reach_the_joint(rig):
    u = drive(50)
    assert np.array_equal(record(Plant(rig, noise=True), u)[1], record(Plant(rig, noise=False), u)[1])


def test_noise_is_what_the_rig_declares(rig):
    """White, zero mean, uncorrelated between sensors, each bound five standard errors of 4000 samples wide."""
    measured, truth = record(Plant(rig, joint="locked", seed=5), np.full((4000, 2), 5.5))
    p = rig.parameters("locked")
    exact = np.column_stack((truth[:, 2:], truth[:, 0], [dynamics.torque(x, p) for x in truth]))
    error = measured - exact
    sensors = rig.sensors
    quantised = math.sqrt(sensors.pressure_std**2 + sensors.pressure_step**2 / 12)
    std = np.array([quantised, quantised, sensors.angle_std, sensors.torque_std])
    assert np.mean(error, axis=0) / std == pytest.approx(0.0, abs=5 / math.sqrt(4000))
    assert np.std(error, axis=0) / std == pytest.approx(1.0, abs=5 / math.sqrt(8000))
    scaled = error / std
    assert scaled.T @ scaled / 4000 == pytest.approx(np.eye(4), abs=5 * math.sqrt(2 / 4000))
    assert np.mean(scaled[1:] * scaled[:-1], axis=0) == pytest.approx(0.0, abs=5 / math.sqrt(4000))


def test_sensors_are_quantised(rig, tmp_path):
    file = tmp_path / "coarse.yaml"
    file.write_text("based_on: shin2022\nsensors: {angle_step: 0.0002, torque_step: 0.002}\n")
    coarse = load_rig(file)
    measured, _ = record(Plant(coarse, seed=6), drive(200))
    for column, step in ((0, 244.0), (1, 244.0), (2, 0.0002), (3, 0.002)):
        levels = measured[:, column] / step
        assert levels == pytest.approx(np.round(levels), abs=1e-6)
        assert len(set(np.round(levels))) > 2
    # ... and not where the step is 0, as for the angle of shin2022.
    angles = record(Plant(rig, seed=6), drive(200))[0][:, 2]
    assert len(set(angles)) == 200


def test_it_tells_the_voltages_that_were_on_the_valves(rig):
    plant = Plant(rig)
    given = np.array([4.0, 6.0])
    sample = plant.step(given)
    given[:] = 0.0
    assert sample.voltage.tolist() == [4.0, 6.0]
    plant.step((5.0, 5.0))
    assert sample.voltage.tolist() == [4.0, 6.0], "a later step changes an earlier sample"


def test_mismatch_scatters_what_is_uncertain_and_nothing_else(rig):
    p = rig.parameters()
    spread = 0.02
    plants = np.array([scattered(p, spread, np.random.default_rng(seed)) for seed in range(300)])
    factors = plants / np.where(p == 0.0, 1.0, p)
    of = {name: factors[:, index] for name, index in par.INDEX.items()}
    for name in ("friction.shaft", "gas.polytropic_flow", "valve_2.outflow_area", "muscle_1.force.v1"):
        assert np.std(of[name]) == pytest.approx(spread, rel=0.25)
        assert np.mean(of[name]) == pytest.approx(1.0, abs=5 * spread / math.sqrt(300))
    for name in ("geometry.radius", "joint.stop", "atmosphere.pressure", "gas.constant", "friction.time_step"):
        assert np.all(of[name] == 1.0)
    # A map whose coefficients nearly cancel is scaled as a whole.
    assert of["muscle_1.force.v1"] == pytest.approx(of["muscle_1.force.w2"], rel=1e-12)
    assert abs(np.corrcoef(of["muscle_1.force.v1"], of["muscle_2.force.v1"])[0, 1]) < 0.3


def test_no_mismatch_is_the_declared_rig(rig):
    plant = Plant(rig, substeps=1)
    assert np.array_equal(plant.parameters, rig.parameters())
    plant.parameters[:] = 0.0
    assert plant.parameters[par.RADIUS] == rig.geometry.radius


def test_a_regulator_that_swings_makes_no_vacuum():
    rig = load_rig("shin2022_regulators", regulators=True).with_value("effects.regulator_lag.damping", 0.1)
    plant, air = Plant(rig, noise=False), rig.atmosphere.pressure
    for pressure in (400e3, rig.command_limits[0]):
        _, truth = record(plant, np.full((300, 2), pressure))
    assert air == pytest.approx(truth[:, 2:4].min(), rel=1e-12)


def test_it_starts_at_rest(rig):
    """At the balance of its own, scattered, parameters: the joint does not jump at the first step."""
    plant = Plant(rig, seed=7, mismatch=0.03, noise=False, initial_pressure=(500e3, 300e3))
    first = plant.step((5.5, 5.5)).truth
    assert first[0] == pytest.approx(equilibrium.rest_angle(500e3, 300e3, plant.parameters), abs=1e-6)
    assert abs(first[0] - equilibrium.rest_angle(500e3, 300e3, rig.parameters())) > 1e-3
    assert abs(first[1]) < 1e-3


def test_locked_plant_stays_where_it_is_locked(rig):
    _, truth = record(Plant(rig, joint="locked", lock_angle=0.2), drive(200))
    assert np.all(truth[:, :2] == [0.2, 0.0])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"substeps": 0}, ["0 substeps", "1 or more"]),
        ({"mismatch": -0.1}, ["mismatch -0.1", "0 to 0.3"]),
        ({"mismatch": math.nan}, ["mismatch nan"]),
        ({"mismatch": 0.5}, ["mismatch 0.5"]),
        ({"initial_pressure": (350e3, 0.0)}, ["initial pressures", "absolute", "101300"]),
        ({"initial_pressure": (450.0, 450.0)}, ["initial pressures", "Pa"]),
        ({"initial_pressure": (450e3, math.nan)}, ["initial pressures", "nan"]),
        ({"joint": "fixed"}, ["'fixed'", "'free' or 'locked'"]),
        ({"joint": "locked", "lock_angle": 25.0}, ["lock angle 25 rad", "0.436"]),
        ({"joint": "locked", "lock_angle": math.nan}, ["lock angle nan"]),
    ],
)
def test_bad_arguments(rig, arguments, words):
    with pytest.raises(BadInput) as error:
        Plant(rig, **arguments)
    message = str(error.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("voltage", [(math.nan, 5.0), (5.0, math.inf)])
def test_bad_voltage(rig, voltage):
    with pytest.raises(BadInput, match="finite"):
        Plant(rig).step(voltage)
