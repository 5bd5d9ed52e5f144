"""What each effect of muscle and joint does: loops, drifts, loads, stick bands, pushes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import transcription as paper
from scipy.integrate import trapezoid
from states import held, sealed

from pam_antagonist.model import dynamics, equilibrium, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import parameter_path
from pam_antagonist.model.effects.hysteresis import loop_rate

T = paper.CORRECTED
DT = 1e-3
WIDTH = 2e-3


def with_effects(p, **effects):
    changes = {parameter_path(name, key): value for name, values in effects.items() for key, value in values.items()}
    return par.changed(p, changes)


# Hysteresis


def loop_of(rate_scale, amplitude=5e-3, cycles=3, points=4000):
    """z along a length that goes ±amplitude as a sine, stepped evenly in the angle of the sine."""
    phase = np.linspace(0.0, 2.0 * math.pi * cycles, cycles * points + 1)
    length = amplitude * np.sin(phase)
    z = np.zeros(len(phase))
    for k in range(1, len(phase)):
        duration = 1.0 / rate_scale
        rate = (length[k] - length[k - 1]) / duration
        first = loop_rate(WIDTH, rate, z[k - 1])
        z[k] = z[k - 1] + duration * loop_rate(WIDTH, rate, z[k - 1] + 0.5 * duration * first)
    return length[-points - 1 :], z[-points - 1 :]


def test_the_loop_does_not_depend_on_the_speed():
    slow, fast = loop_of(1.0)[1], loop_of(1024.0)[1]
    assert np.array_equal(slow, fast)


def pushed(p, peak, period=4.0):
    """Angles while an outer torque goes up and down between ±peak, slowly; the last of two cycles."""
    time = np.arange(round(2 * period / DT)) * DT
    push = peak * np.sin(2.0 * math.pi * time / period)
    voltage = np.column_stack([np.full((len(time), 2), 5.5), push])
    states, _, _ = integration.simulate(equilibrium.initial_state(0.0, 450e3, 450e3, voltage[0], p), voltage, p, DT, 2)
    half = len(time) // 2
    return states[half:, 0], push[half:]


def test_a_joint_with_hysteresis_takes_more_work_in_a_cycle(rig):
    base = held(rig)
    rough = with_effects(base, hysteresis={"amplitude_1": 4.0, "amplitude_2": 4.0, "width": 1e-3})
    work = []
    for p in (base, rough):
        angle, push = pushed(p, 1.0)
        work.append(trapezoid(push, angle))
    # Two muscles, each ∮ F dl = 2 a per length and way, 4 a r per radian there and back; less where z turns round.
    angle, _ = pushed(rough, 1.0)
    most = 2 * 2 * 4.0 * T["r"] * (np.sin(angle.max()) - np.sin(angle.min()))
    assert 0.4 * most < work[1] - work[0] < most


# Load


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


def test_a_torque_meter_on_the_muscles_does_not_see_the_load(rig):
    p = with_effects(rig.parameters("locked"), load_torque={"constant": 0.5, "sine": 1.0})
    x = np.array([0.2, 0.0, 500e3, 400e3])
    assert dynamics.torque(x, p) == dynamics.torque(x, rig.parameters("locked"))


# Friction


def stands(p, push):
    """Whether a joint at its angle of rest stays there under a push."""
    x = np.array([equilibrium.rest_angle(450e3, 450e3, p), 0.0, 450e3, 450e3])
    states, _, _ = integration.simulate(x, np.tile([5.5, 5.5, push], (20, 1)), p, DT, 1)
    return abs(states[-1, 0] - states[0, 0]) < 1e-6


@pytest.mark.parametrize(("coulomb", "stribeck"), [(0.05, 0.0), (0.0, 0.04), (0.03, 0.02), (-0.04, 0.0)])
def test_the_stick_band_is_wider_by_what_is_added_at_rest(rig, coulomb, stribeck):
    p = with_effects(held(rig), friction={"coulomb": coulomb, "stribeck": stribeck, "velocity": 0.3})
    angle = equilibrium.rest_angle(450e3, 450e3, p)
    _, band, _ = paper.balance(T, [angle, 0.0, 450e3, 450e3])
    band += coulomb + stribeck
    for way in (1.0, -1.0):
        assert stands(p, way * 0.999 * band)
        assert not stands(p, way * 1.02 * band)


# External torque


def test_a_known_push_and_an_estimated_one_move_alike(rig):
    base = rig.parameters()
    p = with_effects(base, external_torque={"noise": 0.1})
    time = np.arange(2000)
    pushes = np.where((time > 300) & (time < 900), 0.4, 0.0)
    voltage = np.tile([5.8, 5.2], (2000, 1))
    known, _, _ = integration.simulate(
        np.array([0.0, 0.0, 450e3, 450e3]), np.column_stack([voltage, pushes]), base, DT, 1
    )
    x = np.array([0.0, 0.0, 450e3, 450e3, 0.0])
    for k in range(1, 2000):
        x[4] = pushes[k]
        integration.rk4_step(x, voltage[k], p, DT, x)
        assert np.array_equal(x[:4], known[k])
    quiet, torque, _ = integration.simulate(np.array([0.0, 0.0, 450e3, 450e3]), voltage, base, DT, 1)
    assert known[800, 0] > quiet[800, 0] + math.radians(1.0), "a push about +z turns the joint that way"
    # The muscles' torque is what pulls back: the meter reads less.
    assert dynamics.torque(known[800], base) < torque[800] - 0.2


# Slack


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
