"""κ(u) by the paper's three steps: open rate → steady pressure, voltage → steady pressure, the two combined.

The paper draws the curve and describes the procedure (section on model parameters, figure "A procedure for
obtaining the function κ(u)"): the first relation comes from the model, the second from a recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.model import flow
from pam_antagonist.model import parameters as par

Floats = NDArray[np.float64]

_SETTLED_S = 1.0
"""[s] A pressure counts as steady when it and the voltage have kept still for so long."""
_DRIFT = 300.0
"""[Pa/s] A pressure that moves less is steady."""
_SAME_VOLTAGE = 0.01
"""[V] Steps of a converter that count as one voltage."""
_FEWEST = 3


@dataclass(frozen=True, eq=False)
class SteadyPoints:
    """Steady pressures of one valve: voltages (K,) [V], increasing, and pressures (K,) [Pa] with spread (K,) [Pa]."""

    voltage: Floats
    pressure: Floats
    spread: Floats


def steady_open_rate(pressure: Floats, p: Floats) -> Floats:
    """Step one: the open rate at which as much flows in as out, for each pressure.

    In the steady state equation (5) is α m_in = (1 − α) m_out, in which neither the orifice areas nor the
    polytropic indices stand (Proposition 1), so that α = m_out/(m_in + m_out). It is the relation that the paper
    gets by simulating until the pressure stands.

    Args:
        pressure: (K,) [Pa], between atmosphere and supply.
        p: parameter vector.

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

    Returns:
        One point for each voltage that was held until the pressure stood still.
    """
    length = round(_SETTLED_S / dt)
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

    Args:
        points: of step two.
        p: parameter vector.

    Returns:
        Voltages (K,) [V] and open rates (K,) [-], not decreasing: knots of the curve, linear between them.

    Raises:
        BadInput: fewer than three voltages were held until the pressure stood still.
    """
    if len(points.voltage) < _FEWEST:
        raise BadInput(
            f"{len(points.voltage)} voltages were held until the pressure stood still, expected at least {_FEWEST}: "
            f"record a staircase, each step held until the pressure drifts by less than {_DRIFT / 1e3:g} kPa/s"
        )
    inside = np.clip(points.pressure, p[par.ATMOSPHERE], p[par.SUPPLY])
    return points.voltage, np.maximum.accumulate(steady_open_rate(inside, p))
