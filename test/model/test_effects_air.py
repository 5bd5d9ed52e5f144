"""What each effect of the air does in the long run and in the short: balances, steady pressures, time constants."""

from __future__ import annotations

import numpy as np
import pytest
import transcription as paper
from scipy.integrate import trapezoid
from states import ATMOSPHERE, TANK

from pam_antagonist.model import equilibrium, integration, sensor

T = paper.CORRECTED
SHUT = {f"valve_{i}.{way}_area": 0.0 for i in (1, 2) for way in ("inflow", "outflow")}
VOLUME = paper.volume(T, T["L_0"])
GAIN = T["k_1"] * T["R"] * T["T"] / VOLUME
"""[Pa/kg] Pressure of a kilogram in a muscle that is held at 0°."""
DT = 1e-3


def locked(rig, changes=None, **effects):
    return rig.replaced(effects=effects).parameters("locked", changes=changes)


def held(p, u, seconds, pressures=(450e3, 450e3), before=None, dt=DT):
    """States (N, n) of a joint held at 0°, voltages ``u`` from the first step on, ``before`` until then."""
    voltage = np.tile(np.asarray(u, dtype=np.float64), (round(seconds / dt) + 1, 1))
    start = equilibrium.initial_state(0.0, *pressures, np.array(u if before is None else before, dtype=np.float64), p)
    return integration.simulate(start, voltage, p, dt, 1)[0]


# Leak


def test_a_leak_takes_the_air_that_is_missing(rig):
    """Behind a shut valve, ∫ of the leak's flow is the mass that the pressure has lost, V (P_0 − P)/(k_1 R T)."""
    area = 2e-9
    states = held(locked(rig, SHUT, leak={"area_1": area}), (5.5, 5.5), 20.0)
    pressure = states[:, 2]
    lost = area * trapezoid([paper.nozzle(T, value, ATMOSPHERE) for value in pressure], dx=DT)
    assert pressure[0] - pressure[-1] == pytest.approx(GAIN * lost, rel=1e-6)
    assert pressure[0] - pressure[-1] > 50e3
    assert np.all(states[:, 3] == 450e3), "muscle 2 does not leak"


# Play of a valve


def to_and_fro(swing, cycles=2, period=2.0, middle=5.5):
    """Voltages (N, 2) that go up and down as triangles."""
    phase = np.arange(round(cycles * period / DT) + 1) * DT / period
    wave = 1.0 - 4.0 * np.abs((phase + 0.25) % 1.0 - 0.5)
    return np.column_stack([middle + swing * wave, np.full(len(phase), middle)])


