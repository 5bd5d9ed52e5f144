"""Air is kept account of, and mechanical energy with the pressures held is kept without friction and lost with it.

Air: equation (4) against what it integrates to, equation (5) against its balance. Energy: with constant pressures the
muscles are springs. The force map is linear in sin ψ, so the energy U(ψ) = −∫ τ dψ + k_s ψ²/2 is a polynomial,
E = J ψ̇²/2 + U(ψ).
"""

from __future__ import annotations

import numpy as np
import pytest
import transcription as paper
from scipy.optimize import brentq
from states import ATMOSPHERE, TANK, held, sealed, steps

from pam_antagonist.model import drive
from pam_antagonist.model import parameters as par

T = paper.CORRECTED


def test_sealed_chambers_keep_p_v_to_the_k_2(rig):
    """Without flow equation (4) is Ṗ/P = −k_2 V̇/V, so ln P + k_2 ln V does not change, however the joint moves."""
    swing = steps([0.25, 0.0, 400e3, 450e3], sealed(rig), 500)
    for i in (1, 2):
        pressure = swing[:, 1 + i]
        volume = np.array([paper.volume(T, paper.length(T, i, angle)) for angle in swing[:, 0]])
        assert np.ptp(pressure) > 50e3, "the joint hardly moved: nothing is shown"
        product = pressure * volume ** T["k_2"]
        assert np.ptp(product) < 1e-6 * product[0]


def steady(alpha):
    """The pressure at which α m_in = (1 − α) m_out."""
    return brentq(
        lambda pressure: alpha * paper.nozzle(T, TANK, pressure) - (1 - alpha) * paper.nozzle(T, pressure, ATMOSPHERE),
        ATMOSPHERE,
        TANK,
        xtol=1e-6,
    )


@pytest.mark.parametrize("voltage", [4.0, 4.6, 5.5, 6.3, 7.5])
def test_steady_pressure_is_the_root_of_the_balance(rig, voltage):
    """From below and from above, with whatever areas and polytropic indices (Proposition 1 of the paper)."""
    expected = steady(paper.kappa(T, voltage))
    assert 1.1 * ATMOSPHERE < expected < 0.99 * TANK
    for changes in ({}, {"valve_1.inflow_area": 2e-7, "valve_2.outflow_area": 2e-8, "gas.polytropic_flow": 1.4}):
        p = rig.parameters("locked", changes=changes)
        # 300 s: the time constant is 4 s with the table's areas and 15 s with the small one.
        voltages = np.full((15_001, 2), voltage)
        states, _, _ = drive.simulate(np.array([0.0, 0.0, 120e3, 690e3]), voltages, p, 0.02, 1)
        assert states[-1, 2:] == pytest.approx([expected, expected], abs=1.0)


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


def test_without_friction_energy_is_kept(rig):
    """To fourth order or better: halving the step leaves a sixteenth or less of the loss."""
    p = held(rig, friction__shaft=0.0, friction__muscle=0.0, joint__viscous_friction=0.0)
    lost = []
    for dt in (2e-3, 1e-3, 0.5e-3):
        states = steps(START, p, int(0.5 / dt), dt)
        assert states[:, 0].min() < -0.3, "it does not swing"
        lost.append(np.ptp(energy(states)) / drop(states))
    assert lost[1] < 5e-5
    assert lost[0] > 16 * lost[1] > 256 * lost[2]


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
