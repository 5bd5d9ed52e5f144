"""Voltages that excite a joint: built-in profiles for simulated recordings, and tables.

A profile is written as a drive between -1 and 1 for each valve: 0 is the voltage at rest, -1 and 1 the lowest and
the highest one. With the default voltages and the valve curve of rig ``shin2022`` these are steady pressures of
about 200, 450 and 700 kPa, the range of Shin, Ibayashi and Kogiso (2022), who show their own input as a picture only.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.model import flow, muscle
from pam_antagonist.numbers import number_of
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import rest_pressure

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class DriveVoltages:
    """Voltages of drive -1, 0 and 1 [V]."""

    lowest: float = 4.15  # at drive -1
    rest: float = 5.5  # at drive 0
    highest: float = 7.5  # at drive 1

    def voltage(self, drive: FloatArray) -> FloatArray:
        """Voltages [V] of a drive (N, 2), linear between the three."""
        return np.interp(drive, [-1.0, 0.0, 1.0], [self.lowest, self.rest, self.highest])


_OPEN_RATES = (0.215, 0.394, 0.80)
_HIGHEST = 0.95
"""Highest pressure of a valve that is closed in the middle, as a share of the supply's: it is never reached wholly."""
_FOLLOWS = 0.05
"""[s] Time constant with which such a pressure follows, if the valve lets enough through."""
_VOLTS = 0.05  # to which the voltages of a rig's span are rounded

# Hold time [s] and drives of valves 1 and 2: differences of both signs and growing size, then both valves together (the
# joint stiffens), then one at a time. Extremes are held longest: a muscle takes seconds to empty.
_PAPER = np.array(
    [
        (4, 0.0, 0.0), (4, 0.4, -0.4), (4, -0.4, 0.4), (4, 0.7, -0.7), (4, -0.7, 0.7), (3, 0.0, 0.0),
        (9, 1.0, -1.0), (10, -1.0, 1.0), (5, 0.0, 0.0), (5, 0.7, 0.7), (5, 1.0, 0.5), (5, 0.5, 1.0),
        (6, -0.5, -0.5), (8, -1.0, -0.4), (8, -0.4, -1.0), (5, 0.0, 0.0), (5, 1.0, 0.0), (5, 0.0, 1.0),
        (5, -0.8, 0.2), (5, 0.2, -0.8), (9, 1.0, -1.0), (9, -1.0, 1.0), (3, 0.0, 0.0),
    ]
)  # fmt: skip
PAPER_DURATION = float(_PAPER[:, 0].sum())
"""Length of the profile ``paper`` [s]: 130, as in the paper."""


def paper(time: FloatArray, seed: int) -> FloatArray:
    """Steps over the pressure range of the paper; 130 s long, then again from the start. `time`: (N,) [s]."""
    ends = np.cumsum(_PAPER[:, 0])
    return np.asarray(_PAPER[np.searchsorted(ends, time % PAPER_DURATION, side="right"), 1:])


def steps(time: FloatArray, seed: int) -> FloatArray:
    """Random levels, each held for a random 0.5 to 3 s, for both valves at the same times.

    `time`: (N,) [s]. Returns drive (N, 2); it begins with 1 s at rest.
    """
    rng = np.random.default_rng(seed)
    end = float(time[-1]) if len(time) else 0.0
    edges, levels = [0.0], [(0.0, 0.0)]
    at = 1.0
    while at <= end:
        common, difference = rng.uniform(-0.4, 0.4), rng.uniform(-0.8, 0.8)
        edges.append(at)
        levels.append((common + difference, common - difference))
        at += rng.uniform(0.5, 3.0)
    held = np.searchsorted(np.array(edges), time, side="right") - 1
    return np.clip(np.array(levels)[held], -1.0, 1.0)


def multisine(time: FloatArray, seed: int) -> FloatArray:
    """Sums of sines from 0.05 to 5 Hz with random phases: the difference of the valves at some, their sum at others.

    `time`: (N,) [s]. Returns drive (N, 2); it fades in over the first second.
    """
    rng = np.random.default_rng(seed)
    frequency = np.geomspace(0.05, 5.0, 16)
    # With falling amplitudes, the fast lines do not dominate the voltages.
    amplitude = frequency**-0.4
    wave = amplitude[:, None] * np.sin(2.0 * np.pi * frequency[:, None] * time + rng.uniform(0.0, 2.0 * np.pi, (16, 1)))
    difference, common = wave[::2].sum(axis=0), wave[1::2].sum(axis=0)
    drive = 0.7 * np.column_stack((difference + 0.5 * common, -difference + 0.5 * common)) / amplitude[::2].sum()
    return np.clip(drive * np.minimum(time, 1.0)[:, None], -1.0, 1.0)


PROFILES: dict[str, Callable[[FloatArray, int], FloatArray]] = {"paper": paper, "steps": steps, "multisine": multisine}
"""Built-in profiles by name."""


