"""Forms of what muscles and joint do: hysteresis, creep, friction, loads, pushes."""

from __future__ import annotations

import numpy as np

from validation.battery.form import (
    Deviation,
    Floats,
    Form,
    Make,
    Random,
    named,
    plain,
    played,
    sign,
    signed,
)
from validation.battery.physics import ELEMENTS


def _dahl(amount: float, muscle: int | None, rng: Random) -> Deviation:
    shape = {"dahl_width": rng.uniform(1e-3, 3e-3), "dahl_power": float(rng.choice([1.0, 2.0]))}
    return Deviation({**named("dahl", amount * 0.15, muscle), **shape})


def _slip(pressure: float = 0.0, fade: float = 0.0) -> Make:
    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        shape = {"slip_width": rng.uniform(0.5e-3, 2e-3), "slip_velocity": rng.uniform(2e-3, 6e-3)}
        return Deviation(
            {**named("slip", amount * 0.15, muscle), **shape, "slip_pressure": pressure, "slip_fade": fade}
        )

    return make


def _pendulum(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """Hanging or standing behind a gear, its rest far from 0, and its inertia on the shaft."""
    weight, gear = amount * 4e-3, rng.uniform(2.5, 4.0)
    rest = sign(rng) * rng.uniform(0.3, 1.2)
    return Deviation(
        {"pendulum": sign(rng) * weight, "pendulum_gear": gear, "pendulum_angle": rest},
        {"joint.inertia": 1.0 + 0.2 * weight * gear},
    )


def _spring(amount: float, muscle: int | None, rng: Random) -> Deviation:
    stiff = amount * 0.02
    return Deviation({"spring": stiff, "spring_angle": sign(rng) * rng.uniform(0.0, 0.2), "spring_hardening": 5.0})


def _creep(times: tuple[float, ...], weights: tuple[float, ...], unit: float, load: float = 0.0) -> Make:
    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        stretch = rng.uniform(0.7, 1.4)
        branches = {"creep_load": load}
        for k in range(ELEMENTS):
            branches[f"creep_time_{k}"] = stretch * times[k] if k < len(times) else 1.0
            branches[f"creep_weight_{k}"] = weights[k] if k < len(weights) else 0.0
        return Deviation({**named("creep", amount * unit, muscle), **branches})

    return make


def _pushes(shape: str) -> Make:
    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        count = int(rng.integers(4, 9))
        begin = np.sort(rng.uniform(2.0, 56.0, count))
        length = rng.uniform(0.5, 3.0, count)
        height = amount * 0.012 * rng.choice([-1.0, 1.0], count) * rng.uniform(0.6, 1.4, count)

        def push(time: Floats) -> Floats:
            total = np.zeros(len(time))
            for at, lasting, torque in zip(begin, length, height, strict=True):
                phase = (time - at) / lasting
                inside = (phase >= 0.0) & (phase < 1.0)
                course = {"smooth": np.sin(np.pi * phase), "fading": np.exp(-3.0 * np.maximum(phase, 0.0))}
                total += torque * inside * course.get(shape, 1.0)
            return total

        return Deviation(push=push)

    return make


def _bristle(fall: float) -> Make:
    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        return Deviation({"bristle": amount * 4e-3, "bristle_angle": rng.uniform(1e-3, 3e-3), "bristle_fall": fall})

    return make


def _rub(amount: float, muscle: int | None, rng: Random) -> Deviation:
    return Deviation({"rub": amount * 4.5e-3, "rub_velocity": rng.uniform(0.05, 0.3)})


def _fading_rub(power: float, least: float, most: float) -> Make:
    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        shape = {"rub_velocity": rng.uniform(0.1, 0.2), "rub_fall": rng.uniform(least, most), "rub_power": power}
        return Deviation({"rub": amount * 4.5e-3, **shape}, {"joint.viscous_friction": rng.uniform(1.0, 8.0)})

    return make


def _geared_rub(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """Friction of a gear goes round with the teeth (Armstrong-Hélouvry, Dupont and Canudas de Wit 1994)."""
    shape = {"rub_wave": rng.uniform(0.2, 0.35), "rub_number": rng.uniform(8.0, 15.0)}
    return Deviation({"rub": amount * 4.5e-3, "rub_velocity": rng.uniform(0.05, 0.15), "rub_fall": 0.9, **shape})


def _tired(by_work: bool) -> Make:
    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        times = {"tire_time": rng.uniform(15.0, 40.0)}
        work = {"tire_work": rng.uniform(1.0, 3.0)} if by_work else {}
        return Deviation({**named("tire", amount * 5e-3, muscle), **times, **work})

    return make


def _play(amount: float, muscle: int | None, rng: Random) -> Deviation:
    return Deviation(angle=lambda angle: played(angle, amount * 6e-4))


def _cogging(amount: float, muscle: int | None, rng: Random) -> Deviation:
    return Deviation({"cogging": amount * 8e-3, "cogging_number": float(rng.integers(30, 60))})


_FRACTIONAL = (0.38, 0.28, 0.2, 0.14)
"""Branches a factor of ten apart that follow a power of the time, about t^−0.15."""
FORMS: tuple[Form, ...] = (
    Form("dahl", "hysteresis", False, _dahl, "Dahl (1968)"),
    Form("maxwell slip", "hysteresis", False, _slip(), "Vo-Minh et al. (2011)"),
    Form("braid under pressure", "hysteresis", False, _slip(pressure=0.9), "Davis and Caldwell (2006)"),
    Form("generalised maxwell slip", "hysteresis", False, _slip(fade=0.3), "Al-Bender, Lampaert and Swevers (2005)"),
    Form("geared pendulum", "load_torque", False, _pendulum, "rigid body under gravity"),
    Form("hardening spring", "load_torque", False, _spring, "Duffing (1918)"),
    Form(
        "bumpers", "load_torque", False, plain("bumper", 0.6, bumper_gap=(0.02, 0.08)), "Hunt and Crossley (1975)"
    ),
    Form("bristles", "friction", False, _bristle(0.4), "LuGre: Canudas de Wit et al. (1995)"),
    Form("dahl at the joint", "friction", False, _bristle(0.0), "Dahl (1976)"),
    Form("hess and soom", "friction", False, _rub, "Hess and Soom (1990)", 15.0),
    Form("stribeck", "friction", False, _fading_rub(2.0, 0.4, 1.2), "Stribeck; Armstrong-Hélouvry et al. (1994)"),
    Form("fading friction", "friction", False, _fading_rub(1.0, 0.4, 1.0), "Tondu and Lopez (2000), viscous as well"),
    Form("friction of a gear", "gear_friction", False, _geared_rub, "Armstrong-Hélouvry et al. (1994)", 15.0),
    Form("two-time creep", "creep", False, _creep((1.5, 9.0), (0.5, 0.5), 1.5e-2), "generalised Maxwell solid", 25.0),
    Form(
        "logarithmic creep", "creep", False, _creep((0.8, 2.4, 7.2, 21.6), (0.25,) * 4, 1.5e-2),
        "Kuhnen and Krejci (2009)", 25.0,
    ),
    Form(
        "fractional creep", "creep", False, _creep((0.2, 2.0, 20.0, 200.0), _FRACTIONAL, 2e-2),
        "Koeller (1984)", 25.0,
    ),
    Form(
        "creep under load", "creep", False, _creep((0.3, 3.0, 30.0), (0.4, 0.3, 0.3), 2e-2, 3.0),
        "Schapery (1969)", 25.0,
    ),
    Form("pushes", "external_torque", False, _pushes("square"), "no law"),
    Form("smooth pushes", "external_torque", False, _pushes("smooth"), "no law"),
    Form("fading pushes", "external_torque", False, _pushes("fading"), "no law"),
    Form("muscles that warm up", "warm_up", True, _tired(by_work=False), "Andrikopoulos et al. (2012)"),
    Form("muscles that work warms", "warm_up", True, _tired(by_work=True), "Mullins (1969)"),
    Form("play of the encoder", "play", False, _play, ""),
    Form("cogging", "cogging", False, _cogging, ""),
    Form("force bends with pressure", "bend", True, signed("bend", 0.25), ""),
)  # fmt: skip
"""Forms of muscles and joint."""
