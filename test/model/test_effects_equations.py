"""Every effect against a second version of it in plain Python: rates at a point, and trajectories by scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import transcription as paper
import transcription_effects as laws
from scipy.integrate import solve_ivp
from states import random_states

from pam_antagonist.model import dynamics, equilibrium, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, parameter_path

T = paper.CORRECTED
SINGLE = {
    "hysteresis": {"amplitude_1": 4.0, "amplitude_2": -2.5, "width": 3e-3},
    "leak": {"area_1": 2e-9, "area_2": 5e-10},
    "supply_droop": {"stiffness": 8e9, "time": 0.3},
    "valve_lag": {"time_1": 0.012, "time_2": 0.03},
    "valve_offset": {"voltage_1": 0.23, "voltage_2": -0.4, "open_rate_1": 0.04, "open_rate_2": -0.07},
    "line_resistance": {"resistance_1": 2e8, "resistance_2": 5e7, "time": 4e-3},
    "pressure_sensor": {"offset_1": 4e3, "offset_2": -1e3, "gain_1": 0.02, "gain_2": -0.01},
    "load_torque": {"constant": -0.04, "sine": 0.3},
    "friction": {"coulomb": 0.03, "stribeck": 0.05, "velocity": 0.4},
    "creep": {"share_1": 0.05, "share_2": 0.11, "stiffness": 80.0, "time": 0.7},
    "thermal": {"share_1": 0.2, "share_2": -0.1, "time": 0.4},
    "external_torque": {"noise": 0.1},
    "valve_play": {"play_1": 0.12, "play_2": 0.05},
    "warm_up": {"share_1": 0.2, "share_2": -0.1, "time": 5.0},
    "slack": {"width": 6.0},
    "friction_by_pressure": {"slope_1": 4e-8, "slope_2": 1e-7},
    "friction_by_signal": {"slope1": 0.02, "slope2": -0.01},
    "load_by_signal": {"slope1": 0.03, "slope2": -0.01},
    "strength_by_signal": {"slope1": 0.1, "slope2": -0.2},
    "regulator_limits": {"lowest": 2e5, "highest": 6e5},
    "regulator_threshold": {"threshold_1": 3e3, "threshold_2": 8e3},
    "regulator_dead_time": {"time_1": 4e-3, "time_2": 9e-3},
    "regulator_lag": {"frequency_1": 56.0, "frequency_2": 40.0, "damping": 0.3},
    "limb_weight": {"torque": 0.4, "hanging": -0.7},
    "weak_laws": {"amount": 0.7, "angle": 0.3, "velocity": 0.6},
}
"""Sizes that are seen, different for the two muscles, so that a mix-up shows."""
SIZES = {name: {item.name: item for item in effect.parameters} for name, effect in CATALOGUE.items()}
ONE_MUSCLE = {
    name: {key: value for key, value in values.items() if SIZES[name][key].muscle != 1}
    for name, values in SINGLE.items() if any(SIZES[name][key].muscle == 2 for key in values)
}  # fmt: skip
CASES = {
    **{name: {name: values} for name, values in SINGLE.items()},
    **{f"{name} of muscle 2": {name: values} for name, values in ONE_MUSCLE.items()},
    "leak through a crack": {"leak": {"area_1": 2e-9, "area_2": 5e-10, "exponent": 1.8}},
    "valve_offset of the spools": {"valve_offset": {"open_rate_1": -0.1, "open_rate_2": 0.06}},
    "valve_offset of spool 2": {"valve_offset": {"open_rate_2": -0.03}},
    "valve_offset and lag": {"valve_offset": {"open_rate_1": 0.05}, "valve_lag": {"time_1": 0.012, "time_2": 0.03}},
    "valve at full speed": {"valve_lag": {"time_1": 0.4, "time_2": 1.0, "reach": 0.03}},
    "turbulent line": {"line_resistance": {"resistance_1": 2e8, "resistance_2": 5e7, "time": 4e-3, "exponent": 1.7}},
    "valve_play and a shifted curve": {"valve_play": {"play_1": 0.3}, "valve_offset": {"voltage_1": 0.2}},
    "creep of the tubes": {"creep": {"stiffness": -120.0, "time": 0.3}},
    "drifting sensors": {"pressure_sensor": {"drift_1": 1e4, "drift_2": 3e4, "drift_time": 0.2}},
    "drifting sensor 2": {"pressure_sensor": {"drift_2": 3e4, "drift_time": 0.05}},
    "regulator that is as fast as it can": {"regulator_lag": {"frequency_1": 90.0, "largest_rate": 4e6}},
    "regulator with all that it may have": {
        "regulator_limits": {"lowest": 3e5, "highest": 5e5},
        "regulator_threshold": {"threshold_1": 3e3, "threshold_2": 8e3},
        "regulator_dead_time": {"time_1": 4e-3, "time_2": 9e-3},
        "regulator_lag": {"frequency_1": 56.0, "frequency_2": 40.0, "dead_zone": 2e3, "largest_rate": 8e6},
    },
    "all at once": SINGLE,
}


def flat(effects):
    return {f"{effect}.{key}": value for effect, values in effects.items() for key, value in values.items()}


def vector(rig, effects, joint="free"):
    changes = {parameter_path(*name.split(".")): value for name, value in flat(effects).items()}
    return rig.parameters(joint, changes={"joint.stop": math.inf, **changes})


def draw(names, rng):
    """Values of added states that may occur."""
    spread = {
        "hysteresis": 0.9,
        "supply": 2e4,
        "open_rate": 0.4,
        "chamber": 1e5,
        "creep": 5.0,
        "warmth": 1e4,
        "spool_voltage": 5.0,
        "reading_drift": 2e3,
        "reading_drift_rate": 1e4,
        "regulator_goal": 1e5,
        "late_command": 1e5,
        "late_command_rate": 1e6,
        "regulator_rate": 5e6,
    }
    middle = {"open_rate": 0.5, "chamber": 4e5, "spool_voltage": 5.0, "warmed": 0.5, "regulator_goal": 4e5}
    middle["late_command"] = 4e5
    kinds = [name.removesuffix("_1").removesuffix("_2") for name in names]
    return [middle.get(kind, 0.0) + spread.get(kind, 0.3) * rng.uniform(-1.0, 1.0) for kind in kinds]


def test_every_effect_has_a_case():
    assert set(SINGLE) == {name for name, effect in CATALOGUE.items() if not effect.of_tables}, "see test_learned.py"
    assert all(set(values) <= {item.name for item in CATALOGUE[name].parameters} for name, values in SINGLE.items())
    assert set(ONE_MUSCLE) == {n for n in SINGLE if any(item.muscle for item in CATALOGUE[n].parameters)}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("joint", ["free", "locked"])
def test_rates(rig, case, joint):
    effects = flat(CASES[case])
    p = vector(rig, CASES[case], joint)
    names = laws.states(effects)
    assert par.added_states(p) == names
    rng = np.random.default_rng(31)
    dx = np.empty(4 + len(names))
    # What counts as nothing: a rate that is the difference of large ones.
    nothing = np.array(
        [1e-12, 1e-8, 1e-2, 1e-2] + [1e-2 if "chamber" in n or n == "supply" or "drift" in n else 1e-6 for n in names]
    )
    slid = set()
    for base, drawn in random_states(60, seed=30):
        x = base + draw(names, rng)
        u = [_asked(case, value) for value in drawn]
        outside = float(rng.uniform(-0.3, 0.3))
        if base[1] == 0.0:
            outside -= laws.moves(T, effects, x)[0]  # near balance, so that the joint sticks in some
        dynamics.derivative(np.array(x), np.array([*u, outside]), p, dx)
        expected = laws.derivative(T, effects, x, u, outside, joint == "locked")
        error = np.abs(dx - expected) - 1e-8 * np.abs(expected)
        assert np.all(error <= nothing), (case, dict(zip(names, dx[4:], strict=True)), error)
        tau, forces = laws.torque_on_muscles(T, effects, x)
        assert dynamics.torque(np.array(x), p) == pytest.approx(tau, rel=1e-11, abs=1e-12)
        assert dynamics.forces(np.array(x), p) == pytest.approx(forces, rel=1e-11, abs=1e-10)
        if "external_torque.noise" not in effects:
            still = laws.moves(T, effects, x)[2][1]
            assert (dynamics.subsystem(np.array(x), p) - 1) % 2 == (still and joint == "free")
        slid.add(laws.moves(T, effects, x, outside)[2][1])
    assert slid == {True, False}


def _asked(case, voltage):
    """A regulator is asked for a pressure; 5 V become 400 kPa."""
    return 8e4 * voltage if case.startswith("regulator") else voltage


def test_signals_that_are_measured(rig):
    effects = {name: SINGLE[name] for name in ("friction_by_signal", "load_by_signal", "strength_by_signal")}
    p, t = vector(rig, effects), {**T, "signals": (0.4, -0.7)}
    p[par.SIGNAL : par.SIGNAL + 2] = t["signals"]
    without = vector(rig, effects)
    dx, still = np.empty(4), np.empty(4)
    moved = 0
    for x, u in random_states(20, seed=3):
        dynamics.derivative(np.array(x), np.array(u), p, dx)
        dynamics.derivative(np.array(x), np.array(u), without, still)
        assert dx == pytest.approx(laws.derivative(t, flat(effects), x, u), rel=1e-8, abs=1e-8)
        moved += bool(dx[1] != still[1])
    assert moved > 10


def test_weak_laws_act_with_their_coefficients(rig):
    effects = {"weak_laws": SINGLE["weak_laws"]}
    coefficients = tuple(0.02 * np.random.default_rng(2).standard_normal(15))
    p, t = vector(rig, effects), {**T, "coefficients": coefficients}
    dx, still = np.empty(4), np.empty(4)
    moved = 0
    for x, u in random_states(30, seed=5):
        p[par.WEAK_LAWS : par.WEAK_LAWS + 15] = coefficients
        dynamics.derivative(np.array(x), np.array(u), p, dx)
        assert dx == pytest.approx(laws.derivative(t, flat(effects), x, u), rel=1e-8, abs=1e-8)
        p[par.WEAK_LAWS : par.WEAK_LAWS + 15] = 0.0
        dynamics.derivative(np.array(x), np.array(u), p, still)
        moved += bool(dx[1] != still[1])
    assert moved > 10


def integrated(effects, x, u, duration, locked, outside):
    solution = solve_ivp(
        lambda _, state: laws.derivative(T, effects, state.tolist(), u, outside, locked),
        (0.0, duration),
        x,
        method="DOP853",
        rtol=1e-10,
        atol=1e-12,
    )
    assert solution.success
    return solution.y[:, -1]


STEPPED = ("leak", "line_resistance", "thermal", "warm_up", "regulator with all that it may have", "all at once")


@pytest.mark.parametrize("case", STEPPED)
@pytest.mark.parametrize(
    ("locked", "base", "u", "duration"),
    [(False, [-0.2, 8.0, 580e3, 480e3], (6.0, 5.0), 0.012), (True, [0.1, 0.0, 380e3, 640e3], (6.0, 5.2), 0.4)],
)
def test_trajectory(rig, case, locked, base, u, duration):
    """A swing that slides one way, and filling and emptying of a locked joint, with fine Runge-Kutta steps.

    The rates are tested for every effect. Here a step takes them, with and without added states of muscles and joint.
    """
    effects = flat(CASES[case])
    p = vector(rig, CASES[case], "locked" if locked else "free")
    u = tuple(_asked(case, value) for value in u)
    if case.startswith("regulator"):
        duration = min(duration, 0.03)  # a regulator is quicker than a valve
    inputs = np.array([*u, 0.05])
    before = np.array([_asked(case, 5.5)] * 2)
    x = equilibrium.initial_state(base[0], base[2], base[3], before, p)
    x[1] = base[1]
    steps = 8 * round(duration * 1e3)
    start = x.copy()
    for _ in range(steps):
        integration.rk4_step(x, inputs, p, duration / steps, x)
    expected = integrated(effects, start, u, duration, locked, 0.05)
    # A rate that has died out: 1 Pa/s is nothing of what it was.
    least = [1.0 if name.startswith("late_command_rate") else 1e-9 for name in (*("",) * 4, *laws.states(effects))]
    scale = np.maximum(np.abs(expected - start), 1e-4 * np.abs(start)) + least
    # What the supply gives jumps where A_0 does, at the turn of the flow: a step that spans it is of first order.
    # Dead zone and largest rate of a regulator have corners, where a step is of lower order as well.
    bounds = {"supply": 1e-3, "regulator_rate_1": 1e-4, "regulator_rate_2": 1e-4}
    bound = [bounds.get(name, 1e-5) for name in (*("",) * 4, *laws.states(effects))]
    assert np.all(np.abs(x - expected) < bound * scale), (x - expected) / scale
