"""Equations (2) to (10) one by one, where the whole derivative does not show them: flow, muscle, joint.

An orifice, whatever its constants: continuity, symmetry, areas by direction.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import transcription as paper
from states import ATMOSPHERE, CHOKED_BELOW, EDGE_PRESSURES, EDGE_VOLTAGES, TANK

from pam_antagonist.model import flow, muscle
from pam_antagonist.model import parameters as par

T = paper.CORRECTED
CHOKED_SCALE = paper.nozzle(T, T["P_tank"], T["P_out"])


@pytest.mark.parametrize("valve", [0, 1])
def test_valve_curve_at_between_and_beyond_its_points(p, valve):
    voltages = [u for u, _ in T["curve"]] + list(EDGE_VOLTAGES) + [k * 0.037 for k in range(-10, 290)]
    for u in voltages:
        assert flow.open_rate(valve, u, p) == pytest.approx(paper.kappa(T, u), abs=1e-15)


def test_valves_have_curves_of_their_own(rig):
    p = rig.parameters()
    par.set_curve(p, 1, [0.0, 10.0], [0.0, 1.0])
    assert flow.open_rate(0, 5.5, p) == 0.394
    assert flow.open_rate(1, 5.5, p) == pytest.approx(0.55)


def test_orifice_both_branches_and_both_ways(p):
    pressures = [*EDGE_PRESSURES, *(60e3 + 3.7e3 * k for k in range(190))]
    for before, behind in itertools.product(pressures[::3], pressures):
        expected = paper.nozzle_either_way(T, before, behind)
        # Close to equal pressures the flow is the root of a difference that cancels.
        assert flow.orifice_flow(before, behind, p) == pytest.approx(expected, rel=1e-9, abs=1e-9 * CHOKED_SCALE)


@pytest.mark.parametrize("valve", [0, 1])
def test_a_voltage_is_found_again_from_its_open_rate(rig, valve):
    p = rig.parameters(changes={"effects.valve_offset.voltage_1": 0.2, "effects.valve_offset.voltage_2": -0.3})
    for voltage in (0.7, 3.9, 4.3, 5.5, 6.2, 8.8):
        alpha = flow.open_rate(valve, voltage, p)
        assert flow.voltage_for(valve, alpha, p) == pytest.approx(voltage, abs=1e-9)


def test_a_flow_is_found_again_from_its_pressure_rate(p):
    for passed in (-5e-5, 0.0, 3e-5):
        rate = flow.pressure_rate(4e5, 3.6e-5, 1e-6, passed, p)
        assert flow.flow_for(rate, 4e5, 3.6e-5, 1e-6, p) == pytest.approx(passed, abs=1e-15)


# ---------------------------------------------------------------- Equations (2), (3), (6), (7)


def test_muscle_1_shortens_where_the_angle_grows(p):
    """Muscle 1 pulls towards positive angles: it is the shorter one there."""
    assert muscle.length(0, math.sin(0.3), p) < T["L_0"] < muscle.length(1, math.sin(0.3), p)


def test_volume_stays_positive_where_the_parabola_does_not(p):
    """Sigma points may fall far outside the joint's range; a negative volume would turn the flow round."""
    assert paper.volume(T, 0.30) < 0.0
    assert muscle.volume(0, 0.30, p)[0] > 0.0


@pytest.mark.parametrize("i", [1, 2])
def test_force_slope_with_length(p, i):
    """F is linear in l: the slope is a difference quotient over any distance."""
    for pressure in (150e3, 450e3, 700e3):
        quotient = (paper.force(T, i, 0.170, pressure) - paper.force(T, i, 0.160, pressure)) / 0.010
        assert muscle.force_length_slope(i - 1, 0.165, pressure, p) == pytest.approx(quotient, rel=1e-10)


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
        below, above = (flow.valve_flow(0, alpha, pressure, TANK, p)[0] for pressure in (-20e3, 1e3))
        assert below == above > 0.0


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
