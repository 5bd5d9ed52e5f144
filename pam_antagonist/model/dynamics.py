"""The state-space model, equations (1) and (11): derivative, output, subsystem, readings of the pressure sensors.

State ``x = [ψ, ψ̇, P_1, P_2]`` [rad, rad/s, Pa, Pa], input ``u = [u_1, u_2]`` [V], parameters ``p``
(:mod:`pam_antagonist.model.parameters`). Arguments come in the order state, input, parameters, step.
"""

from __future__ import annotations

import numpy as np

from pam_antagonist._jit import in_place, inlined, kernel
from pam_antagonist.model import composition, flow, joint, muscle
from pam_antagonist.model.lane_values import shared
from pam_antagonist.model.parameters import (
    BASE_STATES,
    INERTIA,
    LOCKED,
    POLYTROPIC_VOLUME,
    STIFFNESS,
    STOP,
    SUPPLY,
    VISCOUS,
)

ANGLE, VELOCITY, PRESSURE_1, PRESSURE_2 = 0, 1, 2, 3
FIRST, SECOND = np.int64(0), np.int64(1)
"""Indices of the muscles. numba would compile a function anew for each literal 0 or 1."""
WITH_EFFECTS = np.int64(1)
"""Value of the argument ``effects`` where a rig may have effects. The value for a plain rig is None: numba compiles
another version for that type, which is smaller and faster."""

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_leverage, _length, _length_rate, _volume = muscle.leverage, muscle.length, muscle.length_rate, muscle.volume
_force, _force_length_slope, _linear_force = muscle.force, muscle.force_length_slope, muscle.linear_force
_valve_flow, _pressure_rate = flow.valve_flow, flow.pressure_rate
_open_rate, _flow_regime = flow.open_rate, flow.flow_regime
_muscle_torque, _coulomb_torque, _acceleration = joint.muscle_torque, joint.coulomb_torque, joint.acceleration

# Composed functions of the effects.
_spool_voltage, _held_open_rate = composition.spool_voltage, composition.open_rate
_supply_change, _chamber = composition.supply_change, composition.chamber_pressure
_mass_loss, _swelling = composition.mass_loss, composition.swelling
_cooling, _valve_pressure_rate = composition.cooling, composition.valve_pressure_rate
_contraction_force, _passed_on = composition.contraction_force, composition.muscle_force
_with_coulomb = composition.coulomb_torque
_with_disturbance, _joint_torque = composition.disturbance_torque, composition.joint_torque
_muscle_rates, _joint_rates = composition.muscle_rates, composition.joint_rates

small_signal_lags = composition.small_signal_lags
"""Time constants [s] for small changes (L,), of the added states that may be as quick as milliseconds."""

_sensor_reading, _sensor_inverse = composition.sensor_reading, composition.sensor_inverse


@inlined
def reading(i, pressure, p):
    """Reading [Pa] of the sensor of muscle i at a pressure [Pa]: the pressure itself, unless an effect changes it."""
    return _sensor_reading(pressure, i, p)


@inlined
def pressure_behind(i, shown, p):
    """The pressure [Pa] behind a reading [Pa] of the sensor of muscle i; the inverse of :func:`reading`."""
    return _sensor_inverse(shown, i, p)


@kernel
def readings(pressure, p):
    """Readings of both sensors (N, 2) [Pa] at pressures (N, 2) [Pa]."""
    shown = np.empty(pressure.shape)
    for k in range(len(pressure)):
        for i in range(2):
            shown[k, i] = reading(i, pressure[k, i], p)
    return shown


@inlined
def chamber_pressure(i, x, p):
    """Pressure [Pa] in muscle i: P_i of the state, the pressure at the sensor, unless an effect changes it."""
    return _chamber(x[PRESSURE_1 + i], i, x, p)


@inlined
def _force_with_effects(i, muscle_length, length_rate, chamber, x, p):
    """Contraction force [N] of muscle i: static map plus the forces of effects, then what the muscle passes on."""
    static = _force(i, muscle_length, chamber, p)
    return _passed_on(_contraction_force(static, i, muscle_length, length_rate, chamber, x, p), i, p)


