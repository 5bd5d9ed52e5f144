"""Parts of the model, driven by what was measured; the Runge-Kutta step of the whole model integrates them.

The joint's mechanics alone, equations (6) to (10): the valves are shut and the chambers keep the measured pressures. So
only the equations of force, friction and motion act, with all their effects.

The chambers alone, equation (4) with pressure regulators, driven by commands and by the measured angle
(:func:`pressures`): the joint is locked, and the angle is set from outside. So the muscles have their measured volumes,
and the result tests the model of the regulators only.
"""

from __future__ import annotations

import numpy as np

from pam_antagonist._jit import inlined, kernel
from pam_antagonist.model import dynamics, equilibrium, integration, joint, muscle
from pam_antagonist.model.dynamics import ANGLE, FIRST, PRESSURE_1, PRESSURE_2, SECOND, VELOCITY
from pam_antagonist.model.integration import STAGES
from pam_antagonist.model.parameters import (
    ATMOSPHERE,
    BASE_STATES,
    FRICTION_STEP,
    LOCKED,
    POLYTROPIC_VOLUME,
    SIGNAL,
    VALVE,
    VALVE_SIZE,
)

_rk4_step, _initial_state = integration.rk4_step_within, equilibrium.initial_state
_leverage, _force, _muscle_torque = muscle.leverage, muscle.force, joint.muscle_torque
_length, _torque = muscle.length, dynamics.torque
_substeps_of = inlined(integration.substeps_of)


@inlined
def _without_flow(p):
    """Zeros with which equation (4) keeps the pressures, in place: no flow, and no effect of the volume."""
    p[VALVE : VALVE + 2 * VALVE_SIZE] = 0.0
    p[POLYTROPIC_VOLUME] = 0.0


@inlined
def _put_inputs(x, p, pressure, signals, k, share):
    """Pressures and signals at a share of the way from row k − 1 to row k, in state and parameters."""
    x[PRESSURE_1] = pressure[k - 1, 0] + share * (pressure[k, 0] - pressure[k - 1, 0])
    x[PRESSURE_2] = pressure[k - 1, 1] + share * (pressure[k, 1] - pressure[k - 1, 1])
    for j in range(signals.shape[1]):
        p[SIGNAL + j] = signals[k - 1, j] + share * (signals[k, j] - signals[k - 1, j])


@kernel
def angles(first, start, time, pressure, signals, p, longest):
    """Angles of episodes, each started anew.

    Args:
        first: index of the first row of each episode, then the number of rows (E + 1,).
        start: angle [rad] and velocity [rad/s] with which each episode begins (E, 2).
        time: of the rows [s] (N,), increasing within an episode.
        pressure: P_1, P_2 (N, 2) [Pa], linear between rows.
        signals: further signals less their values in the rig file (N, S) [SI], linear between rows; S = 0 for none.
        p: parameter vector (m,).
        longest: longest step of the integration [s].

    Returns:
        ψ of each row (N,) [rad].
    """
    p = p.copy()
    _without_flow(p)
    u = np.zeros(2)
    out = np.empty(time.shape[0])
    for e in range(first.shape[0] - 1):
        begin = first[e]
        for j in range(signals.shape[1]):
            p[SIGNAL + j] = signals[begin, j]
        x = _initial_state(start[e, 0], pressure[begin, 0], pressure[begin, 1], u, p)
        x[VELOCITY] = start[e, 1]
        scratch = np.empty((STAGES + 1, x.shape[0]))
        out[begin] = x[ANGLE]
        for k in range(begin + 1, first[e + 1]):
            dt = time[k] - time[k - 1]
            steps = _substeps_of(dt, longest)
            h = dt / steps
            p[FRICTION_STEP] = h
            for s in range(steps):
                # The inputs are held over a step, at their values in its middle.
                _put_inputs(x, p, pressure, signals, k, (s + 0.5) / steps)
                _rk4_step(x, u, p, h, x, scratch)
            out[k] = x[ANGLE]
    return out


