"""Compiled parts of the search for a missing law: an observer, filters that whiten columns, memories of an argument."""

from __future__ import annotations

import numpy as np

from pam_antagonist._jit import kernel
from pam_antagonist.model import dynamics, equilibrium, flow, integration, muscle
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import ANGLE, FIRST, PRESSURE_1, PRESSURE_2, SECOND, VELOCITY
from pam_antagonist.model.integration import STAGES
from pam_antagonist.model.parameters import FRICTION_STEP

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_rk4_step, _initial_state = integration.rk4_step_within, equilibrium.initial_state
_torque, _needed = dynamics.torque, dynamics.torque_needed
_open_rate, _valve_flow = flow.open_rate, flow.valve_flow
_length, _volume, _leverage = muscle.length, muscle.volume, muscle.leverage


@kernel
def _advanced(x, command, before, after, substeps, p, dt, scratch, shown):
    """The chambers from the middle of a block to that of the next, ``x`` in place.

    The angle goes from ``before`` to ``after`` [rad]; ``shown`` gets the pressures after each sample (S, 2).
    """
    p[FRICTION_STEP] = dt
    count = command.shape[0] * substeps
    x[VELOCITY] = (after - before) / (count * dt)
    for k in range(command.shape[0]):
        for s in range(substeps):
            x[ANGLE] = before + (after - before) * (k * substeps + s + 0.5) / count
            _rk4_step(x, command[k], p, dt, x, scratch)
        shown[k, 0], shown[k, 1] = x[PRESSURE_1], x[PRESSURE_2]


@kernel
def observed(begin, fresh, command, angle, reading, size, period, substeps, old, gains, points):
    """The chambers along a recording.

    Args:
        begin: first sample of each block (K,).
        fresh: whether a block begins anew (K,).
        command: (N, 2) of the samples.
        angle: block means (K,) [rad].
        reading: block means of the pressures (K, 2) [Pa].
        size: samples of a block, odd.
        period: of the samples [s].
        substeps: integration steps a sample.
        old: blocks by which a reading is old when it corrects.
        gains: of pressure [-] and of its unknown rate [1/s].
        points: parameter vectors (M, m), the first of them the model's.

    Returns:
        States in the middles (K, n), means of the pressures over the blocks less those in the middles (K, 2) [Pa],
        jumps by which the next block was corrected (K, 2) [Pa], slopes of the pressures to those a block before
        (K, 2), and what the other vectors change of the next block (M - 1, K, 2) [Pa].
    """
    count, half, p = begin.shape[0], size // 2, points[0]
    x = _initial_state(angle[0], reading[0, 0], reading[0, 1], command[0], p)
    n = x.shape[0]
    states, jumps, slopes = np.zeros((count, n)), np.zeros((count, 2)), np.ones((count, 2))
    changes, means = np.zeros((points.shape[0] - 1, count, 2)), np.zeros((count, 2))
    scratch, other, before = np.empty((STAGES + 1, n)), np.empty(n), np.empty(n)
    shown, unused, dt = np.empty((size, 2)), np.empty((size, 2)), period / substeps
    rate, since = np.zeros(2), 0
    for k in range(count):
        first = begin[k] + half
        if fresh[k]:
            x = _initial_state(angle[k], reading[k, 0], reading[k, 1], command[first], p)
            rate[:] = 0.0
            since = 0
        states[k] = x
        if k + 1 == count or fresh[k + 1]:
            continue
        given = command[first + 1 : first + 1 + size]
        before[:] = x
        _advanced(x, given, angle[k], angle[k + 1], substeps, p, dt, scratch, shown)
        other[:] = before
        other[PRESSURE_1] += 100.0
        other[PRESSURE_2] += 100.0
        _advanced(other, given, angle[k], angle[k + 1], substeps, p, dt, scratch, unused)
        for i in range(2):
            slopes[k, i] = (other[PRESSURE_1 + i] - x[PRESSURE_1 + i]) / 100.0
            for j in range(size - 1):
                if j < half:
                    means[k, i] += (shown[j, i] - before[PRESSURE_1 + i]) / size
                else:
                    means[k + 1, i] += (shown[j, i] - x[PRESSURE_1 + i]) / size
        for m in range(1, points.shape[0]):
            other[:] = before
            _advanced(other, given, angle[k], angle[k + 1], substeps, points[m], dt, scratch, unused)
            for i in range(2):
                changes[m - 1, k, i] = other[PRESSURE_1 + i] - x[PRESSURE_1 + i]
        if since >= old:
            for i in range(2):
                error = reading[k - old, i] - means[k - old, i] - states[k - old, PRESSURE_1 + i]
                rate[i] += gains[1] * error
                jumps[k, i] = gains[0] * error + rate[i] * size * period
                x[PRESSURE_1 + i] += jumps[k, i]
        x[ANGLE] = angle[k + 1]
        since += 1
    return states, means, jumps, slopes, changes


