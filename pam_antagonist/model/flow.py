"""Compressed air through the valve and into the chamber: equations (4) and (5)."""

from __future__ import annotations

from pam_antagonist._jit import inlined
from pam_antagonist.model import composition, orifice
from pam_antagonist.model.lane_values import shared
from pam_antagonist.model.parameters import (
    ATMOSPHERE,
    CRITICAL_RATIO,
    CURVE,
    CURVE_SIZE,
    GAS_CONSTANT,
    INFLOW_AREA,
    MAX_KNOTS,
    OUTFLOW_AREA,
    OVERLAP,
    POLYTROPIC_FLOW,
    POLYTROPIC_VOLUME,
    SUPPLY,
    TEMPERATURE,
    VALVE,
    VALVE_SIZE,
)

# numba compiles calls of plain names, not of attributes that it would have to look up again.
orifice_flow = orifice.orifice_flow
_voltage_shift, _open_rate_shift = composition.voltage_shift, composition.open_rate_shift

INFLOW_CHOKED, BOTH_CHOKED, OUTFLOW_CHOKED = 0, 1, 2
"""Flow regimes of one muscle; the third subsystem index, friction, is in ``joint``."""


@inlined
def _on_curve(valve, voltage, p):
    """κ(u): linear between the knots of the valve's curve, constant beyond its ends."""
    start = CURVE + valve * CURVE_SIZE
    knots = int(shared(p[start]))
    at = start + 1
    rate = start + 1 + MAX_KNOTS
    if voltage <= shared(p[at]):
        return shared(p[rate])
    for i in range(1, knots):
        if voltage < shared(p[at + i]):
            before, low = shared(p[at + i - 1]), shared(p[rate + i - 1])
            share = (voltage - before) / (shared(p[at + i]) - before)
            return low + share * (shared(p[rate + i]) - low)
    return shared(p[rate + knots - 1])


@inlined
def open_rate(valve, voltage, p):
    """α = κ(u) with the shifts of effects, limited to 0 and 1.

    Returns open rate in [0, 1].
    """
    shifted = _open_rate_shift(_on_curve(valve, _voltage_shift(voltage, valve, p), p), valve, p)
    return min(max(shifted, 0.0), 1.0)


@inlined
def curve_shift(valve, p):
    """Shifts that effects give the curve of a valve (0 or 1): along the voltage [V], and along the open rate [-]."""
    return -_voltage_shift(0.0, valve, p), _open_rate_shift(0.0, valve, p)


@inlined
def openings(alpha, overlap):
    """How far the orifices to the supply and to the atmosphere are open [-], for an open rate.

    Equation (5) has α and 1 − α: while one opens, the other closes, and in the middle air passes through both. With an
    overlap c each orifice is shut until its open rate is c: (α − c)/(1 − c) and (1 − α − c)/(1 − c). For c = 0.5 both
    are shut in the middle only. A larger c has a range of open rates at which no air passes (overlap), a smaller one
    a range at which both orifices are open (underlap).
    """
    if overlap == 0.0:
        return alpha, 1.0 - alpha
    share = 1.0 - overlap
    return max(alpha - overlap, 0.0) / share, max(1.0 - alpha - overlap, 0.0) / share


@inlined
def valve_flow(valve, alpha, pressure, supply, p):
    """Mass flow by equation (5) from a supply of any pressure, and the flow drawn from the supply.

    A_0 is the inflow area where the sum is positive and the outflow area where it is not. A_0 is a
    factor of both terms, so the sign is known before the area is. The drawn flow passes the inflow orifice, so
    its area is always A_1.

    `alpha`: open rate α [-] of :func:`open_rate`. `pressure`: pressure at the valve [Pa]. Returns mass flow into the
    chamber, and out of the supply [kg/s].
    """
    first = VALVE + valve * VALVE_SIZE
    filling, emptying = openings(alpha, p[first + OVERLAP])
    drawn = filling * orifice_flow(supply, pressure, p)
    flow = drawn - emptying * orifice_flow(pressure, p[ATMOSPHERE], p)
    area = p[first + INFLOW_AREA] if flow > 0.0 else p[first + OUTFLOW_AREA]
    return area * flow, p[first + INFLOW_AREA] * drawn


