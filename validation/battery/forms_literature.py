"""Effects from the literature and from users' reports that nobody has declared, to try ``close_loop`` on.

They were written by another hand than the search, which has not seen them. Where each sits, and what it depends on,
stands in ``places``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from validation.battery.form import (
    EITHER_WAY,
    Change,
    Deviation,
    Floats,
    Form,
    Random,
    each,
    named,
    plain,
    played,
    remembered,
)

_CODE = 10.0 / 4096
"""Step of the converter [V]."""
_RELIABLE = 8
"""The highest bit that may stick: those above it never change in the range of the voltages."""

# What is read.


def _meter_loop(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A torque meter's spring body: loops of several widths, the narrow ones the strongest."""
    widths = np.array([0.05, 0.2, 0.6]) * rng.uniform(0.7, 1.4)
    # A loop lags by half its width at most.
    share = amount * 0.01 / (0.5 * float(widths.sum()))

    def looped(torque: Floats) -> Floats:
        return np.asarray(torque + share * sum(played(torque, 0.5 * float(width)) - torque for width in widths))

    return Deviation(torque=looped)


def _narrow_line(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A sensor's chamber behind an orifice: it fills in proportion to the root of what is missing."""
    quickest = 4e5 / amount

    def late(time: Floats, pressure: Floats) -> Floats:
        most = quickest * float(time[1] - time[0])

        def follow(held: float, p: float) -> float:
            step = most * math.sqrt(abs(p - held) / 1e4)
            return p if step >= abs(p - held) else held + math.copysign(step, p - held)

        return remembered(pressure, follow)

    return Deviation(pressure=each(muscle, late))


# How the command reaches the valve.


def _stuck_bit(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A bit of the converter that is always set, or never."""
    bit = min(max(round(math.log2(amount * 4e-3 / _CODE)), 0), _RELIABLE)
    weight, stands = 2**bit, bool(rng.random() < 0.5)

    def stuck(time: Floats, voltage: Floats) -> Floats:
        code = np.rint(voltage / _CODE).astype(np.int64)
        return np.asarray((code | weight if stands else code & ~weight) * _CODE)

    return Deviation(voltage=each(muscle, stuck))


def _jitter(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A bus that other messages load: each command is late by a time of its own, and none overtakes another."""
    seed, late = int(rng.integers(2**31)), amount * 12e-3

    def jittered(time: Floats, voltage: Floats) -> Floats:
        period, own = float(time[1] - time[0]), np.random.default_rng(seed)
        knots = np.arange(0.0, float(time[-1]) + 1.0, 0.5)
        delay = np.interp(time, knots, late * own.uniform(0.0, 2.0, len(knots)))
        at = np.maximum.accumulate(np.arange(len(time)) - np.rint(delay / period).astype(np.int64))
        return np.asarray(voltage[np.maximum(at, 0)])

    return Deviation(voltage=each(muscle, jittered))


def _valve_creep(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A piezo bender creeps with the logarithm of the time: what is missing comes in shares a factor of three apart."""
    share, times = amount * 5e-3, np.array([0.5, 1.5, 4.5]) * rng.uniform(0.7, 1.4)

    def crept(time: Floats, voltage: Floats) -> Floats:
        # It takes a third of a second to import, which --help need not.
        from scipy.signal import lfilter

        out, period = voltage.copy(), float(time[1] - time[0])
        for slow in times:
            quick = period / float(slow)
            held, _ = lfilter([quick], [1.0, quick - 1.0], voltage, zi=[(1.0 - quick) * voltage[0]])
            out += share * (held - voltage)
        return np.asarray(out)

    return Deviation(voltage=each(muscle, crept))


def _uneven_slew(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """An amplifier that follows quickly one way, and slowly the other."""
    slow, up = 60.0 / amount, bool(rng.random() < 0.5)
    faster = rng.uniform(4.0, 10.0)

    def slewed(time: Floats, voltage: Floats) -> Floats:
        period = float(time[1] - time[0])
        rise, fall = (slow * period * (1.0 if up is rising else faster) for rising in (True, False))
        return remembered(voltage, lambda held, wanted: min(max(wanted, held - fall), held + rise))

    return Deviation(voltage=each(muscle, slewed))


def _crossover(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """An output stage of two halves: around the voltage at which they take turns, it stands still."""
    middle, half = rng.uniform(5.4, 6.4), amount * 5e-3

    def crossed(time: Floats, voltage: Floats) -> Floats:
        beyond = voltage - middle
        return np.asarray(middle + np.sign(beyond) * np.maximum(np.abs(beyond) - half, 0.0))

    change: Change = each(muscle, crossed)
    return Deviation(voltage=change)


# What depends on more than one number.


def _play_in_pressure(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A bladder that lifts the mesh only after it has moved: force follows a pressure with play."""
    width = rng.uniform(10e3, 40e3)
    return Deviation({named("hold", muscle): amount * 0.22 * 250e3 / width, "hold_width": width})


def _loose(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A muscle whose end hangs through as soon as it is shorter than the distance of its ends."""
    return Deviation({named("loose", muscle): amount * 50.0, "loose_from": rng.uniform(-1e-3, 1e-3)})


def _lifting(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """A fitting that lifts off above a pressure, and seats again only at a lower one."""
    numbers = {"lift_at": rng.uniform(470e3, 540e3), "lift_band": rng.uniform(60e3, 140e3)}
    return Deviation({named("lift", muscle): amount * 4e-13, **numbers})


_FRICTION = (
    Form("rope on its pulley", "rope", True, plain("rope", 2.5e-3), "Euler and Eytelwein; Kaneko et al. (1991)"),
    Form("bearing that sticks near an angle", "stick", False,
         plain("stick", 1e-2, stick_at=(-0.08, 0.08), stick_width=(0.02, 0.05)), "Popovic and Goldenberg (1998)"),
    Form("bush under load", "press", False, plain("press", 3e-2, press_from=(80.0, 120.0)),
         "Palmgren (1959); Wojewoda et al. (2008)"),
    Form("seal's lip that leans", "lean", False, plain("lean", 6e-3, lean_way=EITHER_WAY),
         "Armstrong-Hélouvry (1991), friction by direction"),
    Form("contact that ages at rest", "dwell", False, plain("dwell", 1e-2, dwell_time=(0.5, 3.0)),
         "Rabinowicz (1958); Gitis and Volpe (1992)"),
)  # fmt: skip
_MEMORY = (
    Form("loop in the pressure", "pressure_loop", True, plain("loop", 0.2, loop_width=(20e3, 60e3)),
         "Minh et al. (2010); Schindele and Aschemann (2012)"),
    Form("play in the pressure", "pressure_play", True, _play_in_pressure, "Kuhnen (2003); Lin et al. (2015)"),
    Form("relaxation after steps", "relaxation", True,
         plain("relax", 0.5, relax_time=(1.0, 5.0), relax_back=(0.3, 3.0)), "Minh et al. (2012), creep of a muscle"),
    Form("loop of the torque meter", "meter_loop", False, _meter_loop, "VDI/VDE 2646 (2006)"),
)  # fmt: skip
_ONE_WAY = (
    Form("check valve in the line", "ball", True, plain("ball", 3e-2, ball_pressure=(80e3, 200e3)), "Beater (2007)",
         30.0),
    Form("throttle outwards", "meter_out", True, plain("meter", 3e-2), "Beater (2007), meter-out control", 150.0),
    Form("silencer that clogs", "silencer", True, plain("silencer", 5e-2), "users' report; ISO 20145 (2019)",
         500.0),
    Form("quick exhaust", "quick_exhaust", True, plain("quick", 5e-2, quick_from=(0.1, 0.3)), "Beater (2007)",
         150.0),
    Form("sensor behind a narrow line", "narrow_line", True, _narrow_line, "Whitmore and Leondes (1991)", 60.0),
)  # fmt: skip
_COMMAND = (
    Form("bit that sticks", "stuck_bit", True, _stuck_bit, "users' report; Kester (2005)"),
    Form("delay that jitters", "jitter", True, _jitter, "Nilsson (1998)", 40.0),
    Form("creep of the piezo valve", "valve_creep", True, _valve_creep, "Jung and Gweon (2000)"),
    Form("slew other one way", "uneven_slew", True, _uneven_slew, "Horowitz and Hill (2015)", 80.0),
    Form("crossover of the amplifier", "crossover", True, _crossover, "Horowitz and Hill (2015)"),
)  # fmt: skip
_GEOMETRY = (
    Form("arm that is not round", "arm", False, plain("arm", 8e-3, True, arm_number=(8.0, 16.0)),
         "Schmit and Okada (2012), non-circular spool"),
    Form("muscle that hangs loose", "loose", True, _loose, "users' report; Tondu (2012)"),
    Form("bulging ends", "bulge", True, plain("bulge", 4.0, bulge_from=(-1e-3, 1e-3)), "Tondu (2012)"),
    Form("rubber that its use heats", "heat", True, plain("hot", 1e-2, hot_time=(10.0, 30.0)),
         "Treloar (1975); users' report"),
    Form("tendon that gives", "give", True, plain("give", 8e-7), "Palli et al. (2012)"),
)  # fmt: skip
_AIR = (
    Form("one line for both valves", "shared_line", True, plain("share", 3.5e3), "Beater (2007); users' report", 30.0),
    Form("fitting that lifts and reseats", "lift", True, _lifting, "API 520; van Zyl and Clayton (2007)"),
    Form("exponent by rate", "exponent", False, plain("exponent", 2e-2, exponent_time=(2.0, 6.0)),
         "Al-Ibrahim and Otis (1992)", 20.0),
    Form("seat that leaks inwards", "seat", True, plain("seat", 4e-13), "Merritt (1967), ch. 5"),
)  # fmt: skip
KINDS: Mapping[str, tuple[Form, ...]] = {
    "friction": _FRICTION, "memory": _MEMORY, "one-way flow": _ONE_WAY, "command path": _COMMAND,
    "geometry and force": _GEOMETRY, "supply and air": _AIR,
}  # fmt: skip
"""The forms by kind."""
KIND: Mapping[str, str] = {form.name: kind for kind, forms in KINDS.items() for form in forms}
"""Kind of each form, by its name."""
FORMS: tuple[Form, ...] = tuple(form for forms in KINDS.values() for form in forms)
"""All of them."""