@kernel
def torques(states, p):
    """Torque of the muscles (K,) [N m] in states (K, n)."""
    out = np.empty(states.shape[0])
    for k in range(states.shape[0]):
        out[k] = _torque(states[k], p)
    return out


@kernel
def motions(states, acceleration, direction, p):
    """Torque of the muscles that a motion needs, by equation (8) (K,) [N m]."""
    out = np.empty(states.shape[0])
    for k in range(states.shape[0]):
        out[k] = _needed(states[k], acceleration[k], direction[k], p) + _torque(states[k], p)
    return out


@kernel
def air_columns(states, voltage, p):
    """What the places of the air act with, by states (K, n) and voltages (K, 2).

    Returns for each block and muscle: dP/dt per kg/s, flow per open rate, flow per share of the supply, flow, drawn
    flow, slope of the volume by length over the volume, flow per Pa in the chamber, open rate (K, 2, 8).
    """
    out = np.zeros((states.shape[0], 2, 8))
    for k in range(states.shape[0]):
        sine, _, _ = _leverage(states[k, ANGLE], p)
        for i in range(2):
            muscle_index = FIRST if i == 0 else SECOND
            pressure = states[k, PRESSURE_1 + i]
            volume, slope = _volume(muscle_index, _length(muscle_index, sine, p), p)
            alpha = _open_rate(muscle_index, voltage[k, i], p)
            supply = p[par.SUPPLY]
            passed, drawn = _valve_flow(muscle_index, alpha, pressure, supply, p)
            low, high = max(alpha - 0.01, 0.0), min(alpha + 0.01, 1.0)
            above, _ = _valve_flow(muscle_index, high, pressure, supply, p)
            below, _ = _valve_flow(muscle_index, low, pressure, supply, p)
            more, _ = _valve_flow(muscle_index, alpha, pressure, supply * 1.01, p)
            less, _ = _valve_flow(muscle_index, alpha, pressure, supply * 0.99, p)
            higher, _ = _valve_flow(muscle_index, alpha, pressure + 500.0, supply, p)
            out[k, i, 0] = p[par.POLYTROPIC_FLOW] * p[par.GAS_CONSTANT] * p[par.TEMPERATURE] / volume
            out[k, i, 1] = (above - below) / max(high - low, 1e-9)
            out[k, i, 2] = (more - less) / 0.02
            out[k, i, 3] = passed
            out[k, i, 4] = drawn
            out[k, i, 5] = slope / volume
            out[k, i, 6] = (higher - passed) / 500.0
            out[k, i, 7] = alpha
    return out


