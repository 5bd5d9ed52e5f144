"""Equations (4) and (5): valve curve, orifice, mass flow, pressure rate."""

from __future__ import annotations

import itertools
import math

import pytest
import transcription as paper
from states import EDGE_PRESSURES, EDGE_VOLTAGES, random_states

from pam_antagonist.model import flow
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
def test_mass_flow(p, valve):
    cases = [*itertools.product(EDGE_VOLTAGES, EDGE_PRESSURES)]
    cases += [(u[valve], x[2 + valve]) for x, u in random_states(300, seed=4)]
    ways = set()
    for u, pressure in cases:
        expected = paper.mass_flow(T, u, pressure)
        value = flow.mass_flow(valve, flow.open_rate(valve, u, p), pressure, p)
        assert value == pytest.approx(expected, rel=1e-8, abs=1e-8 * CHOKED_SCALE * T["A_11"])
        ways.add(math.copysign(1.0, expected))
    assert ways == {1.0, -1.0}


def test_pressure_rate(p):
    for (angle, velocity, pressure, _), (u, _) in random_states(200, seed=5):
        l_1 = paper.length(T, 1, angle)
        v = paper.volume(T, l_1)
        v_dot = paper.volume_rate(T, l_1, paper.length_rate(T, 1, angle, velocity))
        rate = flow.pressure_rate(pressure, v, v_dot, paper.mass_flow(T, u, pressure), p)
        assert rate == pytest.approx(paper.pressure_rate(T, 1, angle, velocity, pressure, u), rel=1e-9)


@pytest.mark.parametrize("pressure", EDGE_PRESSURES)
def test_flow_regime(p, pressure):
    assert flow.flow_regime(pressure, p) == paper.regime(T, pressure)
