"""A joint with effects in other forms than the catalogue's, to try a diagnosis on.

Each form is a function of its own; :func:`rates` puts them together with the model's own equations (2) to (10), which
are taken from :mod:`pam_antagonist.model`. Numbers of the forms stand in a record ``q``; a form whose number is 0 is
not there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from pam_antagonist._jit import in_place, inlined, kernel
from pam_antagonist.model import flow, integration, joint, muscle
from pam_antagonist.model.parameters import (
    ATMOSPHERE,
    FRICTION_STEP,
    GAS_CONSTANT,
    INERTIA,
    LOCKED,
    POLYTROPIC_VOLUME,
    RADIUS,
    STOP,
    SUPPLY,
    TEMPERATURE,
)

ELEMENTS = 4
"""Maxwell-slip elements of a muscle, and branches of its creep."""
SETTLING = 500
"""Samples with the pressures held before a recording begins, so that it begins at rest."""

_FIELDS = """
dahl:2 dahl_width dahl_power slip:2 slip_width slip_pressure slip_fade slip_velocity
seep:2 capillary:2 seam:2 seam_pressure crack:2 regulator inlet tank feed compressor switch
spool:2 line:2 line_turbulent line_volume line_critical
pendulum pendulum_gear pendulum_angle spring spring_angle spring_hardening bumper bumper_gap
bristle bristle_angle bristle_fall rub rub_velocity rub_fall rub_power rub_wave rub_number
creep:2 creep_load creep_time:4 creep_weight:4 gas:2 gas_time gas_flow wall:2 wall_time
tire:2 tire_time tire_work exchange cogging cogging_number swell:2 crosstalk bend:2
check relief:2 relief_at kink:2 kink_way fold:2 jet:2 damping:2 damping_lean engage engage_at way
rope:2 stick stick_at stick_width press press_from lean lean_way dwell dwell_time
loop:2 loop_width hold:2 hold_width relax:2 relax_time relax_back hot:2 hot_time give:2 loose:2 loose_from
ball:2 ball_pressure meter:2 silencer:2 quick:2 quick_from seat:2 lift:2 lift_at lift_band
arm arm_number bulge:2 bulge_from share:2 exponent exponent_time
"""
NUMBERS = np.dtype([(name, np.float64, (int(size),)) if size else (name, np.float64)
                    for name, _, size in (field.partition(":") for field in _FIELDS.split())])  # fmt: skip
"""Numbers of the forms; those of two are of either muscle, those of four of the branches of its creep."""

# States behind [ψ, ψ̇, P_1, P_2].
_LOOP, _ELEMENT, _SUPPLY_AT, _OPEN, _OPENING, _AT_VALVE = 4, 6, 14, 15, 17, 19
_LATE, _WARM, _WALL_WARM, _BRISTLE_AT, _TIRED, _RUNNING, _RESTED = 21, 29, 31, 33, 34, 36, 37
_LOOPED, _HELD, _RELAXED, _HOT, _BLOWN, _DRAWN, _LIFTED, SIZE = 38, 40, 42, 44, 46, 48, 50, 52

_MIDDLE, _HALF_RANGE = 450e3, 250e3
_SPOOL_DAMPING, _REGULATOR_LAG, _MIDDLE_FORCE = 0.7, 0.03, 200.0
_REFERENCE_FLOW = 1e-4
_RELIEF_BAND, _KINKED_AT = 30e3, 0.15
_AT_REST, _FORGOTTEN, _MANIFOLD_LAG, _PRESSURE_RATE = 0.02, 0.03, 0.03, 100e3

_round_leverage, _length, _length_rate = muscle.leverage, muscle.length, muscle.length_rate
_volume, _force, _pressure_rate, _open_rate = muscle.volume, muscle.force, flow.pressure_rate, flow.open_rate
_orifice_flow, _valve_flow, _muscle_torque = flow.orifice_flow, flow.valve_flow, joint.muscle_torque
_coulomb_torque, _acceleration, _stop = joint.coulomb_torque, joint.acceleration, integration.apply_stop


def numbers(values: Mapping[str, float]) -> np.ndarray:
    """The record ``q`` with these numbers.

    ``dahl_1`` is muscle 1's ``dahl``, ``creep_time_0`` the first branch's time. The others are 0, and times, widths and
    volumes something harmless.
    """
    q = np.zeros(1, NUMBERS)
    widths = ("dahl_width", "dahl_power", "slip_width", "slip_velocity", "bristle_angle", "rub_velocity")
    others = ("stick_width", "loop_width", "ball_pressure", "arm_number")
    times = ("gas_time", "wall_time", "tire_time", "creep_time", "dwell_time", "relax_time", "relax_back", "hot_time")
    for name in (*widths, *others, *times, "line_turbulent", "line_volume", "exponent_time"):
        q[name] = 1.0
    q["bristle_fall"] = q["rub_fall"] = 0.4
    for name, value in values.items():
        field, _, place = name.rpartition("_")
        if place.isdigit():
            q[field][0, int(place) - (0 if field.startswith("creep_") else 1)] = value
        else:
            q[name] = value
    return q[0]


@inlined
def _leverage(angle, p, q):
    """Travel of the muscles' ends over r and the lever arm over r; an arm that is not round has waves."""
    sine, cosine, _ = _round_leverage(angle, p)
    if q.arm != 0.0:
        turned = q.arm_number * angle
        sine += q.arm * (1.0 - math.cos(turned)) / q.arm_number
        cosine += q.arm * math.sin(turned)
    return sine, cosine


