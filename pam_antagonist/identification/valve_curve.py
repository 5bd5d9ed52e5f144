"""The valve curve κ(u) by the paper's three steps, and whether the recordings contradict the declared curve.

The steps are: open rate → steady pressure, voltage → steady pressure, the two combined. The paper draws the curve and
describes the procedure (section on model parameters, figure "A procedure for obtaining the function κ(u)"): the first
relation comes from the model, the second from a recording.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.runs import Run
from pam_antagonist.model import flow
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_STEADY_S = 1.0
"""[s] A pressure counts as steady if it and the voltage have been constant for this time."""
_DRIFT = 300.0
"""[Pa/s] A pressure that moves less is steady."""
_SAME_VOLTAGE = 0.01
"""[V] Steps of a converter that count as one voltage."""
_FEWEST = 3


@dataclass(frozen=True, eq=False)
class SteadyPoints:
    """Steady pressures of one valve."""

    voltage: Floats  # (K,) [V], increasing
    pressure: Floats  # (K,) [Pa]
    spread: Floats  # standard deviation of the pressures at the same voltage (K,) [Pa]


def steady_open_rate(pressure: Floats, p: Floats) -> Floats:
    """Step one: the open rate at which as much flows in as out, for each pressure.

    In the steady state equation (5) is α m_in = (1 − α) m_out, so that α = m_out/(m_in + m_out). It contains neither
    orifice areas nor polytropic indices (Proposition 1). The paper gets the same relation by simulating until the
    pressure is constant.

    `pressure`: (K,) [Pa], between atmosphere and supply. Returns α (K,) [-].
    """
    inflow = np.array([flow.orifice_flow(p[par.SUPPLY], value, p) for value in pressure])
    outflow = np.array([flow.orifice_flow(value, p[par.ATMOSPHERE], p) for value in pressure])
    return np.asarray(outflow / (inflow + outflow))


def steady_points(voltage: Floats, pressure: Floats, dt: float) -> SteadyPoints:
    """Step two: the steady pressures of a recording.

    `voltage`: of one valve (N,) [V]. `pressure`: of its muscle (N,) [Pa], NaN where missing.
    """
    return _steady([(voltage, pressure, dt)])


def _steady(parts: Iterable[tuple[Floats, Floats, float]]) -> SteadyPoints:
    """The steady pressures of several recordings, given as for :func:`steady_points`."""
    found: dict[int, list[float]] = {}
    for voltage, pressure, dt in parts:
        length = round(_STEADY_S / dt)
        for first in range(0, len(voltage) - length + 1, length):
            part, held = pressure[first : first + length], voltage[first : first + length]
            good = np.isfinite(part)
            if np.ptp(held) > _SAME_VOLTAGE or good.sum() < length / 2:
                continue
            slope = np.polyfit(np.arange(length)[good] * dt, part[good], 1)[0]
            if abs(slope) < _DRIFT:
                found.setdefault(round(float(held.mean()) / _SAME_VOLTAGE), []).append(float(part[good].mean()))
    keys = sorted(found)
    return SteadyPoints(
        voltage=np.round(np.array(keys) * _SAME_VOLTAGE, 2),
        pressure=np.array([np.mean(found[key]) for key in keys]),
        spread=np.array([np.std(found[key]) for key in keys]),
    )


def valve_curve(points: SteadyPoints, p: Floats) -> tuple[Floats, Floats]:
    """Step three: the open rate that gives each steady pressure.

    `p`: parameter vector (P,). Returns voltages (K,) [V] and open rates (K,) [-], not decreasing: knots of the curve,
    linear between them.
    """
    if len(points.voltage) < _FEWEST:
        raise BadInput(
            f"{len(points.voltage)} voltages were held until the pressure stood still, expected at least {_FEWEST}: "
            f"record a staircase, each step held until the pressure drifts by less than {_DRIFT / 1e3:g} kPa/s"
        )
    inside = np.clip(points.pressure, p[par.ATMOSPHERE], p[par.SUPPLY])
    return points.voltage, np.maximum.accumulate(steady_open_rate(inside, p))


_STEADY_STD = 1.5e3
"""[Pa] Distance of a steady pressure from its final value, at most: the drift over one time constant."""
_DEVIATING = 2.0
"""RMS deviation, in standard deviations, above which the declared curve is replaced."""


def identify_curves(rig: Rig, runs: Sequence[Run]) -> tuple[Rig, list[str]]:
    """κ(u) of both valves by the paper's three steps, where the recordings hold steady pressures; and what they say.

    Between the measured voltages the correction of the declared curve is linear. Beyond them the declared curve is
    kept, since nothing is known there.
    """
    notes = []
    for valve in (0, 1):
        name = f"valve_{valve + 1}"
        curve = getattr(rig, name).curve
        measured, shift, note = _correction(rig, runs, valve)
        notes.append(f"valve {valve + 1}: {note}")
        if len(measured):
            knots = _knots(np.array(curve.voltage), measured)
            rates = np.interp(knots, curve.voltage, curve.open_rate)
            rates += np.interp(knots, measured, shift, left=0.0, right=0.0)
            rates = np.maximum.accumulate(np.clip(rates, 0.0, 1.0))
            new = curve.replaced(voltage=tuple(knots.tolist()), open_rate=tuple(rates.tolist()))
            rig = rig.replaced(**{name: getattr(rig, name).replaced(curve=new)})
    return rig, notes


def _knots(declared: Floats, measured: Floats) -> Floats:
    """Knots [V] of a curve, declared and measured ones, as many as a curve may have.

    A guessed curve may have knots at its ends only.
    """
    most = par.MAX_KNOTS - len(declared)
    chosen = np.unique(np.linspace(0, len(measured) - 1, min(most, len(measured))).round().astype(int))
    return np.unique(np.concatenate([declared, measured[chosen]]).round(6))


def _correction(rig: Rig, runs: Sequence[Run], valve: int) -> tuple[Floats, Floats, str]:
    """Voltages (K,) [V] less the rig's offsets, by how much the curve is off there (K,) [-], and a note.

    Both are empty where the declared curve is kept.
    """
    p, kept = rig.parameters(), np.zeros(0)
    parts = [part for run in runs for part in run.commanded()]
    points = _steady((part.command[:, valve], part.pressure[:, valve], part.period) for part in parts)
    try:
        voltage, rates = valve_curve(points, p)
    except BadInput as reason:
        return kept, kept, f"{reason}; declared curve kept"
    # The curve is the steady open rate less the offsets that the rig declares.
    shift, lift = flow.curve_shift(valve, p)
    voltage, rates = voltage - shift, np.clip(rates - lift, 0.0, 1.0)
    curve = getattr(rig, f"valve_{valve + 1}").curve
    off = rates - np.interp(voltage, curve.voltage, curve.open_rate)
    higher, lower = (steady_open_rate(np.clip(points.pressure + step, p[par.ATMOSPHERE], p[par.SUPPLY]), p)
                     for step in (500.0, -500.0))  # fmt: skip
    std = np.maximum(np.abs(higher - lower) / 1e3 * np.hypot(_STEADY_STD, points.spread), 1e-4)
    text = f"{len(voltage)} steady pressures, largest difference from the declared curve {np.max(np.abs(off)):.3f}"
    if np.sqrt(np.mean((off / std) ** 2)) > _DEVIATING:
        return voltage, off, f"{text}: curve replaced between them"
    return kept, kept, f"{text}, within their uncertainty: curve kept"