@pytest.mark.parametrize(("play", "swing"), [(0.1, 0.5), (0.3, 0.5), (0.3, 0.2)])
def test_the_loop_between_command_and_spool_has_the_area_of_the_play_operator(rig, play, swing):
    """A swing of ±a takes the spool ±(a − b/2) and turns by b at either end: the area is b (2 a − b)."""
    p = locked(rig, valve_play={"play_1": play})
    voltage = to_and_fro(swing)
    start = equilibrium.initial_state(0.0, 450e3, 450e3, voltage[0], p)
    assert start[4:] == pytest.approx([5.5]), "in the middle of its play"
    spool = integration.simulate(start, voltage, p, DT, 4)[0][:, 4]
    cycle = slice(len(voltage) // 2, None)
    assert abs(trapezoid(spool[cycle], voltage[cycle, 0])) == pytest.approx(play * (2.0 * swing - play), rel=0.02)
    assert np.ptp(spool[cycle]) == pytest.approx(2.0 * swing - play, abs=0.004)
    assert np.abs(spool - voltage[:, 0]).max() <= 0.5 * play + 0.003


# Valve


def test_a_shifted_valve_at_rest_stands_where_its_voltage_asks(rig):
    """With a lag as well: the state of a joint that has stood for long is that of the shifted curve."""
    offsets = {"voltage_1": 0.2, "open_rate_1": 0.03, "open_rate_2": -0.05}
    p = locked(rig, valve_offset=offsets, valve_lag={"time_1": 0.1, "time_2": 0.1})
    x = equilibrium.initial_state(0.0, 450e3, 430e3, np.array([6.0, 5.0]), p)
    assert x[4:] == pytest.approx([paper.kappa(T, 5.8) + 0.03, paper.kappa(T, 5.0) - 0.05], abs=1e-12)
    assert held(p, (6.0, 5.0), 2.0)[-1, 4:] == pytest.approx(x[4:], abs=1e-6)
    at_once = held(locked(rig, valve_offset=offsets), (6.0, 5.0), 60.0)
    assert held(p, (6.0, 5.0), 60.0)[-1, 2:4] == pytest.approx(at_once[-1, 2:], abs=1.0)


# Line


@pytest.mark.parametrize("exponent", [1.0, 1.8])
def test_a_run_may_begin_while_a_muscle_fills(rig, exponent):
    """From the sensors' pressures alone, in the middle of a run, it goes on as the run did; at rest nothing is lost."""
    p = locked(rig, line_resistance={"resistance_1": 2e8, "resistance_2": 1e8, "time": 2e-3, "exponent": exponent})
    u = (7.5, 4.0)
    states = held(p, u, 3.0)
    begun = equilibrium.initial_state(0.0, states[200, 2], states[200, 3], np.array([*u, 0.0]), p)
    assert begun[4:] == pytest.approx(states[200, 4:], abs=400.0)
    assert np.abs(states[200, 4:] - states[200, 2:4]).min() > 1e3
    rested = held(p, u, 90.0)[-1]
    still = equilibrium.initial_state(0.0, rested[2], rested[3], np.array([*u, 0.0]), p)
    assert still[4:] == pytest.approx(rested[2:4], abs=10.0)


def test_a_line_starts_within_what_there_is(rig):
    p = locked(rig, line_resistance={"resistance_1": 5e9, "resistance_2": 5e9})
    begun = equilibrium.initial_state(0.0, 200e3, 700e3, np.array([10.0, 0.0, 0.0]), p)
    assert begun[4] == T["P_out"] and begun[5] == TANK


def test_a_line_holds_no_air_back(rig):
    """The chamber holds what came through the valve at the pressure that stands there, and then nothing differs."""
    p = locked(rig, line_resistance={"resistance_1": 2e8, "resistance_2": 2e8})
    states = held(p, (7.5, 4.6), 5.0)
    for muscle, u in ((1, 7.5), (2, 4.6)):
        mass = trapezoid([paper.mass_flow(T, u, value) for value in states[:, 1 + muscle]], dx=DT)
        gained = states[-1, 3 + muscle] - states[0, 3 + muscle]
        assert gained == pytest.approx(GAIN * mass, rel=2e-4)
        assert abs(gained) > 50e3
    end = held(p, (7.5, 4.6), 90.0)[-1]
    assert end[4:] == pytest.approx(end[2:4], rel=1e-5)
    assert end[2:4] == pytest.approx(held(locked(rig), (7.5, 4.6), 90.0)[-1, 2:], rel=1e-4)


# Sensor


def test_a_sensor_reads_by_offset_and_gain_and_its_inverse_undoes_it(rig):
    p = locked(rig, pressure_sensor={"offset_1": 4e3, "offset_2": -2e3, "gain_1": 0.02, "gain_2": -0.1})
    for pressure in (90e3, 450e3, 710e3):
        assert sensor.reading(0, pressure, p) == pytest.approx(1.02 * pressure + 4e3, rel=1e-15)
        assert sensor.reading(1, pressure, p) == pytest.approx(0.9 * pressure - 2e3, rel=1e-15)
        for muscle in (0, 1):
            assert sensor.pressure_behind(muscle, sensor.reading(muscle, pressure, p), p) == pytest.approx(pressure)
