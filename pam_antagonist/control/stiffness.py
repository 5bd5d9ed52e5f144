"""The two pressures at which a joint has a torque and a stiffness: equations (2) and (6) to (9) solved for them.

At a given angle, τ and −∂τ/∂ψ are linear in P_1 and P_2 with the paper's force map (6). So a wanted torque and
stiffness give two linear equations. The pressures also have to stay within a box: the declared bounds, and for each
muscle the pressure that gives its least force (:class:`Box`). Within the box, all pressures of one torque lie on a line
from the softest to the stiffest joint. A stiffness that is out of reach is replaced by that of the nearer end, a torque
that is out of reach by that of the nearest corner. The torque has priority over the stiffness.

The solution uses the functions of the model. Force maps that are not linear in the pressure need more iterations.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.errors import BadInput
from pam_antagonist.model import dynamics
from pam_antagonist.model.dynamics import PRESSURE_1, PRESSURE_2
from pam_antagonist.model.parameters import ATMOSPHERE, INDEX, SUPPLY

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_forces, _torque, _torque_slope = dynamics.forces, dynamics.torque, dynamics.torque_slope

_LOWEST, _HIGHEST = INDEX["effects.regulator_limits.lowest"], INDEX["effects.regulator_limits.highest"]
_FORCE_1, _FORCE_2, _TORQUE = 0, 1, 2
_MOST_STEPS = 40
_TORQUE_TOLERANCE, _FORCE_TOLERANCE, _STIFFNESS_TOLERANCE = 1e-6, 1e-4, 1e-5
"""[N m], [N], [N m/rad] Tolerances of the solution, far below the resolution of sensors."""
_PRESSURE_STEP = 1e3
"""[Pa] Step of the difference quotients, which only force maps need that are not linear in the pressure."""


_LOWEST_SHARE = (200.0 - 101.3) / (710.0 - 101.3)
"""[-] Least pressure as a share of the supply's gauge pressure: 200 of 710 kPa absolute in the paper's experiments. A
muscle empties slowly below it."""
SUPPLY_MARGIN = 20e3
"""[Pa] Margin below the supply's pressure, at which air still flows in at a fifth of the choked flow."""
LEAST_FORCE = 2.0
"""[N] With this force a muscle is not slack, even if the force map has an error."""


class Box(NamedTuple):
    """Bounds of the wanted pressures [Pa], and of the contraction forces of both muscles [N]."""

    lowest: float
    highest: float
    least_force: float

    @classmethod
    def of(
        cls, p: np.ndarray, lowest: float | None = None, margin: float = SUPPLY_MARGIN, force: float = LEAST_FORCE
    ) -> Box:
        """The box of a rig, by its parameter vector (parameters.SIZE,).

        `lowest`: pressure [Pa]; None: about a sixth of the supply's gauge pressure. `margin`: below the supply's
        pressure, so that air still flows [Pa]. `force`: least contraction force of either muscle [N].
        """
        highest = float(p[SUPPLY]) - margin
        # Regulators hold any pressure of their range, so no margin is needed there.
        if p[_HIGHEST] > 0.0:
            highest = min(highest, float(p[_HIGHEST]))
        if lowest is None:
            lowest = float(round(p[ATMOSPHERE] + _LOWEST_SHARE * (p[SUPPLY] - p[ATMOSPHERE])))
        lowest = max(lowest, float(p[_LOWEST]))
        if not p[ATMOSPHERE] <= lowest < highest <= p[SUPPLY]:
            raise BadInput(
                f"lowest_pressure {lowest:g} Pa, supply_margin {margin:g} Pa: expected pressures from "
                f"{p[ATMOSPHERE]:g} Pa (the atmosphere's) to {p[SUPPLY]:g} Pa (the supply's), lowest_pressure below "
                "the supply's less supply_margin"
            )
        return cls(float(lowest), highest, float(force))


@inlined
def _quantity(kind, x, p):
    if kind == _TORQUE:
        return _torque(x, p)
    force_1, force_2 = _forces(x, p)
    return force_1 if kind == _FORCE_1 else force_2