@inlined
def _muscle_force(i, sine, cosine, x, p, effects):
    """Contraction force [N] of muscle i in a state; without effects if ``effects`` is None."""
    muscle_length = _length(i, sine, p)
    if effects is None:
        force = _linear_force(i, muscle_length, x[PRESSURE_1 + i], p)
    else:
        length_rate, chamber = _length_rate(i, cosine, x[VELOCITY], p), chamber_pressure(i, x, p)
        force = _force_with_effects(i, muscle_length, length_rate, chamber, x, p)
    return force


@inlined
def forces(x, p, effects=True):
    """Contraction forces F_1, F_2 [N] of a state. `x`: state (n,). `p`: parameter vector (m,)."""
    sine, cosine, _ = _leverage(x[ANGLE], p)
    return _muscle_force(FIRST, sine, cosine, x, p, effects), _muscle_force(SECOND, sine, cosine, x, p, effects)


@inlined
def torque(x, p, effects=True):
    """τ [N m] of a state, the last row of equation (11b). `x`: state (n,). `p`: parameter vector (m,)."""
    force_1, force_2 = forces(x, p, effects)
    _, cosine, _ = _leverage(x[ANGLE], p)
    return _muscle_torque(cosine, force_1, force_2, p)


@inlined
def torque_slope(x, p, effects=True):
    """Slope ∂τ/∂ψ of the torque [N m/rad], minus the stiffness, at constant pressures, from (2), (6), (7), (9)."""
    force_1, force_2 = forces(x, p, effects)
    sine, cosine, bend = _leverage(x[ANGLE], p)
    # ∂l_1/∂ψ = −r cos ψ and ∂l_2/∂ψ = +r cos ψ: the length rates at 1 rad/s.
    slope_1 = _force_length_slope(FIRST, _length(FIRST, sine, p), chamber_pressure(FIRST, x, p), p)
    slope_2 = _force_length_slope(SECOND, _length(SECOND, sine, p), chamber_pressure(SECOND, x, p), p)
    slope_1 *= _length_rate(FIRST, cosine, 1.0, p)
    slope_2 *= _length_rate(SECOND, cosine, 1.0, p)
    return _muscle_torque(cosine, slope_1, slope_2, p) + _muscle_torque(bend, force_1, force_2, p)


@inlined
def _stopped(angle, velocity, p):
    """The velocity, but 0 if it points into a stop that is reached: the volumes must not change there."""
    if angle >= p[STOP]:
        return min(velocity, 0.0)
    if angle <= -p[STOP]:
        return max(velocity, 0.0)
    return velocity


@inlined
def _air(i, alpha, wanted, pressure, chamber, muscle_length, length_rate, supply, x, p, effects):
    """Equations (3) to (5) of one muscle.

    Returns ṗ of the chamber without cooling and with it [Pa/s], mass flow through the valve and out of the supply
    [kg/s].
    """
    volume, volume_slope = _volume(i, muscle_length, p)
    passed, drawn = _valve_flow(i, alpha, pressure, supply, p)
    net = passed if effects is None else _mass_loss(passed, i, chamber, muscle_length, length_rate, wanted, x, p)
    polytropic = _pressure_rate(chamber, volume, volume_slope * length_rate, net, p)
    if effects is not None:
        modulus, volume_rate = p[POLYTROPIC_VOLUME] * chamber, volume_slope * length_rate / volume
        polytropic = _swelling(polytropic, i, modulus, volume_rate, muscle_length, length_rate, x, p)
    rate = polytropic if effects is None else _cooling(polytropic, i, chamber, x, p)
    return polytropic, rate, passed, drawn


@inlined
def _motion(angle, velocity, sine, cosine, force_1, force_2, chamber_1, chamber_2, external, x, p, effects):
    """Equations (8) to (10): ψ̈, and whether the joint slides."""
    coulomb = _coulomb_torque(force_1, force_2, chamber_1, chamber_2, p)
    balance = _muscle_torque(cosine, force_1, force_2, p) + external
    if effects is not None:
        coulomb = _with_coulomb(coulomb, angle, velocity, sine, chamber_1, chamber_2, x, p)
        balance = _joint_torque(balance, angle, velocity, sine, x, p)
    return _acceleration(angle, velocity, balance, coulomb, p, effects)


