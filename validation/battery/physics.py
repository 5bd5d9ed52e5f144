"""A joint with effects in other forms than the catalogue's, to try a diagnosis on.

Each form is a function of its own; :func:`rates` puts them together with the model's own equations (2) to (10), which
are taken from :mod:`pam_antagonist.model`. Numbers of the forms stand in a flat array ``q``, indexed by ``Q``; a form
whose number is 0 is not there. Those that both muscles have follow one another.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import in_place, inlined, kernel
from pam_antagonist.model import flow, integration, joint, lever_arm, muscle
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
    # Hysteresis: Dahl; Maxwell slip, which may grow with the pressure and fade with the speed.
    *("dahl_1", "dahl_2", "dahl_width", "dahl_power"),
    *("slip_1", "slip_2", "slip_width", "slip_pressure", "slip_fade", "slip_velocity"),
    # Leak: linear in the pressure, as in a long capillary, a seam that a pressure opens, a crack that the length opens.
    *("seep_1", "seep_2", "capillary_1", "capillary_2", "seam_1", "seam_2", "seam_pressure", "crack_1", "crack_2"),
    # Supply: drops with the root of the flow and with its square; a tank behind an orifice; a compressor's switch.
    *("regulator", "inlet", "tank", "feed", "compressor", "switch"),
    # Valve: spool. Line: resistance, flow at which it is twice the laminar one, volume, ratio at which it chokes.
    *("spool_1", "spool_2", "line_1", "line_2", "line_turbulent", "line_volume", "line_critical"),
    # Load: a pendulum off the vertical behind a gear, a spring that hardens, bumpers on either side.
    *("pendulum", "pendulum_gear", "pendulum_angle"),
    *("spring", "spring_angle", "spring_hardening", "bumper", "bumper_gap"),
    # Friction: bristles whose level falls with the velocity, a level that does, and one that changes with the angle.
    *("bristle", "bristle_angle", "bristle_fall"),
    *("rub", "rub_velocity", "rub_fall", "rub_power", "rub_wave", "rub_number"),
    # Creep: branches with times and weights, quicker under load.
    *("creep_1", "creep_2", "creep_load"),
    *(f"creep_time_{k}" for k in range(ELEMENTS)),
    *(f"creep_weight_{k}" for k in range(ELEMENTS)),
    # Gas: energy balance with the mass in the chamber; gas, wall and surroundings.
    *("gas_1", "gas_2", "gas_time", "gas_flow", "wall_1", "wall_2", "wall_time"),
    # Force that gets less with the running time, or with the work done.
    *("tire_1", "tire_2", "tire_time", "tire_work"),
    # In no catalogue.
    *("exchange", "cogging", "cogging_number", "swell_1", "swell_2", "crosstalk", "bend_1", "bend_2"),
)
Q = {name: index for index, name in enumerate(_NAMES)}
_DAHL, _DAHL_WIDTH, _DAHL_POWER = Q["dahl_1"], Q["dahl_width"], Q["dahl_power"]
_SLIP, _SLIP_WIDTH, _SLIP_PRESSURE = Q["slip_1"], Q["slip_width"], Q["slip_pressure"]
_SLIP_FADE, _SLIP_VELOCITY = Q["slip_fade"], Q["slip_velocity"]
_SEEP, _CAPILLARY, _SEAM, _SEAM_PRESSURE = Q["seep_1"], Q["capillary_1"], Q["seam_1"], Q["seam_pressure"]
_CRACK, _SPOOL, _REGULATOR, _INLET, _TANK = Q["crack_1"], Q["spool_1"], Q["regulator"], Q["inlet"], Q["tank"]
_FEED, _COMPRESSOR, _SWITCH, _CREEP_LOAD = Q["feed"], Q["compressor"], Q["switch"], Q["creep_load"]
_LINE, _LINE_TURBULENT = Q["line_1"], Q["line_turbulent"]
_LINE_VOLUME, _LINE_CRITICAL = Q["line_volume"], Q["line_critical"]
_PENDULUM, _PENDULUM_GEAR, _PENDULUM_ANGLE = Q["pendulum"], Q["pendulum_gear"], Q["pendulum_angle"]
_SPRING, _SPRING_ANGLE, _SPRING_HARDENING = Q["spring"], Q["spring_angle"], Q["spring_hardening"]
_BUMPER, _BUMPER_GAP, _RUB_WAVE, _RUB_NUMBER = Q["bumper"], Q["bumper_gap"], Q["rub_wave"], Q["rub_number"]
_BRISTLE, _BRISTLE_ANGLE, _BRISTLE_FALL = Q["bristle"], Q["bristle_angle"], Q["bristle_fall"]
_RUB, _RUB_VELOCITY, _RUB_FALL, _RUB_POWER = Q["rub"], Q["rub_velocity"], Q["rub_fall"], Q["rub_power"]
_CREEP, _CREEP_TIME, _CREEP_WEIGHT = Q["creep_1"], Q["creep_time_0"], Q["creep_weight_0"]
_GAS, _GAS_TIME, _GAS_FLOW, _WALL, _WALL_TIME = Q["gas_1"], Q["gas_time"], Q["gas_flow"], Q["wall_1"], Q["wall_time"]
_TIRE, _TIRE_TIME, _TIRE_WORK = Q["tire_1"], Q["tire_time"], Q["tire_work"]
_EXCHANGE, _COGGING, _COGGING_NUMBER = Q["exchange"], Q["cogging"], Q["cogging_number"]
_SWELL, _CROSSTALK, _BEND = Q["swell_1"], Q["crosstalk"], Q["bend_1"]

# States behind [ψ, ψ̇, P_1, P_2].
_LOOP, _ELEMENT, _SUPPLY_AT, _OPEN, _OPENING, _AT_VALVE = 4, 6, 14, 15, 17, 19
_LATE, _WARM, _WALL_WARM, _BRISTLE_AT, _TIRED, _RUNNING, SIZE = 21, 29, 31, 33, 34, 36, 37

_MIDDLE, _HALF_RANGE = 450e3, 250e3
_SPOOL_DAMPING, _REGULATOR_LAG, _MIDDLE_FORCE = 0.7, 0.03, 200.0
_REFERENCE_FLOW = 1e-4

_leverage, _length, _length_rate = lever_arm.leverage, muscle.length, muscle.length_rate
_volume, _force, _pressure_rate, _open_rate = muscle.volume, muscle.force, flow.pressure_rate, flow.open_rate
_orifice_flow, _valve_flow, _muscle_torque = flow.orifice_flow, flow.valve_flow, joint.muscle_torque
_coulomb_torque, _acceleration, _stop = joint.coulomb_torque, joint.acceleration, integration.apply_stop


def numbers(**values: float) -> np.ndarray:
    """The array ``q`` with these numbers; the others are 0, and times, widths and volumes something harmless.

    Raises:
        KeyError: a name that is none.
    """
    q = np.zeros(len(_NAMES))
    widths = ("dahl_width", "dahl_power", "slip_width", "slip_velocity", "bristle_angle", "rub_velocity")
    times = ("gas_time", "wall_time", "tire_time", *(f"creep_time_{k}" for k in range(ELEMENTS)))
    for name in (*widths, *times, "line_turbulent", "line_volume"):
        q[Q[name]] = 1.0
    q[_BRISTLE_FALL] = q[_RUB_FALL] = 0.4
    for name, value in values.items():
        q[Q[name]] = value
    return q


@inlined
def _dahl_rate(loop, rate, q):
    """Dahl (1968): dz/dt of a loop that bends all the way round, (dl/dt)/s · (1 − z sgn dl/dt)^power."""
    way = 1.0 if rate > 0.0 else -1.0
    return rate / q[_DAHL_WIDTH] * max(1.0 - loop * way, 0.0) ** q[_DAHL_POWER]


@inlined
def _slip_share(i, pressure, rate, x, q):
    """Mean extension of the Maxwell-slip elements of muscle i, each over the length at which it slips [-].

    A braid that a higher pressure loads rubs harder (Davis and Caldwell 2006). In the generalised model (Al-Bender et
    al. 2005) the elements hold less while they slip quickly.
    """
    total = 0.0
    for k in range(ELEMENTS):
        total += x[_ELEMENT + ELEMENTS * i + k] / (q[_SLIP_WIDTH] * (k + 0.5))
    loaded = 1.0 + q[_SLIP_PRESSURE] * (pressure - _MIDDLE) / _HALF_RANGE
    return total / ELEMENTS * loaded * (1.0 - q[_SLIP_FADE] * (1.0 - math.exp(-abs(rate) / q[_SLIP_VELOCITY])))


@in_place
def _slip(i, travel, x, q):
    """Maxwell slip (Al-Bender et al. 2005): each element follows the length until it slips."""
    for k in range(ELEMENTS):
        at, most = _ELEMENT + ELEMENTS * i + k, q[_SLIP_WIDTH] * (k + 0.5)
        x[at] = min(max(x[at] + travel, -most), most)


@inlined
def _escaped(i, pressure, muscle_length, p, q):
    """Mass flow of the leaks [kg/s]: linear in the gauge pressure, or in the difference of squares (capillary).

    A seam opens above a pressure, in proportion to what is above it. A crack opens beyond the middle length.
    """
    outside = p[ATMOSPHERE]
    gauge = pressure - outside
    seam = q[_SEAM + i] * max(pressure - q[_SEAM_PRESSURE], 0.0) * gauge
    crack = q[_CRACK + i] * max(muscle_length - _length(i, 0.0, p), 0.0) * gauge
    return q[_SEEP + i] * gauge + q[_CAPILLARY + i] * (pressure * pressure - outside * outside) + seam + crack


@inlined
def _supply_rate(deviation, drawn, running, p, q):
    """How the supply's deviation s [Pa] from its set pressure moves [Pa/s].

    A regulator drops with the root of the flow, a line in front of the valves with its square; a tank of volume V is
    refilled through an orifice, or by a compressor that is running or not.
    """
    if q[_REGULATOR] != 0.0 or q[_INLET] != 0.0:
        ratio = max(drawn, 0.0) / _REFERENCE_FLOW
        drop = q[_REGULATOR] * math.sqrt(ratio) + q[_INLET] * ratio * ratio
        return (-drop - deviation) / _REGULATOR_LAG
    if q[_COMPRESSOR] != 0.0:
        return q[_COMPRESSOR] * (2.0 * running - drawn / _REFERENCE_FLOW)
    if q[_TANK] != 0.0:
        refill = q[_FEED] * _orifice_flow(p[SUPPLY], p[SUPPLY] + deviation, p)
        return q[_TANK] * p[GAS_CONSTANT] * p[TEMPERATURE] * (refill - drawn)
    return 0.0


@inlined
def _line_flow(i, upper, lower, q):
    """Mass flow [kg/s] through a line: ΔP = R m (1 + |m|/m_0), solved for m.

    A fitting whose flow chokes (ISO 6358) gets no more once the ratio of the pressures falls below the critical one.
    """
    high, low = max(upper, lower), min(upper, lower)
    if q[_LINE_CRITICAL] != 0.0:
        low = max(low, q[_LINE_CRITICAL] * high)
    reference = q[_LINE_TURBULENT]
    root = math.sqrt(1.0 + 4.0 * (high - low) / (q[_LINE + i] * reference))
    size = 0.5 * reference * (root - 1.0)
    return size if upper > lower else -size


@inlined
def _load(angle, q):
    """Torque of the loads [N m]: a geared pendulum whose rest is not at 0, a spring that hardens, bumpers, cogging."""
    stretch = angle - q[_SPRING_ANGLE]
    pull = q[_SPRING] * stretch * (1.0 + q[_SPRING_HARDENING] * stretch * stretch)
    deep = max(abs(angle) - q[_BUMPER_GAP], 0.0)
    pull += q[_BUMPER] * deep * math.sqrt(deep) * (1.0 if angle > 0.0 else -1.0)
    return (
        q[_PENDULUM] * math.sin(q[_PENDULUM_GEAR] * angle - q[_PENDULUM_ANGLE])
        - pull
        - q[_COGGING] * math.sin(q[_COGGING_NUMBER] * angle)
    )


@inlined
def _rubbing(angle, velocity, q):
    """Friction [N m] of a level at rest, and less of it at speed; a gear's goes round.

    It falls as 1/(1 + (v/w)²) by Hess and Soom (1990), as exp(−|v/w|^power) by Bo and Pavelescu (1982): the power is 2
    for the curve that is named after Stribeck.
    """
    ratio = abs(velocity) / q[_RUB_VELOCITY]
    wave = 1.0 + q[_RUB_WAVE] * math.sin(q[_RUB_NUMBER] * angle)
    power = q[_RUB_POWER]
    left = math.exp(-(ratio**power)) if power != 0.0 else 1.0 / (1.0 + ratio * ratio)
    return q[_RUB] * wave * (1.2 - q[_RUB_FALL] + q[_RUB_FALL] * left)


@inlined
def _late_force(i, static, x, q):
    """Force of a muscle [N], less by what it is tired, some of whose share comes late, in branches of their own."""
    total = static * (1.0 - q[_TIRE + i] * x[_TIRED + i])
    if q[_CREEP + i] != 0.0:
        for k in range(ELEMENTS):
            total += q[_CREEP + i] * q[_CREEP_WEIGHT + k] * (x[_LATE + ELEMENTS * i + k] - static)
    return total


@inlined
def _contraction_force(i, sine, cosine, pressure, x, q, p):
    """Contraction force of muscle i [N], forms included."""
    static = _force(i, _length(i, sine, p), pressure, p)
    bent = (pressure - _MIDDLE) / _HALF_RANGE
    total = _late_force(i, static, x, q) + q[_DAHL + i] * x[_LOOP + i] + q[_BEND + i] * bent * bent
    if q[_SLIP + i] != 0.0:
        total += q[_SLIP + i] * _slip_share(i, pressure, _length_rate(i, cosine, x[1], p), x, q)
    return total


@inlined
def _cooling(i, pressure, rate, through, x, q, dx):
    """What Ṗ loses to the walls [Pa/s]; the states of the gas in ``dx``.

    By an energy balance the warmth θ/T − 1 follows dP/P and cools with a time that grows with the mass of gas,
    so with the pressure; air that streams in or out cools it quicker (forced convection). With a wall of its own
    warmth, gas, wall and surroundings exchange heat one after the other.
    """
    lost = 0.0
    warm = x[_WARM + i]
    if q[_GAS + i] != 0.0:
        fall = warm / (q[_GAS_TIME] * pressure / _MIDDLE) * (1.0 + q[_GAS_FLOW] * abs(through) / _REFERENCE_FLOW)
        dx[_WARM + i] = q[_GAS + i] * (1.0 + warm) * rate / pressure - fall
        lost = pressure / (1.0 + warm) * fall
    if q[_WALL + i] != 0.0:
        wall = x[_WALL_WARM + i]
        fall = (warm - wall) / q[_WALL_TIME]
        dx[_WARM + i] = q[_WALL + i] * rate - fall
        dx[_WALL_WARM + i] = 0.5 * fall - wall / (6.0 * q[_WALL_TIME])
        lost = fall
    return lost


@in_place
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
            arriving = _line_flow(i, at_valve, chamber, q)
            dx[_AT_VALVE + i] = _pressure_rate(at_valve, q[_LINE_VOLUME], 0.0, through - arriving, p)
        net = arriving - _escaped(i, chamber, muscle_length, p, q) - (crossing if i == 0 else -crossing)
        swelling = q[_SWELL + i] / _HALF_RANGE
        swollen = volume * (1.0 + swelling * (chamber - _MIDDLE))
        rate = _pressure_rate(chamber, swollen, slope * length_rate, net, p)
        # The volume that grows with the pressure takes its share of every change of it.
        rate /= 1.0 + p[POLYTROPIC_VOLUME] * volume * swelling * chamber / swollen
        dx[2 + i] = rate - _cooling(i, chamber, rate, net, x, q, dx)
        if q[_DAHL + i] != 0.0:
            dx[_LOOP + i] = _dahl_rate(x[_LOOP + i], length_rate, q)
        if q[_CREEP + i] != 0.0:
            static = _force(i, muscle_length, chamber, p)
            # Rubber relaxes quicker under load (Schapery 1969).
            hurry = (max(static, 10.0) / _MIDDLE_FORCE) ** q[_CREEP_LOAD]
            for k in range(ELEMENTS):
                dx[_LATE + ELEMENTS * i + k] = (static - x[_LATE + ELEMENTS * i + k]) / q[_CREEP_TIME + k] * hurry
        if q[_TIRE + i] != 0.0:
            work = abs(_force(i, muscle_length, chamber, p) * length_rate)
            gain = work / q[_TIRE_WORK] if q[_TIRE_WORK] != 0.0 else 1.0 / q[_TIRE_TIME]
            dx[_TIRED + i] = gain - x[_TIRED + i] / q[_TIRE_TIME]
    dx[_SUPPLY_AT] = _supply_rate(x[_SUPPLY_AT], drawn_in_all, x[_RUNNING], p, q)
    if p[LOCKED] != 0.0:
        return
    force_1 = _contraction_force(0, sine, cosine, x[2], x, q, p)
    force_2 = _contraction_force(1, sine, cosine, x[3], x, q, p)
    coulomb = _coulomb_torque(force_1, force_2, x[2], x[3], p) + _rubbing(angle, velocity, q)
    balance = _muscle_torque(cosine, force_1, force_2, p) + push + _load(angle, q)
    if q[_BRISTLE] != 0.0:
        # Bristles (Canudas de Wit et al. 1995): a spring that slips, with a Stribeck level, and its damping.
        level = 1.0 + q[_BRISTLE_FALL] * math.exp(-abs(velocity) / 0.1)
        bend = velocity - abs(velocity) * x[_BRISTLE_AT] / (q[_BRISTLE_ANGLE] * level)
        dx[_BRISTLE_AT] = bend
        balance -= q[_BRISTLE] / q[_BRISTLE_ANGLE] * (x[_BRISTLE_AT] + 2e-3 * bend)
    dx[0] = velocity
    dx[1], _ = _acceleration(angle, velocity, balance, coulomb, p)


@in_place
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
    if q[_COMPRESSOR] != 0.0 and abs(x[_SUPPLY_AT]) > 0.5 * q[_SWITCH]:
        # Between the switch's two pressures it goes on as it is.
        x[_RUNNING] = 1.0 if x[_SUPPLY_AT] < 0.0 else 0.0
    if q[_SLIP] != 0.0 or q[_SLIP + 1] != 0.0:
        after, _, _ = _leverage(x[0], p)
        for i in range(2):
            _slip(i, _length(i, after, p) - _length(i, sine, p), x, q)


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
        force_1 = _contraction_force(0, sine, cosine, x[2], x, q, p)
        force_2 = _contraction_force(1, sine, cosine, x[3], x, q, p)
        torques[k] = _muscle_torque(cosine, force_1, force_2, p)
    return angles, pressures, torques
