"""Compressed air through the valve and into the chamber: equations (4) and (5).

With them the effects of the air: valve offset and lag, supply droop, leak, line resistance, warmth of the gas.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import inlined, kernel
from pam_antagonist.model.parameters import (
    ATMOSPHERE,
    CHOKED_FLOW,
    CRITICAL_RATIO,
    CURVE,
    CURVE_SIZE,
    DROOP_STIFFNESS,
    DROOP_TIME,
    FLOW_EXPONENT,
    FRICTION_STEP,
    GAS_CONSTANT,
    INFLOW_AREA,
    LEAK_AREA,
    LEAK_EXPONENT,
    LINE_EXPONENT,
    LINE_RESISTANCE,
    LINE_TIME,
    MAX_KNOTS,
    OUTFLOW_AREA,
    POLYTROPIC_FLOW,
    POLYTROPIC_VOLUME,
    RATE_OFFSET,
    SUBSONIC_FLOW,
    SUPPLY,
    TEMPERATURE,
    THERMAL_SHARE,
    THERMAL_TIME,
    VALVE,
    VALVE_OFFSET,
    VALVE_REACH,
    VALVE_SIZE,
    VALVE_TIME,
)

_LEAK_GAUGE = 350e3
"""[Pa] Gauge pressure at which a leak of any exponent is an orifice of its area."""
_LINE_FLOW = 5e-5
"""[kg/s] Flow at which lines of any exponent have their resistance; what a muscle draws when it fills."""
INFLOW_CHOKED, BOTH_CHOKED, OUTFLOW_CHOKED = 0, 1, 2
"""Flow regimes of one muscle; the third subsystem index, friction, is in ``joint``."""


@inlined
def _on_curve(valve, voltage, p):
    """κ(u): linear between the knots of the valve's curve, constant beyond its ends."""
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
def open_rate(valve, voltage, p):
    """α = κ(u − δ) + ρ, as far as the valve goes; δ and ρ are the valve's offsets along voltage and open rate.

    Args:
        valve: 0 or 1.
        voltage: u [V].
        p: parameter vector.

    Returns:
        Open rate in [0, 1].
    """
    shifted = _on_curve(valve, voltage - p[VALVE_OFFSET + valve], p) + p[RATE_OFFSET + valve]
    return min(max(shifted, 0.0), 1.0)


@inlined
def _power(ratio, exponent):
    """A power of what is not negative, faster than a general power and as exact here."""
    return math.exp(exponent * math.log(ratio))


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
    # With q = r^((k−1)/k), r^(1/k) is r/q: one power instead of two, and upstream r = downstream.
    q = _power(downstream / upstream, p[FLOW_EXPONENT])
    return sign * downstream * p[SUBSONIC_FLOW] * math.sqrt(max(1.0 - q, 0.0)) / q


@inlined
def valve_flow(valve, alpha, pressure, supply, p):
    """Equation (5) from a supply of any pressure, and what of it is drawn from the supply.

    A_0 is the inflow area where the sum is positive and the outflow area where it is not. A_0 is a
    factor of both terms, so the sign is known before the area is.

    Args:
        valve: 0 or 1.
        alpha: open rate α [-] of :func:`open_rate`.
        pressure: pressure at the valve [Pa].
        supply: P_tank [Pa].
        p: parameter vector.

    Returns:
        Mass flow into the chamber, and out of the supply [kg/s].
    """
    drawn = alpha * orifice_flow(supply, pressure, p)
    flow = drawn - (1.0 - alpha) * orifice_flow(pressure, p[ATMOSPHERE], p)
    area = p[VALVE + valve * VALVE_SIZE + (INFLOW_AREA if flow > 0.0 else OUTFLOW_AREA)]
    return area * flow, area * drawn


@inlined
def mass_flow(valve, alpha, pressure, p):
    """Mass flow m_i into the chamber [kg/s], equation (5): α m_in − (1 − α) m_out.

    Args:
        valve: 0 or 1.
        alpha: open rate α [-] of :func:`open_rate`.
        pressure: P_i [Pa].
        p: parameter vector.
    """
    flow, _ = valve_flow(valve, alpha, pressure, p[SUPPLY], p)
    return flow


@kernel
def leak_flow(muscle, pressure, p):
    """Mass flow out of a leaking muscle [kg/s]: an orifice to the atmosphere, or a crack that resists more at first."""
    if p[LEAK_AREA + muscle] == 0.0:
        return 0.0
    flow = p[LEAK_AREA + muscle] * orifice_flow(pressure, p[ATMOSPHERE], p)
    if p[LEAK_EXPONENT] != 1.0:
        flow *= _power(max(pressure - p[ATMOSPHERE], 1.0) / _LEAK_GAUGE, p[LEAK_EXPONENT] - 1.0)
    return flow


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
def warmth_rates(muscle, warmth, polytropic_rate, p):
    """How the warmth of the gas moves the pressure: dq/dt and what Ṗ loses by cooling [Pa/s].

    Args:
        muscle: 0 or 1.
        warmth: q [Pa], the part of the pressure that is due to the gas being warmer than its surroundings.
        polytropic_rate: Ṗ of equation (4) [Pa/s].
        p: parameter vector.
    """
    cooling = warmth / p[THERMAL_TIME]
    return p[THERMAL_SHARE + muscle] * polytropic_rate - cooling, cooling


@inlined
def droop_rate(droop, drawn, p):
    """ds/dt [Pa/s] of the supply's deviation s [Pa] from its set pressure, with the drawn mass flow [kg/s]."""
    return -p[DROOP_STIFFNESS] * drawn - droop / p[DROOP_TIME]


@inlined
def quickest_lag(p):
    """Shortest time constant [s] of a valve that a step of the integration follows."""
    return 0.5 * p[FRICTION_STEP]


def small_signal_lags(p: np.ndarray) -> np.ndarray:
    """Time constants [s] with which the two valves (2,) follow small changes of their voltage; 0 for none."""
    return p[VALVE_TIME : VALVE_TIME + 2] * min(p[VALVE_REACH], 1.0)


@inlined
def valve_rate(valve, alpha, wanted, p):
    """dα/dt [1/s] of a valve that follows the open rate κ(u) that its voltage asks for, at its full speed at most."""
    # A search tries times that no step of the integration would follow; a rig file may not have them.
    quickest = quickest_lag(p)
    stroke = max(p[VALVE_TIME + valve], quickest)
    behind = wanted - alpha
    if p[VALVE_REACH] >= 1.0:
        return behind / stroke
    reach = min(max(p[VALVE_REACH], quickest / stroke), 1.0)
    return min(max(behind, -reach), reach) / (reach * stroke)


@inlined
def line_fall(muscle, flow, p):
    """Fall of the pressure [Pa] along a line that carries a mass flow [kg/s]."""
    fall = p[LINE_RESISTANCE + muscle] * flow
    if p[LINE_EXPONENT] != 1.0:
        fall *= _power(abs(flow) / _LINE_FLOW, p[LINE_EXPONENT] - 1.0)
    return fall


@inlined
def line_rate(muscle, sensed, chamber, flow, p):
    """dP_s/dt [Pa/s] of the pressure at the valve: the chamber's and what the line's resistance adds, with a lag."""
    return (chamber + line_fall(muscle, flow, p) - sensed) / p[LINE_TIME]


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
