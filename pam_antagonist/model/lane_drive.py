"""The driver of several models side by side, compiled. Import it only where it is needed: it generates the lane form.

To read the generated module: ``python -m pam_antagonist.model.lane_drive``.
"""

from __future__ import annotations

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.model import composition, dynamics, integration, lane_form
from pam_antagonist.model.drive import BY_COMMAND, BY_MOTION, BY_PRESSURE, IMBALANCE, NEEDED, TORQUE
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2, VELOCITY
from pam_antagonist.model.lane_values import CHUNK, LANES, item, put
from pam_antagonist.model.parameters import BASE_STATES, FRICTION_STEP, SIGNAL

_ROOTS = (integration.rk4_step_within, dynamics.torque, dynamics.torque_needed, dynamics.imbalance)
TEXT = composition.remembered("lanes", lambda: lane_form.lane_module(_ROOTS))
"""Source of the module with the lane form of the equations."""
_form = composition.imported(TEXT, "lanes")
rk4_step = _form.rk4_step_within
_torque, _needed, _imbalance = _form.torque, _form.torque_needed, _form.imbalance
_substeps_of = inlined(integration.substeps_of)


@inlined
def _move(mask, x, u, length, command, pressure, motion, signals, k, p, longest, scratch):
    """:func:`~pam_antagonist.model.drive.drive` from row k - 1 to row k."""
    steps = _substeps_of(length, longest)
    h = length / steps
    put(p, FRICTION_STEP, h)
    if mask & BY_COMMAND:
        for i in range(command.shape[1]):
            u[i] = command[k, i]
    moved = 0.0
    if mask & BY_MOTION:
        moved = motion[k, 0] - motion[k - 1, 0]
        put(x, VELOCITY, moved / length)
    for s in range(steps):
        share = (s + 0.5) / steps
        if mask & BY_MOTION:
            put(x, ANGLE, motion[k - 1, 0] + share * moved)
        if mask & BY_PRESSURE:
            put(x, PRESSURE_1, pressure[k - 1, 0] + share * (pressure[k, 0] - pressure[k - 1, 0]))
            put(x, PRESSURE_2, pressure[k - 1, 1] + share * (pressure[k, 1] - pressure[k - 1, 1]))
        for j in range(signals.shape[1]):
            put(p, SIGNAL + j, signals[k - 1, j] + share * (signals[k, j] - signals[k - 1, j]))
        rk4_step(x, u, p, h, x, scratch)


@inlined
def _at_row(mask, x, pressure, motion, signals, k, p):
    """What is given at row k, into states and parameters."""
    if mask & BY_MOTION:
        put(x, ANGLE, motion[k, 0])
        put(x, VELOCITY, motion[k, 1])
    if mask & BY_PRESSURE:
        put(x, PRESSURE_1, pressure[k, 0])
        put(x, PRESSURE_2, pressure[k, 1])
    for j in range(signals.shape[1]):
        put(p, SIGNAL + j, signals[k, j])


@inlined
def _flush(recent, recent_torques, count, states, shown, done):
    """The last rows, to each model."""
    for lane in range(LANES):
        for row in range(count):
            for i in range(recent.shape[1]):
                states[lane, done + row, i] = recent[row, i, lane]
            if shown.shape[2] > 0:
                shown[lane, 0, done + row] = recent_torques[row, 0, lane]
                shown[lane, 1, done + row] = recent_torques[row, 1, lane]


@in_place
def drive(mask, first, start, keeps, length, command, pressure, motion, signals, p, longest, states, shown, scratch):
    """:func:`~pam_antagonist.model.drive.drive` of several models; ``p`` is changed.

    `start`: (E, n, LANES). `p`: parameter vectors (P, LANES). `states`: result (LANES, N, n). `shown`: result
    (LANES, 2, N) or (LANES, 2, 0) [N m]. `scratch`: (STAGES + 1, n, LANES) for a step, (n, LANES) for the state, zeros
    for the input (2,) or (3,), (CHUNK, n, LANES) and (CHUNK, 2, LANES) for the last rows.
    """
    stages, x, u, recent, recent_torques = scratch
    n, done = start.shape[1], first[0]
    follows = n > BASE_STATES or mask & (BY_PRESSURE | BY_MOTION) != BY_PRESSURE | BY_MOTION
    for e in range(first.shape[0] - 1):
        for k in range(first[e], first[e + 1]):
            if follows and (k > first[e] or keeps[e]):
                _move(mask, x, u, length[k], command, pressure, motion, signals, k, p, longest, stages)
            if k == first[e]:
                for i in range(n):
                    if i < BASE_STATES or not keeps[e]:
                        put(x, i, item(start, (e, i)))
            _at_row(mask, x, pressure, motion, signals, k, p)
            for i in range(n):
                put(recent, (k - done, i), item(x, i))
            if mask & TORQUE:
                put(recent_torques, (k - done, 0), _torque(x, p))
            if mask & NEEDED:
                put(recent_torques, (k - done, 1), _needed(x, motion[k, 2], motion[k, 3], p))
            if mask & IMBALANCE:
                put(recent_torques, (k - done, 1), _imbalance(x, motion[k, 2], motion[k, 3], p))
            if k + 1 - done == CHUNK or k + 1 == first[-1]:
                _flush(recent, recent_torques, k + 1 - done, states, shown, done)
                done = k + 1


if __name__ == "__main__":
    print(TEXT)
