"""How each step of a joint that measured pressures drive passes on a small change of its state.

So one simulation tells what all values of all tables of learned laws do to the angle, to first order.
"""

from __future__ import annotations

import numpy as np

from pam_antagonist._jit import inlined, kernel
from pam_antagonist.model import equilibrium, integration, joint, muscle
from pam_antagonist.model.dynamics import ANGLE, FIRST, PRESSURE_1, PRESSURE_2, SECOND, VELOCITY
from pam_antagonist.model.integration import STAGES
from pam_antagonist.model.parameters import ATMOSPHERE, FRICTION_STEP, SIGNAL

_rk4_step, _initial_state = integration.rk4_step_within, equilibrium.initial_state
_leverage, _force, _muscle_torque = muscle.leverage, muscle.force, joint.muscle_torque
_length = muscle.length
_substeps_of = inlined(integration.substeps_of)


@kernel
def linearised(first, start, time, pressure, signals, p, longest, moving, moves):
    """Each step of episodes that measured pressures drive, and how it passes on a small change of the state.

    Args:
        first: index of the first row of each episode, then the number of rows (E + 1,).
        start: angle [rad] and velocity [rad/s] with which each episode begins (E, 2).
        time: of the rows [s] (N,).
        pressure: P_1, P_2 (N, 2) [Pa].
        signals: further signals (N, S) [SI].
        p: parameter vector (m,) without a flow of air, see :class:`~pam_antagonist.model.drive.Inputs`.
        longest: longest step of the integration [s].
        moving: indices of the states that the joint's motion changes (Q,), angle and velocity first.
        moves: of these states, for difference quotients (Q,).

    Returns:
        The row to which each step leads (S,); the step's time since its episode's start, length [s], ψ, ψ̇, P_1, P_2,
        the torques that the pressures add through muscle 1 and 2 [N m], the way in which the joint slides (−1, 0, 1)
        and the signals (S, 9 + signals); the changes at the end of the step by those at its begin (S, Q, Q).
    """
    p = p.copy()
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
                x[PRESSURE_1] = pressure[k - 1, 0] + share * (pressure[k, 0] - pressure[k - 1, 0])
                x[PRESSURE_2] = pressure[k - 1, 1] + share * (pressure[k, 1] - pressure[k - 1, 1])
                for j in range(signals.shape[1]):
                    p[SIGNAL + j] = signals[k - 1, j] + share * (signals[k, j] - signals[k - 1, j])
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
        first: as that of :func:`linearised`.
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
