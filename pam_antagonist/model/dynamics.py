"""The state-space model, equations (1) and (11): derivative, Runge-Kutta step, output, subsystem.

State ``x = [ψ, ψ̇, P_1, P_2]`` [rad, rad/s, Pa, Pa], input ``u = [u_1, u_2]`` [V], parameters ``p``
(:mod:`pam_antagonist.model.parameters`). Arguments come in the order state, input, parameters, step.
"""

from __future__ import annotations

import numpy as np

from pam_antagonist._jit import inlined, kernel
from pam_antagonist.model import flow, joint, muscle
from pam_antagonist.model.parameters import (
    BASE_STATES,
    LOCKED,
    PLAIN,
    SLOT_OF,
    STATELESS_EFFECTS,
    STOP,
    SUPPLY,
)

ANGLE, VELOCITY, PRESSURE_1, PRESSURE_2 = 0, 1, 2, 3
_LOOP, _LATE, _OPEN_RATE = SLOT_OF["hysteresis_1"], SLOT_OF["creep_1"], SLOT_OF["open_rate_1"]
_CHAMBER, _WARMTH = SLOT_OF["chamber_1"], SLOT_OF["warmth_1"]
_SUPPLY, _EXTERNAL = SLOT_OF["supply"], SLOT_OF["external_torque"]

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_leverage, _length, _length_rate, _volume = muscle.leverage, muscle.length, muscle.length_rate, muscle.volume
_force, _force_length_slope, _loaded_force = muscle.force, muscle.force_length_slope, muscle.loaded_force
_linear_force = muscle.linear_force
_hysteresis_rate, _creep_rate = muscle.hysteresis_rate, muscle.creep_rate
_relaxing_force = muscle.relaxing_force
_valve_flow, _leak_flow, _pressure_rate = flow.valve_flow, flow.leak_flow, flow.pressure_rate
_open_rate, _flow_regime = flow.open_rate, flow.flow_regime
_warmth_rates, _droop_rate, _valve_rate, _line_rate = (
    flow.warmth_rates,
    flow.droop_rate,
    flow.valve_rate,
    flow.line_rate,
)
_muscle_torque, _coulomb_torque, _acceleration = joint.muscle_torque, joint.coulomb_torque, joint.acceleration
_extra_coulomb_torque, _load_torque = joint.extra_coulomb_torque, joint.load_torque


@inlined
def _added(state, x, p, otherwise):
    """Value of an added state, by its place in ``p``, or what stands for it where ``x`` does not hold it."""
    # Most states are absent: nothing is converted for those, and an index without sign need not be turned round.
    at = p[state]
    if at > 0.0 and at < x.shape[0]:
        return x[np.uint64(at)]
    return otherwise


@inlined
def _chamber_pressure(i, x, p):
    """Pressure in the chamber of muscle i: the sensor's, but behind a line with resistance."""
    return _added(_CHAMBER + i, x, p, x[PRESSURE_1 + i])


@inlined
def _muscle_force(i, sine, x, p):
    """Contraction force of muscle i of a state, effects included."""
    muscle_length = _length(i, sine, p)
    static = _force(i, muscle_length, _chamber_pressure(i, x, p), p)
    if x.shape[0] == BASE_STATES:
        return static
    relaxing = _relaxing_force(i, muscle_length, static, p)
    return _loaded_force(i, static, _added(_LOOP + i, x, p, 0.0), relaxing, _added(_LATE + i, x, p, relaxing), p)


@inlined
def forces(x, p):
    """Contraction forces F_1, F_2 [N] of a state."""
    sine, _, _ = _leverage(x[ANGLE], p)
    return _muscle_force(0, sine, x, p), _muscle_force(1, sine, x, p)


@inlined
def torque(x, p):
    """τ [N m] of a state, the last row of equation (11b)."""
    force_1, force_2 = forces(x, p)
    _, cosine, _ = _leverage(x[ANGLE], p)
    return _muscle_torque(cosine, force_1, force_2, p)


