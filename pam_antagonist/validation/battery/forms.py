"""The forms of the battery: what each does to a joint, of which effect it is a form, and how large a size of one is.

A *size* of 1 moves one channel of a typical recording by about its sensor's noise (root mean square over a minute; half
of it where the effect is brief, as those of valves and creep);
``test/validation/battery/test_plants.py`` holds them to that. Signs, times and widths are drawn at random.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.validation.battery.physics import ELEMENTS

Floats = NDArray[np.float64]
Random = np.random.Generator
Change = Callable[[Floats, Floats], Floats]
"""Of times, and of what goes on at them."""


@dataclass(frozen=True)
class Deviation:
    """What a form changes on the joint and around it.

    Attributes:
        numbers: of ``physics.Q``.
        parameters: factors on parameters of the model, by dotted path.
        voltage: from times (K,) [s] and voltages (K, 2) [V] to those that the valves act on.
        pressure: from times (N,) [s] and pressures (N, 2) [Pa] to those that the sensors are given.
        angle: from angles (N,) [rad] to those that the encoder is given.
        push: from times (N,) [s] to a torque from outside (N,) [N m].
        supply: from times (N,) [s] to a deviation of the supply (N,) [Pa].
    """

    numbers: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    voltage: Change | None = None
    pressure: Change | None = None
    angle: Callable[[Floats], Floats] | None = None
    push: Callable[[Floats], Floats] | None = None
    supply: Callable[[Floats], Floats] | None = None


Make = Callable[[float, "int | None", Random], Deviation]


@dataclass(frozen=True)
class Form:
    """One way to write an effect, or something that is in no catalogue.

    Attributes:
        name: of the form.
        effect: name in the catalogue; for what is in none, the form's own.
        by_muscle: whether it belongs to one muscle.
        make: from size (multiples of the noise), muscle (1, 2 or None) and a source of randomness.
        largest: size up to which it makes sense.
    """

    name: str
    effect: str
    by_muscle: bool
    make: Make
    largest: float = 30.0


def _sides(muscle: int | None) -> tuple[int, ...]:
    return (1, 2) if muscle is None else (muscle,)


def _named(name: str, value: float, muscle: int | None) -> dict[str, float]:
    return {f"{name}_{i}": value for i in _sides(muscle)}


def _sign(rng: Random) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _plain(name: str, unit: float, **others: tuple[float, float]) -> Make:
    """A number of the physics in proportion to the size; other numbers drawn between two bounds."""

    def make(size: float, muscle: int | None, rng: Random) -> Deviation:
        drawn = {key: float(rng.uniform(*bounds)) for key, bounds in others.items()}
        own = {name: size * unit} if muscle is None else {f"{name}_{muscle}": size * unit}
        return Deviation({**own, **drawn})

    return make


def _dahl(size: float, muscle: int | None, rng: Random) -> Deviation:
    shape = {"dahl_width": rng.uniform(1e-3, 3e-3), "dahl_power": float(rng.choice([1.0, 2.0]))}
    return Deviation({**_named("dahl", size * 0.15, muscle), **shape})


def _slip(size: float, muscle: int | None, rng: Random) -> Deviation:
    return Deviation({**_named("slip", size * 0.15, muscle), "slip_width": rng.uniform(0.5e-3, 2e-3)})


def _spool(size: float, muscle: int | None, rng: Random) -> Deviation:
    # A spool of second order is late by 2 ζ/ω.
    return Deviation(_named("spool", 1.4 / (size * 10.0e-3), muscle))


def _delay(size: float, muscle: int | None, rng: Random) -> Deviation:
    def late(time: Floats, voltage: Floats) -> Floats:
        out = voltage.copy()
        steps = round(size * 10.0e-3 / float(time[1] - time[0]))
        for i in _sides(muscle):
            out[steps:, i - 1] = voltage[: len(voltage) - steps, i - 1]
            out[:steps, i - 1] = voltage[0, i - 1]
        return out

    return Deviation(voltage=late)


def _slew(size: float, muscle: int | None, rng: Random) -> Deviation:
    def slewed(time: Floats, voltage: Floats) -> Floats:
        # The amplifier's slew, in volts: how quickly the valve opens then depends on where its curve is steep.
        out = voltage.copy()
        most = 140.0 / size * float(time[1] - time[0])
        for i in _sides(muscle):
            held = float(voltage[0, i - 1])
            for k, wanted in enumerate(voltage[:, i - 1].tolist()):
                held = min(max(wanted, held - most), held + most)
                out[k, i - 1] = held
        return out

    return Deviation(voltage=slewed)


def _added(muscle: int | None, change: Change) -> Change:
    """What adds a change of its own to the columns of a muscle, or of both; of the time and of one column."""

    def changed(time: Floats, columns: Floats) -> Floats:
        out = columns.copy()
        for i in _sides(muscle):
            out[:, i - 1] += change(time, columns[:, i - 1])
        return out

    return changed


def _shift_and_gain(size: float, muscle: int | None, rng: Random) -> Deviation:
    # An amplifier both off and too steep or too flat; with less gain it would be the catalogue's shifted curve.
    shift, gain = _sign(rng) * size * 4e-3, _sign(rng) * rng.uniform(0.15, 0.3) * size * 4e-3
    return Deviation(voltage=_added(muscle, lambda time, voltage: shift + gain * (voltage - 6.0)))


def _drifting_zero(size: float, muscle: int | None, rng: Random) -> Deviation:
    # A driver that warms up.
    shift, drift = _sign(rng) * size * 4e-3, _sign(rng) * rng.uniform(0.3, 0.6)
    return Deviation(voltage=_added(muscle, lambda time, voltage: shift * (1.0 + drift * (time / 60.0 - 0.5))))


def _line(turbulent: bool) -> Make:
    def make(size: float, muscle: int | None, rng: Random) -> Deviation:
        # A muscle draws some 0.05 g/s: all laminar, or most of it turbulent.
        unit, turn = (1.0e7, 3e-5) if turbulent else (2.0e7, 1e3)
        return Deviation(
            {**_named("line", size * unit, muscle), "line_turbulent": turn, "line_volume": rng.uniform(4e-7, 6e-7)}
        )

    return make


def _sensor(cubic: bool) -> Make:
    def make(size: float, muscle: int | None, rng: Random) -> Deviation:
        offset, drift = _sign(rng) * size * 500.0, rng.uniform(-0.3, 0.3)
        bend = rng.uniform(0.3, 0.6)

        def wrong(time: Floats, pressure: Floats) -> Floats:
            middle = (pressure - 450e3) / 250e3
            return offset * (1.0 + (bend * (middle + middle**3) if cubic else drift * (time / 60.0 - 0.5)))

        return Deviation(pressure=_added(muscle, wrong))

    return make


def _pendulum(size: float, muscle: int | None, rng: Random) -> Deviation:
    weight, gear = size * 4e-3, rng.uniform(2.5, 4.0)
    # Hanging or standing behind a gear, its rest far from 0, and its inertia on the shaft.
    rest = _sign(rng) * rng.uniform(0.3, 1.2)
    return Deviation(
        {"pendulum": _sign(rng) * weight, "pendulum_gear": gear, "pendulum_angle": rest},
        {"joint.inertia": 1.0 + 0.2 * weight * gear},
    )


def _spring(size: float, muscle: int | None, rng: Random) -> Deviation:
    stiff = size * 0.02
    return Deviation({"spring": stiff, "spring_angle": _sign(rng) * rng.uniform(0.0, 0.2), "spring_hardening": 5.0})


def _creep(times: tuple[float, ...], weights: tuple[float, ...], unit: float) -> Make:
    def make(size: float, muscle: int | None, rng: Random) -> Deviation:
        stretch = rng.uniform(0.7, 1.4)
        branches = {}
        for k in range(ELEMENTS):
            branches[f"creep_time_{k}"] = stretch * times[k] if k < len(times) else 1.0
            branches[f"creep_weight_{k}"] = weights[k] if k < len(weights) else 0.0
        return Deviation({**_named("creep", size * unit, muscle), **branches})

    return make


def _warm(name: str, unit: float, low: float, high: float) -> Make:
    def make(size: float, muscle: int | None, rng: Random) -> Deviation:
        return Deviation({**_named(name, size * unit, muscle), f"{name}_time": rng.uniform(low, high)})

    return make


def _tank(size: float, muscle: int | None, rng: Random) -> Deviation:
    # 1/V, and an orifice that holds the working flow at a drop of a few kPa for a size of one.
    return Deviation({"tank": rng.uniform(800.0, 3000.0), "feed": 6.7e-7 / math.sqrt(size)})


def _pushes(smooth: bool) -> Make:
    def make(size: float, muscle: int | None, rng: Random) -> Deviation:
        count = int(rng.integers(4, 9))
        begin = np.sort(rng.uniform(2.0, 56.0, count))
        length = rng.uniform(0.5, 3.0, count)
        height = size * 0.012 * rng.choice([-1.0, 1.0], count) * rng.uniform(0.6, 1.4, count)

        def push(time: Floats) -> Floats:
            total = np.zeros(len(time))
            for at, lasting, torque in zip(begin, length, height, strict=True):
                phase = (time - at) / lasting
                inside = (phase >= 0.0) & (phase < 1.0)
                total += torque * inside * (np.sin(np.pi * phase) if smooth else 1.0)
            return total

        return Deviation(push=push)

    return make


def _bristle(size: float, muscle: int | None, rng: Random) -> Deviation:
    return Deviation({"bristle": size * 4e-3, "bristle_angle": rng.uniform(1e-3, 3e-3)})


def _signed(name: str, unit: float) -> Make:
    def make(size: float, muscle: int | None, rng: Random) -> Deviation:
        key = name if muscle is None else f"{name}_{muscle}"
        return Deviation({key: _sign(rng) * size * unit})

    return make


def _play(size: float, muscle: int | None, rng: Random) -> Deviation:
    half = size * 6e-4

    def played(angle: Floats) -> Floats:
        out, held = np.empty(len(angle)), float(angle[0])
        for k, value in enumerate(angle):
            held = min(max(held, value - half), value + half)
            out[k] = held
        return out

    return Deviation(angle=played)


def _rub(size: float, muscle: int | None, rng: Random) -> Deviation:
    return Deviation({"rub": size * 4.5e-3, "rub_velocity": rng.uniform(0.05, 0.3)})


def _ripple(size: float, muscle: int | None, rng: Random) -> Deviation:
    frequency, phase = rng.uniform(0.15, 0.5), rng.uniform(0.0, 2.0 * np.pi)
    return Deviation(supply=lambda time: size * 2e3 * np.sin(2.0 * np.pi * frequency * time + phase))


def _cogging(size: float, muscle: int | None, rng: Random) -> Deviation:
    return Deviation({"cogging": size * 8e-3, "cogging_number": float(rng.integers(30, 60))})


SINGLE: tuple[Form, ...] = (
    Form("dahl", "hysteresis", False, _dahl),
    Form("maxwell slip", "hysteresis", False, _slip),
    Form("seeping", "leak", True, _plain("seep", 2.6e-13)),
    Form("capillary", "leak", True, _plain("capillary", 4.3e-19)),
    Form("regulator", "supply_droop", False, _plain("regulator", 900.0)),
    Form("orifice-fed tank", "supply_droop", False, _tank),
    Form("dead time", "valve_lag", True, _delay, 10.0),
    Form("second-order spool", "valve_lag", True, _spool, 10.0),
    Form("limited slew", "valve_lag", True, _slew, 15.0),
    Form("shift and gain", "valve_offset", True, _shift_and_gain),
    Form("drifting zero", "valve_offset", True, _drifting_zero),
    Form("turbulent line", "line_resistance", True, _line(True)),
    Form("line with volume", "line_resistance", True, _line(False)),
    Form("drifting offset", "pressure_sensor", True, _sensor(False)),
    Form("cubic error", "pressure_sensor", True, _sensor(True)),
    Form("geared pendulum", "load_torque", False, _pendulum),
    Form("hardening spring", "load_torque", False, _spring),
    Form("bristles", "friction", False, _bristle),
    Form("hess and soom", "friction", False, _rub, 15.0),
    Form("two-time creep", "creep", False, _creep((1.5, 9.0), (0.5, 0.5), 1.5e-2), 15.0),
    Form("logarithmic creep", "creep", False, _creep((0.8, 2.4, 7.2, 21.6), (0.25,) * 4, 1.5e-2), 15.0),
    Form("energy balance", "thermal", False, _warm("gas", 1e-2, 0.6, 2.0)),
    Form("gas and wall", "thermal", False, _warm("wall", 1e-2, 0.6, 2.0)),
    Form("pushes", "external_torque", False, _pushes(False)),
    Form("smooth pushes", "external_torque", False, _pushes(True)),
)
"""Other forms of the catalogue's effects."""

FOREIGN: tuple[Form, ...] = (
    Form("chambers exchange air", "exchange", False, _plain("exchange", 6.0e-13)),
    Form("play of the encoder", "play", False, _play),
    Form("cogging", "cogging", False, _cogging),
    Form("volume swells with pressure", "swell", True, _plain("swell", 1e-2)),
    Form("valves disturb each other", "crosstalk", False, _signed("crosstalk", 3e-3)),
    Form("supply ripples", "ripple", False, _ripple),
    Form("force bends with pressure", "bend", True, _signed("bend", 0.25)),
)
"""What is in no catalogue."""
