"""Mechanical energy of the joint with the pressures held: kept without friction, lost with it.

With constant pressures the muscles are springs: the force map is linear in sin ψ, so the energy
U(ψ) = −∫ τ dψ + k_s ψ²/2 is a polynomial, E = J ψ̇²/2 + U(ψ).
"""

from __future__ import annotations

import numpy as np
import transcription as paper
from states import held, steps

from pam_antagonist.model import parameters as par

T = paper.CORRECTED
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
