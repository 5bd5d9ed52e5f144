"""Whether the recordings ask for another valve curve than the rig declares, and which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.valve_curve import SteadyPoints, steady_open_rate, steady_points, valve_curve
from pam_antagonist.inference.trial import PRESSURE_1, Trial
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_STEADY_STD = 1.5e3
"""[Pa] How far a pressure that counts as steady may still be from where it ends: drift over its time constant."""
_TELLING = 2.0
"""RMS of the deviations, in standard deviations, from which on the declared curve is replaced."""


@dataclass(frozen=True, eq=False)
class CurveFinding:
    """What the steady pressures say about the curve of one valve.

    Attributes:
        valve: 0 or 1.
        voltage: knots that were measured (K,) [V], offsets of the rig taken off; empty where there were too few.
        open_rate: their open rates (K,) [-].
        declared: the declared curve there (K,) [-].
        std: standard deviations of the open rates (K,) [-].
        replaced: whether the declared curve was changed.
        note: what there is to say.
    """

    valve: int
    voltage: Floats
    open_rate: Floats
    declared: Floats
    std: Floats
    replaced: bool
    note: str


def identify_curves(rig: Rig, trials: Sequence[Trial]) -> tuple[Rig, list[CurveFinding]]:
    """κ(u) of both valves by the paper's three steps, where the recordings hold steady pressures.

    Between the measured voltages the correction of the declared curve is linear; beyond them the declared curve
    stands, for nothing is known there.

    Args:
        rig: the declared curves.
        trials: recordings.

    Returns:
        The rig with the curves that had to be replaced, and what was found.
    """
    findings = []
    for valve in (0, 1):
        finding = _one(rig, trials, valve)
        findings.append(finding)
        if finding.replaced:
            name = f"valve_{valve + 1}"
            curve = getattr(rig, name).curve
            knots = np.array(curve.voltage)
            shift = finding.open_rate - finding.declared
            inside = (knots >= finding.voltage[0]) & (knots <= finding.voltage[-1])
            rates = np.array(curve.open_rate) + np.where(inside, np.interp(knots, finding.voltage, shift), 0.0)
            new = curve.replaced(open_rate=tuple(float(r) for r in np.maximum.accumulate(np.clip(rates, 0.0, 1.0))))
            rig = rig.replaced(**{name: getattr(rig, name).replaced(curve=new)})
    return rig, findings


def _one(rig: Rig, trials: Sequence[Trial], valve: int) -> CurveFinding:
    p = rig.parameters()
    found = [
        steady_points(trial.voltage[:, valve], trial.measured[:, PRESSURE_1 + valve], trial.dt) for trial in trials
    ]
    points = _merged(found)
    none = np.zeros(0)
    try:
        voltage, rates = valve_curve(points, p)
    except BadInput as reason:
        return CurveFinding(valve, none, none, none, none, False, f"valve {valve + 1}: {reason}; declared curve kept")
    # The curve is what is left of the steady open rates when the offsets that the rig declares are taken off.
    voltage = voltage - p[par.VALVE_OFFSET + valve]
    rates = np.clip(rates - p[par.RATE_OFFSET + valve], 0.0, 1.0)
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
    if off > _TELLING:
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
