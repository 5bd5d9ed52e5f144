"""A joint with effects in other forms than the catalogue's, to try a diagnosis on.

Each form is a function of its own; :func:`rates` puts them together with the model's own equations (2) to (10), which
are taken from :mod:`pam_antagonist.model` and not written again. A form whose size is 0 is not there.

Numbers of the forms stand in a flat array ``q``, indexed by ``Q``; those that both muscles have follow one another.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import inlined, kernel
from pam_antagonist.model import dynamics, flow, joint, muscle
from pam_antagonist.model.parameters import (
    ATMOSPHERE,
    GAS_CONSTANT,
    LOCKED,
    POLYTROPIC_VOLUME,
    STOP,
    SUPPLY,
    TEMPERATURE,
)

ELEMENTS = 4
"""Maxwell-slip elements of a muscle, and branches of its creep."""
SETTLING = 500
"""Samples with the pressures held before a recording begins, so that it begins at rest."""

_NAMES = (
    # Hysteresis: Dahl, and Maxwell slip.
    *("dahl_1", "dahl_2", "dahl_width", "dahl_power", "slip_1", "slip_2", "slip_width"),
    # Leak: linear in the pressure, as in a long capillary.
    *("seep_1", "seep_2", "capillary_1", "capillary_2"),
    # Supply: a regulator's drop with the root of the flow; a tank that is fed through an orifice.
    *("regulator", "tank", "feed"),
    # Valve: second-order spool.
    *("spool_1", "spool_2"),
    # Line with a volume: resistance, flow at which it is twice the laminar one, volume.
    *("line_1", "line_2", "line_turbulent", "line_volume"),
    # Load: a pendulum off the vertical behind a gear, a spring that hardens.
    *("pendulum", "pendulum_gear", "pendulum_angle", "spring", "spring_angle", "spring_hardening"),
    # Friction: bristles, and a level that falls with the velocity.
    *("bristle", "bristle_angle", "rub", "rub_velocity"),
    # Creep: branches with times and weights.
    *("creep_1", "creep_2"),
    *(f"creep_time_{k}" for k in range(ELEMENTS)),
    *(f"creep_weight_{k}" for k in range(ELEMENTS)),
    # Gas: energy balance with the mass in the chamber; gas, wall and surroundings.
    *("gas_1", "gas_2", "gas_time", "wall_1", "wall_2", "wall_time"),
    # In no catalogue.
    *("exchange", "cogging", "cogging_number", "swell_1", "swell_2", "crosstalk", "bend_1", "bend_2"),
)
Q = {name: index for index, name in enumerate(_NAMES)}
_DAHL, _DAHL_WIDTH, _DAHL_POWER = Q["dahl_1"], Q["dahl_width"], Q["dahl_power"]
_SLIP, _SLIP_WIDTH = Q["slip_1"], Q["slip_width"]
_SEEP, _CAPILLARY = Q["seep_1"], Q["capillary_1"]
_REGULATOR, _TANK, _FEED = Q["regulator"], Q["tank"], Q["feed"]
_SPOOL = Q["spool_1"]
_LINE, _LINE_TURBULENT, _LINE_VOLUME = Q["line_1"], Q["line_turbulent"], Q["line_volume"]
_PENDULUM, _PENDULUM_GEAR, _PENDULUM_ANGLE = Q["pendulum"], Q["pendulum_gear"], Q["pendulum_angle"]
_SPRING, _SPRING_ANGLE, _SPRING_HARDENING = Q["spring"], Q["spring_angle"], Q["spring_hardening"]
_BRISTLE, _BRISTLE_ANGLE, _RUB, _RUB_VELOCITY = Q["bristle"], Q["bristle_angle"], Q["rub"], Q["rub_velocity"]
_CREEP, _CREEP_TIME, _CREEP_WEIGHT = Q["creep_1"], Q["creep_time_0"], Q["creep_weight_0"]
_GAS, _GAS_TIME, _WALL, _WALL_TIME = Q["gas_1"], Q["gas_time"], Q["wall_1"], Q["wall_time"]
_EXCHANGE, _COGGING, _COGGING_NUMBER = Q["exchange"], Q["cogging"], Q["cogging_number"]
_SWELL, _CROSSTALK, _BEND = Q["swell_1"], Q["crosstalk"], Q["bend_1"]

# States behind [ψ, ψ̇, P_1, P_2].
_LOOP, _ELEMENT, _SUPPLY_AT, _OPEN, _OPENING, _AT_VALVE = 4, 6, 14, 15, 17, 19
_LATE, _WARM, _WALL_WARM, _BRISTLE_AT, SIZE = 21, 29, 31, 33, 34

_MIDDLE, _HALF_RANGE = 450e3, 250e3
_SPOOL_DAMPING, _REGULATOR_LAG = 0.7, 0.03
_REFERENCE_FLOW = 1e-4

_leverage, _length, _length_rate, _volume, _force = (
    muscle.leverage,
    muscle.length,
    muscle.length_rate,
    muscle.volume,
    muscle.force,
)
_orifice_flow, _valve_flow, _pressure_rate, _open_rate = (
    flow.orifice_flow,
    flow.valve_flow,
    flow.pressure_rate,
    flow.open_rate,
)
_muscle_torque, _coulomb_torque, _acceleration = joint.muscle_torque, joint.coulomb_torque, joint.acceleration
_stop = dynamics._stop


def numbers(**values: float) -> np.ndarray:
    """The array ``q`` with these numbers; the others are 0, and times, widths and volumes something harmless.

    Raises:
        KeyError: a name that is none.
    """
    q = np.zeros(len(_NAMES))
    widths = ("dahl_width", "dahl_power", "slip_width", "bristle_angle", "rub_velocity")
    for name in (*widths, "line_turbulent", "line_volume"):
        q[Q[name]] = 1.0
    for name in ("gas_time", "wall_time", *(f"creep_time_{k}" for k in range(ELEMENTS))):
        q[Q[name]] = 1.0
    for name, value in values.items():
        q[Q[name]] = value
    return q


@inlined
def dahl_rate(loop, rate, q):
    """Dahl (1968): dz/dt of a loop that bends all the way round, (dl/dt)/s · (1 − z sgn dl/dt)^power.

    Args:
        loop: z [-].
        rate: dl/dt [m/s].
        q: sizes of the forms, see ``Q``.
    """
    way = 1.0 if rate > 0.0 else -1.0
    return rate / q[_DAHL_WIDTH] * max(1.0 - loop * way, 0.0) ** q[_DAHL_POWER]


@inlined
def slip_share(i, x, q):
    """Mean extension of the Maxwell-slip elements of muscle i, each over the length at which it slips [-].

    Args:
        i: muscle, 0 or 1.
        x: state of the joint with its forms.
        q: sizes of the forms, see ``Q``.
    """
    total = 0.0
    for k in range(ELEMENTS):
        total += x[_ELEMENT + ELEMENTS * i + k] / (q[_SLIP_WIDTH] * (k + 0.5))
    return total / ELEMENTS


@kernel
def slip(i, travel, x, q):
    """Maxwell slip (Al-Bender et al. 2005): each element follows the length until it slips.

    Args:
        i: muscle, 0 or 1.
        travel: change of the length [m].
        x: state of the joint with its forms, changed in place.
        q: sizes of the forms, see ``Q``.
    """
    for k in range(ELEMENTS):
        at, most = _ELEMENT + ELEMENTS * i + k, q[_SLIP_WIDTH] * (k + 0.5)
        x[at] = min(max(x[at] + travel, -most), most)


@inlined
def escaped(i, pressure, p, q):
    """Mass flow of the leaks [kg/s]: linear in the gauge pressure, or in the difference of squares (capillary).

    Args:
        i: muscle, 0 or 1.
        pressure: absolute [Pa].
        p: parameter vector of the model.
        q: sizes of the forms, see ``Q``.
    """
    outside = p[ATMOSPHERE]
    return q[_SEEP + i] * (pressure - outside) + q[_CAPILLARY + i] * (pressure * pressure - outside * outside)


@inlined
def supply_rate(deviation, drawn, p, q):
    """How the supply's deviation s [Pa] from its set pressure moves [Pa/s].

    A regulator drops with the root of the flow; a tank of volume V is refilled through an orifice.

    Args:
        deviation: s [Pa].
        drawn: mass flow from the supply [kg/s].
        p: parameter vector of the model.
        q: sizes of the forms, see ``Q``.
    """
    if q[_REGULATOR] != 0.0:
        drop = q[_REGULATOR] * math.sqrt(max(drawn, 0.0) / _REFERENCE_FLOW)
        return (-drop - deviation) / _REGULATOR_LAG
    if q[_TANK] != 0.0:
        refill = q[_FEED] * _orifice_flow(p[SUPPLY], p[SUPPLY] + deviation, p)
        return q[_TANK] * p[GAS_CONSTANT] * p[TEMPERATURE] * (refill - drawn)
    return 0.0


@inlined
def line_flow(i, difference, q):
    """Mass flow [kg/s] through a line: ΔP = R m (1 + |m|/m_0), solved for m.

    Args:
        i: muscle, 0 or 1.
        difference: ΔP over the line [Pa].
        q: sizes of the forms, see ``Q``.
    """
    reference = q[_LINE_TURBULENT]
    root = math.sqrt(1.0 + 4.0 * abs(difference) / (q[_LINE + i] * reference))
    size = 0.5 * reference * (root - 1.0)
    return size if difference > 0.0 else -size


@inlined
def load(angle, q):
    """Torque of the loads [N m]: a geared pendulum whose rest is not at 0, a spring that hardens, cogging."""
    stretch = angle - q[_SPRING_ANGLE]
    pull = q[_SPRING] * stretch * (1.0 + q[_SPRING_HARDENING] * stretch * stretch)
    return (
        q[_PENDULUM] * math.sin(q[_PENDULUM_GEAR] * angle - q[_PENDULUM_ANGLE])
        - pull
        - q[_COGGING] * math.sin(q[_COGGING_NUMBER] * angle)
    )


@inlined
def rubbing(velocity, q):
    """Friction [N m] by Hess and Soom (1990): a level at rest, and a third less of it at speed."""
    ratio = velocity / q[_RUB_VELOCITY]
    return q[_RUB] * (0.8 + 0.4 / (1.0 + ratio * ratio))


@inlined
def late_force(i, static, x, q):
    """Force of a muscle [N] some of whose share comes late, in branches of their own times.

    Args:
        i: muscle, 0 or 1.
        static: force of the force map [N].
        x: state of the joint with its forms.
        q: sizes of the forms, see ``Q``.
    """
    total = static
    if q[_CREEP + i] != 0.0:
        for k in range(ELEMENTS):
            total += q[_CREEP + i] * q[_CREEP_WEIGHT + k] * (x[_LATE + ELEMENTS * i + k] - static)
    return total


@inlined
def contraction_force(i, sine, pressure, x, q, p):
    """Contraction force of muscle i [N], forms included.

    Args:
        i: muscle, 0 or 1.
        sine: of the angle.
        pressure: absolute [Pa].
        x: state of the joint with its forms.
        q: sizes of the forms, see ``Q``.
        p: parameter vector of the model.
    """
    static = _force(i, _length(i, sine, p), pressure, p)
    bent = (pressure - _MIDDLE) / _HALF_RANGE
    total = late_force(i, static, x, q) + q[_DAHL + i] * x[_LOOP + i] + q[_BEND + i] * bent * bent
    if q[_SLIP + i] != 0.0:
        total += q[_SLIP + i] * slip_share(i, x, q)
    return total


@inlined
def _cooling(i, pressure, rate, x, q, dx):
    """What Ṗ loses to the walls [Pa/s]; the states of the gas in ``dx``.

    By an energy balance the warmth θ/T − 1 follows dP/P and cools with a time that grows with the mass of gas,
    so with the pressure. With a wall of its own warmth, gas, wall and surroundings exchange heat one after the other.
    """
    lost = 0.0
    warm = x[_WARM + i]
    if q[_GAS + i] != 0.0:
        fall = warm / (q[_GAS_TIME] * pressure / _MIDDLE)
        dx[_WARM + i] = q[_GAS + i] * (1.0 + warm) * rate / pressure - fall
        lost = pressure / (1.0 + warm) * fall
    if q[_WALL + i] != 0.0:
        wall = x[_WALL_WARM + i]
        fall = (warm - wall) / q[_WALL_TIME]
        dx[_WARM + i] = q[_WALL + i] * rate - fall
        dx[_WALL_WARM + i] = 0.5 * fall - wall / (6.0 * q[_WALL_TIME])
        lost = fall
    return lost


@kernel
def rates(x, wanted, push, supply_change, p, q, dx):
    """All rates of a joint with such effects.

    Args:
        x: state (SIZE,).
        wanted: open rates (2,) [-] that the voltages ask for.
        push: torque from outside [N m].
        supply_change: pressure [Pa] by which the supply is off.
        p: parameter vector of the model, without effects.
        q: numbers of the forms.
        dx: result (SIZE,).
    """
    dx[:] = 0.0
    angle, velocity = x[0], x[1]
    if angle >= p[STOP]:
        velocity = min(velocity, 0.0)
    elif angle <= -p[STOP]:
        velocity = max(velocity, 0.0)
    sine, cosine, _ = _leverage(angle, p)
    supply = p[SUPPLY] + supply_change + x[_SUPPLY_AT]
    drawn_in_all = 0.0
    crossing = q[_EXCHANGE] * (x[2] - x[3])
    for i in range(2):
        chamber = x[2 + i]
        at_valve = x[_AT_VALVE + i] if q[_LINE + i] != 0.0 else chamber
        alpha = wanted[i]
        if q[_SPOOL + i] != 0.0:
            omega = q[_SPOOL + i]
            alpha = x[_OPEN + i]
            dx[_OPEN + i] = x[_OPENING + i]
            dx[_OPENING + i] = omega * (omega * (wanted[i] - alpha) - 2.0 * _SPOOL_DAMPING * x[_OPENING + i])
        alpha += q[_CROSSTALK] * (wanted[1 - i] - 0.4)
        alpha = min(max(alpha, 0.0), 1.0)
        through, drawn = _valve_flow(i, alpha, at_valve, supply, p)
        drawn_in_all += drawn
        muscle_length, length_rate = _length(i, sine, p), _length_rate(i, cosine, velocity, p)
        volume, slope = _volume(i, muscle_length, p)
        arriving = through
        if q[_LINE + i] != 0.0:
            arriving = line_flow(i, at_valve - chamber, q)
            dx[_AT_VALVE + i] = _pressure_rate(at_valve, q[_LINE_VOLUME], 0.0, through - arriving, p)
        net = arriving - escaped(i, chamber, p, q) - (crossing if i == 0 else -crossing)
        swelling = q[_SWELL + i] / _HALF_RANGE
        swollen = volume * (1.0 + swelling * (chamber - _MIDDLE))
        rate = _pressure_rate(chamber, swollen, slope * length_rate, net, p)
        # The volume that grows with the pressure takes its share of every change of it.
        rate /= 1.0 + p[POLYTROPIC_VOLUME] * volume * swelling * chamber / swollen
        dx[2 + i] = rate - _cooling(i, chamber, rate, x, q, dx)
        if q[_DAHL + i] != 0.0:
            dx[_LOOP + i] = dahl_rate(x[_LOOP + i], length_rate, q)
        if q[_CREEP + i] != 0.0:
            static = _force(i, muscle_length, chamber, p)
            for k in range(ELEMENTS):
                dx[_LATE + ELEMENTS * i + k] = (static - x[_LATE + ELEMENTS * i + k]) / q[_CREEP_TIME + k]
    dx[_SUPPLY_AT] = supply_rate(x[_SUPPLY_AT], drawn_in_all, p, q)
    if p[LOCKED] != 0.0:
        return
    force_1 = contraction_force(0, sine, x[2], x, q, p)
    force_2 = contraction_force(1, sine, x[3], x, q, p)
    coulomb = _coulomb_torque(force_1, force_2, x[2], x[3], p) + rubbing(velocity, q)
    balance = _muscle_torque(cosine, force_1, force_2, p) + push + load(angle, q)
    if q[_BRISTLE] != 0.0:
        # Bristles (Canudas de Wit et al. 1995): a spring that slips, with a Stribeck level, and its damping.
        level = 1.0 + 0.4 * math.exp(-abs(velocity) / 0.1)
        bend = velocity - abs(velocity) * x[_BRISTLE_AT] / (q[_BRISTLE_ANGLE] * level)
        dx[_BRISTLE_AT] = bend
        balance -= q[_BRISTLE] / q[_BRISTLE_ANGLE] * (x[_BRISTLE_AT] + 2e-3 * bend)
    dx[0] = velocity
    dx[1], _ = _acceleration(angle, velocity, balance, coulomb, p)


@kernel
def _step(x, wanted, push, supply_change, p, q, dt, slopes, point):
    """One Runge-Kutta step in place, then what slips and the stop."""
    sine, _, _ = _leverage(x[0], p)
    rates(x, wanted, push, supply_change, p, q, slopes[0])
    for stage in range(1, 4):
        reach = dt if stage == 3 else 0.5 * dt
        for i in range(SIZE):
            point[i] = x[i] + reach * slopes[stage - 1, i]
        rates(point, wanted, push, supply_change, p, q, slopes[stage])
    for i in range(SIZE):
        x[i] += dt / 6.0 * (slopes[0, i] + 2.0 * (slopes[1, i] + slopes[2, i]) + slopes[3, i])
    _stop(x, p)
    if q[_SLIP] != 0.0 or q[_SLIP + 1] != 0.0:
        after, _, _ = _leverage(x[0], p)
        for i in range(2):
            slip(i, _length(i, after, p) - _length(i, sine, p), x, q)


@kernel
def simulate(angle, pressure, voltage, push, supply_change, p, q, dt, substeps):
    """The joint from rest, driven by voltages.

    Args:
        angle: at the start [rad]; a free joint then settles for SETTLING samples while the pressures are held.
        pressure: of both muscles at the start [Pa].
        voltage: (N · substeps, 2) [V] that the valves act on, each row over one substep.
        push: torque from outside (N,) [N m].
        supply_change: deviation of the supply's set pressure (N,) [Pa].
        p: parameter vector of the model, without effects, ``friction.time_step`` the substep.
        q: numbers of the forms.
        dt: sample period [s].
        substeps: steps a sample.

    Returns:
        Angle (N,) [rad], pressures at the sensors (N, 2) [Pa], torque of the muscles (N,) [N m].
    """
    samples = push.shape[0]
    x = np.zeros(SIZE)
    x[0] = angle
    slopes, point, wanted = np.zeros((4, SIZE)), np.zeros(SIZE), np.zeros(2)
    for i in range(2):
        x[2 + i] = x[_AT_VALVE + i] = pressure
        x[_OPEN + i] = wanted[i] = _open_rate(i, voltage[0, i], p)
        sine, _, _ = _leverage(angle, p)
        for k in range(ELEMENTS):
            x[_LATE + ELEMENTS * i + k] = _force(i, _length(i, sine, p), pressure, p)
    at_rest = x.copy()
    step = dt / substeps
    for _ in range(SETTLING * substeps):
        _step(x, wanted, 0.0, supply_change[0], p, q, step, slopes, point)
        # Angle, velocity, loops and bristles settle; air and what is slow begin as they were.
        for i in range(2, SIZE):
            if not (_LOOP <= i < _SUPPLY_AT or i == _BRISTLE_AT):
                x[i] = at_rest[i]
    angles, pressures, torques = np.empty(samples), np.empty((samples, 2)), np.empty(samples)
    for k in range(samples):
        for part in range(substeps):
            for i in range(2):
                wanted[i] = _open_rate(i, voltage[k * substeps + part, i], p)
            _step(x, wanted, push[k], supply_change[k], p, q, step, slopes, point)
        sine, cosine, _ = _leverage(x[0], p)
        angles[k] = x[0]
        for i in range(2):
            pressures[k, i] = x[_AT_VALVE + i] if q[_LINE + i] != 0.0 else x[2 + i]
        force_1 = contraction_force(0, sine, x[2], x, q, p)
        force_2 = contraction_force(1, sine, x[3], x, q, p)
        torques[k] = _muscle_torque(cosine, force_1, force_2, p)
    return angles, pressures, torques
