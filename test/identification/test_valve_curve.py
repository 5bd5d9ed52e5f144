"""The paper's three steps to κ(u), on a staircase of the project's own plant."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist import simulate
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.runs import Run, runs_of
from pam_antagonist.identification.valve_curve import (
    SteadyPoints,
    identify_curves,
    steady_open_rate,
    steady_points,
    valve_curve,
)
from pam_antagonist.model import parameters as par
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation.plant import Plant

RIG = load_rig("shin2022")


def test_the_relation_holds_where_a_simulated_chamber_comes_to_rest() -> None:
    for rate in (0.2, 0.394, 0.8):
        voltage = float(np.interp(rate, RIG.valve_1.curve.open_rate, RIG.valve_1.curve.voltage))
        plant = Plant(RIG, joint="locked", noise=False, substeps=1)
        for _ in range(40_000):
            sample = plant.step((voltage, voltage))
        assert steady_open_rate(sample.pressure, RIG.parameters()) == pytest.approx(rate, rel=3e-4)


def test_the_relation_depends_on_neither_areas_nor_polytropic_indices() -> None:
    """Proposition 1."""
    pressures = np.linspace(105e3, 705e3, 9)
    other = RIG.parameters(
        changes={"valve_1.inflow_area": 1e-7, "gas.polytropic_flow": 1.4, "gas.polytropic_volume": 0.9}
    )
    rates = steady_open_rate(pressures, RIG.parameters())
    assert np.array_equal(rates, steady_open_rate(pressures, other))
    assert np.all(np.diff(rates) > 0.0) and 0.0 < rates[0] and rates[-1] < 1.0


@pytest.mark.slow(5)
def test_a_staircase_gives_the_plants_curve_back() -> None:
    levels = np.array([4.2, 4.6, 5.0, 5.5, 6.0, 6.6, 7.0])
    voltage = np.repeat(levels, 25_000)
    pressure = simulate(RIG, voltage[:, None] * np.ones(2), joint="locked", seed=3).pressure
    points = steady_points(voltage, pressure[:, 1], RIG.sample_period)
    assert np.allclose(points.voltage, levels)
    volts, rates = valve_curve(points, RIG.parameters())
    true = np.interp(volts, RIG.valve_2.curve.voltage, RIG.valve_2.curve.open_rate)
    assert np.abs(rates - true).max() < 0.005
    # Another supply gives other steady pressures, and a wrong curve where the model does not know of it.
    wrong = par.changed(RIG.parameters(), {"supply.pressure": 650e3})
    assert np.abs(valve_curve(points, wrong)[1] - true).max() > 0.02


def _with_curve(shift: float) -> Rig:
    """The rig whose valve 2 is open by another share in the middle of its range."""
    curve = RIG.valve_2.curve
    rates = tuple(
        rate + (shift if 4.5 < u < 6.0 else 0.0) for u, rate in zip(curve.voltage, curve.open_rate, strict=True)
    )
    return RIG.replaced(valve_2=RIG.valve_2.replaced(curve=curve.replaced(open_rate=rates)))


def _staircase(rig: Rig) -> list[Run]:
    voltage = np.repeat([4.6, 5.0, 5.5, 6.0], 30_000)[:, None] * np.ones(2)
    recording = simulate(rig, voltage, joint="locked", seed=4)
    return runs_of(recording, JointCondition("locked", 0.0, "command line"), "staircase")


def test_a_curve_that_is_declared_wrong_is_replaced_where_it_was_measured_and_nowhere_else() -> None:
    true = _with_curve(-0.02)
    found, (first, second) = identify_curves(RIG, _staircase(true))
    assert "curve kept" in first and found.valve_1 == RIG.valve_1
    assert "curve replaced" in second
    knots, declared = np.array(RIG.valve_2.curve.voltage), np.array(RIG.valve_2.curve.open_rate)
    rates, wanted = np.array(found.valve_2.curve.open_rate), np.array(true.valve_2.curve.open_rate)
    measured = (knots >= 4.6) & (knots <= 6.0)
    assert np.abs(rates - wanted)[measured].max() < 0.005 < np.abs(declared - wanted)[measured].max()
    assert np.array_equal(rates[~measured], declared[~measured])


def test_a_guessed_curve_bends_where_it_was_measured() -> None:
    straight = RIG.valve_1.curve.replaced(voltage=(0.0, 10.0), open_rate=(0.0, 1.0))
    guessed = RIG.replaced(valve_1=RIG.valve_1.replaced(curve=straight))
    found, (first, _) = identify_curves(guessed, _staircase(RIG))
    assert "curve replaced" in first
    curve, true = found.valve_1.curve, RIG.valve_1.curve
    assert (curve.voltage[0], curve.open_rate[0], curve.voltage[-1], curve.open_rate[-1]) == (0.0, 0.0, 10.0, 1.0)
    for voltage in (4.6, 4.8, 5.0, 5.25, 5.5, 6.0):
        rates = [np.interp(voltage, item.voltage, item.open_rate) for item in (curve, true)]
        assert rates[0] == pytest.approx(rates[1], abs=0.005)


def test_an_offset_that_the_rig_declares_is_not_put_into_the_curve_once_more() -> None:
    offset = RIG.replaced(effects={"valve_offset": {"voltage_1": 0.1, "open_rate_2": 0.04}})
    runs = _staircase(offset)
    assert all("curve replaced" in note for note in identify_curves(RIG, runs)[1])
    found, declared = identify_curves(offset, runs)
    assert all("curve kept" in note for note in declared)
    assert (found.valve_1, found.valve_2) == (RIG.valve_1, RIG.valve_2)


def test_a_pressure_that_still_moves_is_no_point() -> None:
    time = np.arange(4000) * 1e-3
    rising = 300e3 + 50e3 * time
    points = steady_points(np.full(4000, 5.0), rising, 1e-3)
    assert len(points.voltage) == 0
    with pytest.raises(BadInput, match="staircase"):
        valve_curve(points, RIG.parameters())


def test_noise_cannot_make_the_curve_fall() -> None:
    points = SteadyPoints(np.array([4.0, 5.0, 6.0]), np.array([300e3, 299e3, 500e3]), np.zeros(3))
    assert np.all(np.diff(valve_curve(points, RIG.parameters())[1]) >= 0.0)