@inlined
def sliding_friction(x, direction, p):
    """Friction torque [N m] of a sliding joint, equation (10).

    `x`: state (n,), of which angle, velocity and pressures count. `direction`: of the motion, −1 to 1.
    """
    sine, _, _ = _leverage(x[ANGLE], p)
    force_1, force_2 = forces(x, p)
    coulomb = _coulomb_torque(force_1, force_2, x[PRESSURE_1], x[PRESSURE_2], p)
    coulomb = _with_coulomb(coulomb, x[ANGLE], x[VELOCITY], sine, x[PRESSURE_1], x[PRESSURE_2], x, p)
    return coulomb * direction + p[VISCOUS] * x[VELOCITY]


@inlined
def torque_needed(x, acceleration, direction, p):
    """External torque [N m] that a motion needs, from equation (8).

    `x`: state (n,), of which angle, velocity and pressures count. `acceleration`: ψ̈ [rad/s²]. `direction`: of the
    motion, −1 to 1.
    """
    sine, _, _ = _leverage(x[ANGLE], p)
    load = _joint_torque(0.0, x[ANGLE], x[VELOCITY], sine, x, p)
    inertial = p[INERTIA] * acceleration + p[STIFFNESS] * x[ANGLE]
    return inertial + sliding_friction(x, direction, p) - torque(x, p) - load


@inlined
def imbalance(x, acceleration, direction, p):
    """Imbalance of all torques [N m] of a motion without a torque from outside.

    `acceleration`: ψ̈ [rad/s²]. `direction`: −1 or 1; 0: friction may have any value up to its level.
    """
    if direction != 0.0:
        return torque_needed(x, acceleration, direction, p)
    without = torque_needed(x, acceleration, 0.0, p)
    level = max(torque_needed(x, acceleration, 1.0, p) - without, 0.0)
    return without - min(max(without, -level), level)


@inlined
def slopes(angle, velocity, pressure_1, pressure_2, alpha_1, alpha_2, external, p, effects):
    """The rows of equation (11a) without added states, as scalars: a sigma point stays in the processor's registers.

    `alpha_1`: open rate [-] of valve 1. `alpha_2`: likewise of valve 2. `external`: torque from outside [N m].
    `effects`: None where the rig is known to be plain: the branches of options and effects are left out.
    """
    velocity = _stopped(angle, velocity, p)
    sine, cosine, _ = _leverage(angle, p)
    length_1 = _length(FIRST, sine, p)
    length_2 = _length(SECOND, sine, p)
    speed_1 = _length_rate(FIRST, cosine, velocity, p)
    speed_2 = _length_rate(SECOND, cosine, velocity, p)
    supply = p[SUPPLY] if effects is None else _supply_change(p[SUPPLY], None, p)
    _, rate_1, _, _ = _air(FIRST, alpha_1, alpha_1, pressure_1, pressure_1, length_1, speed_1, supply, None, p, effects)
    _, rate_2, _, _ = _air(
        SECOND, alpha_2, alpha_2, pressure_2, pressure_2, length_2, speed_2, supply, None, p, effects
    )
    if shared(p[LOCKED]) != 0.0:
        return 0.0, 0.0, rate_1, rate_2
    if effects is None:
        force_1, force_2 = _linear_force(FIRST, length_1, pressure_1, p), _linear_force(SECOND, length_2, pressure_2, p)
    else:
        force_1 = _force_with_effects(FIRST, length_1, speed_1, pressure_1, None, p)
        force_2 = _force_with_effects(SECOND, length_2, speed_2, pressure_2, None, p)
    acceleration, _ = _motion(
        angle, velocity, sine, cosine, force_1, force_2, pressure_1, pressure_2, external, None, p, effects
    )
    return velocity, acceleration, rate_1, rate_2


@inlined
def external_torque(u):
    """External torque [N m] of an input that has one. `u`: as for :func:`derivative`."""
    if u.shape[0] > 2:
        return u[2]
    return 0.0


