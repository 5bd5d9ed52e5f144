"""The Runge-Kutta step against scipy's integrator at tight tolerances where the equations are smooth, and ``simulate``.

Smooth means: the joint slides one way or is locked, and no flow changes its regime. scipy integrates the
transcription, so that equations and integrator are both someone else's. Of ``simulate``: which voltage belongs to which
sample, what is reported where; and the locked joint.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import transcription as paper
from scipy.integrate import solve_ivp
from states import steps

from pam_antagonist.model import drive, dynamics

T = paper.CORRECTED
SCALE = np.array([0.1, 10.0, 1e5, 1e5])
"""What the states change by in these runs [rad, rad/s, Pa, Pa]."""


def reference(x, u, duration, locked=False):
    """States of the transcription at 101 times, and that nothing switches among them."""
    times = np.linspace(0.0, duration, 101)
    solution = solve_ivp(
        lambda _, state: paper.derivative(T, state.tolist(), u, locked), (0.0, duration), x, method="DOP853",
        t_eval=times, rtol=1e-12, atol=[1e-14, 1e-12, 1e-6, 1e-6],
    )  # fmt: skip
    states = solution.y.T
    regimes = {(paper.regime(T, s[2]), paper.regime(T, s[3])) for s in states}
    assert len(regimes) == 1, "a flow changes its regime on the way"
    if not locked:
        assert all(paper.slides(T, s) for s in states.tolist())
        assert len({math.copysign(1.0, s[1]) for s in states}) == 1, "the joint turns on the way"
    return states


def errors(x, u, duration, p, divisions, locked=False):
    """Largest errors at the end (len(divisions), 4) with that many steps."""
    end = reference(x, u, duration, locked)[-1]
    return np.array([np.abs(steps(x, p, n, duration / n, u)[-1] - end) for n in divisions])


def test_sliding_joint_converges_to_fourth_order(p):
    x, u = [-0.2, 8.0, 580e3, 480e3], (6.0, 5.0)
    # In one number, since a single state's error may pass through zero between two step sizes.
    error = np.max(errors(x, u, 0.016, p, (8, 16, 32, 64)) / SCALE, axis=1)
    rate = np.log2(error[:-1] / error[1:])
    assert np.all(rate > 3.6)
    assert np.all(rate < 5.0)


def test_sliding_joint_at_the_sample_period(p):
    x, u = [-0.2, 8.0, 580e3, 480e3], (6.0, 5.0)
    error = errors(x, u, 0.016, p, (16,))[0]
    assert np.all(error < 1e-4 * SCALE)


def test_locked_joint_converges_to_fourth_order(p_locked):
    """Both muscles where the inflow is subsonic; steps of 0.2 s and less, since at 1 ms only rounding is left."""
    x, u = [0.0, 0.0, 380e3, 640e3], (6.0, 5.5)
    error = errors(x, u, 1.6, p_locked, (4, 8, 16), locked=True)[:, 2:]
    rate = np.log2(error[:-1] / error[1:])
    assert np.all(rate > 3.7)
    assert np.all(rate < 5.5)


def test_locked_joint_at_the_sample_period(p_locked):
    for x, u in (([0.0, 0.0, 200e3, 370e3], (6.0, 5.0)), ([0.3, 0.0, 380e3, 640e3], (6.0, 5.5))):
        assert np.all(errors(x, u, 0.3, p_locked, (300,), locked=True)[0] < 1e-5)


START = np.array([0.0, 0.0, 450e3, 450e3])


def voltages(samples: int, seed: int = 16) -> np.ndarray:
    """Random levels, each held for 0.25 s."""
    levels = np.random.default_rng(seed).uniform(0.0, 10.0, (samples // 250 + 1, 2))
    return np.repeat(levels, 250, axis=0)[:samples]


@pytest.mark.parametrize("substeps", [1, 4])
def test_row_k_of_the_voltages_acts_over_the_step_that_ends_at_sample_k(p_stop, substeps):
    u = voltages(600)
    states, torques, sigma = drive.simulate(START, u, p_stop, 1e-3, substeps)
    assert states.shape == (600, 4)
    assert torques.shape == sigma.shape == (600,)
    assert np.array_equal(states[0], START)
    x = START.tolist()
    for k in range(1, 600):
        x = steps(x, p_stop, substeps, dt=1e-3 / substeps, u=tuple(u[k]))[-1]
        assert np.array_equal(states[k], x)


def test_row_0_is_not_used(p_stop):
    u = voltages(50)
    other = u.copy()
    other[0] = np.nan
    one, two = (drive.simulate(START, voltage, p_stop, 1e-3, 1)[0] for voltage in (u, other))
    assert np.array_equal(one, two)


def test_torque_and_subsystem_are_those_of_the_state_reported(p_stop):
    states, torques, sigma = drive.simulate(START, voltages(6000), p_stop, 1e-3, 1)
    for k in range(0, 6000, 37):
        assert torques[k] == dynamics.torque(states[k], p_stop)
        assert sigma[k] == dynamics.subsystem(states[k], p_stop)
    assert len(set(sigma.tolist())) > 3


@pytest.mark.parametrize("angle", [0.0, 0.2, -math.radians(25.0), math.radians(25.0)])
def test_locked_joint_holds_exactly(rig, angle):
    start = np.array([angle, 0.0, 450e3, 450e3])
    states, torques, sigma = drive.simulate(start, voltages(3000), rig.parameters("locked", angle), 1e-3, 1)
    assert np.all(states[:, 0] == angle)
    assert np.all(states[:, 1] == 0.0)
    assert np.all(sigma % 2 == 1)
    # The muscles still pull: the torque follows the pressures.
    assert np.ptp(torques) > 0.3


def test_mirrored_drive_mirrors_the_motion(rig):
    """Equal muscles, voltages exchanged: the angle changes sign, the pressures change places."""
    same = {f"muscle_2.force.{k}": rig.value(f"muscle_1.force.{k}") for k in ("v1", "v2", "w1", "w2")}
    p = rig.parameters(changes=same)
    u = voltages(4000)
    one, _, _ = drive.simulate(START, u, p, 1e-3, 1)
    other, _, _ = drive.simulate(START, np.ascontiguousarray(u[:, ::-1]), p, 1e-3, 1)
    assert np.ptp(one[:, 0]) > 0.05
    assert other[:, 0] == pytest.approx(-one[:, 0], abs=1e-9)
    assert other[:, [3, 2]] == pytest.approx(one[:, [2, 3]], rel=1e-9)
