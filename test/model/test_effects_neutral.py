"""At its neutral values an effect is not there: not approximately, but to the last bit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from states import random_states

from pam_antagonist.model import dynamics, equilibrium, integration, sensor
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.simulation import excitation

VOLTAGE = excitation.profile("steps", 8.0, 1e-3, seed=6)
NAMES = (
    "hysteresis", "leak", "supply_droop", "valve_lag", "valve_offset", "line_resistance", "pressure_sensor",
    "load_torque", "friction", "creep", "thermal", "external_torque", "valve_play", "warm_up", "slack",
    "friction_by_pressure", "friction_by_signal", "load_by_signal", "strength_by_signal", "regulator_limits",
    "regulator_threshold", "regulator_dead_time", "regulator_lag", "limb_weight",
    "learned",
)  # fmt: skip
"""As reports call them."""


def run(p: np.ndarray, substeps: int = 1, start: np.ndarray | None = None):
    if start is None:
        start = equilibrium.initial_state(0.05, 430e3, 470e3, VOLTAGE[0], p)
    return integration.simulate(start, VOLTAGE, p, 1e-3, substeps)


def same(one, other) -> None:
    for a, b in zip(one, other, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("joint", ["free", "locked"])
@pytest.mark.parametrize("name", CATALOGUE)
def test_sizes_of_zero_are_the_base_model_whatever_the_shapes(rig, name, joint):
    shapes = {item.name: item.high for item in CATALOGUE[name].parameters if not item.is_size}
    sizes = {item.name: 0.0 for item in CATALOGUE[name].parameters if item.is_size}
    angle = 0.05 if joint == "locked" else 0.0
    base = rig.parameters(joint, angle)
    with_effect = rig.replaced(effects={name: {**shapes, **sizes}}).parameters(joint, angle)
    assert int(with_effect[par.STATES]) == 4
    whole = run(base)
    assert np.ptp(whole[0][:, 2:], axis=0).min() > 100e3, "the valves did not move the pressures"
    same(run(with_effect), whole)


def test_sensors_show_the_pressure_itself(rig):
    p = rig.parameters()
    for pressure in np.random.default_rng(1).uniform(90e3, 720e3, 100):
        for muscle in (0, 1):
            assert sensor.reading(muscle, pressure, p) == pressure
            assert sensor.pressure_behind(muscle, pressure, p) == pressure


@pytest.mark.parametrize("joint", ["free", "locked"])
def test_the_general_kernel_is_the_scalar_one(rig, joint):
    """With a fifth state that does nothing, all goes through the general kernel, with the same bits."""
    base = rig.parameters(joint, 0.05 if joint == "locked" else 0.0)
    general = par.changed(base, {parameter_path("external_torque", "noise"): 0.1})
    assert int(general[par.STATES]) == 5
    states, torques, sigma = run(general, substeps=2)
    assert np.all(states[:, 4] == 0.0)
    same((states[:, :4], torques, sigma), run(base, substeps=2))


@pytest.mark.parametrize("joint", ["free", "locked"])
def test_the_derivative_is_what_the_step_integrates(rig, joint):
    """``derivative`` is general, ``rk4_step`` scalar for four states: a step made of the first is the second."""
    p = rig.parameters(joint, changes={"joint.stop": math.inf})
    k = np.empty((4, 4))
    result = np.empty(4)
    h = 1e-3
    for values, voltages in random_states(200, seed=41):
        x, u = np.array(values), np.array(voltages)
        dynamics.derivative(x, u, p, k[0])
        dynamics.derivative(x + 0.5 * h * k[0], u, p, k[1])
        dynamics.derivative(x + 0.5 * h * k[1], u, p, k[2])
        dynamics.derivative(x + h * k[2], u, p, k[3])
        integration.rk4_step(x, u, p, h, result)
        assert np.array_equal(result, x + h / 6.0 * (k[0] + 2.0 * (k[1] + k[2]) + k[3]))


def test_a_state_comes_with_its_size_and_goes_with_it(rig):
    p = rig.parameters()
    for effect in CATALOGUE.values():
        for state in effect.states:
            for switch in (state.switch, *state.further):
                item = next(entry for entry in effect.parameters if entry.name == switch)
                assert item.is_size
                there = par.changed(p, {parameter_path(effect.name, item.name): item.scale})
                brought = [s.name for s in effect.states if switch in (s.switch, *s.further)]
                assert state.name in brought
                assert par.added_states(there) == brought
                assert int(there[par.STATES]) == 4 + len(brought)
                assert np.array_equal(par.changed(there, {parameter_path(effect.name, item.name): 0.0}), p)


def test_the_catalogue_is_whole():
    assert tuple(CATALOGUE) == NAMES
    for effect in CATALOGUE.values():
        assert all((effect.meaning, effect.law, effect.source, effect.signature))
        assert any(item.is_size for item in effect.parameters)
        for item in effect.parameters:
            assert item.low <= item.neutral <= item.high
            assert item.low < item.scale < item.high
            assert item.unit and item.meaning
        names = {item.name for item in effect.parameters}
        noises = [state.noise for state in effect.states]
        assert all(noise in names if isinstance(noise, str) else noise >= 0.0 for noise in noises)
        assert all(state.initial_std > 0.0 for state in effect.states)
