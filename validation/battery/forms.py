"""The forms of the battery: which effects they write in another way, and which are in no catalogue.

An *amount* of 1 moves one channel of a typical recording by about its sensor's noise (root mean square over a minute).
Signs, times and widths are drawn at random. A form whose effect the catalogue does not have counts as in no catalogue.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pam_antagonist.model.effects import CATALOGUE
from validation.battery import forms_literature, forms_uncatalogued
from validation.battery.form import (
    Deviation,
    Floats,
    Form,
    Make,
    Random,
    each,
    named,
    plain,
    played,
    remembered,
    sides,
    sign,
)
from validation.battery.physics import ELEMENTS

# Muscles and joint: hysteresis, creep, friction, loads, pushes.


def _slip(pressure: float = 0.0, fade: float = 0.0) -> Make:
    width, velocity = (0.5e-3, 2e-3), (2e-3, 6e-3)
    return plain("slip", 0.15, slip_width=width, slip_velocity=velocity, slip_pressure=pressure, slip_fade=fade)


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
        return Deviation({named("creep", muscle): amount * unit, **branches})

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


def _fading_rub(power: float, least: float, most: float) -> Make:
    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        shape = {"rub_velocity": rng.uniform(0.1, 0.2), "rub_fall": rng.uniform(least, most), "rub_power": power}
        return Deviation({"rub": amount * 4.5e-3, **shape}, {"joint.viscous_friction": rng.uniform(1.0, 8.0)})

    return make


def _play(amount: float, muscle: int | None, rng: Random) -> Deviation:
    return Deviation(angle=lambda angle: played(angle, amount * 6e-4))


def _cogging(amount: float, muscle: int | None, rng: Random) -> Deviation:
    return Deviation({"cogging": amount * 8e-3, "cogging_number": float(rng.integers(30, 60))})


# Valves, lines and pressure sensors.


def _delay(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A dead time (Richer and Hurmuzlu 2000)."""

    def late(time: Floats, voltage: Floats) -> Floats:
        out = voltage.copy()
        steps = round(amount * 10.0e-3 / float(time[1] - time[0]))
        for i in sides(muscle):
            out[steps:, i - 1] = voltage[: len(voltage) - steps, i - 1]
            out[:steps, i - 1] = voltage[0, i - 1]
        return out

    return Deviation(voltage=late)


