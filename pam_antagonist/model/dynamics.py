"""The state-space model, equations (1) and (11): derivative, Runge-Kutta step, output, subsystem.

State ``x = [ψ, ψ̇, P_1, P_2]`` [rad, rad/s, Pa, Pa], input ``u = [u_1, u_2]`` [V], parameters ``p``
(:mod:`pam_antagonist.model.parameters`). Arguments come in the order state, input, parameters, step.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import inlined, kernel
from pam_antagonist.model import flow, joint, muscle
from pam_antagonist.model.parameters import LOCKED, STIFFNESS, STOP

ANGLE, VELOCITY, PRESSURE_1, PRESSURE_2 = 0, 1, 2, 3
STATES = 4

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_length, _length_rate, _volume, _force = muscle.length, muscle.length_rate, muscle.volume, muscle.force
_force_length_slope = muscle.force_length_slope
_mass_flow, _pressure_rate, _flow_regime = flow.mass_flow, flow.pressure_rate, flow.flow_regime
_open_rate = flow.open_rate
_muscle_torque, _coulomb_torque, _acceleration = joint.muscle_torque, joint.coulomb_torque, joint.acceleration


@inlined
def forces(x, p):
    """Contraction forces F_1, F_2 [N] of a state."""
    sine = math.sin(x[ANGLE])
    return _force(0, _length(0, sine, p), x[PRESSURE_1], p), _force(1, _length(1, sine, p), x[PRESSURE_2], p)


@inlined
def torque(x, p):
    """τ [N m] of a state, the last row of equation (11b)."""
    force_1, force_2 = forces(x, p)
    return _muscle_torque(math.cos(x[ANGLE]), force_1, force_2, p)


@inlined
def torque_slope(x, p):
    """Joint stiffness ∂τ/∂ψ [N m/rad] at constant pressures, from (2), (6), (7) and (9)."""
    force_1, force_2 = forces(x, p)
    cosine = math.cos(x[ANGLE])
    # ∂l_1/∂ψ = −r cos ψ and ∂l_2/∂ψ = +r cos ψ, through the same functions as everywhere.
    slope_1 = _force_length_slope(0, x[PRESSURE_1], p) * _length_rate(0, cosine, 1.0, p)
    slope_2 = _force_length_slope(1, x[PRESSURE_2], p) * _length_rate(1, cosine, 1.0, p)
    bending = _muscle_torque(-math.sin(x[ANGLE]), force_1, force_2, p)
    return _muscle_torque(cosine, slope_1, slope_2, p) + bending


@inlined
def _slopes(angle, velocity, pressure_1, pressure_2, alpha_1, alpha_2, p):
    """The four rows of equation (11a), in scalars: a sigma point passes through registers, not memory."""
    # Pressed against the stop, the joint stands: without this, the volumes would go on changing there.
    if angle >= p[STOP]:
        velocity = min(velocity, 0.0)
    elif angle <= -p[STOP]:
        velocity = max(velocity, 0.0)
    sine = math.sin(angle)
    cosine = math.cos(angle)
    length_1 = _length(0, sine, p)
    length_2 = _length(1, sine, p)
    volume_1, volume_slope_1 = _volume(0, length_1, p)
    volume_2, volume_slope_2 = _volume(1, length_2, p)
    volume_rate_1 = volume_slope_1 * _length_rate(0, cosine, velocity, p)
    volume_rate_2 = volume_slope_2 * _length_rate(1, cosine, velocity, p)
    rate_1 = _pressure_rate(pressure_1, volume_1, volume_rate_1, _mass_flow(0, alpha_1, pressure_1, p), p)
    rate_2 = _pressure_rate(pressure_2, volume_2, volume_rate_2, _mass_flow(1, alpha_2, pressure_2, p), p)
    if p[LOCKED] != 0.0:
        return 0.0, 0.0, rate_1, rate_2
    force_1 = _force(0, length_1, pressure_1, p)
    force_2 = _force(1, length_2, pressure_2, p)
    coulomb = _coulomb_torque(force_1, force_2, pressure_1, pressure_2, p)
    balance = _muscle_torque(cosine, force_1, force_2, p)
    acceleration, _ = _acceleration(angle, velocity, balance, coulomb, p)
    return velocity, acceleration, rate_1, rate_2


@kernel
def derivative(x, u, p, dx):
    """ẋ = f_σ(x, u), equation (11a).

    Args:
        x: state (4,).
        u: valve voltages (2,) [V].
        p: parameter vector.
        dx: result (4,), written in place.
    """
    dx[ANGLE], dx[VELOCITY], dx[PRESSURE_1], dx[PRESSURE_2] = _slopes(
        x[ANGLE], x[VELOCITY], x[PRESSURE_1], x[PRESSURE_2], _open_rate(0, u[0], p), _open_rate(1, u[1], p), p
    )


@kernel
def rk4_step(x, u, p, dt, result):
    """One step of the fourth-order Runge-Kutta method with the input held, then the mechanical stop.

    The stop is an inelastic impact: the angle is held at ±``joint.stop`` and the velocity into it is lost.

    Args:
        x: state (4,), not changed unless it is also ``result``.
        u: valve voltages (2,) [V] over the step.
        p: parameter vector.
        dt: step [s].
        result: state after the step (4,).
    """
    alpha_1 = _open_rate(0, u[0], p)
    alpha_2 = _open_rate(1, u[1], p)
    half = 0.5 * dt
    a, b, c, d = x[ANGLE], x[VELOCITY], x[PRESSURE_1], x[PRESSURE_2]
    a1, b1, c1, d1 = _slopes(a, b, c, d, alpha_1, alpha_2, p)
    a2, b2, c2, d2 = _slopes(a + half * a1, b + half * b1, c + half * c1, d + half * d1, alpha_1, alpha_2, p)
    a3, b3, c3, d3 = _slopes(a + half * a2, b + half * b2, c + half * c2, d + half * d2, alpha_1, alpha_2, p)
    a4, b4, c4, d4 = _slopes(a + dt * a3, b + dt * b3, c + dt * c3, d + dt * d3, alpha_1, alpha_2, p)
    sixth = dt / 6.0
    result[ANGLE] = a + sixth * (a1 + 2.0 * (a2 + a3) + a4)
    result[VELOCITY] = b + sixth * (b1 + 2.0 * (b2 + b3) + b4)
    result[PRESSURE_1] = c + sixth * (c1 + 2.0 * (c2 + c3) + c4)
    result[PRESSURE_2] = d + sixth * (d1 + 2.0 * (d2 + d3) + d4)
    stop = p[STOP]
    if result[ANGLE] >= stop:
        result[ANGLE] = stop
        result[VELOCITY] = min(result[VELOCITY], 0.0)
    elif result[ANGLE] <= -stop:
        result[ANGLE] = -stop
        result[VELOCITY] = max(result[VELOCITY], 0.0)


@inlined
def subsystem(x, p):
    """Index σ of the subsystem that is active, 1 to 18.

    σ = 1 + 6 a + 2 b + c with the flow regimes a, b of muscles 1 and 2 (0: only the inflow choked,
    1: both, 2: only the outflow) and c = 1 where the joint slides.

    Args:
        x: state (4,).
        p: parameter vector.
    """
    slides = 0.0
    if p[LOCKED] == 0.0:
        force_1, force_2 = forces(x, p)
        coulomb = _coulomb_torque(force_1, force_2, x[PRESSURE_1], x[PRESSURE_2], p)
        balance = _muscle_torque(math.cos(x[ANGLE]), force_1, force_2, p)
        _, slides = _acceleration(x[ANGLE], x[VELOCITY], balance, coulomb, p)
    regimes = 6 * _flow_regime(x[PRESSURE_1], p) + 2 * _flow_regime(x[PRESSURE_2], p)
    return 1 + regimes + (1 if slides > 0.0 else 0)


@kernel
def rest_angle(pressure_1, pressure_2, p):
    """Angle [rad] at which the muscles' torque balances k_s ψ, friction aside; within the stop.

    Where the balance lies beyond the stop (or beyond ±60° without one), that bound.
    """
    high = min(p[STOP], math.pi / 3.0)
    low = -high
    x = np.array([low, 0.0, pressure_1, pressure_2])
    if torque(x, p) - p[STIFFNESS] * low <= 0.0:
        return low
    x[ANGLE] = high
    if torque(x, p) - p[STIFFNESS] * high >= 0.0:
        return high
    for _ in range(60):
        x[ANGLE] = 0.5 * (low + high)
        if torque(x, p) - p[STIFFNESS] * x[ANGLE] > 0.0:
            low = x[ANGLE]
        else:
            high = x[ANGLE]
    return 0.5 * (low + high)


@kernel
def simulate(x0, voltage, p, dt, substeps):
    """The model alone, driven by recorded voltages.

    Args:
        x0: state (4,) at the first sample.
        voltage: (N, 2) [V]; row k holds over the step that ends at sample k, row 0 is not used.
        p: parameter vector.
        dt: sample period [s].
        substeps: Runge-Kutta steps a sample.

    Returns:
        States (N, 4), torques (N,) [N m] and subsystem indices (N,).
    """
    samples = voltage.shape[0]
    n = x0.shape[0]
    states = np.empty((samples, n))
    torques = np.empty(samples)
    sigma = np.empty(samples, dtype=np.int64)
    x = x0.copy()
    for k in range(samples):
        if k > 0:
            for _ in range(substeps):
                rk4_step(x, voltage[k], p, dt / substeps, x)
        states[k] = x
        torques[k] = torque(x, p)
        sigma[k] = subsystem(x, p)
    return states, torques, sigma