@inlined
def _dahl_rate(loop, rate, q):
    """Dahl (1968): dz/dt of a loop that bends all the way round, (dl/dt)/s · (1 − z sgn dl/dt)^power."""
    way = 1.0 if rate > 0.0 else -1.0
    return rate / q.dahl_width * max(1.0 - loop * way, 0.0) ** q.dahl_power


@inlined
def _slip_share(i, pressure, rate, x, q):
    """Mean extension of the Maxwell-slip elements of muscle i, each over the length at which it slips [-].

    A braid that a higher pressure loads rubs harder (Davis and Caldwell 2006). In the generalised model (Al-Bender et
    al. 2005) the elements hold less while they slip quickly.
    """
    total = 0.0
    for k in range(ELEMENTS):
        total += x[_ELEMENT + ELEMENTS * i + k] / (q.slip_width * (k + 0.5))
    loaded = 1.0 + q.slip_pressure * (pressure - _MIDDLE) / _HALF_RANGE
    return total / ELEMENTS * loaded * (1.0 - q.slip_fade * (1.0 - math.exp(-abs(rate) / q.slip_velocity)))


@in_place
def _slip(i, travel, x, q):
    """Maxwell slip (Al-Bender et al. 2005): each element follows the length until it slips."""
    for k in range(ELEMENTS):
        at, most = _ELEMENT + ELEMENTS * i + k, q.slip_width * (k + 0.5)
        x[at] = min(max(x[at] + travel, -most), most)


@inlined
def _escaped(i, pressure, muscle_length, p, q):
    """Mass flow of the leaks [kg/s]: linear in the gauge pressure, or in the difference of squares (capillary).

    A seam opens above a pressure, in proportion to what is above it. A crack opens beyond the middle length. A relief
    valve opens above its set pressure, and is wide open within a band.
    """
    outside = p[ATMOSPHERE]
    gauge = pressure - outside
    seam = q.seam[i] * max(pressure - q.seam_pressure, 0.0) * gauge
    crack = q.crack[i] * max(muscle_length - _length(i, 0.0, p), 0.0) * gauge
    lifted = min(max((pressure - q.relief_at) / _RELIEF_BAND, 0.0), 1.0)
    relief = q.relief[i] * lifted * _orifice_flow(pressure, outside, p)
    return q.seep[i] * gauge + q.capillary[i] * (pressure * pressure - outside * outside) + seam + crack + relief


