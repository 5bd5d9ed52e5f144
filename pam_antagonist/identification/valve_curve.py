"""The valve curve κ(u) by the paper's three steps, and whether the recordings contradict the declared curve.

The steps are: open rate → steady pressure, voltage → steady pressure, the two combined. The paper draws the curve and
describes the procedure (section on model parameters, figure "A procedure for obtaining the function κ(u)"): the first
relation comes from the model, the second from a recording.
"""

from __future__ import annotations

from collections.abc import Sequence
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

    Args:
        pressure: (K,) [Pa], between atmosphere and supply.
        p: parameter vector (P,).

    Returns:
        α (K,) [-].
    """
    inflow = np.array([flow.orifice_flow(p[par.SUPPLY], value, p) for value in pressure])
    outflow = np.array([flow.orifice_flow(value, p[par.ATMOSPHERE], p) for value in pressure])
    return np.asarray(outflow / (inflow + outflow))


def steady_points(voltage: Floats, pressure: Floats, dt: float) -> SteadyPoints:
    """Step two: the steady pressures of a recording.

    Args:
        voltage: of one valve (N,) [V].
        pressure: of its muscle (N,) [Pa], NaN where missing.
        dt: sample period [s].
    """
    length = round(_STEADY_S / dt)
    found: dict[int, list[float]] = {}
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
        voltage=np.array([key * _SAME_VOLTAGE for key in keys]),
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


@dataclass(frozen=True, eq=False)
class CurveFinding:
    """What the steady pressures say about the curve of one valve."""

    valve: int  # 0 or 1
    voltage: Floats  # knots that were measured (K,) [V], less the rig's offsets; empty where there were too few
    open_rate: Floats  # their open rates (K,) [-]
    declared: Floats  # the declared curve there (K,) [-]
    std: Floats  # standard deviations of the open rates (K,) [-]
    replaced: bool
    note: str


def identify_curves(rig: Rig, runs: Sequence[Run]) -> tuple[Rig, list[CurveFinding]]:
    """κ(u) of both valves by the paper's three steps, where the recordings hold steady pressures.

    Between the measured voltages the correction of the declared curve is linear. Beyond them the declared curve is
    kept, since nothing is known there.
    """
    findings = []
    for valve in (0, 1):
        finding = _curve_finding(rig, runs, valve)
        findings.append(finding)
        if finding.replaced:
            name = f"valve_{valve + 1}"
            curve = getattr(rig, name).curve
            knots = _knots(np.array(curve.voltage), finding.voltage)
            shift = finding.open_rate - finding.declared
            inside = (knots >= finding.voltage[0]) & (knots <= finding.voltage[-1])
            rates = np.interp(knots, curve.voltage, curve.open_rate)
            rates += np.where(inside, np.interp(knots, finding.voltage, shift), 0.0)
            rates = np.maximum.accumulate(np.clip(rates, 0.0, 1.0))
            new = curve.replaced(voltage=tuple(knots.tolist()), open_rate=tuple(rates.tolist()))
            rig = rig.replaced(**{name: getattr(rig, name).replaced(curve=new)})
    return rig, findings


def _knots(declared: Floats, measured: Floats) -> Floats:
    """Knots [V] of a curve, declared and measured ones, as many as a curve may have.

    A guessed curve may have knots at its ends only.
    """
    most = par.MAX_KNOTS - len(declared)
    chosen = np.unique(np.linspace(0, len(measured) - 1, min(most, len(measured))).round().astype(int))
    return np.unique(np.concatenate([declared, measured[chosen]]).round(6))


def _curve_finding(rig: Rig, runs: Sequence[Run], valve: int) -> CurveFinding:
    p = rig.parameters()
    parts = [part for run in runs for part in run.commanded()]
    found = [steady_points(part.command[:, valve], part.pressure[:, valve], part.period) for part in parts]
    points = _merged(found)
    none = np.zeros(0)
    try:
        voltage, rates = valve_curve(points, p)
    except BadInput as reason:
        return CurveFinding(valve, none, none, none, none, False, f"valve {valve + 1}: {reason}; declared curve kept")
    # The curve is the steady open rate less the offsets that the rig declares.
    shift, lift = flow.curve_shift(valve, p)
    voltage = voltage - shift
    rates = np.clip(rates - lift, 0.0, 1.0)
    curve = getattr(rig, f"valve_{valve + 1}").curve
    declared = np.interp(voltage, curve.voltage, curve.open_rate)
    slope = (
        np.abs(
            steady_open_rate(np.minimum(points.pressure + 500.0, p[par.SUPPLY]), p)
            - steady_open_rate(np.maximum(points.pressure - 500.0, p[par.ATMOSPHERE]), p)
        )
        / 1e3
    )
    std = np.maximum(slope * np.hypot(_STEADY_STD, points.spread), 1e-4)
    off = float(np.sqrt(np.mean(((rates - declared) / std) ** 2)))
    far = float(np.max(np.abs(rates - declared)))
    text = f"valve {valve + 1}: {len(voltage)} steady pressures, largest difference from the declared curve {far:.3f}"
    if off > _DEVIATING:
        return CurveFinding(valve, voltage, rates, declared, std, True, f"{text}: curve replaced between them")
    return CurveFinding(valve, voltage, rates, declared, std, False, f"{text}, within their uncertainty: curve kept")


def _merged(parts: Sequence[SteadyPoints]) -> SteadyPoints:
    voltage = np.concatenate([part.voltage for part in parts])
    pressure = np.concatenate([part.pressure for part in parts])
    spread = np.concatenate([part.spread for part in parts])
    keys = np.unique(np.round(voltage, 2))
    rows = [np.flatnonzero(np.round(voltage, 2) == key) for key in keys]
    return SteadyPoints(
        keys,
        np.array([pressure[row].mean() for row in rows]),
        np.array([np.hypot(spread[row].mean(), pressure[row].std()) for row in rows]),
    )
