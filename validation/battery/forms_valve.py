"""Forms of what valves and pressure sensors do wrong."""

from __future__ import annotations

import math

import numpy as np

from validation.battery.form import (
    Deviation,
    Floats,
    Form,
    Make,
    Random,
    each,
    named,
    played,
    remembered,
    sides,
    sign,
)


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
    return Deviation(named("spool", 1.4 / (amount * 10.0e-3), muscle))


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


def _tube(amount: float, muscle: int | None, rng: Random) -> Deviation:
    """The longer a tube, the more it resists and the more it holds (Richer and Hurmuzlu 2000)."""
    resistance, volume = amount * 5e6, amount * rng.uniform(1.25e-6, 2.25e-6)
    numbers = {"line_turbulent": 3e-5, "line_volume": volume}
    substeps = math.ceil(max(4.0, 60.0 / (resistance * volume)))
    return Deviation({**named("line", resistance, muscle), **numbers}, substeps=substeps)


def _line(turbulent: bool, critical: float = 0.0) -> Make:
    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        # A muscle draws some 0.05 g/s: all laminar, or most of it turbulent.
        unit, turn = (1.0e7, 3e-5) if turbulent else (2.0e7, 1e3)
        volume = rng.uniform(4e-7, 6e-7)
        numbers = {"line_turbulent": turn, "line_volume": volume, "line_critical": critical}
        # The volume fills the quicker the less the line resists.
        substeps = math.ceil(max(4.0, 60.0 / (amount * unit * volume)))
        return Deviation({**named("line", amount * unit, muscle), **numbers}, substeps=substeps)

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

    def stuck(time: Floats, voltage: Floats) -> Floats:
        return remembered(voltage, lambda held, u: u if abs(u - held) > band else held)

    return Deviation(voltage=each(muscle, stuck))


_SPOOL = "Sorli, Figliolini and Pastorelli (2004)"
_BEATER = "Beater (2007)"
FORMS: tuple[Form, ...] = (
    Form("dead time", "valve_lag", True, _delay, "Richer and Hurmuzlu (2000)", 30.0),
    Form("second-order spool", "valve_lag", True, _spool, _SPOOL, 30.0),
    Form("limited slew", "valve_lag", True, _slew, "amplifier's data sheets", 40.0),
    Form("slow one way", "valve_lag", True, _one_way_lag, "Taghizadeh, Ghaffari and Najafi (2009)", 30.0),
    Form("shift and gain", "valve_offset", True, _shift_and_gain, "amplifier's data sheets"),
    Form("drifting zero", "valve_offset", True, _drifting_zero, "amplifier's data sheets"),
    Form("warm coil", "valve_offset", True, _warm_coil, f"copper's resistance; {_BEATER}"),
    Form("worn edge", "valve_offset", True, _bent_curve, "Merritt (1967), ch. 5"),
    Form("turbulent line", "line_resistance", True, _line(True), "Darcy and Weisbach; Beater (2007)", 30.0, 0.4),
    Form("line with volume", "line_resistance", True, _line(False), "Richer and Hurmuzlu (2000)", 40.0, 0.2),
    Form("long tube", "line_resistance", True, _tube, "Richer and Hurmuzlu (2000)", 30.0, 0.3),
    Form("choked fitting", "line_resistance", True, _line(True, 0.95), "ISO 6358-1 (2013)", 60.0, 0.4),
    Form("drifting offset", "pressure_sensor", True, _sensor(False), "sensor's data sheets"),
    Form("cubic error", "pressure_sensor", True, _sensor(True), "sensor's data sheets"),
    Form("hysteresis of the membrane", "pressure_sensor", True, _membrane, "Kuhnen (2003)"),
    Form("play of the spool", "valve_play", True, _backlash, "Tao and Kokotovic (1996)"),
    Form("spool that sticks", "valve_play", True, _spool_stiction, "Choudhury, Thornhill and Shah (2005)"),
)
"""Forms of valves, lines and pressure sensors."""