@inlined
def _crossing(pressure_1, pressure_2, p, q):
    """Mass flow from chamber 1 to chamber 2 [kg/s]: in proportion to the difference; through a check valve one way."""
    total = q.exchange * (pressure_1 - pressure_2)
    if q.check != 0.0 and q.way * (pressure_1 - pressure_2) > 0.0:
        high, low = max(pressure_1, pressure_2), min(pressure_1, pressure_2)
        total += q.check * q.way * _orifice_flow(high, low, p)
    return total


@inlined
def _one_way(i, through, drawn, drop, x, q):
    """A valve's flow behind what acts one way, and what it then draws from the supply [kg/s].

    The ball of a check valve opens wholly only where the inlet's pressure falls by much. A throttle hinders the outflow
    the more, the more it is; a silencer as well, and more and more with what it was blown through. A quick exhaust
    opens from a flow on.
    """
    if through > 0.0:
        opened = 1.0 - q.ball[i] * math.exp(-max(drop, 0.0) / q.ball_pressure)
        return opened * through, opened * drawn
    out = -through / _REFERENCE_FLOW
    left = 1.0 / ((1.0 + q.meter[i] * out) * math.sqrt(1.0 + q.silencer[i] * (1.0 + x[_BLOWN + i]) * out * out))
    if q.quick[i] != 0.0 and out > q.quick_from:
        left *= 1.0 + q.quick[i] * (out - q.quick_from) / out
    return left * through, drawn


@inlined
def _stiffened(pressure, rate, q):
    """Factor on Ṗ of a gas whose exponent rises from the isothermal to the adiabatic with the rate."""
    hurry = abs(rate) / pressure * q.exponent_time
    return 1.0 + q.exponent * hurry / (1.0 + hurry)


@in_place
def _remember(i, pressure, rate, through, drawn, x, q, dx):
    """How what muscle i remembers of its pressure, and its valve of the air, moves.

    A loop bends as Dahl's does, in the pressure. What relaxes follows the pressure, and back in another time. Changes
    of the pressure heat the rubber. A silencer clogs with what blows through it.
    """
    if q.loop[i] != 0.0:
        way = 1.0 if rate > 0.0 else -1.0
        dx[_LOOPED + i] = rate / q.loop_width * max(1.0 - x[_LOOPED + i] * way, 0.0)
    if q.relax[i] != 0.0:
        late = pressure - x[_RELAXED + i]
        dx[_RELAXED + i] = late / (q.relax_time if late > 0.0 else q.relax_time * q.relax_back)
    if q.hot[i] != 0.0:
        dx[_HOT + i] = (abs(rate) / _PRESSURE_RATE - x[_HOT + i]) / q.hot_time
    if q.silencer[i] != 0.0:
        dx[_BLOWN + i] = max(-through, 0.0) / _REFERENCE_FLOW
    if q.share[1 - i] != 0.0:
        dx[_DRAWN + i] = (drawn / _REFERENCE_FLOW - x[_DRAWN + i]) / _MANIFOLD_LAG


@inlined
def _ageing(velocity, x, q):
    """How the age of a contact moves: to 1 at rest, quickly to 0 while it slides."""
    if q.dwell == 0.0:
        return 0.0
    return (1.0 - x[_RESTED]) / q.dwell_time if abs(velocity) < _AT_REST else -x[_RESTED] / _FORGOTTEN


@inlined
def _dry(angle, velocity, force_1, force_2, balance, x, p, q):
    """Further dry friction [N m].

    Ropes that slide on their pulleys rub in proportion to their forces. A bearing sticks near an angle. A bush is
    pressed out of its play from a load on, and rubs more. A seal's lip leans, and rubs one way only. A contact ages
    at rest.
    """
    total = p[RADIUS] * (q.rope[0] * max(force_1, 0.0) + q.rope[1] * max(force_2, 0.0))
    if q.stick != 0.0:
        beside = (angle - q.stick_at) / q.stick_width
        total += q.stick * math.exp(-beside * beside)
    total += q.press * max(force_1 + force_2 - q.press_from, 0.0) / _MIDDLE_FORCE
    if q.lean != 0.0 and q.lean_way * (velocity + p[FRICTION_STEP] / p[INERTIA] * balance) > 0.0:
        total += q.lean
    return total + q.dwell * x[_RESTED]