@kernel
def whitened(fresh, slope, noise, walk, at, quiet, seen, columns_in, columns_out):
    """Whitens columns by a Kalman filter whose unknowns are the errors of both pressures and a random walk.

    Args:
        fresh: whether a block begins anew (K,).
        slope: of the errors over a block (K, 2).
        noise: variance of each channel, not finite where it is missing (K, C).
        walk: variance of the walk's step [unit²], and at the begin.
        at: what a unit of the walk does over a block and to the channels (K, 2 + C).
        quiet: variance of the errors' steps [Pa²].
        seen: which pressure's error a channel shows, 0 or 1; -1 for none (C,).
        columns_in: what regressors add to the errors over a block, and what is taken from the data (N, K, 2).
        columns_out: likewise, to the channels (N, K, C).

    Returns:
        Whitened columns (N, K, C), 0 where missing, and the logarithms of the variances (K, C).
    """
    count, channels = noise.shape
    white, logs = np.zeros(columns_out.shape), np.zeros(noise.shape)
    state = np.zeros((columns_in.shape[0], 3))
    cov, gain, row = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for k in range(count):
        if fresh[k]:
            cov[:] = 0.0
            cov[0, 0] = cov[1, 1] = 4e8
            cov[2, 2] = walk[1]
            state[:] = 0.0
        for c in range(channels):
            if not np.isfinite(noise[k, c]):
                continue
            row[:] = 0.0
            if seen[c] >= 0:
                row[seen[c]] = 1.0
            row[2] = at[k, 2 + c]
            for i in range(3):
                gain[i] = cov[i, 0] * row[0] + cov[i, 1] * row[1] + cov[i, 2] * row[2]
            spread = noise[k, c] + row[0] * gain[0] + row[1] * gain[1] + row[2] * gain[2]
            logs[k, c] = np.log(spread)
            for i in range(3):
                for j in range(3):
                    cov[i, j] -= gain[i] * gain[j] / spread
            scale = 1.0 / np.sqrt(spread)
            g0, g1, g2 = gain[0] / spread, gain[1] / spread, gain[2] / spread
            for n in range(state.shape[0]):
                left = columns_out[n, k, c] - row[0] * state[n, 0] - row[1] * state[n, 1] - row[2] * state[n, 2]
                white[n, k, c] = left * scale
                state[n, 0] += g0 * left
                state[n, 1] += g1 * left
                state[n, 2] += g2 * left
        a0, a1, b0, b1 = slope[k, 0], slope[k, 1], at[k, 0], at[k, 1]
        for n in range(state.shape[0]):
            state[n, 0] = a0 * state[n, 0] + b0 * state[n, 2] - columns_in[n, k, 0]
            state[n, 1] = a1 * state[n, 1] + b1 * state[n, 2] - columns_in[n, k, 1]
        p00, p01, p11, p02, p12, p22 = cov[0, 0], cov[0, 1], cov[1, 1], cov[0, 2], cov[1, 2], cov[2, 2]
        cov[0, 0] = a0 * a0 * p00 + 2.0 * a0 * b0 * p02 + b0 * b0 * p22 + quiet
        cov[1, 1] = a1 * a1 * p11 + 2.0 * a1 * b1 * p12 + b1 * b1 * p22 + quiet
        cov[0, 1] = cov[1, 0] = a0 * a1 * p01 + a0 * b1 * p02 + b0 * a1 * p12 + b0 * b1 * p22
        cov[0, 2] = cov[2, 0] = a0 * p02 + b0 * p22
        cov[1, 2] = cov[2, 1] = a1 * p12 + b1 * p22
        cov[2, 2] = p22 + walk[0]
    return white, logs


@kernel
def lagged(values, share, fresh):
    """First-order lag of an argument (K,), in steps of a share of its time, at rest where a stretch begins."""
    out = np.empty(values.shape[0])
    held = 0.0
    for k in range(values.shape[0]):
        if fresh[k]:
            held = values[k]
        else:
            held += (1.0 - np.exp(-share)) * (0.5 * (values[k] + values[k - 1]) - held)
        out[k] = held
    return out


@kernel
def played(values, width, fresh):
    """Play of a width on an argument (K,), in its middle where a stretch begins."""
    out = np.empty(values.shape[0])
    held = 0.0
    for k in range(values.shape[0]):
        if fresh[k]:
            held = values[k]
        held = min(max(held, values[k] - 0.5 * width), values[k] + 0.5 * width)
        out[k] = held
    return out