@in_place
def rows(x, u, wanted_1, wanted_2, p, dx):
    """All rows of equation (11a), with any added states, from the same functions as :func:`slopes`.

    `wanted_1`: open rate [-] that the voltage of valve 1 asks for. `wanted_2`: likewise of valve 2. `dx`: result (n,).
    """
    angle = x[ANGLE]
    velocity = _stopped(angle, x[VELOCITY], p)
    sine, cosine, _ = _leverage(angle, p)
    supply = _supply_change(p[SUPPLY], x, p)
    consumption = 0.0
    for i in range(2):
        sensed, chamber = x[PRESSURE_1 + i], chamber_pressure(i, x, p)
        muscle_length, length_rate = _length(i, sine, p), _length_rate(i, cosine, velocity, p)
        wanted = wanted_1 if i == 0 else wanted_2
        spool = _spool_voltage(u[i], i, x, p)
        if spool != u[i]:
            wanted = _open_rate(i, spool, p)
        alpha = _held_open_rate(wanted, i, muscle_length, length_rate, x, p)
        polytropic, rate, passed, drawn = _air(
            i, alpha, wanted, sensed, chamber, muscle_length, length_rate, supply, x, p, WITH_EFFECTS
        )
        consumption += drawn
        dx[PRESSURE_1 + i] = _valve_pressure_rate(rate, i, sensed, chamber, passed, x, p)
        if x.shape[0] > BASE_STATES:
            _muscle_rates(
                i, angle, velocity, sine, muscle_length, length_rate, u[i], wanted, sensed, chamber, passed, polytropic,
                rate, x, dx, p,
            )  # fmt: skip
    if x.shape[0] > BASE_STATES:
        _joint_rates(angle, velocity, sine, consumption, x, dx, p)
    if shared(p[LOCKED]) != 0.0:
        dx[ANGLE] = 0.0
        dx[VELOCITY] = 0.0
        return
    force_1 = _muscle_force(FIRST, sine, cosine, x, p, WITH_EFFECTS)
    force_2 = _muscle_force(SECOND, sine, cosine, x, p, WITH_EFFECTS)
    dx[ANGLE] = velocity
    dx[VELOCITY], _ = _motion(
        angle, velocity, sine, cosine, force_1, force_2, chamber_pressure(FIRST, x, p), chamber_pressure(SECOND, x, p),
        _with_disturbance(external_torque(u), x, p), x, p, WITH_EFFECTS,
    )  # fmt: skip


@in_place
def derivative(x, u, p, dx):
    """ẋ = f_σ(x, u), equation (11a), with the rows of the states that effects add.

    `x`: state (n,), n = p[parameters.STATES]. `u`: valve voltages [V], and where it is known the torque from outside
    [N m]; (2,) or (3,). `dx`: result (n,), written in place.
    """
    rows(x, u, _open_rate(FIRST, u[0], p), _open_rate(SECOND, u[1], p), p, dx)


@inlined
def subsystem(x, p, effects=True):
    """Index σ of the subsystem that is active, 1 to 18.

    σ = 1 + 6 a + 2 b + c with the flow regimes a, b of muscles 1 and 2 (0: only the inflow choked,
    1: both, 2: only the outflow) and c = 1 where the joint slides.

    `effects`: as for :func:`forces`.
    """
    slides = 0.0
    if shared(p[LOCKED]) == 0.0:
        force_1, force_2 = forces(x, p, effects)
        sine, cosine, _ = _leverage(x[ANGLE], p)
        chamber_1 = x[PRESSURE_1] if effects is None else chamber_pressure(FIRST, x, p)
        chamber_2 = x[PRESSURE_2] if effects is None else chamber_pressure(SECOND, x, p)
        external = 0.0 if effects is None else _with_disturbance(0.0, x, p)
        _, slides = _motion(
            x[ANGLE], x[VELOCITY], sine, cosine, force_1, force_2, chamber_1, chamber_2, external, x, p, effects
        )
    regimes = 6 * _flow_regime(x[PRESSURE_1], p) + 2 * _flow_regime(x[PRESSURE_2], p)
    return 1 + regimes + (1 if slides > 0.0 else 0)
