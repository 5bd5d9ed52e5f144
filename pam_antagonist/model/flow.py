"""Compressed air through the valve and into the chamber: equations (4) and (5)."""

from __future__ import annotations

import math

from pam_antagonist._jit import inlined
from pam_antagonist.model.parameters import (
    ATMOSPHERE,
    CHOKED_FLOW,
    CRITICAL_RATIO,
    CURVE,
    CURVE_SIZE,
    FLOW_EXPONENT,
    GAS_CONSTANT,
    INFLOW_AREA,
    MAX_KNOTS,
    OUTFLOW_AREA,
    POLYTROPIC_FLOW,
    POLYTROPIC_VOLUME,
    SUBSONIC_FLOW,
    SUPPLY,
    TEMPERATURE,
    VALVE,
    VALVE_SIZE,
)

INFLOW_CHOKED, BOTH_CHOKED, OUTFLOW_CHOKED = 0, 1, 2
"""Flow regimes of one muscle; the third subsystem index, friction, is in ``joint``."""


@inlined
def open_rate(valve, voltage, p):
    """α = κ(u): linear between the knots of the valve's curve, constant beyond its ends.

    Args:
        valve: 0 or 1.
        voltage: u [V].
        p: parameter vector.

    Returns:
        Open rate in [0, 1].
    """
    start = CURVE + valve * CURVE_SIZE
    knots = int(p[start])
    at = start + 1
    rate = start + 1 + MAX_KNOTS
    if voltage <= p[at]:
        return p[rate]
    for i in range(1, knots):
        if voltage < p[at + i]:
            share = (voltage - p[at + i - 1]) / (p[at + i] - p[at + i - 1])
            return p[rate + i - 1] + share * (p[rate + i] - p[rate + i - 1])
    return p[rate + knots - 1]


@inlined
def orifice_flow(upstream, downstream, p):
    """Mass flow per orifice area [kg/(s m²)] of an ideal orifice, both branches of m_in and m_out.

    Choked where downstream ≤ upstream (2/(k+1))^(k/(k−1)), else subsonic. Where the ends are exchanged
    (a chamber above the tank's or below the atmosphere's pressure, which the paper leaves out) the flow
    reverses by the same law.

    Args:
        upstream: absolute pressure before the orifice [Pa].
        downstream: absolute pressure behind it [Pa].
        p: parameter vector.
    """
    sign = 1.0
    if downstream > upstream:
        upstream, downstream = downstream, upstream
        sign = -1.0
    if downstream <= upstream * p[CRITICAL_RATIO]:
        return sign * upstream * p[CHOKED_FLOW]
    # With q = r^((k−1)/k), r^(1/k) is r/q: one power instead of two (by exp and log, faster than
    # a general power and as exact here), and upstream r = downstream.
    q = math.exp(p[FLOW_EXPONENT] * math.log(downstream / upstream))
    return sign * downstream * p[SUBSONIC_FLOW] * math.sqrt(max(1.0 - q, 0.0)) / q


@inlined
def mass_flow(valve, alpha, pressure, p):
    """Mass flow m_i into the chamber [kg/s], equation (5): α m_in − (1 − α) m_out.

    A_0 is the inflow area where the sum is positive and the outflow area where it is not. A_0 is a
    factor of both terms, so the sign is known before the area is.

    Args:
        valve: 0 or 1.
        alpha: open rate α [-] of :func:`open_rate`.
        pressure: P_i [Pa].
        p: parameter vector.
    """
    flow = alpha * orifice_flow(p[SUPPLY], pressure, p) - (1.0 - alpha) * orifice_flow(pressure, p[ATMOSPHERE], p)
    area = VALVE + valve * VALVE_SIZE + (INFLOW_AREA if flow > 0.0 else OUTFLOW_AREA)
    return p[area] * flow


@inlined
def pressure_rate(pressure, chamber_volume, volume_rate, flow, p):
    """Ṗ_i [Pa/s], equation (4): k_1 R T m / V − k_2 V̇ P / V.

    Args:
        pressure: P_i [Pa].
        chamber_volume: V_i [m³].
        volume_rate: V̇_i [m³/s].
        flow: m_i [kg/s].
        p: parameter vector.
    """
    supplied = p[POLYTROPIC_FLOW] * p[GAS_CONSTANT] * p[TEMPERATURE] * flow
    # The reciprocal is ready long before the flow is: one division less to wait for.
    return (supplied - p[POLYTROPIC_VOLUME] * volume_rate * pressure) * (1.0 / chamber_volume)


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