@inlined
def _passing(i, angle, q):
    """Share of the valve's flow that a hose lets pass: a tube flattens with its curvature squared (Brazier 1927)."""
    bend = min(max(q.kink_way * angle, 0.0) / _KINKED_AT, 1.0)
    return 1.0 - q.kink[i] * bend * bend


@inlined
def _supply_rate(deviation, drawn, running, p, q):
    """How the supply's deviation s [Pa] from its set pressure moves [Pa/s].

    A regulator drops with the root of the flow, a line in front of the valves with its square; a tank of volume V is
    refilled through an orifice, or by a compressor that is running or not.
    """
    if q.regulator != 0.0 or q.inlet != 0.0:
        ratio = max(drawn, 0.0) / _REFERENCE_FLOW
        drop = q.regulator * math.sqrt(ratio) + q.inlet * ratio * ratio
        return (-drop - deviation) / _REGULATOR_LAG
    if q.compressor != 0.0:
        return q.compressor * (2.0 * running - drawn / _REFERENCE_FLOW)
    if q.tank != 0.0:
        refill = q.feed * _orifice_flow(p[SUPPLY], p[SUPPLY] + deviation, p)
        return q.tank * p[GAS_CONSTANT] * p[TEMPERATURE] * (refill - drawn)
    return 0.0


@inlined
def _line_flow(i, upper, lower, q):
    """Mass flow [kg/s] through a line: ΔP = R m (1 + |m|/m_0), solved for m.

    A fitting whose flow chokes (ISO 6358) gets no more once the ratio of the pressures falls below the critical one.
    """
    high, low = max(upper, lower), min(upper, lower)
    if q.line_critical != 0.0:
        low = max(low, q.line_critical * high)
    reference = q.line_turbulent
    root = math.sqrt(1.0 + 4.0 * (high - low) / (q.line[i] * reference))
    size = 0.5 * reference * (root - 1.0)
    return size if upper > lower else -size


@inlined
def _load(angle, q):
    """Torque of the loads [N m]: a geared pendulum whose rest is not at 0, a spring that hardens, bumpers, cogging.

    A spring that engages acts beyond an angle on one side.
    """
    stretch = angle - q.spring_angle
    pull = q.spring * stretch * (1.0 + q.spring_hardening * stretch * stretch)
    deep = max(abs(angle) - q.bumper_gap, 0.0)
    pull += q.bumper * deep * math.sqrt(deep) * (1.0 if angle > 0.0 else -1.0)
    pull += q.engage * q.way * max(q.way * angle - q.engage_at, 0.0)
    return (
        q.pendulum * math.sin(q.pendulum_gear * angle - q.pendulum_angle)
        - pull
        - q.cogging * math.sin(q.cogging_number * angle)
    )


@inlined
def _rubbing(angle, velocity, q):
    """Friction [N m] of a level at rest, and less of it at speed; a gear's goes round.

    It falls as 1/(1 + (v/w)²) by Hess and Soom (1990), as exp(−|v/w|^power) by Bo and Pavelescu (1982): the power is 2
    for the curve that is named after Stribeck.
    """
    ratio = abs(velocity) / q.rub_velocity
    wave = 1.0 + q.rub_wave * math.sin(q.rub_number * angle)
    power = q.rub_power
    left = math.exp(-(ratio**power)) if power != 0.0 else 1.0 / (1.0 + ratio * ratio)
    return q.rub * wave * (1.2 - q.rub_fall + q.rub_fall * left)


@inlined
def _late_force(i, static, x, q):
    """Force of a muscle [N], less by what it is tired, some of whose share comes late, in branches of their own."""
    total = static * (1.0 - q.tire[i] * x[_TIRED + i])
    if q.creep[i] != 0.0:
        for k in range(ELEMENTS):
            total += q.creep[i] * q.creep_weight[k] * (x[_LATE + ELEMENTS * i + k] - static)
    return total


