"""What an orifice must do whatever its constants: continuity, symmetry, areas by direction."""

from __future__ import annotations

import numpy as np
import pytest
from states import ATMOSPHERE, CHOKED_BELOW, TANK

from pam_antagonist.model import flow
from pam_antagonist.model import parameters as par

CRITICAL = CHOKED_BELOW / TANK


def test_value_and_slope_are_continuous_where_the_flow_chokes(p):
    """The subsonic branch ends at its maximum: level, like the choked one. A wrong exponent or a wrong
    critical ratio shows as a step or a kink."""
    edge = CRITICAL * TANK
    choked = flow.orifice_flow(TANK, edge * (1 - 1e-6), p)
    subsonic = flow.orifice_flow(TANK, edge * (1 + 1e-6), p)
    assert subsonic == pytest.approx(choked, rel=1e-10)
    step = 1e-4 * edge
    slope = (flow.orifice_flow(TANK, edge + step, p) - choked) / step
    assert abs(slope) * TANK < 1e-3 * choked
    # ... and it does fall further on, so that the test above can fail.
    assert flow.orifice_flow(TANK, 1.3 * edge, p) < 0.95 * choked


def test_choked_flow_of_air_has_the_textbook_value(p):
    """0.0404 √K s/m for air, a figure of any gas dynamics text: m = 0.0404 A P/√T."""
    per_area = flow.orifice_flow(TANK, ATMOSPHERE, p)
    assert per_area * np.sqrt(293.0) / TANK == pytest.approx(0.0404, abs=5e-5)


def test_flow_below_vacuum_is_that_into_a_vacuum(p):
    """No chamber gets there, but a sigma point may: choked inflow from both sides, and no NaN."""
    for alpha in (0.0, 0.5, 1.0):
        assert flow.mass_flow(0, alpha, -20e3, p) == flow.mass_flow(0, alpha, 1e3, p) > 0.0


@pytest.mark.parametrize("heat_ratio", [1.1, 1.3, 1.4, 1.667, 1.9])
def test_subsonic_flow_is_the_printed_one_of_any_gas(rig, heat_ratio):
    """The polynomial in its place errs by less than the rounding of the two powers that equation (5) has."""
    p = rig.parameters(changes={"gas.heat_ratio": heat_ratio})
    k, gas, temperature = heat_ratio, p[par.GAS_CONSTANT], p[par.TEMPERATURE]
    ratios = np.linspace((2 / (k + 1)) ** (k / (k - 1)) + 1e-9, 0.999, 300)
    powers = ratios ** (2 / k) - ratios ** ((k + 1) / k)
    printed = TANK * np.sqrt(2 * k / (gas * (k - 1) * temperature) * powers)
    flows = [flow.orifice_flow(TANK, TANK * ratio, p) for ratio in ratios]
    np.testing.assert_allclose(flows, printed, rtol=2e-13)