@inlined
def torque_slope(x, p):
    """Joint stiffness ∂τ/∂ψ [N m/rad] at constant pressures, from (2), (6), (7) and (9)."""
    force_1, force_2 = forces(x, p)
    sine, cosine, bend = _leverage(x[ANGLE], p)
    # ∂l_1/∂ψ = −r cos ψ and ∂l_2/∂ψ = +r cos ψ, through the same functions as everywhere.
    slope_1 = _force_length_slope(0, _length(0, sine, p), _chamber_pressure(0, x, p), p)
    slope_2 = _force_length_slope(1, _length(1, sine, p), _chamber_pressure(1, x, p), p)
    slope_1 *= _length_rate(0, cosine, 1.0, p)
    slope_2 *= _length_rate(1, cosine, 1.0, p)
    return _muscle_torque(cosine, slope_1, slope_2, p) + _muscle_torque(bend, force_1, force_2, p)


@inlined
def _stopped(angle, velocity, p):
    """The velocity, or none into a stop that is reached: without this, the volumes would go on changing there."""
    if angle >= p[STOP]:
        return min(velocity, 0.0)
    if angle <= -p[STOP]:
        return max(velocity, 0.0)
    return velocity


@inlined
def _air(i, alpha, pressure, chamber, muscle_length, length_rate, supply, p, plain):
    """Equations (3) to (5) of one muscle: Ṗ of the chamber, mass flow through the valve and out of the supply."""
    volume, volume_slope = _volume(i, muscle_length, p)
    passed, drawn = _valve_flow(i, alpha, pressure, supply, p)
    net = passed
    if not plain and p[STATELESS_EFFECTS] != 0.0:
        net -= _leak_flow(i, chamber, p)
    return _pressure_rate(chamber, volume, volume_slope * length_rate, net, p), passed, drawn


@inlined
def _motion(angle, velocity, sine, cosine, force_1, force_2, chamber_1, chamber_2, external, p, plain):
    """Equations (8) to (10): ψ̈, and whether the joint slides."""
    coulomb = _coulomb_torque(force_1, force_2, chamber_1, chamber_2, p)
    balance = _muscle_torque(cosine, force_1, force_2, p) + external
    if not plain and p[STATELESS_EFFECTS] != 0.0:
        coulomb = max(coulomb + _extra_coulomb_torque(velocity, p), 0.0)
        balance += _load_torque(sine, p)
    return _acceleration(angle, velocity, balance, coulomb, p, plain)


@inlined
def _slopes(angle, velocity, pressure_1, pressure_2, alpha_1, alpha_2, external, p, plain):
    """The rows of equation (11a) without added states, in scalars: a sigma point passes through registers, not memory.

    ``plain`` is a literal: a rig without options and effects is spared their branches.
    """
    velocity = _stopped(angle, velocity, p)
    sine, cosine, _ = _leverage(angle, p)
    length_1 = _length(0, sine, p)
    length_2 = _length(1, sine, p)
    supply = p[SUPPLY]
    rate_1, _, _ = _air(
        0, alpha_1, pressure_1, pressure_1, length_1, _length_rate(0, cosine, velocity, p), supply, p, plain
    )
    rate_2, _, _ = _air(
        1, alpha_2, pressure_2, pressure_2, length_2, _length_rate(1, cosine, velocity, p), supply, p, plain
    )
    if p[LOCKED] != 0.0:
        return 0.0, 0.0, rate_1, rate_2
    force_1 = _linear_force(0, length_1, pressure_1, p) if plain else _force(0, length_1, pressure_1, p)
    force_2 = _linear_force(1, length_2, pressure_2, p) if plain else _force(1, length_2, pressure_2, p)
    acceleration, _ = _motion(
        angle, velocity, sine, cosine, force_1, force_2, pressure_1, pressure_2, external, p, plain
    )
    return velocity, acceleration, rate_1, rate_2


