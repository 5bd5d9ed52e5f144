"""``simulate``: which voltage belongs to which sample, what is reported where; and the locked joint."""

from __future__ import annotations

import math

import numpy as np
import pytest
from states import steps

from pam_antagonist.model import dynamics, integration

START = np.array([0.0, 0.0, 450e3, 450e3])


def voltages(samples: int, seed: int = 16) -> np.ndarray:
    """Random levels, each held for 0.25 s."""
    levels = np.random.default_rng(seed).uniform(0.0, 10.0, (samples // 250 + 1, 2))
    return np.repeat(levels, 250, axis=0)[:samples]


@pytest.mark.parametrize("substeps", [1, 4])
def test_row_k_of_the_voltages_acts_over_the_step_that_ends_at_sample_k(p_stop, substeps):
    u = voltages(600)
    states, torques, sigma = integration.simulate(START, u, p_stop, 1e-3, substeps)
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
    one, two = (integration.simulate(START, voltage, p_stop, 1e-3, 1)[0] for voltage in (u, other))
    assert np.array_equal(one, two)


def test_torque_and_subsystem_are_those_of_the_state_reported(p_stop):
    states, torques, sigma = integration.simulate(START, voltages(6000), p_stop, 1e-3, 1)
    for k in range(0, 6000, 37):
        assert torques[k] == dynamics.torque(states[k], p_stop)
        assert sigma[k] == dynamics.subsystem(states[k], p_stop)
    assert len(set(sigma.tolist())) > 3


@pytest.mark.parametrize("angle", [0.0, 0.2, -math.radians(25.0), math.radians(25.0)])
def test_locked_joint_holds_exactly(rig, angle):
    start = np.array([angle, 0.0, 450e3, 450e3])
    states, torques, sigma = integration.simulate(start, voltages(3000), rig.parameters("locked", angle), 1e-3, 1)
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
    one, _, _ = integration.simulate(START, u, p, 1e-3, 1)
    other, _, _ = integration.simulate(START, np.ascontiguousarray(u[:, ::-1]), p, 1e-3, 1)
    assert np.ptp(one[:, 0]) > 0.05
    assert other[:, 0] == pytest.approx(-one[:, 0], abs=1e-9)
    assert other[:, [3, 2]] == pytest.approx(one[:, [2, 3]], rel=1e-9)