def _spool(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A spool of second order, late by 2 ζ/ω (Sorli, Figliolini and Pastorelli 2004)."""
    return Deviation({named("spool", muscle): 1.4 / (amount * 10.0e-3)})


def _slew(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """An amplifier's slew, in volts: how quickly the valve opens then depends on where its curve is steep."""

    def slewed(time: Floats, voltage: Floats) -> Floats:
        most = 140.0 / amount * float(time[1] - time[0])
        return remembered(voltage, lambda held, wanted: min(max(wanted, held - most), held + most))

    return Deviation(voltage=each(muscle, slewed))


def _one_way_lag(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A coil that pulls quickly and a spring that returns slowly (Taghizadeh, Ghaffari and Najafi 2009)."""
    time_constant, opens = amount * 20.0e-3, bool(rng.random() < 0.5)

    def lagged(time: Floats, voltage: Floats) -> Floats:
        share = 1.0 - math.exp(-float(time[1] - time[0]) / time_constant)
        return remembered(voltage, lambda held, u: held + share * (u - held) if (u > held) is opens else u)

    return Deviation(voltage=each(muscle, lagged))


def _shift_and_gain(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """An amplifier both off and too steep or too flat; with less gain it would be the catalogue's shifted curve."""
    shift, gain = sign(rng) * amount * 4e-3, sign(rng) * rng.uniform(0.15, 0.3) * amount * 4e-3
    return Deviation(voltage=each(muscle, lambda time, voltage: voltage + shift + gain * (voltage - 6.0)))


def _drifting_zero(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A driver that warms up."""
    shift, drift = sign(rng) * amount * 4e-3, sign(rng) * rng.uniform(0.3, 0.6)
    return Deviation(voltage=each(muscle, lambda time, u: u + shift * (1.0 + drift * (time / 60.0 - 0.5))))


def _warm_coil(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A coil that its current warms: copper resists more, and the same voltage opens less."""
    slow, loss = rng.uniform(8.0, 20.0), amount * 8e-3

    def warmed(time: Floats, voltage: Floats) -> Floats:
        share = float(time[1] - time[0]) / slow
        heat = (voltage / 6.0) ** 2
        # It takes a third of a second to import, which --help need not.
        from scipy.signal import lfilter

        warmth, _ = lfilter([share], [1.0, share - 1.0], heat, zi=[(1.0 - share) * 0.7])
        return np.asarray(voltage - loss * warmth * voltage / 6.0)

    return Deviation(voltage=each(muscle, warmed))


def _bent_curve(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A worn metering edge: the curve is shifted in its lower part only."""
    shift, edge = sign(rng) * amount * 7e-3, rng.uniform(5.2, 6.2)
    return Deviation(voltage=each(muscle, lambda time, u: u + shift / (1.0 + np.exp((u - edge) / 0.25))))


def _line(unit: float, turn: float, volumes: tuple[float, float], critical: float = 0.0, longer: bool = False) -> Make:
    """A line that resists and holds air; the longer, the more of both (Richer and Hurmuzlu 2000).

    A muscle draws some 0.05 g/s: far below the turn all laminar, above it most of it turbulent.
    """

    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        resistance, volume = amount * unit, (amount if longer else 1.0) * rng.uniform(*volumes)
        numbers = {"line_turbulent": turn, "line_volume": volume, "line_critical": critical}
        # The volume fills the quicker the less the line resists.
        substeps = math.ceil(max(4.0, 60.0 / (resistance * volume)))
        return Deviation({named("line", muscle): resistance, **numbers}, substeps=substeps)

    return make


def _sensor(cubic: bool) -> Make:
    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        offset, drift = sign(rng) * amount * 500.0, rng.uniform(-0.3, 0.3)
        bend = rng.uniform(0.3, 0.6)

        def wrong(time: Floats, pressure: Floats) -> Floats:
            middle = (pressure - 450e3) / 250e3
            error = bend * (middle + middle**3) if cubic else drift * (time / 60.0 - 0.5)
            return pressure + offset * (1.0 + error)

        return Deviation(pressure=each(muscle, wrong))

    return make


def _membrane(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A membrane with hysteresis (Prandtl and Ishlinskii, after Kuhnen 2003), clamped too tightly."""
    offset, loop = sign(rng) * amount * 300.0, amount * rng.uniform(300.0, 500.0)

    def wrong(time: Floats, pressure: Floats) -> Floats:
        lags = sum((played(pressure, width) - pressure) / width for width in (20e3, 60e3, 120e3))
        return np.asarray(pressure + offset + loop * lags / 3.0)

    return Deviation(pressure=each(muscle, wrong))


def _backlash(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """Play between coil and spool (Tao and Kokotovic 1996)."""
    return Deviation(voltage=each(muscle, lambda time, voltage: played(voltage, amount * 5e-3)))


def _spool_stiction(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A spool that sticks, then jumps to where the voltage is (Choudhury, Thornhill and Shah 2005)."""
    band = amount * 8e-3
    return Deviation(
        voltage=each(
            muscle, lambda time, voltage: remembered(voltage, lambda held, u: u if abs(u - held) > band else held)
        )
    )


# Air: leaks, the supply, warmth.


def _tank(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """1/V, and an orifice that holds the working flow at a drop of a few kPa for an amount of one."""
    return Deviation({"tank": rng.uniform(800.0, 3000.0), "feed": 6.7e-7 / math.sqrt(amount)})


def _compressor(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A compressor with a pressure switch: the supply saws between two pressures (Beater 2007)."""
    band = amount * 4e3
    return Deviation({"compressor": band / rng.uniform(3.0, 6.0), "switch": band})


def _ripple(amount: float, muscle: int | None, rng: Random) -> Deviation:
    frequency, phase = rng.uniform(0.15, 0.5), rng.uniform(0.0, 2.0 * np.pi)

    def rippled(time: Floats) -> Floats:
        return np.asarray(amount * 2e3 * np.sin(2.0 * np.pi * frequency * time + phase))

    return Deviation(supply=rippled)


_FRACTIONAL = (0.38, 0.28, 0.2, 0.14)
"""Branches a factor of ten apart that follow a power of the time, about t^−0.15."""
_HOSE = (4e-7, 6e-7)
"""Volume of a line [m³]."""
_ALL: tuple[Form, ...] = (
    Form("dahl", "hysteresis", False, plain("dahl", 0.15, dahl_width=(1e-3, 3e-3), dahl_power=[1.0, 2.0]),
         "Dahl (1968)"),
    Form("maxwell slip", "hysteresis", False, _slip(), "Vo-Minh et al. (2011)"),
    Form("braid under pressure", "hysteresis", False, _slip(pressure=0.9), "Davis and Caldwell (2006)"),
    Form("generalised maxwell slip", "hysteresis", False, _slip(fade=0.3), "Al-Bender, Lampaert and Swevers (2005)"),
    Form("geared pendulum", "load_torque", False, _pendulum, "rigid body under gravity"),
    Form("hardening spring", "load_torque", False, _spring, "Duffing (1918)"),
    Form("bumpers", "load_torque", False, plain("bumper", 0.6, bumper_gap=(0.02, 0.08)), "Hunt and Crossley (1975)"),
    Form("bristles", "friction", False, plain("bristle", 4e-3, bristle_angle=(1e-3, 3e-3), bristle_fall=0.4),
         "LuGre: Canudas de Wit et al. (1995)"),
    Form("dahl at the joint", "friction", False, plain("bristle", 4e-3, bristle_angle=(1e-3, 3e-3), bristle_fall=0.0),
         "Dahl (1976)"),
    Form("hess and soom", "friction", False, plain("rub", 4.5e-3, rub_velocity=(0.05, 0.3)),
         "Hess and Soom (1990)", 15.0),
    Form("stribeck", "friction", False, _fading_rub(2.0, 0.4, 1.2), "Stribeck; Armstrong-Hélouvry et al. (1994)"),
    Form("fading friction", "friction", False, _fading_rub(1.0, 0.4, 1.0), "Tondu and Lopez (2000), viscous as well"),
    Form("friction of a gear", "gear_friction", False,
         plain("rub", 4.5e-3, rub_wave=(0.2, 0.35), rub_number=(8.0, 15.0), rub_velocity=(0.05, 0.15), rub_fall=0.9),
         "Armstrong-Hélouvry et al. (1994)", 15.0),
    Form("two-time creep", "creep", False, _creep((1.5, 9.0), (0.5, 0.5), 1.5e-2), "generalised Maxwell solid", 25.0),
    Form("logarithmic creep", "creep", False, _creep((0.8, 2.4, 7.2, 21.6), (0.25,) * 4, 1.5e-2),
         "Kuhnen and Krejci (2009)", 25.0),
    Form("fractional creep", "creep", False, _creep((0.2, 2.0, 20.0, 200.0), _FRACTIONAL, 2e-2),
         "Koeller (1984)", 25.0),
    Form("creep under load", "creep", False, _creep((0.3, 3.0, 30.0), (0.4, 0.3, 0.3), 2e-2, 3.0),
         "Schapery (1969)", 25.0),
    Form("pushes", "external_torque", False, _pushes("square"), "no law"),
    Form("smooth pushes", "external_torque", False, _pushes("smooth"), "no law"),
    Form("fading pushes", "external_torque", False, _pushes("fading"), "no law"),
    Form("muscles that warm up", "warm_up", True, plain("tire", 5e-3, tire_time=(15.0, 40.0)),
         "Andrikopoulos et al. (2012)"),
    Form("muscles that work warms", "warm_up", True,
         plain("tire", 5e-3, tire_time=(15.0, 40.0), tire_work=(1.0, 3.0)), "Mullins (1969)"),
    Form("play of the encoder", "play", False, _play, ""),
    Form("cogging", "cogging", False, _cogging, ""),
    Form("force bends with pressure", "bend", True, plain("bend", 0.25, True), ""),
    Form("dead time", "valve_lag", True, _delay, "Richer and Hurmuzlu (2000)", 30.0),
    Form("second-order spool", "valve_lag", True, _spool, "Sorli, Figliolini and Pastorelli (2004)", 30.0),
    Form("limited slew", "valve_lag", True, _slew, "amplifier's data sheets", 40.0),
    Form("slow one way", "valve_lag", True, _one_way_lag, "Taghizadeh, Ghaffari and Najafi (2009)", 30.0),
    Form("shift and gain", "valve_offset", True, _shift_and_gain, "amplifier's data sheets"),
    Form("drifting zero", "valve_offset", True, _drifting_zero, "amplifier's data sheets"),
    Form("warm coil", "valve_offset", True, _warm_coil, "copper's resistance; Beater (2007)"),
    Form("worn edge", "valve_offset", True, _bent_curve, "Merritt (1967), ch. 5"),
    Form("turbulent line", "line_resistance", True, _line(1.0e7, 3e-5, _HOSE),
         "Darcy and Weisbach; Beater (2007)", 30.0, 0.4),
    Form("line with volume", "line_resistance", True, _line(2.0e7, 1e3, _HOSE),
         "Richer and Hurmuzlu (2000)", 40.0, 0.2),
    Form("long tube", "line_resistance", True, _line(5e6, 3e-5, (1.25e-6, 2.25e-6), longer=True),
         "Richer and Hurmuzlu (2000)", 30.0, 0.3),
    Form("choked fitting", "line_resistance", True, _line(1.0e7, 3e-5, _HOSE, 0.95), "ISO 6358-1 (2013)", 60.0, 0.4),
    Form("drifting offset", "pressure_sensor", True, _sensor(False), "sensor's data sheets"),
    Form("cubic error", "pressure_sensor", True, _sensor(True), "sensor's data sheets"),
    Form("hysteresis of the membrane", "pressure_sensor", True, _membrane, "Kuhnen (2003)"),
    Form("play of the spool", "valve_play", True, _backlash, "Tao and Kokotovic (1996)"),
    Form("spool that sticks", "valve_play", True, _spool_stiction, "Choudhury, Thornhill and Shah (2005)"),
    Form("seeping", "leak", True, plain("seep", 2.6e-13), "Hagen and Poiseuille"),
    Form("capillary", "leak", True, plain("capillary", 4.3e-19), "compressible Hagen and Poiseuille"),
    Form("seam that opens", "leak", True, plain("seam", 4e-18, seam_pressure=(350e3, 500e3)),
         "variable area: van Zyl and Clayton (2007)"),
    Form("crack that stretches", "crack", True, plain("crack", 4e-10), "Klute and Hannaford (1998)"),
    Form("regulator", "supply_droop", False, plain("regulator", 900.0), "Beater (2007)"),
    Form("orifice-fed tank", "supply_droop", False, _tank, "ISO 6358-1 (2013)"),
    Form("line to the supply", "supply_droop", False, plain("inlet", 1500.0), "Darcy and Weisbach"),
    Form("bottle without compressor", "supply_droop", False, plain("compressor", 100.0, switch=1e9),
         "Wehner et al. (2014)"),
    Form("compressor with a switch", "compressor", False, _compressor, "Beater (2007)"),
    Form("energy balance", "thermal", False, plain("gas", 1e-2, gas_time=(0.6, 2.0)), "Carneiro and de Almeida (2006)"),
    Form("gas and wall", "thermal", False, plain("wall", 1e-2, wall_time=(0.6, 2.0)),
         "Det, Scavarda and Richard (1989)"),
    Form("forced convection", "thermal", False, plain("gas", 2e-2, gas_time=(4.0, 8.0), gas_flow=40.0),
         "Carneiro and de Almeida (2006)"),
    Form("chambers exchange air", "exchange", False, plain("exchange", 6.0e-13), ""),
    Form("volume swells with pressure", "swell", True, plain("swell", 1e-2), ""),
    Form("valves disturb each other", "crosstalk", False, plain("crosstalk", 3e-3, True), ""),
    Form("supply ripples", "ripple", False, _ripple, ""),
)  # fmt: skip
"""Forms of muscles and joint, of valves, lines and sensors, and of air."""
UNCATALOGUED = forms_uncatalogued.FORMS
"""Outside of every law, and drawn by themselves, so that they change no battery of old."""
FORMS: dict[str, Form] = {form.name: form for form in (*_ALL, *UNCATALOGUED, *forms_literature.FORMS)}
"""All forms by name, those of no battery included."""
SINGLE: tuple[Form, ...] = tuple(form for name in CATALOGUE for form in _ALL if form.effect == name)
"""Other forms of the catalogue's effects."""
FOREIGN: tuple[Form, ...] = tuple(form for form in _ALL if form.effect not in CATALOGUE)
"""What is in no catalogue."""
OTHER, VARIATION = 0.10, 0.05
"""Forms with a remainder above the first are truly other ones, those below the second variations of the catalogue's."""
REMAINDERS = {
    "bottle without compressor": 0.23, "braid under pressure": 0.019, "bristles": 0.11, "bumpers": 0.135,
    "capillary": 0.001, "choked fitting": 0.04, "creep under load": 0.024, "cubic error": 0.028, "dahl": 0.022,
    "dahl at the joint": 0.094, "dead time": 0.108, "drifting offset": 0.016, "drifting zero": 0.016,
    "energy balance": 0.034, "fading friction": 0.083, "forced convection": 0.105, "fractional creep": 0.054,
    "gas and wall": 0.052, "geared pendulum": 0.013, "generalised maxwell slip": 0.143, "hardening spring": 0.016,
    "hess and soom": 0.052, "hysteresis of the membrane": 0.355, "limited slew": 0.058, "line to the supply": 0.033,
    "line with volume": 0.014, "logarithmic creep": 0.037, "long tube": 0.052, "maxwell slip": 0.015,
    "muscles that warm up": 0.005, "muscles that work warms": 0.037, "orifice-fed tank": 0.034,
    "play of the spool": 0.003, "regulator": 0.004, "seam that opens": 0.461, "second-order spool": 0.093,
    "seeping": 0.001, "shift and gain": 0.021, "slow one way": 0.281, "spool that sticks": 0.617, "stribeck": 0.079,
    "turbulent line": 0.04, "two-time creep": 0.023, "warm coil": 0.052, "worn edge": 0.24,
    "check valve between the chambers": 0.506, "relief valve": 0.252, "kinked hose": 0.392,
    "fold of the bladder": 0.476, "flow forces on the spool": 0.164, "coil with minor loops": 0.24,
    "damping other one way": 0.213, "spring that engages": 0.392, "gauge behind a tube": 0.517,
    "multiplexer that remembers": 0.814, "eccentric code disc": 0.127,
}  # fmt: skip
"""What base parameters and the catalogue's law of that effect (of the last eleven: its best law) leave of a form.

Fitted at commit c47df4a to 30 s without noise at a size of 8: root mean square over all channels of both recordings, as
a share of what the form does to them. Forms without a law (pushes) have none.
"""


def is_other(form: Form) -> bool:
    """Whether the catalogue's law leaves more than a tenth of a form."""
    return REMAINDERS.get(form.name, 0.0) > OTHER


def group_of(forms: Sequence[str]) -> str:
    """In which group the forms of a case count: ``other``, ``near`` or ``variation``; ``no law`` without remainders."""
    shares = [REMAINDERS.get(name) for name in forms]
    known = [share for share in shares if share is not None]
    if len(known) < len(forms) or not known:
        return "no law"
    return "other" if min(known) > OTHER else "near" if min(known) >= VARIATION else "variation"
