"""Air is kept account of: equation (4) against what it integrates to, equation (5) against its balance."""

from __future__ import annotations

import numpy as np
import pytest
import transcription as paper
from scipy.optimize import brentq
from states import ATMOSPHERE, TANK, sealed, steps

from pam_antagonist.model import integration

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
        states, _, _ = integration.simulate(np.array([0.0, 0.0, 120e3, 690e3]), voltages, p, 0.02, 1)
        assert states[-1, 2:] == pytest.approx([expected, expected], abs=1.0)


@pytest.mark.parametrize(("voltage", "expected"), [(0.0, ATMOSPHERE), (10.0, TANK)])
def test_shut_valve_ends_at_the_atmosphere_or_the_tank(p_locked, voltage, expected):
    """... and stays there: with the root in the subsonic branch the pressure arrives in finite time."""
    states, _, _ = integration.simulate(
        np.array([0.0, 0.0, 300e3, 300e3]), np.full((4001, 2), voltage), p_locked, 1e-3, 1
    )
    assert states[-1, 2:] == pytest.approx([expected] * 2, abs=1.0)
    # An overshoot through the flow's infinite slope at equal pressures is bounded by a step.
    assert np.all(states[:, 2] >= ATMOSPHERE - 50.0)
    assert np.all(states[:, 2] <= TANK + 50.0)
