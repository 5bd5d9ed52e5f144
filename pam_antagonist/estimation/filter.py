"""One sample after another through the filter: time, missing values and outliers, as one compiled kernel.

The live node calls :func:`process` once a sample, a replay calls it in a loop: there is no second path, so
both give the same bits.

A sample is two pressures at a stamp and the voltages that were on the valves over the step that ends
there. What can be wrong with it is decided here, by stamps alone and never by the time of arrival:

* not newer than the last one: dropped and counted (``duplicates``, ``late``);
* older by more than ``RESTART_AFTER_NS``: the clock was set back, the filter starts again;
* samples missing before it: predicted over, up to ``LONGEST_GAP_NS``; beyond that the filter starts again;
* a pressure that is not finite: the other one alone is used, or none (prediction only);
* voltages that are not finite: the last known ones are taken to hold;
* an innovation beyond the gate (Mahalanobis distance): the pressure that is further off is left out,
  then the other one if that is beyond the gate as well. After ``PATIENCE`` such samples in a row it is
  the filter that is wrong, not the sensor, and the pressures are used again.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pam_antagonist._jit import kernel
from pam_antagonist.estimation import ukf
from pam_antagonist.model import dynamics, rest, sensor
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, VELOCITY
from pam_antagonist.model.parameters import LOCKED

RESTART_AFTER_NS = 500_000_000
LONGEST_GAP_NS = 1_000_000_000
PATIENCE = 20

MISSING_PRESSURE_1, MISSING_PRESSURE_2, MISSING_VALVE, OUTLIER, GAP, REPAIRED, LATE = 1, 2, 4, 8, 16, 32, 64
"""Flags of an estimate, as in ``JointEstimate.msg``."""

COUNTERS = ("processed", "predicted_only", "missing", "outliers", "late", "duplicates", "gaps", "repaired", "restarts")
_PROCESSED, _PREDICTED_ONLY, _MISSING, _OUTLIERS, _LATE, _DUPLICATES, _GAPS, _REPAIRS, _RESTARTS = range(len(COUNTERS))

CLOCK_SIZE = 4
_RUNNING, _LAST, _STARTED, _REJECTED = range(CLOCK_SIZE)

ESTIMATE_DTYPE = np.dtype(
    [
        ("angle", "f8"),
        ("velocity", "f8"),
        ("torque", "f8"),
        ("covariance", "f8", (3, 3)),
        ("pressure", "f8", (2,)),
        ("force", "f8", (2,)),
        ("stiffness", "f8"),
        ("innovation", "f8", (2,)),
        ("innovation_covariance", "f8", (2, 2)),
        ("nis", "f8"),
        ("subsystem", "f8"),
        ("flags", "f8"),
    ]
)
"""One estimate: rad, rad/s, N m, their covariance, Pa, N, N m/rad, Pa, Pa², and what helps to judge it."""
ROW = ESTIMATE_DTYPE.itemsize // 8
_COVARIANCE, _PRESSURE, _FORCE, _STIFFNESS, _INNOVATION, _INNOVATION_COVARIANCE, _NIS, _SUBSYSTEM, _FLAGS = (
    ESTIMATE_DTYPE.fields[name][1] // 8  # type: ignore[index]
    for name in ESTIMATE_DTYPE.names[3:]  # type: ignore[index]
)

_spread_predict, _innovate, _update, _torque_moments = ukf.predict, ukf.innovate, ukf.update, ukf.torque_moments
_start_angle, _forces, _torque_slope = rest.start_angle, dynamics.forces, dynamics.torque_slope
_subsystem, _initial_state, _pressure_behind = dynamics.subsystem, rest.initial_state, sensor.pressure_behind


def make_work(states: int, considered: int) -> tuple[np.ndarray, ...]:
    """Scratch arrays of the kernels, so that no step allocates.

    Args:
        states: n.
        considered: m.
    """
    points = 1 + 2 * (states + considered)
    return (
        np.zeros((points, states)),
        np.zeros((states, states)),
        np.zeros((states, states)),
        np.zeros((states, 2)),
        np.zeros(points),
    )


@kernel
def _start(stamp, y, u, memory, settings):
    """Set the filter to what a first sample tells: its pressures, and a joint at rest under them."""
    x, covariance, cross, held, clock, counts, _, _, _, _ = memory
    parameter_sets, initial, _, _, _, scalars = settings
    n = x.shape[0]
    p = parameter_sets[0]
    pressure_1, pressure_2 = _pressure_behind(0, y[0], p), _pressure_behind(1, y[1], p)
    angle = scalars[3] if p[LOCKED] != 0.0 else _start_angle(pressure_1, pressure_2, p)
    x[:] = _initial_state(angle, pressure_1, pressure_2, u, p)
    covariance[:] = 0.0
    cross[:] = 0.0
    for i in range(n):
        covariance[i, i] = initial[i]
    held[0] = u[0]
    held[1] = u[1]
    clock[_RUNNING] = 1
    clock[_LAST] = stamp
    clock[_STARTED] = stamp
    clock[_REJECTED] = 0


@kernel
def _select(innovation, s, usable_1, usable_2, gate):
    """Which pressures lie within the gate: the joint Mahalanobis distance first, then the better one alone."""
    v1 = innovation[0]
    v2 = innovation[1]
    limit = gate * gate
    if usable_1 and usable_2:
        determinant = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
        distance = (v1 * v1 * s[1, 1] - 2.0 * v1 * v2 * s[0, 1] + v2 * v2 * s[0, 0]) / determinant
        if distance <= limit:
            return True, True
        if v1 * v1 / s[0, 0] > v2 * v2 / s[1, 1]:
            usable_1 = False
        else:
            usable_2 = False
    if usable_1:
        usable_1 = v1 * v1 / s[0, 0] <= limit
    if usable_2:
        usable_2 = v2 * v2 / s[1, 1] <= limit
    return usable_1, usable_2


@kernel
def _finite(x, covariance):
    for i in range(x.shape[0]):
        if not (math.isfinite(x[i]) and math.isfinite(covariance[i, i])):
            return False
    return True


@kernel
def _write(row, memory, settings, nis, flags, work):
    """Put the estimate into its row; False where the covariance is lost."""
    x, covariance, cross, held, _, _, innovation, innovation_covariance, moments, _ = memory
    parameter_sets, _, _, _, _, scalars = settings
    p = parameter_sets[0]
    if _torque_moments(x, covariance, cross, parameter_sets, scalars[1], work, moments) < 0:
        return False
    row[0] = x[ANGLE]
    row[1] = x[VELOCITY]
    row[2] = moments[0]
    for i in range(2):
        for j in range(2):
            row[_COVARIANCE + 3 * i + j] = covariance[i, j]
        row[_COVARIANCE + 3 * i + 2] = moments[2 + i]
        row[_COVARIANCE + 6 + i] = moments[2 + i]
        row[_PRESSURE + i] = x[PRESSURE_1 + i]
        row[_INNOVATION + i] = innovation[i]
        for j in range(2):
            row[_INNOVATION_COVARIANCE + 2 * i + j] = innovation_covariance[i, j]
    row[_COVARIANCE + 8] = moments[1]
    row[_FORCE], row[_FORCE + 1] = _forces(x, p)
    row[_STIFFNESS] = _torque_slope(x, p)
    row[_NIS] = nis
    row[_SUBSYSTEM] = _subsystem(x, p)
    row[_FLAGS] = flags
    return math.isfinite(row[2]) and math.isfinite(row[_COVARIANCE + 8])


@kernel
def process(stamp, y, u, memory, settings, work, row):
    """Take one sample in.

    Args:
        stamp: [ns].
        y: pressures (2,) [Pa], NaN where missing.
        u: voltages (2,) [V] over the step that ends at the stamp, NaN where missing.
        memory: what the filter remembers, see :class:`pam_antagonist.estimation.Estimator`.
        settings: its settings, likewise.
        work: scratch of :func:`make_work`.
        row: result (ROW,), an ``ESTIMATE_DTYPE`` as floats.

    Returns:
        True where ``row`` holds an estimate; False where the sample was dropped, or no filter could be
        started from it.
    """
    x, covariance, cross, held, clock, counts, innovation, innovation_covariance, _, noise = memory
    parameter_sets, _, process_noise, measurement_noise, gain_noise, scalars = settings
    period, kappa, gate = scalars[0], scalars[1], scalars[2]
    finite_1 = math.isfinite(y[0])
    finite_2 = math.isfinite(y[1])
    known_u = math.isfinite(u[0]) and math.isfinite(u[1])
    innovation[:] = np.nan
    innovation_covariance[:] = np.nan
    flags = 0
    elapsed = stamp - clock[_LAST]
    if clock[_RUNNING] == 1:
        if elapsed == 0:
            counts[_DUPLICATES] += 1
            return False
        if -RESTART_AFTER_NS <= elapsed < 0:
            counts[_LATE] += 1
            return False
        if elapsed < 0 or elapsed > LONGEST_GAP_NS or not _finite(x, covariance):
            clock[_RUNNING] = 0
            counts[_RESTARTS] += 1
    if clock[_RUNNING] == 0:
        if not (finite_1 and finite_2 and known_u):
            counts[_MISSING] += 1
            return False
        _start(stamp, y, u, memory, settings)
        counts[_PROCESSED] += 1
        return _write(row, memory, settings, np.nan, 0, work)

    seconds = elapsed / 1e9
    steps = max(1, int(seconds / period + 0.5))
    if steps > 1:
        counts[_GAPS] += 1
        flags |= GAP
    dt = seconds / steps
    for i in range(x.shape[0]):
        noise[i] = process_noise[i] * (dt / period)
    repaired = 0
    for step in range(steps):
        if step == steps - 1 and known_u:
            held[0] = u[0]
            held[1] = u[1]
        outcome = _spread_predict(x, covariance, cross, held, parameter_sets, dt, noise, kappa, work)
        if outcome < 0:
            break
        repaired += outcome
    clock[_LAST] = stamp
    if not _finite(x, covariance):
        # Nothing of the old estimate is of use: begin again with this sample, or with the next good one.
        clock[_RUNNING] = 0
        counts[_RESTARTS] += 1
        if not (finite_1 and finite_2 and known_u):
            return False
        _start(stamp, y, u, memory, settings)
        counts[_PROCESSED] += 1
        return _write(row, memory, settings, np.nan, 0, work)

    p = parameter_sets[0]
    for i in range(2):
        innovation[i] = _pressure_behind(i, y[i], p)
    _innovate(x, covariance, innovation, measurement_noise, innovation, innovation_covariance)
    use_1, use_2 = _select(innovation, innovation_covariance, finite_1, finite_2, gate)
    if (finite_1 and not use_1) or (finite_2 and not use_2):
        clock[_REJECTED] += 1
        if clock[_REJECTED] > PATIENCE:
            use_1, use_2 = finite_1, finite_2
        else:
            flags |= OUTLIER
            counts[_OUTLIERS] += 1
    else:
        clock[_REJECTED] = 0
    nis = np.nan
    if use_1 or use_2:
        nis = _update(x, covariance, cross, innovation, measurement_noise, gain_noise, use_1, use_2, work)
    else:
        counts[_PREDICTED_ONLY] += 1
    if not use_1:
        innovation[0] = np.nan
    if not use_2:
        innovation[1] = np.nan
    if not finite_1:
        flags |= MISSING_PRESSURE_1
    if not finite_2:
        flags |= MISSING_PRESSURE_2
    if not known_u:
        flags |= MISSING_VALVE
    if not (finite_1 and finite_2 and known_u):
        counts[_MISSING] += 1
    if repaired > 0:
        counts[_REPAIRS] += 1
        flags |= REPAIRED
    counts[_PROCESSED] += 1
    return _write(row, memory, settings, nis, flags, work)


@kernel
def process_all(stamps, pressures, voltages, memory, settings, work, rows, states, index, started):
    """:func:`process` for every sample of a recording.

    Args:
        stamps: (N,) [ns].
        pressures: (N, 2) [Pa].
        voltages: (N, 2) [V].
        memory, settings, work: as for :func:`process`.
        rows: results (N, ROW).
        states: result (N, n), the whole state behind each estimate.
        index: for each result the sample it belongs to (N,).
        started: for each result the stamp [ns] at which its filter was started (N,).

    Returns:
        How many results there are.
    """
    count = 0
    clock = memory[4]
    for k in range(stamps.shape[0]):
        if process(stamps[k], pressures[k], voltages[k], memory, settings, work, rows[count]):
            states[count] = memory[0]
            index[count] = k
            started[count] = clock[_STARTED]
            count += 1
    return count


def started_ns(clock: Any) -> int | None:
    """Stamp of the sample that the running filter was started with, None before the first."""
    return int(clock[_STARTED]) if clock[_RUNNING] else None


def running_since(stamp_ns: int) -> tuple[int, int, int, int]:
    """The clock (CLOCK_SIZE,) of a filter that was started at a stamp [ns]."""
    return 1, stamp_ns, stamp_ns, 0