@kernel
def torques(time, angle, velocity, pressure, p, longest):
    """Torques of the muscles of a joint whose motion and pressures are given; added states begin steady and follow.

    Args:
        time: of the rows [s] (N,), increasing.
        angle: ψ [rad] (N,), linear between rows.
        velocity: ψ̇ [rad/s] (N,) at the rows.
        pressure: P_1, P_2 (N, 2) [Pa], linear between rows.
        p: parameter vector (m,).
        longest: longest step of the integration [s].

    Returns:
        (N,) [N m].
    """
    p = p.copy()
    _without_flow(p)
    p[LOCKED] = 1.0
    u, signals, out = np.zeros(2), np.empty((0, 0)), np.empty(time.shape[0])
    if time.shape[0] == 0:
        return out
    x = _initial_state(angle[0], pressure[0, 0], pressure[0, 1], u, p)
    scratch = np.empty((STAGES + 1, x.shape[0]))
    for k in range(time.shape[0]):
        if k > 0 and x.shape[0] > BASE_STATES:
            dt, moved = time[k] - time[k - 1], angle[k] - angle[k - 1]
            steps = _substeps_of(dt, longest)
            p[FRICTION_STEP] = dt / steps
            for s in range(steps):
                share = (s + 0.5) / steps
                x[ANGLE], x[VELOCITY] = angle[k - 1] + share * moved, moved / dt
                _put_inputs(x, p, pressure, signals, k, share)
                _rk4_step(x, u, p, dt / steps, x, scratch)
        x[ANGLE], x[VELOCITY] = angle[k], velocity[k]
        x[PRESSURE_1], x[PRESSURE_2] = pressure[k, 0], pressure[k, 1]
        out[k] = _torque(x, p)
    return out


@kernel
def linearised(first, start, time, pressure, signals, p, longest, moving, moves):
    """Each step of :func:`angles`, and how it passes on a small change of the state.

    Args:
        first: as that of :func:`angles`; so are start, signals, p and longest.
        start: angle [rad] and velocity [rad/s] with which each episode begins (E, 2).
        time: of the rows [s] (N,).
        pressure: P_1, P_2 (N, 2) [Pa].
        signals: further signals (N, S) [SI].
        p: parameter vector (m,).
        longest: longest step of the integration [s].
        moving: indices of the states that the joint's motion changes (Q,), angle and velocity first.
        moves: of these states, for difference quotients (Q,).

    Returns:
        The row to which each step leads (S,); the step's time since its episode's start, length [s], ψ, ψ̇, P_1, P_2,
        the torques that the pressures add through muscle 1 and 2 [N m], the way in which the joint slides (−1, 0, 1)
        and the signals (S, 9 + signals); the changes at the end of the step by those at its begin (S, Q, Q).
    """
    p = p.copy()
    _without_flow(p)
    u = np.zeros(2)
    count, q = 0, moving.shape[0]
    for e in range(first.shape[0] - 1):
        for k in range(first[e] + 1, first[e + 1]):
            count += _substeps_of(time[k] - time[k - 1], longest)
    row = np.empty(count, np.int64)
    seen = np.empty((count, 9 + signals.shape[1]))
    passed = np.empty((count, q, q))
    at = 0
    for e in range(first.shape[0] - 1):
        begin = first[e]
        for j in range(signals.shape[1]):
            p[SIGNAL + j] = signals[begin, j]
        x = _initial_state(start[e, 0], pressure[begin, 0], pressure[begin, 1], u, p)
        x[VELOCITY] = start[e, 1]
        scratch, near, end = np.empty((STAGES + 1, x.shape[0])), np.empty(x.shape[0]), np.empty(x.shape[0])
        for k in range(begin + 1, first[e + 1]):
            dt = time[k] - time[k - 1]
            steps = _substeps_of(dt, longest)
            h = dt / steps
            p[FRICTION_STEP] = h
            for s in range(steps):
                share = (s + 0.5) / steps
                _put_inputs(x, p, pressure, signals, k, share)
                for j in range(signals.shape[1]):
                    seen[at, 9 + j] = p[SIGNAL + j]
                row[at] = k
                seen[at, 0] = time[k - 1] + share * dt - time[begin]
                seen[at, 1], seen[at, 2], seen[at, 3] = h, x[ANGLE], x[VELOCITY]
                seen[at, 4], seen[at, 5] = x[PRESSURE_1], x[PRESSURE_2]
                sine, cosine, _ = _leverage(x[ANGLE], p)
                length_1, length_2 = _length(FIRST, sine, p), _length(SECOND, sine, p)
                active_1 = _force(FIRST, length_1, x[PRESSURE_1], p) - _force(FIRST, length_1, p[ATMOSPHERE], p)
                active_2 = _force(SECOND, length_2, x[PRESSURE_2], p) - _force(SECOND, length_2, p[ATMOSPHERE], p)
                seen[at, 6] = _muscle_torque(cosine, active_1, 0.0, p)
                seen[at, 7] = _muscle_torque(cosine, 0.0, active_2, p)
                _rk4_step(x, u, p, h, end, scratch)
                seen[at, 8] = np.sign(end[VELOCITY])
                for i in range(q):
                    near[:] = x
                    near[moving[i]] += moves[i]
                    _rk4_step(near, u, p, h, near, scratch)
                    for j in range(q):
                        passed[at, j, i] = (near[moving[j]] - end[moving[j]]) / moves[i]
                x[:] = end
                at += 1
    return row, seen, passed


