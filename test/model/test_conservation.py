"""Air ends at the atmosphere or the tank behind a shut valve, and friction takes mechanical energy.

With constant pressures the muscles are springs. The force map is linear in sin ψ, so the energy
U(ψ) = −∫ τ dψ + k_s ψ²/2 is a polynomial, E = J ψ̇²/2 + U(ψ).
"""

from __future__ import annotations

import numpy as np
import pytest
import transcription as paper
from states import ATMOSPHERE, TANK, held, steps

from pam_antagonist.model import drive
from pam_antagonist.model import parameters as par

T = paper.CORRECTED


@pytest.mark.parametrize(("voltage", "expected"), [(0.0, ATMOSPHERE), (10.0, TANK)])
def test_shut_valve_ends_at_the_atmosphere_or_the_tank(p_locked, voltage, expected):
    """... and stays there: with the root in the subsonic branch the pressure arrives in finite time."""
    states, _, _ = drive.simulate(np.array([0.0, 0.0, 300e3, 300e3]), np.full((4001, 2), voltage), p_locked, 1e-3, 1)
    assert states[-1, 2:] == pytest.approx([expected] * 2, abs=1.0)
    # An overshoot through the flow's infinite slope at equal pressures is bounded by a step.
    assert np.all(states[:, 2] >= ATMOSPHERE - 50.0)
    assert np.all(states[:, 2] <= TANK + 50.0)


START = [0.25, 0.0, 400e3, 450e3]


def energy(states):
    """E [J] (N,), from the transcription's forces."""

    def difference(sine):
        forces = [paper.force(T, i, T["L_0"] + way * T["r"] * sine, START[1 + i]) for i, way in ((1, -1), (2, 1))]
        return forces[0] - forces[1]

    offset = difference(0.0)
    slope = difference(1.0) - offset
    sine = np.sin(states[:, 0])
    potential = -T["r"] * (offset * sine + slope * sine**2 / 2) + T["k_s"] * states[:, 0] ** 2 / 2
    return T["J"] * states[:, 1] ** 2 / 2 + potential


def drop(states):
    """Energy that the start has above the lowest point [J]."""
    bottom = np.array([[paper.rest(T, START[2], START[3]), 0.0, START[2], START[3]]])
    return energy(states[:1])[0] - energy(bottom)[0]


def reversal_gain(law_step):
    """What the friction law may give back at a reversal [J].

    The law looks one step ahead (ψ̇ + Z T_0): for the last moment before a reversal, while |ψ̇| < Z |T_0|, it already
    acts the other way. That lasts T_stp |T_0| / (|T_0| − T_c), at no more than the Coulomb torque T_c times Z |T_0|.
    """
    _, coulomb, applied = paper.balance(T, START)
    applied = abs(applied)
    return 0.5 * coulomb * law_step / T["J"] * applied * law_step * applied / (applied - coulomb)


def test_with_friction_energy_never_grows(rig):
    """... beyond what the friction law's look-ahead may give back at a reversal, which shrinks with T_stp²."""
    for law_step in (1e-3, 1e-4):
        p = held(rig)
        p[par.FRICTION_STEP] = law_step
        states = steps(START, p, int(0.5 / law_step), law_step)
        value = energy(states)
        assert value[0] - value[-1] > 0.99 * drop(states), "it does not come to rest"
        assert np.max(value - np.minimum.accumulate(value)) < reversal_gain(law_step)
    assert reversal_gain(1e-3) < 1e-3 * drop(states)