@inlined
def open_rate_for(valve, flow, pressure, supply, p):
    """Equation (5) solved for α: the open rate at which a valve lets a mass flow pass.

    `flow`: wanted into the chamber [kg/s]. `pressure`: pressure at the valve [Pa]. Returns open rate in [0, 1]; the
    nearest end where no open rate gives that flow.
    """
    most, _ = valve_flow(valve, 1.0, pressure, supply, p)
    least, _ = valve_flow(valve, 0.0, pressure, supply, p)
    if flow >= most:
        return 1.0
    if flow <= least:
        return 0.0
    first = VALVE + valve * VALVE_SIZE
    outflow = -least / p[first + OUTFLOW_AREA]
    inflow = most / p[first + INFLOW_AREA]
    overlap = p[first + OVERLAP]
    if overlap != 0.0:
        return _lapped_open_rate(flow, most, least, inflow, outflow, overlap)
    # At this open rate in- and outflow are equal; the flow is linear in α on either side of it.
    balance = min(max(outflow / (inflow + outflow), 0.0), 1.0)
    if flow >= 0.0:
        return balance + (1.0 - balance) * flow / most
    return balance * (1.0 - flow / least)


@inlined
def _lapped_open_rate(flow, most, least, inflow, outflow, overlap):
    """:func:`open_rate_for` of a valve with overlap, from the flows of the wholly open orifices.

    `flow`: wanted [kg/s], between ``least`` and ``most``. `most`: through the wholly open inflow orifice [kg/s].
    `least`: through the wholly open outflow orifice, negative [kg/s]. `inflow`: ``most`` by its area [kg/(s m²)].
    `outflow`: −``least`` by its area, likewise. `overlap`: c [-], above 0.
    """
    share = 1.0 - overlap
    if overlap >= 0.5:
        if flow == 0.0:
            return 0.5
        return overlap + share * flow / most if flow > 0.0 else share * (1.0 - flow / least)
    # Both orifices are open from c to 1 − c. There the flow is that of equation (5), with shifted open rates.
    balance = (outflow + overlap * (inflow - outflow)) / (inflow + outflow)
    balance = min(max(balance, overlap), share)
    if flow >= 0.0:
        slope = most * (1.0 + outflow / inflow) / share
        alpha = balance + flow / slope
        return alpha if alpha <= share else overlap + share * flow / most
    slope = -least * (1.0 + inflow / outflow) / share
    alpha = balance + flow / slope
    return alpha if alpha >= overlap else share * (1.0 - flow / least)


@inlined
def voltage_for(valve, alpha, p):
    """Voltage [V] of an open rate, the inverse of κ; beyond the curve, the voltage of its nearest end."""
    along, across = curve_shift(valve, p)
    wanted = alpha - across
    start = CURVE + valve * CURVE_SIZE
    knots = int(p[start])
    at = start + 1
    rate = start + 1 + MAX_KNOTS
    if wanted <= p[rate]:
        return p[at] + along
    for i in range(1, knots):
        if wanted < p[rate + i]:
            share = (wanted - p[rate + i - 1]) / (p[rate + i] - p[rate + i - 1])
            return p[at + i - 1] + share * (p[at + i] - p[at + i - 1]) + along
    return p[at + knots - 1] + along


@inlined
def pressure_rate(pressure, chamber_volume, volume_rate, flow, p):
    """Ṗ_i [Pa/s], equation (4): k_1 R T m / V − k_2 V̇ P / V."""
    supplied = p[POLYTROPIC_FLOW] * p[GAS_CONSTANT] * p[TEMPERATURE] * flow
    # The processor computes the reciprocal before it has the flow, so no division waits for the flow.
    return (supplied - p[POLYTROPIC_VOLUME] * volume_rate * pressure) * (1.0 / chamber_volume)


@inlined
def flow_for(rate, pressure, chamber_volume, volume_rate, p):
    """Mass flow m_i [kg/s] that gives a rate of the pressure, the inverse of equation (4).

    `rate`: Ṗ_i wanted [Pa/s].
    """
    # pressure_rate is linear in the flow: its value without flow is the offset, its value for a unit of flow the slope.
    without = pressure_rate(pressure, chamber_volume, volume_rate, 0.0, p)
    return (rate - without) / pressure_rate(0.0, chamber_volume, 0.0, 1.0, p)


@inlined
def flow_regime(pressure, p):
    """Which of the two orifices of a valve are choked: the three flow regimes of a muscle.

    Below both thresholds only the inflow is choked, above both only the outflow, between them both
    (for the supplies in use P_out/b < b P_tank, b the critical ratio; otherwise the middle regime is the
    one where neither is).
    """
    inflow_choked = pressure <= p[SUPPLY] * p[CRITICAL_RATIO]
    outflow_choked = p[ATMOSPHERE] <= pressure * p[CRITICAL_RATIO]
    if inflow_choked == outflow_choked:
        return BOTH_CHOKED
    return INFLOW_CHOKED if inflow_choked else OUTFLOW_CHOKED