@kernel
def responses(first, row, passed, torques, rows):
    """Changes of the angle by small torques, from what :func:`linearised` found.

    Args:
        first: as that of :func:`angles`.
        row: to which each step leads (S,).
        passed: changes that each step passes on (S, Q, Q).
        torques: over each step, times its length over the inertia [rad/s] (S, C).
        rows: number of rows (N).

    Returns:
        (N, C) [rad].
    """
    count, q = torques.shape[1], passed.shape[1]
    out = np.zeros((rows, count))
    change, new = np.zeros((q, count)), np.zeros((q, count))
    for at in range(row.shape[0]):
        k = row[at]
        if at > 0 and k != row[at - 1] and k != row[at - 1] + 1:
            change[:] = 0.0
        for c in range(count):
            change[VELOCITY, c] += torques[at, c]
        for i in range(q):
            for c in range(count):
                total = 0.0
                for j in range(q):
                    total += passed[at, i, j] * change[j, c]
                new[i, c] = total
        change[:] = new
        for c in range(count):
            out[k, c] = change[ANGLE, c]
    return out


@kernel
def remembered(values, since, length, number, lags):
    """What an operator with a memory holds at the begin of each step.

    Args:
        values: of the argument over each step (S,), the first of an episode after a long rest.
        since: time since the start of the episode (S,) [s].
        length: of each step (S,) [s].
        number: time constant [s] of a lag, or width of a play.
        lags: whether it is a lag.
    """
    out = np.empty(values.shape[0])
    held = values[0]
    for at in range(values.shape[0]):
        if at > 0 and since[at] < since[at - 1]:
            held = values[at]
        out[at] = held
        if lags:
            held += (values[at] - held) * (1.0 - np.exp(-length[at] / number))
        else:
            held = min(max(held, values[at] - 0.5 * number), values[at] + 0.5 * number)
    return out


@kernel
def pressures(first, start, time, command, angle, p, longest, anew):
    """Pressures of episodes, each with its own start.

    Args:
        first: index of the first row of each episode, then the number of rows (E + 1,).
        start: pressures with which each episode begins (E, 2) [Pa].
        time: of the rows [s] (N,), increasing within an episode.
        command: pressures commanded over the step that ends at each row (N, 2) [Pa].
        angle: measured (N,) [rad], linear between rows.
        p: parameter vector (m,) of a locked joint.
        longest: longest step of the integration [s].
        anew: whether each episode starts after a long rest (E,). If not, it goes on from the episode before: only the
            pressures start from the given ones, and the states of supply and regulators go on.

    Returns:
        P_1, P_2 of each row (N, 2) [Pa].
    """
    p = p.copy()
    u = np.zeros(2)
    out = np.empty((time.shape[0], 2))
    x = _initial_state(angle[0], start[0, 0], start[0, 1], u, p)
    scratch = np.empty((STAGES + 1, x.shape[0]))
    for e in range(first.shape[0] - 1):
        begin = first[e]
        u[:] = command[begin]
        if anew[e]:
            x = _initial_state(angle[begin], start[e, 0], start[e, 1], u, p)
        else:
            x[PRESSURE_1], x[PRESSURE_2] = start[e, 0], start[e, 1]
        out[begin] = start[e]
        for k in range(begin + 1, first[e + 1]):
            u[:] = command[k]
            dt = time[k] - time[k - 1]
            steps = _substeps_of(dt, longest)
            p[FRICTION_STEP] = dt / steps
            moved = angle[k] - angle[k - 1]
            x[VELOCITY] = moved / dt
            for s in range(steps):
                x[ANGLE] = angle[k - 1] + (s + 0.5) / steps * moved
                _rk4_step(x, u, p, dt / steps, x, scratch)
            out[k, 0], out[k, 1] = x[PRESSURE_1], x[PRESSURE_2]
    return out