@in_place
def _solve(i, kind, wanted, low, high, x, p):
    """Set pressure i of x to a wanted force or torque; to the nearer end if the solution is not between the ends."""
    at = PRESSURE_1 + i
    tolerance = _TORQUE_TOLERANCE if kind == _TORQUE else _FORCE_TOLERANCE
    x[at] = low
    off_low = _quantity(kind, x, p) - wanted
    x[at] = high
    off_high = _quantity(kind, x, p) - wanted
    if off_low * off_high > 0.0:
        x[at] = low if abs(off_low) < abs(off_high) else high
        return
    for step in range(_MOST_STEPS):
        # False position is exact for a linear map. Every third step is a bisection, for strongly curved maps.
        share = 0.5 if step % 3 == 2 else off_low / (off_low - off_high) if off_low != off_high else 0.0
        x[at] = low + share * (high - low)
        off = _quantity(kind, x, p) - wanted
        if abs(off) <= tolerance:
            return
        if off * off_low > 0.0:
            low, off_low = x[at], off
        else:
            high, off_high = x[at], off


@in_place
def _least_pressure(i, box, x, p):
    """Lowest pressure [Pa] of muscle i in the box."""
    x[PRESSURE_1], x[PRESSURE_2] = box.lowest, box.lowest
    if _quantity(i, x, p) < box.least_force:
        _solve(i, i, box.least_force, box.lowest, box.highest, x, p)
    return x[PRESSURE_1 + i]


@in_place
def _end(stiff, torque, low_1, low_2, high, x, p):
    """Set the pressures of x to the softest or stiffest joint with a torque. Returns the stiffness."""
    if stiff:
        x[PRESSURE_1], x[PRESSURE_2] = high, high
        lower_first = _torque(x, p) > torque
        i, low = (0, low_1) if lower_first else (1, low_2)
    else:
        x[PRESSURE_1], x[PRESSURE_2] = low_1, low_2
        raise_second = _torque(x, p) > torque
        i, low = (1, low_2) if raise_second else (0, low_1)
    _solve(i, _TORQUE, torque, low, high, x, p)
    return -_torque_slope(x, p)


@in_place
def _refine(torque, stiffness, low_1, low_2, high, x, p):
    """Newton steps on both equations; no step is needed if the force map is linear in the pressure."""
    for _ in range(_MOST_STEPS):
        off_torque, off_stiffness = _torque(x, p) - torque, -_torque_slope(x, p) - stiffness
        if abs(off_torque) <= _TORQUE_TOLERANCE and abs(off_stiffness) <= _STIFFNESS_TOLERANCE:
            return
        x[PRESSURE_1] += _PRESSURE_STEP
        a, c = _torque(x, p) - torque - off_torque, -_torque_slope(x, p) - stiffness - off_stiffness
        x[PRESSURE_1] -= _PRESSURE_STEP
        x[PRESSURE_2] += _PRESSURE_STEP
        b, d = _torque(x, p) - torque - off_torque, -_torque_slope(x, p) - stiffness - off_stiffness
        x[PRESSURE_2] -= _PRESSURE_STEP
        determinant = a * d - b * c
        if determinant == 0.0:
            return
        first = (d * off_torque - b * off_stiffness) / determinant * _PRESSURE_STEP
        second = (a * off_stiffness - c * off_torque) / determinant * _PRESSURE_STEP
        x[PRESSURE_1] = min(max(x[PRESSURE_1] - first, low_1), high)
        x[PRESSURE_2] = min(max(x[PRESSURE_2] - second, low_2), high)


@in_place
def set_pressures(torque, stiffness, box, x, p):
    """Set the pressures of a state so that its muscles have a torque and, as far as possible, a stiffness.

    Wanted are τ at the state's angle [N m] and −∂τ/∂ψ [N m/rad], NaN: the middle of the possible range. The pressures
    of the state x (n,) are set, within a :class:`Box`. Returns least and largest stiffness possible with the torque [N
    m/rad], and wanted minus reached torque [N m].
    """
    low_1, low_2 = _least_pressure(0, box, x, p), _least_pressure(1, box, x, p)
    high = box.highest
    softest = _end(False, torque, low_1, low_2, high, x, p)
    soft_1, soft_2 = x[PRESSURE_1], x[PRESSURE_2]
    stiffest = _end(True, torque, low_1, low_2, high, x, p)
    missing = torque - _torque(x, p)
    wanted = 0.5 * (softest + stiffest)
    if not math.isnan(stiffness):
        wanted = min(max(stiffness, softest), stiffest)
    if stiffest - softest > _STIFFNESS_TOLERANCE:
        share = (wanted - softest) / (stiffest - softest)
        x[PRESSURE_1] = soft_1 + share * (x[PRESSURE_1] - soft_1)
        x[PRESSURE_2] = soft_2 + share * (x[PRESSURE_2] - soft_2)
        _refine(torque, wanted, low_1, low_2, high, x, p)
    return softest, stiffest, missing