@inlined
def _contraction_force(i, sine, cosine, pressure, x, q, p):
    """Contraction force of muscle i [N], forms included.

    A contracting element is damped by the pressure, otherwise while it gets longer than while it gets shorter (Reynolds
    et al. 2003). A tendon that gives lets its muscle be shorter. A short muscle hangs loose, and pulls less. Force also
    lags or leads the pressure, in a loop, by play, or while it relaxes, and a hot muscle is weaker.
    """
    at = _length(i, sine, p)
    static, rate = _force(i, at, pressure, p), _length_rate(i, cosine, x[1], p)
    if q.give[i] != 0.0:
        static = _force(i, at - q.give[i] * static, pressure, p)
    bent = (pressure - _MIDDLE) / _HALF_RANGE
    total = _late_force(i, static, x, q) + q.dahl[i] * x[_LOOP + i] + q.bend[i] * bent * bent
    if q.slip[i] != 0.0:
        total += q.slip[i] * _slip_share(i, pressure, rate, x, q)
    if q.damping[i] != 0.0:
        lean = q.damping_lean if rate > 0.0 else -q.damping_lean
        total += q.damping[i] * pressure / _MIDDLE * rate * (1.0 + lean)
    if q.hold[i] != 0.0:
        total += q.hold[i] * (x[_HELD + i] - pressure) / _HALF_RANGE
    if q.relax[i] != 0.0:
        total += q.relax[i] * (pressure - x[_RELAXED + i]) / _HALF_RANGE
    if q.loose[i] != 0.0:
        lost = q.loose[i] * max(_length(i, 0.0, p) - q.loose_from - at, 0.0)
        total -= min(lost, max(total, 0.0))
    return total * (1.0 - q.hot[i] * x[_HOT + i]) - q.loop[i] * x[_LOOPED + i]


@inlined
def _cooling(i, pressure, rate, through, x, q, dx):
    """What Ṗ loses to the walls [Pa/s]; the states of the gas in ``dx``.

    By an energy balance the warmth θ/T − 1 follows dP/P and cools with a time that grows with the mass of gas,
    so with the pressure; air that streams in or out cools it quicker (forced convection). With a wall of its own
    warmth, gas, wall and surroundings exchange heat one after the other.
    """
    lost = 0.0
    warm = x[_WARM + i]
    if q.gas[i] != 0.0:
        fall = warm / (q.gas_time * pressure / _MIDDLE) * (1.0 + q.gas_flow * abs(through) / _REFERENCE_FLOW)
        dx[_WARM + i] = q.gas[i] * (1.0 + warm) * rate / pressure - fall
        lost = pressure / (1.0 + warm) * fall
    if q.wall[i] != 0.0:
        wall = x[_WALL_WARM + i]
        fall = (warm - wall) / q.wall_time
        dx[_WARM + i] = q.wall[i] * rate - fall
        dx[_WALL_WARM + i] = 0.5 * fall - wall / (6.0 * q.wall_time)
        lost = fall
    return lost