@kernel
def _rows(x, wanted_1, wanted_2, external, p, dx):
    """All rows with any added states; the same functions as in :func:`_slopes`, put together for every case.

    Args:
        x: state (n,).
        wanted_1: open rate [-] that the voltage of valve 1 asks for.
        wanted_2: likewise of valve 2.
        external: torque [N m] from outside that is known.
        p: parameter vector.
        dx: result (n,).
    """
    velocity = _stopped(x[ANGLE], x[VELOCITY], p)
    sine, cosine, _ = _leverage(x[ANGLE], p)
    supply = p[SUPPLY] + _added(_SUPPLY, x, p, 0.0)
    consumption = 0.0
    for i in range(2):
        sensed, chamber = x[PRESSURE_1 + i], _chamber_pressure(i, x, p)
        muscle_length, length_rate = _length(i, sine, p), _length_rate(i, cosine, velocity, p)
        wanted = wanted_1 if i == 0 else wanted_2
        alpha = _added(_OPEN_RATE + i, x, p, wanted)
        rate, passed, drawn = _air(i, alpha, sensed, chamber, muscle_length, length_rate, supply, p, False)
        consumption += drawn
        at = int(p[_WARMTH + i])
        if at > 0:
            dx[at], cooling = _warmth_rates(i, x[at], rate, p)
            rate -= cooling
        dx[PRESSURE_1 + i] = rate
        at = int(p[_CHAMBER + i])
        if at > 0:
            dx[at] = rate
            dx[PRESSURE_1 + i] = _line_rate(i, sensed, chamber, passed, p)
        at = int(p[_OPEN_RATE + i])
        if at > 0:
            dx[at] = _valve_rate(i, alpha, wanted, p)
        at = int(p[_LOOP + i])
        if at > 0:
            dx[at] = _hysteresis_rate(x[at], length_rate, p)
        at = int(p[_LATE + i])
        if at > 0:
            static = _force(i, muscle_length, chamber, p)
            dx[at] = _creep_rate(x[at], _relaxing_force(i, muscle_length, static, p), p)
    at = int(p[_SUPPLY])
    if at > 0:
        dx[at] = _droop_rate(x[at], consumption, p)
    at = int(p[_EXTERNAL])
    if at > 0:
        dx[at] = 0.0
        external += x[at]
    if p[LOCKED] != 0.0:
        dx[ANGLE] = 0.0
        dx[VELOCITY] = 0.0
        return
    force_1, force_2 = _muscle_force(0, sine, x, p), _muscle_force(1, sine, x, p)
    dx[ANGLE] = velocity
    dx[VELOCITY], _ = _motion(
        x[ANGLE], velocity, sine, cosine, force_1, force_2, _chamber_pressure(0, x, p), _chamber_pressure(1, x, p),
        external, p, False,
    )  # fmt: skip


@inlined
def _outside(u):
    """External torque [N m] of an input that has one."""
    return u[2] if u.shape[0] > 2 else 0.0


@kernel
def derivative(x, u, p, dx):
    """ẋ = f_σ(x, u), equation (11a), with the rows of the states that effects add.

    Args:
        x: state (n,), n = p[parameters.STATES].
        u: valve voltages [V], and where it is known the torque from outside [N m]; (2,) or (3,).
        p: parameter vector.
        dx: result (n,), written in place.
    """
    _rows(x, _open_rate(0, u[0], p), _open_rate(1, u[1], p), _outside(u), p, dx)


@inlined
def _stop(x, p):
    """The mechanical stop, an inelastic impact: the angle is held at ±``joint.stop``, the velocity into it is lost."""
    stop = p[STOP]
    if x[ANGLE] >= stop:
        x[ANGLE] = stop
        x[VELOCITY] = min(x[VELOCITY], 0.0)
    elif x[ANGLE] <= -stop:
        x[ANGLE] = -stop
        x[VELOCITY] = max(x[VELOCITY], 0.0)


@kernel
def _extended_step(x, u, p, dt, result):
    """:func:`rk4_step` with any number of states."""
    n = x.shape[0]
    wanted_1, wanted_2 = _open_rate(0, u[0], p), _open_rate(1, u[1], p)
    external = _outside(u)
    # One piece of memory: to ask for it takes as long as a good part of the step.
    memory = np.empty((5, n))
    slopes, point = memory[:4], memory[4]
    _rows(x, wanted_1, wanted_2, external, p, slopes[0])
    for stage in range(1, 4):
        reach = dt if stage == 3 else 0.5 * dt
        for i in range(n):
            point[i] = x[i] + reach * slopes[stage - 1, i]
        _rows(point, wanted_1, wanted_2, external, p, slopes[stage])
    sixth = dt / 6.0
    for i in range(n):
        result[i] = x[i] + sixth * (slopes[0, i] + 2.0 * (slopes[1, i] + slopes[2, i]) + slopes[3, i])
    _stop(result, p)