def profile(name: str, duration: float, period: float, seed: int = 0, span: DriveVoltages | None = None) -> FloatArray:
    """Voltages (N, 2) [V] of a built-in profile, one of ``PROFILES``; row k is held over sample period k [s].

    `span`: of the voltages; default: 4.15, 5.5, 7.5 V.
    """
    if name not in PROFILES:
        raise BadInput(f"profile {name!r}: expected one of {', '.join(PROFILES)}, or a CSV file")
    time = np.arange(round(duration / period)) * period
    return (span or DriveVoltages()).voltage(PROFILES[name](np.asarray(time, dtype=np.float64), seed))


def for_rig(rig: Rig, name: str, duration: float, seed: int = 0) -> FloatArray:
    """Commands of a built-in profile within the limits of a rig's valves or regulators.

    `name`: one of ``PROFILES``. Returns (N, 2) [V] of valves, or [Pa] of pressure regulators: from a sixth of their
    range to its end.
    """
    low, high = rig.command_limits
    lapped = rig.drive == "valve" and max(rig.valve_1.overlap, rig.valve_2.overlap) > 0.0
    if rig.drive == "valve" and not lapped:
        return np.clip(profile(name, duration, rig.sample_period, seed, _of_valves(rig)), low, high)
    least, most = (rig.atmosphere.pressure, rig.supply.pressure) if lapped else (low, high)
    rest, top = (rest_pressure(rig), least + _HIGHEST * (most - least)) if lapped else (0.5 * (low + high), high)
    span = DriveVoltages(least + (most - least) / 6.0, rest, top)
    wanted = profile(name, duration, rig.sample_period, seed, span)
    return np.clip(_voltages_for(wanted, rig) if lapped else wanted, low, high)


def _voltages_for(wanted: FloatArray, rig: Rig) -> FloatArray:
    """Voltages [V] with which pressures (N, 2) [Pa] come about, within what the valves let through.

    A valve that is closed in the middle keeps a pressure there. A constant voltage elsewhere would fill or empty the
    muscle to the end. The chambers have their volume at angle 0; where the joint moves, the pressures differ.
    """
    p, supply, out = rig.parameters("locked", 0.0), rig.supply.pressure, np.empty_like(wanted)
    for i in (0, 1):
        room, now = float(muscle.volume(i, rig.geometry.length, p)[0]), float(wanted[0, i]) if len(wanted) else 0.0
        for k, aim in enumerate(wanted[:, i]):
            flow_wanted = flow.flow_for((aim - now) / _FOLLOWS, now, room, 0.0, p)
            rate = flow.open_rate_for(i, flow_wanted, now, supply, p)
            out[k, i] = flow.voltage_for(i, rate, p)
            let, _ = flow.valve_flow(i, rate, now, supply, p)
            now += rig.sample_period * flow.pressure_rate(now, room, 0.0, let, p)
    return out


def _of_valves(rig: Rig) -> DriveVoltages:
    """Voltages with the open rates that :class:`DriveVoltages` has on the curve of ``shin2022``."""
    curves = rig.valve_1.curve, rig.valve_2.curve
    means = [np.mean([np.interp(rate, curve.open_rate, curve.voltage) for curve in curves]) for rate in _OPEN_RATES]
    return DriveVoltages(*(round(float(mean) / _VOLTS) * _VOLTS for mean in means))


def read_table(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read voltages from a CSV file with the header ``t_s,u1,u2``: time [s], then both voltages [V].

    Returns times (K,) [s] and voltages (K, 2) [V].
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"{path}: cannot be read as CSV: {error}") from None
    if not rows or [cell.strip() for cell in rows[0]] != ["t_s", "u1", "u2"]:
        raise BadInput(f"{path}: the first line is {','.join(rows[0]) if rows else 'missing'!r}, expected t_s,u1,u2")
    table = np.empty((len(rows) - 1, 3))
    for number, row in enumerate(rows[1:], 2):
        values = [number_of(cell) for cell in row]
        if len(row) != 3 or None in values:
            raise BadInput(f"{path}: row {number} is {','.join(row)!r}, expected three numbers")
        table[number - 2] = values
        if not all(math.isfinite(value) for value in table[number - 2]):
            raise BadInput(f"{path}: row {number} is {','.join(row)!r}, expected finite numbers")
    if len(table) < 2:
        raise BadInput(f"{path}: {len(table)} rows, expected two or more: a voltage holds until the next row")
    if np.any(np.diff(table[:, 0]) <= 0.0):
        number = int(np.argmax(np.diff(table[:, 0]) <= 0.0)) + 3
        raise BadInput(f"{path}: time t_s does not increase at row {number}")
    return table[:, 0].copy(), table[:, 1:].copy()


def held(time: FloatArray, voltage: FloatArray, duration: float, period: float) -> FloatArray:
    """Voltages (N, 2) [V] at a constant period [s] from a table, each row held until the next.

    The rows are voltages (K, 2) [V] at increasing times (K,) [s]; the duration [s] counts from the first row.
    """
    # Half a period of tolerance: a row at 0.003 s belongs to sample 3, although 3 * 0.001 is not exactly 0.003.
    at = time[0] + (np.arange(round(duration / period)) + 0.5) * period
    return np.asarray(voltage[np.searchsorted(time, at, side="right") - 1])
