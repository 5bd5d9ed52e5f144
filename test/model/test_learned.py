"""Learned laws against a second version of them in plain Python, integrated by scipy; limits, passivity, bits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import transcription as paper
from scipy.integrate import solve_ivp
from states import random_states

from pam_antagonist.model import drive, dynamics, equilibrium
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, places
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, value_path, with_law

T = paper.CORRECTED
SIGNALS = {"next_pressure": 0.0, "room": 293.0}
FADE = 2e3
DROP = (-2e5, -5e4, 5e4, 2e5)


def cases() -> dict[str, Law]:
    laws = [
        Law("flow", DROP, (1e-5, 0.0, 2e-5, -3e-5), 2, "pressure_difference"),
        Law("flow", (2e5, 5e5), (-1e-5, 2e-5), "both", "pressure", "lag", time=0.2),
        Law("flow", (-1e-4, 1e-4), (-1e-5, 1e-5), 1, "valve_flow"),
        Law("leak", (2e5, 5e5), (-1e-9, 4e-9), 1, "other_pressure"),
        Law("valve", (2e5, 5e5), (0.03, -0.03), "both", "pressure"),
        Law("valve", (0.2, 0.8), (0.03, -0.03), 1, "open_rate", "high_pass", time=0.1),
        Law("force", (0.15, 0.16, 0.18), (2.0, -2.0, 3.0), "both", "length"),
        Law("strength", (-0.01, 0.01), (-0.05, 0.05), "both", "length_rate"),
        Law("strength", (0.0, 0.4), (0.0, 0.1), 2, "time"),
        Law("strength", (-1.0, 1.0), (0.0, 0.1), "both", "room"),
        Law("torque", (-0.4, 0.4), (-0.1, 0.1), argument="angle"),
        Law("torque", (-1.0, 1.0), (0.05, -0.05), argument="velocity"),
        Law("torque", (0.0,), (0.04,)),
        Law("damping", (3e5, 9e5), (-9.0, 0.1), argument="pressure_sum"),
        Law("friction", (0.0, 0.5, 1.0), (0.05, 0.02, -9.0), argument="speed"),
        Law("friction", (3e5, 9e5), (0.0, 0.1), argument="pressure_sum", operator="lag", time=0.1),
        Law("exchange", DROP, (1e-5, 0.0, 0.0, 1e-5), argument="pressure_difference"),
        Law("supply", (0.0, 2e-4), (0.0, -0.2), argument="draw", operator="lag", time=0.3),
        Law("supply", (4e5, 9e5), (0.1, -0.1), argument="pressure_sum"),
        Law("passage", (0.15, 0.16, 0.18), (0.3, -0.2, -9.0), "both", "length"),
        Law("volume", (0.15, 0.16, 0.18), (0.1, -0.1, 0.2), 2, "length"),
        Law("volume", (2e5, 5e5), (0.0, 0.1), "both", "pressure"),
        Law("passage", (-2e-4, 2e-4), (0.3, -0.4), 1, "valve_flow"),
        Law("command", (4.0, 6.0), (0.2, -0.3), 2, "voltage"),
        Law("command", (-1.0, 1.0), (-0.4, 0.5), "both", "voltage", "high_pass", time=0.2),
    ]
    return {f"{law.at}-{law.argument}-{law.operator}": law for law in laws}


CASES = cases()


@pytest.fixture(scope="module")
def signalled(rig: Rig) -> Rig:
    return rig.replaced(signals=SIGNALS)


def vector(rig: Rig, *laws: Law, joint: str = "free") -> np.ndarray:
    for law in laws:
        rig = with_law(rig, law)
    return rig.parameters(joint, changes={"joint.stop": math.inf})


def theta(law: Law, argument: float) -> float:
    """The table, written by itself."""
    if argument <= law.nodes[0]:
        return law.values[0]
    for k in range(1, len(law.nodes)):
        if argument <= law.nodes[k]:
            share = (argument - law.nodes[k - 1]) / (law.nodes[k] - law.nodes[k - 1])
            return law.values[k - 1] + share * (law.values[k] - law.values[k - 1])
    return law.values[-1]


def inclination(law: Law, argument: float) -> float:
    """Slope of the table."""
    inside = [k for k in range(1, len(law.nodes)) if law.nodes[k - 1] <= argument < law.nodes[k]]
    return sum((law.values[k] - law.values[k - 1]) / (law.nodes[k] - law.nodes[k - 1]) for k in inside)


def second_version(law: Law, x: list[float], u: tuple[float, float], time: float, signals: Any) -> list[float]:
    """Rates of [ψ, ψ̇, P_1, P_2] and of the law's memories, from the paper's equations and this law alone."""
    psi, psi_dot, p_1, p_2, *memories = x
    pressure = {1: p_1, 2: p_2}
    open_rate = {i: paper.kappa(T, u[i - 1]) for i in (1, 2)}
    length = {i: paper.length(T, i, psi) for i in (1, 2)}
    speed = {i: paper.length_rate(T, i, psi, psi_dot) for i in (1, 2)}
    area = {True: T["A_11"], False: T["A_12"]}

    def valve(i: int, alpha: float, supply: float) -> float:
        flow = alpha * paper.nozzle_either_way(T, supply, pressure[i])
        flow -= (1 - alpha) * paper.nozzle_either_way(T, pressure[i], T["P_out"])
        return area[flow > 0] * flow

    def draw() -> float:
        parts = (open_rate[i] * paper.nozzle_either_way(T, T["P_tank"] * (1 + on(0)), pressure[i]) for i in (1, 2))
        return T["A_11"] * sum(parts)

    known: dict[str, Callable[[int], float]] = {
        "none": lambda i: 0.0,
        "pressure": lambda i: pressure[i],
        "other_pressure": lambda i: pressure[3 - i],
        "pressure_difference": lambda i: p_1 - p_2,
        "pressure_sum": lambda i: p_1 + p_2,
        "length": lambda i: length[i],
        "length_rate": lambda i: speed[i],
        "angle": lambda i: psi,
        "velocity": lambda i: psi_dot,
        "speed": lambda i: abs(psi_dot),
        "open_rate": lambda i: open_rate[i],
        "valve_flow": lambda i: valve(i, open_rate[i], T["P_tank"]),
        "time": lambda i: time,
        "voltage": lambda i: u[i - 1],
        "draw": lambda i: draw(),
        **{name: lambda i, k=k: signals[k] for k, name in enumerate(SIGNALS)},
    }
    muscles = {1: (1,), 2: (2,), "both": (1, 2), None: (0,)}[law.muscle]
    held = dict(zip(muscles, memories, strict=False))

    def on(i: int) -> float:
        if i not in muscles:
            return 0.0
        if law.operator == "lag":
            return theta(law, held[i])
        argument = known[law.argument](i)
        return theta(law, argument - held[i] if law.operator == "high_pass" else argument)

    def fade(flow: float, left: float) -> float:
        return flow * min(max(left / FADE, 0.0), 1.0)

    def place(name: str, i: int = 0) -> float:
        return on(i) if law.place == name else 0.0

    def along(force: float, rate: float) -> float:
        wrong = law.argument in ("length_rate", "velocity") and force * rate < 0.0
        return 0.0 if wrong else force

    supply = T["P_tank"] * (1 + place("supply"))
    p_dot = []
    for i in (1, 2):
        asked = paper.kappa(T, u[i - 1] + place("command", i))
        alpha = min(max(asked + place("valve", i), 0.0), 1.0)
        flow = valve(i, alpha, supply) * (1.0 + max(place("passage", i), -1.0))
        extra = place("flow", i)
        flow += fade(extra, T["P_tank"] - pressure[i] if extra > 0 else pressure[i] - T["P_out"])
        flow -= max(place("leak", i), 0.0) * paper.nozzle_either_way(T, pressure[i], T["P_out"])
        passed = place("exchange")
        passed = fade(passed, p_1 - p_2 if passed > 0 else p_2 - p_1)
        flow += -passed if i == 1 else passed
        v = paper.volume(T, length[i])
        v_dot = paper.volume_rate(T, length[i], speed[i])
        # dV'/dt = (1 + φ) dV/dt + V φ', with φ' by length or by the pressure itself.
        grown = 1.0 + place("volume", i)
        swells = law.place == "volume" and law.muscle in (i, "both")
        slope = inclination(law, known[law.argument](i)) if swells else 0.0
        by_length, by_pressure = (slope * (law.argument == name) for name in ("length", "pressure"))
        swell = grown * v_dot + v * by_length * speed[i]
        rate = T["k_1"] * T["R"] * T["T"] * flow - T["k_2"] * swell * pressure[i]
        p_dot.append(rate / (v * grown + T["k_2"] * v * by_pressure * pressure[i]))
    forces = {}
    for i in (1, 2):
        static, passive = (paper.force(T, i, length[i], value) for value in (pressure[i], T["P_out"]))
        forces[i] = (
            static + along(place("force", i), speed[i]) + along(place("strength", i), speed[i]) * (static - passive)
        )
    tau = T["r"] * math.cos(psi) * (forces[1] - forces[2]) - along(-place("torque"), psi_dot)
    tau -= max(place("damping"), -T["c_s"]) * psi_dot
    coulomb = paper.shaft_friction(T, forces[1], forces[2]) + paper.muscle_friction(T, p_1, p_2)
    t_f, _ = paper.friction(T, psi_dot, tau - T["k_s"] * psi, max(coulomb + place("friction"), 0.0))
    rates = [(known[law.argument](i) - held[i]) / law.time for i in held] if law.operator != "none" else []
    return [psi_dot, (tau - t_f - T["k_s"] * psi) / T["J"], *p_dot, *rates]


def span(law: Law) -> float:
    return law.nodes[-1] - law.nodes[0]


@pytest.mark.parametrize("case", CASES)
def test_rates(signalled: Rig, case: str) -> None:
    law, signals = CASES[case], (0.2, -0.3)
    p = vector(signalled, law)
    p[par.SIGNAL : par.SIGNAL + 2] = signals
    base = vector(signalled)
    differs = 0
    for x, u in random_states(40, seed=5):
        start = equilibrium.initial_state(x[0] + 0.02, x[2] * 0.98, x[3] * 1.02, np.array(u), p)
        state = np.concatenate([x, start[4:]])
        clock = 0.1
        if law.argument == "time":
            state[4] = clock / span(law)
        dx, plain = np.empty(len(state)), np.empty(4)
        dynamics.derivative(state, np.array(u), p, dx)
        dynamics.derivative(np.array(x), np.array(u), base, plain)
        memories = [] if law.operator == "none" else list(state[4:] * span(law))
        wanted = second_version(law, [*x, *memories], u, clock, signals)
        assert dx[:4] == pytest.approx(wanted[:4], rel=1e-7, abs=1e-7)
        assert dx[4:] * span(law) == pytest.approx([1.0] if law.argument == "time" else wanted[4:], rel=1e-7, abs=1e-9)
        differs += bool(np.any(dx[:4] != plain))
    assert differs > 5


@pytest.mark.parametrize(
    "case", [case for case, law in CASES.items() if law.operator != "none" or law.place in ("exchange", "volume")]
)
def test_trajectory(signalled: Rig, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of a second against scipy: steps of 0.25 ms leave two thousandths of the way at most."""
    monkeypatch.setitem(T, "T_stp", 0.25e-3)
    law, u = CASES[case], np.array([5.6, 5.2])
    p = vector(signalled, law)
    x = equilibrium.initial_state(0.02, 380e3, 330e3, u, p)
    states, _ = drive.course(x, np.tile(u, (1001, 1)), p, 0.25e-3, 1)
    memories = [] if law.operator == "none" else list(x[4:] * span(law))
    solution = solve_ivp(
        lambda t, y: second_version(law, y.tolist(), (u[0], u[1]), t, (0.0, 0.0)),
        (0.0, 0.25), [*x[:4], *memories], method="LSODA", rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    way = np.ptp(states[:, :4], axis=0)
    assert np.all(np.abs(states[-1, :4] - solution.y[:4, -1]) <= 2e-3 * way + 1e-6)
    if memories:
        assert states[-1, 4:] * span(law) == pytest.approx(solution.y[4:, -1], rel=1e-3)


def test_play_and_stop_are_the_operators_of_their_names(rig: Rig) -> None:
    """Turned to and fro, z stays within a ± width/2 and does not move within the play; stop is what is left."""
    width, u = 0.1, np.array([5.0, 5.0])
    for operator in ("play", "stop"):
        p = vector(rig, Law("torque", (-0.2, 0.2), (-0.01, 0.01), argument="angle", operator=operator, width=width))
        angle = np.concatenate([np.linspace(0.0, 0.3, 300), np.linspace(0.3, 0.1, 300)])
        x = equilibrium.initial_state(0.0, 400e3, 400e3, u, p)
        dx = np.empty(5)
        z = 0.0
        for now in angle:
            for _ in range(5):
                x[0] = now
                dynamics.derivative(x, u, p, dx)
                x[4] += 1e-3 * 0.4 * dx[4]
            z = min(max(z, now - width / 2), now + width / 2)
            assert x[4] * 0.4 == pytest.approx(z, abs=1e-3)
        x[0] = 0.0
        loaded, without = np.empty(5), np.empty(4)
        x[1] = 3.0  # a joint that slides
        dynamics.derivative(x, u, p, loaded)
        dynamics.derivative(x[:4].copy(), u, vector(rig), without)
        wanted = 0.05 * (z if operator == "play" else -z)
        assert (loaded[1] - without[1]) * T["J"] == pytest.approx(wanted, rel=0.02)


def test_no_law_drives_the_joint_or_pumps_air(rig: Rig) -> None:
    """Laws with the wrong sign: negative friction, a damping that pushes, a leak and flows against pressures."""
    states = random_states(200, seed=8)
    wrong = {
        "friction": Law("friction", (0.0, 1.0), (-50.0, -90.0), argument="speed"),
        "torque": Law("torque", (-1.0, 1.0), (-5.0, 5.0), argument="velocity"),
        "strength": Law("strength", (-0.01, 0.01), (5.0, -5.0), "both", "length_rate"),
    }
    base = vector(rig)
    for name, law in wrong.items():
        p = vector(rig, law)
        for x, u in states:
            dx, plain = np.empty(4), np.empty(4)
            dynamics.derivative(np.array(x), np.array(u), p, dx)
            dynamics.derivative(np.array(x), np.array(u), base, plain)
            if name != "friction":
                assert np.array_equal(dx, plain)
        fast = dynamics.sliding_friction(np.array([0.0, 2.0, 400e3, 400e3]), 1.0, p)
        assert fast >= T["c_s"] * 2.0
    u = np.array([5.0, 5.0])
    shut = {"valve_1.inflow_area": 1e-13, "valve_1.outflow_area": 1e-13, "valve_2.inflow_area": 1e-13}
    shut |= {"valve_2.outflow_area": 1e-13, "joint.stop": math.inf}
    for law, low, high in (
        (Law("leak", (1e5, 2e5), (-1e-6, -1e-6), 1, "pressure"), 200e3, 200e3),
        (Law("flow", (1e5, 2e5), (-1e-4, -1e-4), "both", "pressure"), 101.3e3, 200e3),
        (Law("flow", (1e5, 2e5), (1e-3, 1e-3), "both", "pressure"), 200e3, 710e3),
        (Law("exchange", (0.0,), (1e-4,)), 180e3, 220e3),
    ):
        p = with_law(rig, law).parameters("locked", changes=shut)
        states, _ = drive.course(np.array([0.0, 0.0, 200e3, 200e3]), np.tile(u, (4001, 1)), p, 1e-3, 1)
        assert states[:, 2:].min() >= low - 50.0 and states[:, 2:].max() <= high + 50.0


@pytest.mark.parametrize("case", CASES)
def test_side_by_side_it_has_the_same_bits(signalled: Rig, case: str) -> None:
    """Values, nodes and the operator's number differ between the lanes."""
    law = CASES[case]
    voltage = np.random.default_rng(3).uniform(4.5, 6.5, (60, 2))
    others = [replace(law, values=tuple((1.0 + 0.3 * k) * value for value in law.values)) for k in range(3)]
    others += [replace(law, nodes=tuple(1.1 * node for node in law.nodes), time=1.2 * law.time)]
    vectors = [vector(signalled, each) for each in (law, *others)]
    starts = [equilibrium.initial_state(0.05, 430e3, 470e3, voltage[0], p) for p in vectors]
    along = drive.Inputs.even(len(voltage), 1e-3, command=voltage)
    together = along.driven_each([x[None] for x in starts], vectors, drive.TORQUE)
    for x, p, (states, shown) in zip(starts, vectors, together, strict=True):
        for one, other in zip(drive.course(x, voltage, p, 1e-3, 1), (states, shown[0]), strict=True):
            assert np.array_equal(one, other)


def test_a_value_moves_by_its_path(rig: Rig) -> None:
    law = CASES["torque-angle-none"]
    moved = par.changed(vector(rig, law), {value_path(1, 2): 0.3})
    assert np.array_equal(moved, vector(rig, replace(law, values=(law.values[0], 0.3))))


def test_a_law_whose_values_are_0_is_not_there(rig: Rig) -> None:
    p = par.changed(vector(rig, CASES["torque-angle-none"]), {value_path(1, 1): 0.0, value_path(1, 2): 0.0})
    assert p[par.PLAIN] == 1.0 and p[par.LAWS_PRESENT] == 0.0


def test_a_sensor_s_reading_and_its_inverse(rig: Rig) -> None:
    law = Law("sensor", (200e3, 300e3, 500e3), (1e3, -2e3, 5e3), "both", "pressure")
    p = vector(rig, law)
    for pressure in np.linspace(100e3, 700e3, 200):
        reading = dynamics.reading(0, pressure, p)
        assert reading == pytest.approx(pressure + theta(law, reading), rel=1e-12)
        assert dynamics.pressure_behind(1, reading, p) == pytest.approx(pressure, rel=1e-12)


@pytest.mark.parametrize("name", [name for name, place in places.TABLE.items() if place.hooks])
def test_a_rig_can_hold_every_law_that_is_looked_for_at_a_place(signalled: Rig, name: str) -> None:
    """The row of a place is all that the search, the rig file and the equations know of it: they have to agree."""
    place = places.TABLE[name]
    muscles = place.sides or (None,)
    laws = [
        Law(name, (0.0,) if argument == "none" else (-1.0, 1.0), (1e-3,) if argument == "none" else (0.0, 1e-3),
            muscle if muscle in (None, "both") else int(muscle), argument)
        for muscle in muscles for argument in place.arguments
    ]  # fmt: skip
    assert all(hook in CATALOGUE["learned"].hooks for hook in place.hooks)
    for law in laws:
        assert law.is_of_readings or law.complaint() == "", law
    assert all(argument in place.arguments or argument == "draw" for argument in place.with_memory)