@inlined
def _scalar_step(x, u, p, dt, result, plain):
    """:func:`rk4_step` without added states."""
    alpha_1 = _open_rate(0, u[0], p)
    alpha_2 = _open_rate(1, u[1], p)
    e = _outside(u)
    half = 0.5 * dt
    a, b, c, d = x[ANGLE], x[VELOCITY], x[PRESSURE_1], x[PRESSURE_2]
    a1, b1, c1, d1 = _slopes(a, b, c, d, alpha_1, alpha_2, e, p, plain)
    a2, b2, c2, d2 = _slopes(a + half * a1, b + half * b1, c + half * c1, d + half * d1, alpha_1, alpha_2, e, p, plain)
    a3, b3, c3, d3 = _slopes(a + half * a2, b + half * b2, c + half * c2, d + half * d2, alpha_1, alpha_2, e, p, plain)
    a4, b4, c4, d4 = _slopes(a + dt * a3, b + dt * b3, c + dt * c3, d + dt * d3, alpha_1, alpha_2, e, p, plain)
    sixth = dt / 6.0
    result[ANGLE] = a + sixth * (a1 + 2.0 * (a2 + a3) + a4)
    result[VELOCITY] = b + sixth * (b1 + 2.0 * (b2 + b3) + b4)
    result[PRESSURE_1] = c + sixth * (c1 + 2.0 * (c2 + c3) + c4)
    result[PRESSURE_2] = d + sixth * (d1 + 2.0 * (d2 + d3) + d4)
    _stop(result, p)


@kernel
def _optional_step(x, u, p, dt, result):
    """:func:`rk4_step` with options or effects, but without added states."""
    _scalar_step(x, u, p, dt, result, False)


@kernel
def rk4_step(x, u, p, dt, result):
    """One step of the fourth-order Runge-Kutta method with the input held, then the mechanical stop.

    Args:
        x: state (n,), not changed unless it is also ``result``.
        u: valve voltages [V] over the step, and where it is known the torque from outside [N m]; (2,) or (3,).
        p: parameter vector.
        dt: step [s].
        result: state after the step (n,).
    """
    if p[PLAIN] != 0.0:
        _scalar_step(x, u, p, dt, result, True)
    elif x.shape[0] == BASE_STATES:
        _optional_step(x, u, p, dt, result)
    else:
        _extended_step(x, u, p, dt, result)


@inlined
def subsystem(x, p):
    """Index σ of the subsystem that is active, 1 to 18.

    σ = 1 + 6 a + 2 b + c with the flow regimes a, b of muscles 1 and 2 (0: only the inflow choked,
    1: both, 2: only the outflow) and c = 1 where the joint slides.

    Args:
        x: state (n,).
        p: parameter vector.
    """
    slides = 0.0
    if p[LOCKED] == 0.0:
        force_1, force_2 = forces(x, p)
        sine, cosine, _ = _leverage(x[ANGLE], p)
        _, slides = _motion(
            x[ANGLE], x[VELOCITY], sine, cosine, force_1, force_2,
            _chamber_pressure(0, x, p), _chamber_pressure(1, x, p), _added(_EXTERNAL, x, p, 0.0), p, False,
        )  # fmt: skip
    regimes = 6 * _flow_regime(x[PRESSURE_1], p) + 2 * _flow_regime(x[PRESSURE_2], p)
    return 1 + regimes + (1 if slides > 0.0 else 0)


@kernel
def course(x0, voltage, p, dt, substeps):
    """The model alone, driven by recorded voltages: states and torques, which is all that a fit compares.

    Args:
        x0: state (n,) at the first sample.
        voltage: (N, 2) [V], or (N, 3) with the torque from outside [N m]; row k holds over the step that ends at
            sample k, row 0 is not used.
        p: parameter vector.
        dt: sample period [s].
        substeps: Runge-Kutta steps a sample.

    Returns:
        States (N, n) and torques (N,) [N m].
    """
    samples = voltage.shape[0]
    states = np.empty((samples, x0.shape[0]))
    torques = np.empty(samples)
    x = x0.copy()
    for k in range(samples):
        if k > 0:
            for _ in range(substeps):
                rk4_step(x, voltage[k], p, dt / substeps, x)
        states[k] = x
        torques[k] = torque(x, p)
    return states, torques


@kernel
def simulate(x0, voltage, p, dt, substeps):
    """:func:`course`, and the subsystems (N,) that it passed through; same arguments."""
    states, torques = course(x0, voltage, p, dt, substeps)
    sigma = np.empty(states.shape[0], dtype=np.int64)
    for k in range(states.shape[0]):
        sigma[k] = subsystem(states[k], p)
    return states, torques, sigma
