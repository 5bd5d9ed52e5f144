"""What effects do at rest, at a start and under a push, beside the rates that the transcription holds them against."""

from __future__ import annotations

import math

import numpy as np
import pytest
import transcription as paper
from states import TANK, sealed

from pam_antagonist.model import drive, dynamics, equilibrium, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import parameter_path

T = paper.CORRECTED
DT = 1e-3


def locked(rig, **effects):
    return rig.replaced(effects=effects).parameters("locked")


def held(p, u, seconds):
    """States (N, n) of a joint held at 0° at constant voltages."""
    voltage = np.tile(np.asarray(u, dtype=np.float64), (round(seconds / DT) + 1, 1))
    return drive.simulate(equilibrium.initial_state(0.0, 450e3, 450e3, voltage[0], p), voltage, p, DT, 1)[0]


def test_a_shifted_valve_at_rest_stands_where_its_voltage_asks(rig):
    """With a lag as well: the state of a joint that has stood for long is that of the shifted curve."""
    offsets = {"voltage_1": 0.2, "open_rate_1": 0.03, "open_rate_2": -0.05}
    p = locked(rig, valve_offset=offsets, valve_lag={"time_1": 0.1, "time_2": 0.1})
    x = equilibrium.initial_state(0.0, 450e3, 430e3, np.array([6.0, 5.0]), p)
    assert x[4:] == pytest.approx([paper.kappa(T, 5.8) + 0.03, paper.kappa(T, 5.0) - 0.05], abs=1e-12)
    assert held(p, (6.0, 5.0), 2.0)[-1, 4:] == pytest.approx(x[4:], abs=1e-6)
    at_once = held(locked(rig, valve_offset=offsets), (6.0, 5.0), 60.0)
    assert held(p, (6.0, 5.0), 60.0)[-1, 2:4] == pytest.approx(at_once[-1, 2:], abs=1.0)


@pytest.mark.parametrize("exponent", [1.0, 1.8])
def test_a_run_may_begin_while_a_muscle_fills(rig, exponent):
    """From the sensors' pressures alone, in the middle of a run, it goes on as the run did; at rest nothing is lost."""
    p = locked(rig, line_resistance={"resistance_1": 2e8, "resistance_2": 1e8, "time": 2e-3, "exponent": exponent})
    u = (7.5, 4.0)
    states = held(p, u, 3.0)
    begun = equilibrium.initial_state(0.0, states[200, 2], states[200, 3], np.array([*u, 0.0]), p)
    assert begun[4:] == pytest.approx(states[200, 4:], abs=400.0)
    assert np.abs(states[200, 4:] - states[200, 2:4]).min() > 1e3
    rested = held(p, u, 90.0)[-1]
    still = equilibrium.initial_state(0.0, rested[2], rested[3], np.array([*u, 0.0]), p)
    assert still[4:] == pytest.approx(rested[2:4], abs=10.0)


def test_a_line_starts_within_what_there_is(rig):
    p = locked(rig, line_resistance={"resistance_1": 5e9, "resistance_2": 5e9})
    begun = equilibrium.initial_state(0.0, 200e3, 700e3, np.array([10.0, 0.0, 0.0]), p)
    assert begun[4] == T["P_out"] and begun[5] == TANK


def test_a_sensor_reads_by_offset_and_gain_and_its_inverse_undoes_it(rig):
    p = locked(rig, pressure_sensor={"offset_1": 4e3, "offset_2": -2e3, "gain_1": 0.02, "gain_2": -0.1})
    for pressure in (90e3, 450e3, 710e3):
        assert dynamics.reading(0, pressure, p) == pytest.approx(1.02 * pressure + 4e3, rel=1e-15)
        assert dynamics.reading(1, pressure, p) == pytest.approx(0.9 * pressure - 2e3, rel=1e-15)
        for muscle in (0, 1):
            assert dynamics.pressure_behind(muscle, dynamics.reading(muscle, pressure, p), p) == pytest.approx(pressure)


def with_effects(p, **effects):
    changes = {parameter_path(name, key): value for name, values in effects.items() for key, value in values.items()}
    return par.changed(p, changes)


@pytest.mark.parametrize(("constant", "sine"), [(0.2, 0.0), (-0.3, 0.0), (0.0, 1.5), (0.1, -0.8)])
def test_a_load_moves_the_angle_of_rest(rig, constant, sine):
    p = with_effects(sealed(rig), load_torque={"constant": constant, "sine": sine})
    for pressures in ((450e3, 450e3), (600e3, 350e3), (300e3, 450e3)):
        angle = equilibrium.rest_angle(*pressures, p)
        tau = paper.torque(T, angle, *pressures)
        assert tau + constant + sine * math.sin(angle) - T["k_s"] * angle == pytest.approx(0.0, abs=1e-9)
    positive = equilibrium.rest_angle(450e3, 450e3, p) - equilibrium.rest_angle(450e3, 450e3, sealed(rig))
    if sine == 0.0:
        assert math.copysign(1.0, positive) == math.copysign(1.0, constant)


def test_a_known_push_and_an_estimated_one_move_alike(rig):
    base = rig.parameters()
    p = with_effects(base, external_torque={"noise": 0.1})
    time = np.arange(2000)
    pushes = np.where((time > 300) & (time < 900), 0.4, 0.0)
    voltage = np.tile([5.8, 5.2], (2000, 1))
    known, _, _ = drive.simulate(np.array([0.0, 0.0, 450e3, 450e3]), np.column_stack([voltage, pushes]), base, DT, 1)
    x = np.array([0.0, 0.0, 450e3, 450e3, 0.0])
    for k in range(1, 2000):
        x[4] = pushes[k]
        integration.rk4_step(x, voltage[k], p, DT, x)
        assert np.array_equal(x[:4], known[k])
    quiet, torque, _ = drive.simulate(np.array([0.0, 0.0, 450e3, 450e3]), voltage, base, DT, 1)
    assert known[800, 0] > quiet[800, 0] + math.radians(1.0), "a push about +z turns the joint that way"
    # The muscles' torque is what pulls back: the meter reads less.
    assert dynamics.torque(known[800], base) < torque[800] - 0.2


@pytest.mark.parametrize("width", [0.1, 2.0, 20.0])
def test_a_slack_muscle_never_pushes(rig, width):
    base, p = rig.parameters(), with_effects(rig.parameters(), slack={"width": width})
    pushes = 0
    for angle in np.linspace(-0.43, 0.43, 23):
        for pressure in np.linspace(101.3e3, 700e3, 25):
            x = np.array([angle, 0.0, pressure, pressure])
            for pulls, linear in zip(dynamics.forces(x, p), dynamics.forces(x, base), strict=True):
                assert pulls > 0.0
                # Above either branch of the sharp bend, and nowhere by more than half the width.
                assert 0.0 <= pulls - max(linear, 0.0) <= 0.5 * width + 1e-12
                pushes += linear < 0.0
    assert pushes > 50, "the base model pushes in some of these states"
