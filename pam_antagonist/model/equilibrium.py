"""Joints at rest: angle of rest, pressures of sealed muscles, and the state from which a run starts."""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import in_place, inlined, kernel
from pam_antagonist.model import composition, dynamics, flow, muscle
from pam_antagonist.model.dynamics import ANGLE, FIRST, PRESSURE_1, PRESSURE_2, SECOND
from pam_antagonist.model.numeric import power
from pam_antagonist.model.parameters import CHARGE, POLYTROPIC_VOLUME, STATES, STIFFNESS, STOP, SUPPLY

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_leverage, _length, _length_rate, _volume = muscle.leverage, muscle.length, muscle.length_rate, muscle.volume
_open_rate, _valve_flow, _torque = flow.open_rate, flow.valve_flow, dynamics.torque
_joint_torque, _muscle_steady = composition.joint_torque, composition.muscle_steady
_joint_steady = composition.joint_steady

_LARGEST_WITHOUT_STOP = math.pi / 3.0
"""[rad] Without a stop, the search for an angle of rest still needs an end."""


@inlined
def largest_angle(p):
    """Largest angle at which a joint may rest, to both sides [rad]: its stop, or 60° without one."""
    return p[STOP] if p[STOP] < math.inf else _LARGEST_WITHOUT_STOP


@inlined
def pull(x, p, effects=True):
    """Torque [N m] on a joint at rest, without friction and without a torque from outside.

    `x`: state (n,), of which angle and pressures count.
    """
    sine, _, _ = _leverage(x[ANGLE], p)
    load = 0.0 if effects is None else _joint_torque(0.0, x[ANGLE], 0.0, sine, x, p)
    return _torque(x, p, effects) + load - p[STIFFNESS] * x[ANGLE]


@kernel
def rest_angle(pressure_1, pressure_2, p, effects=True):
    """Angle [rad] at which the muscles' torque balances k_s ψ, friction aside; within :func:`largest_angle`.

    A balance beyond it gives the nearer bound.
    """
    high = largest_angle(p)
    low = -high
    x = np.array([low, 0.0, pressure_1, pressure_2])
    if pull(x, p, effects) <= 0.0:
        return low
    x[ANGLE] = high
    if pull(x, p, effects) >= 0.0:
        return high
    for _ in range(60):
        x[ANGLE] = 0.5 * (low + high)
        if pull(x, p, effects) > 0.0:
            low = x[ANGLE]
        else:
            high = x[ANGLE]
    return 0.5 * (low + high)


@inlined
def closed_pressure(i, angle, p):
    """Pressure [Pa] of a sealed muscle: by equation (4) without flow, P V^k_2 stays constant after the charge."""
    travel, _, _ = _leverage(angle, p)
    volume, _ = _volume(i, _length(i, travel, p), p)
    charged, _ = _volume(i, _length(i, 0.0, p), p)
    return p[CHARGE + i] * power(charged / volume, p[POLYTROPIC_VOLUME])


@kernel
def start_angle(pressure_1, pressure_2, p, effects=True):
    """Angle [rad] at which a filter starts.

    If the charge of sealed muscles is known, it is the angle at which the closed chambers have this ratio of
    pressures. Otherwise it is the angle of rest.
    """
    if p[CHARGE] <= 0.0 or p[CHARGE + 1] <= 0.0:
        return rest_angle(pressure_1, pressure_2, p, effects)
    ratio = pressure_1 / pressure_2
    high = largest_angle(p)
    low = -high
    # Muscle 1 gets shorter and wider as the angle grows, muscle 2 longer and narrower.
    for _ in range(60):
        middle = 0.5 * (low + high)
        if closed_pressure(FIRST, middle, p) > ratio * closed_pressure(SECOND, middle, p):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def initial_state(angle, pressure_1, pressure_2, u, p, velocity=0.0):
    """State of a joint after a long rest: valves at the open rates that ``u`` asks for, added states steady.

    The pressure drop of a line belongs to the valve flow at these pressures, so it is 0 if they are steady. With a
    velocity, the added states are those after a long motion at this velocity.

    `velocity`: ψ̇ [rad/s] of the motion before; the velocity in the state is 0. Returns state (n,), n =
    p[parameters.STATES].
    """
    x = np.empty(int(p[STATES]))
    make_steady(x, angle, pressure_1, pressure_2, u, p, velocity, dynamics.WITH_EFFECTS)
    return x


@in_place
def make_steady(x, angle, pressure_1, pressure_2, u, p, velocity, effects):
    """:func:`initial_state`, written into an array.

    `x`: the array (n,). `velocity`: ψ̇ [rad/s] of the motion before.
    """
    x[:] = 0.0
    x[ANGLE], x[PRESSURE_1], x[PRESSURE_2] = angle, pressure_1, pressure_2
    if effects is None:
        return
    sine, cosine, _ = _leverage(angle, p)
    consumption = 0.0
    for i in range(2):
        wanted = _open_rate(i, u[i], p)
        pressure = x[PRESSURE_1 + i]
        passed, drawn = _valve_flow(i, wanted, pressure, p[SUPPLY], p)
        consumption += drawn
        _muscle_steady(
            i, angle, velocity, sine, _length(i, sine, p), _length_rate(i, cosine, velocity, p), u[i], wanted, pressure,
            passed, x, p,
        )  # fmt: skip
    _joint_steady(consumption, x, p)