@in_place
def rates(x, wanted, push, supply_change, p, q, dx):
    """All rates dx (SIZE,) of a joint in state x, by the open rates (2,) that are asked for and a torque [N m]."""
    dx[:] = 0.0
    angle, velocity = x[0], x[1]
    if angle >= p[STOP]:
        velocity = min(velocity, 0.0)
    elif angle <= -p[STOP]:
        velocity = max(velocity, 0.0)
    sine, cosine = _leverage(angle, p, q)
    supply = p[SUPPLY] + supply_change + x[_SUPPLY_AT]
    drawn_in_all = 0.0
    crossing = _crossing(x[2], x[3], p, q)
    for i in range(2):
        chamber = x[2 + i]
        at_valve = x[_AT_VALVE + i] if q.line[i] != 0.0 else chamber
        alpha = wanted[i]
        if q.spool[i] != 0.0:
            omega = q.spool[i]
            alpha = x[_OPEN + i]
            dx[_OPEN + i] = x[_OPENING + i]
            dx[_OPENING + i] = omega * (omega * (wanted[i] - alpha) - 2.0 * _SPOOL_DAMPING * x[_OPENING + i])
        alpha += q.crosstalk * (wanted[1 - i] - 0.4) - q.jet[i] * (at_valve - _MIDDLE) / _HALF_RANGE
        alpha = min(max(alpha, 0.0), 1.0)
        # Both draw through one line, in which the other one's draw is felt.
        inlet = supply - q.share[i] * x[_DRAWN + 1 - i]
        through, drawn = _valve_flow(i, alpha, at_valve, inlet, p)
        passing = _passing(i, angle, q)
        through, drawn = passing * through, passing * drawn
        through, drawn = _one_way(i, through, drawn, inlet - at_valve, x, q)
        drawn_in_all += drawn
        muscle_length, length_rate = _length(i, sine, p), _length_rate(i, cosine, velocity, p)
        volume, slope = _volume(i, muscle_length, p)
        unfolded = max(muscle_length - _length(i, 0.0, p), 0.0)
        volume += q.fold[i] * unfolded * unfolded
        slope += 2.0 * q.fold[i] * unfolded
        bulged = max(_length(i, 0.0, p) - q.bulge_from - muscle_length, 0.0)
        volume += q.bulge[i] * bulged * bulged * bulged
        slope -= 3.0 * q.bulge[i] * bulged * bulged
        arriving = through
        if q.line[i] != 0.0:
            arriving = _line_flow(i, at_valve, chamber, q)
            dx[_AT_VALVE + i] = _pressure_rate(at_valve, q.line_volume, 0.0, through - arriving, p)
        net = arriving - _escaped(i, chamber, muscle_length, p, q) - (crossing if i == 0 else -crossing)
        net += q.seat[i] * (inlet - chamber) - q.lift[i] * x[_LIFTED + i] * (chamber - p[ATMOSPHERE])
        swelling = q.swell[i] / _HALF_RANGE
        swollen = volume * (1.0 + swelling * (chamber - _MIDDLE))
        rate = _pressure_rate(chamber, swollen, slope * length_rate, net, p)
        # The volume that grows with the pressure takes its share of every change of it.
        rate /= 1.0 + p[POLYTROPIC_VOLUME] * volume * swelling * chamber / swollen
        rate *= _stiffened(chamber, rate, q)
        dx[2 + i] = rate - _cooling(i, chamber, rate, net, x, q, dx)
        _remember(i, chamber, dx[2 + i], through, drawn, x, q, dx)
        if q.dahl[i] != 0.0:
            dx[_LOOP + i] = _dahl_rate(x[_LOOP + i], length_rate, q)
        if q.creep[i] != 0.0:
            static = _force(i, muscle_length, chamber, p)
            # Rubber relaxes quicker under load (Schapery 1969).
            hurry = (max(static, 10.0) / _MIDDLE_FORCE) ** q.creep_load
            for k in range(ELEMENTS):
                dx[_LATE + ELEMENTS * i + k] = (static - x[_LATE + ELEMENTS * i + k]) / q.creep_time[k] * hurry
        if q.tire[i] != 0.0:
            work = abs(_force(i, muscle_length, chamber, p) * length_rate)
            gain = work / q.tire_work if q.tire_work != 0.0 else 1.0 / q.tire_time
            dx[_TIRED + i] = gain - x[_TIRED + i] / q.tire_time
    dx[_SUPPLY_AT] = _supply_rate(x[_SUPPLY_AT], drawn_in_all, x[_RUNNING], p, q)
    if p[LOCKED] != 0.0:
        return
    force_1 = _contraction_force(0, sine, cosine, x[2], x, q, p)
    force_2 = _contraction_force(1, sine, cosine, x[3], x, q, p)
    coulomb = _coulomb_torque(force_1, force_2, x[2], x[3], p) + _rubbing(angle, velocity, q)
    balance = _muscle_torque(cosine, force_1, force_2, p) + push + _load(angle, q)
    coulomb += _dry(angle, velocity, force_1, force_2, balance, x, p, q)
    dx[_RESTED] = _ageing(velocity, x, q)
    if q.bristle != 0.0:
        # Bristles (Canudas de Wit et al. 1995): a spring that slips, with a Stribeck level, and its damping.
        level = 1.0 + q.bristle_fall * math.exp(-abs(velocity) / 0.1)
        bend = velocity - abs(velocity) * x[_BRISTLE_AT] / (q.bristle_angle * level)
        dx[_BRISTLE_AT] = bend
        balance -= q.bristle / q.bristle_angle * (x[_BRISTLE_AT] + 2e-3 * bend)
    dx[0] = velocity
    dx[1], _ = _acceleration(angle, velocity, balance, coulomb, p)


@in_place
def _step(x, wanted, push, supply_change, p, q, dt, slopes, point):
    """One Runge-Kutta step in place, then what slips and the stop."""
    sine, _ = _leverage(x[0], p, q)
    rates(x, wanted, push, supply_change, p, q, slopes[0])
    for stage in range(1, 4):
        reach = dt if stage == 3 else 0.5 * dt
        for i in range(SIZE):
            point[i] = x[i] + reach * slopes[stage - 1, i]
        rates(point, wanted, push, supply_change, p, q, slopes[stage])
    for i in range(SIZE):
        x[i] += dt / 6.0 * (slopes[0, i] + 2.0 * (slopes[1, i] + slopes[2, i]) + slopes[3, i])
    _stop(x, p)
    if q.compressor != 0.0 and abs(x[_SUPPLY_AT]) > 0.5 * q.switch:
        # Between the switch's two pressures it goes on as it is.
        x[_RUNNING] = 1.0 if x[_SUPPLY_AT] < 0.0 else 0.0
    if q.slip[0] != 0.0 or q.slip[1] != 0.0:
        after, _ = _leverage(x[0], p, q)
        for i in range(2):
            _slip(i, _length(i, after, p) - _length(i, sine, p), x, q)
    for i in range(2):
        x[_HELD + i] = min(max(x[_HELD + i], x[2 + i] - q.hold_width), x[2 + i] + q.hold_width)
        if x[2 + i] > q.lift_at:
            x[_LIFTED + i] = 1.0
        elif x[2 + i] < q.lift_at - q.lift_band:
            x[_LIFTED + i] = 0.0


@kernel
def simulate(angle, pressure, voltage, push, supply_change, p, q, dt, substeps):
    """The joint from rest, driven by voltages (N · substeps, 2) [V], a push (N,) [N m] and a change of the supply [Pa].

    A free joint first settles for SETTLING samples while the pressures are held. In `p`, ``friction.time_step`` is the
    substep. Returns angle (N,) [rad], pressures at the sensors (N, 2) [Pa], torque of the muscles (N,) [N m].
    """
    samples = push.shape[0]
    x = np.zeros(SIZE)
    x[0] = angle
    slopes, point, wanted = np.zeros((4, SIZE)), np.zeros(SIZE), np.zeros(2)
    for i in range(2):
        x[2 + i] = x[_AT_VALVE + i] = pressure
        x[_OPEN + i] = wanted[i] = _open_rate(i, voltage[0, i], p)
        x[_HELD + i] = x[_RELAXED + i] = pressure
        sine, _ = _leverage(angle, p, q)
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
        sine, cosine = _leverage(x[0], p, q)
        angles[k] = x[0]
        for i in range(2):
            pressures[k, i] = x[_AT_VALVE + i] if q.line[i] != 0.0 else x[2 + i]
        force_1 = _contraction_force(0, sine, cosine, x[2], x, q, p)
        force_2 = _contraction_force(1, sine, cosine, x[3], x, q, p)
        torques[k] = _muscle_torque(cosine, force_1, force_2, p)
    return angles, pressures, torques
