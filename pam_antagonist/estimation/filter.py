"""Processing of samples by the filter: time, missing values and outliers, as one compiled kernel.

The live node calls :func:`process_all` with one sample, a replay with all of them: both give the same bits.

A sample is two pressures at a stamp and the voltages that were on the valves over the step that ends
there. All decisions here depend on stamps (:mod:`~pam_antagonist.estimation.stamps`) and values, never on the time of
arrival:

* a stamp not newer than the last one: the sample is dropped and counted (``duplicates``, ``late``);
* a stamp older by more than ``RESTART_AFTER_NS``: the clock was set back, and the filter starts again;
* an interval longer than the stream's own period: samples are missing. The filter predicts over the gap, up to
  ``LONGEST_GAP_NS``, with the last known voltages or with those that explain the pressures after it
  (:mod:`~pam_antagonist.estimation.bridge`); after a longer gap it starts again;
* a pressure that is not finite, or not possible on the rig (:mod:`~pam_antagonist.estimation.possible`): only the other
  one is used, or none (prediction only);
* voltages that are not finite or not possible: the last known ones are held;
* a joint with pressure regulators: commanded pressures take the place of the voltages. At a start, a commanded pressure
  also replaces a missing measured one;
* both pressures as in the last sample, of sensors that are slower than the samples: prediction only
  (:mod:`~pam_antagonist.estimation.stamps`);
* a measured angle, where the filter uses one: see :mod:`~pam_antagonist.estimation.encoder`;
* an innovation beyond the declared ``onset`` of pushes: see :mod:`~pam_antagonist.estimation.push`;
* an innovation beyond the gate (Mahalanobis distance): the pressure with the larger normalised innovation is left out,
  then the other one if it is beyond the gate as well. After ``PATIENCE`` such samples in a row the filter is
  taken to be wrong, not the sensor, and the pressures are used again.

The gap between two samples is divided into equal steps of the model near 1 ms. The process noise of the tuning is
per nominal period, and is scaled to the step.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import in_place, inlined, merged
from pam_antagonist.estimation import bridge, encoder, push, stamps, start, ukf
from pam_antagonist.estimation.memory import (
    COUNTERS,
    GAP,
    MISSING_PRESSURE_1,
    MISSING_PRESSURE_2,
    MISSING_VALVE,
    NO_ANGLE,
    OUTLIER,
    REPAIRED,
    FilterSettings,
    Memory,
)
from pam_antagonist.estimation.stamps import LAST, LONGEST_GAP_NS, REJECTED, RESTART_AFTER_NS, RUNNING, STARTED
from pam_antagonist.estimation.ukf import FilterScratch
from pam_antagonist.model import dynamics
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, VELOCITY
from pam_antagonist.model.parameters import SIGNAL, SLOT_OF

_NO_FLAGS, _ANGLE_MISSING, _ANGLE_REFUSED = np.int64(0), np.int64(NO_ANGLE), np.int64(OUTLIER)
_VERDICT, _WITHOUT, _PATIENCE = encoder.VERDICT, encoder.WITHOUT, stamps.PATIENCE
(
    _PROCESSED, _PREDICTED_ONLY, _MISSING, _OUTLIERS, _LATE, _DUPLICATES, _GAPS, _REPAIRS, _RESTARTS, _ANGLES_USED,
    _ANGLES_REFUSED, _REPEATED,
) = range(len(COUNTERS))  # fmt: skip

_innovate, _update, _torque_moments = ukf.innovate, ukf.update, ukf.torque_moments
_forces, _torque_slope, _start = dynamics.forces, dynamics.torque_slope, start.start
_subsystem, _pressure_behind = dynamics.subsystem, dynamics.pressure_behind
_EXTERNAL_TORQUE = SLOT_OF[push.EXTERNAL_TORQUE]
_REGULATED = SLOT_OF["regulator_rate_1"]
_examine, _correct_angle = encoder.examine, encoder.correct
_jumped, _widen = push.jumped, push.widen
_propagate, _over_gap = bridge.propagate, bridge.over_gap
_repeats, _forget = stamps.repeats, stamps.forget
_start_clock, _own_period, _steps_over = stamps.start, stamps.own_period, stamps.steps_over


@inlined
def _put_further(further, k, share, sets, beside):
    """Further inputs of sample k into all parameter sets, a share of the way from those that are there.

    `beside`: the sets of the sigma points side by side.
    """
    for j in range(further.shape[1]):
        value = sets[0, SIGNAL + j] + share * (further[k, j] - sets[0, SIGNAL + j])
        for row in range(sets.shape[0]):
            sets[row, SIGNAL + j] = value
        for group in range(beside.shape[0]):
            for lane in range(beside.shape[2]):
                beside[group, SIGNAL + j, lane] = value


@inlined
def _distance(innovation, s):
    """Squared Mahalanobis distance of both pressures' innovations."""
    v1, v2 = innovation[0], innovation[1]
    determinant = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
    return (v1 * v1 * s[1, 1] - 2.0 * v1 * v2 * s[0, 1] + v2 * v2 * s[0, 0]) / determinant


@in_place
def _select(innovation, s, usable_1, usable_2, gate):
    """Which pressures lie within the gate: both by their joint Mahalanobis distance, else the better one alone."""
    v1 = innovation[0]
    v2 = innovation[1]
    limit = gate * gate
    if usable_1 and usable_2:
        if _distance(innovation, s) <= limit:
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


@in_place
def _finite(x, covariance):
    for i in range(x.shape[0]):
        if not (math.isfinite(x[i]) and math.isfinite(covariance[i, i])):
            return False
    return True


@in_place
def _write(row, effects, memory, settings, nis, flags, work):
    """Put the estimate into its row; False where the covariance is lost."""
    x, covariance, moments = memory.x, memory.covariance, memory.torque_moments
    sets = settings.parameter_sets
    p = sets[0]
    if _torque_moments(x, covariance, memory.cross, sets, settings.kappa, effects, work, moments) < 0:
        return False
    row.angle = x[ANGLE]
    row.velocity = x[VELOCITY]
    row.torque = moments[0]
    for i in range(2):
        for j in range(2):
            row.covariance[i, j] = covariance[i, j]
            row.innovation_covariance[i, j] = memory.innovation_covariance[i, j]
        row.covariance[i, 2] = moments[2 + i]
        row.covariance[2, i] = moments[2 + i]
        row.pressure[i] = x[PRESSURE_1 + i]
        row.innovation[i] = memory.innovation[i]
    row.covariance[2, 2] = moments[1]
    row.force[0], row.force[1] = _forces(x, p, effects)
    row.stiffness = -_torque_slope(x, p, effects)
    row.nis = nis
    row.subsystem = _subsystem(x, p, effects)
    row.flags = flags
    at = int(p[_EXTERNAL_TORQUE])
    row.external_torque = x[at] if at > 0 else np.nan
    for i in range(2):
        row.external_torque_covariance[i] = covariance[at, i] if at > 0 else np.nan
    row.external_torque_covariance[2] = moments[2 + at] if at > 0 else np.nan
    row.external_torque_covariance[3] = covariance[at, at] if at > 0 else np.nan
    return math.isfinite(moments[0]) and math.isfinite(moments[1])


@in_place
def _dropped(elapsed, x, covariance, clock, counts):
    """Whether a running filter drops a sample after this interval [ns]. Stops a filter that has to start again."""
    if clock[RUNNING] == 0:
        return False
    if elapsed == 0:
        counts[_DUPLICATES] += 1
        return True
    if -RESTART_AFTER_NS <= elapsed < 0:
        counts[_LATE] += 1
        return True
    if elapsed < 0 or elapsed > LONGEST_GAP_NS or not _finite(x, covariance):
        clock[RUNNING] = 0
        counts[_RESTARTS] += 1
    return False


@in_place
def _begin(stamp, y, u, angles, further, k, effects, memory, settings, work, row):
    """Start the filter with a sample that has pressures and voltages. Returns whether there is an estimate."""
    if further is not None:
        _put_further(further, k, 1.0, settings.parameter_sets, work.lane_sets)
    memory.held[0], memory.held[1] = u
    _start(y, effects, memory, settings, work)
    _start_clock(memory.clock, stamp)
    _forget(memory.readings)
    _repeats(y, 0.0, memory.readings)
    flags = _NO_FLAGS
    if angles is not None:
        # Both pressures are finite here. numba would compile _angle once more for the literal True.
        flags = _angle(angles[k], 0.0, y, math.isfinite(y[0]), effects, memory, settings, work)
    memory.counts[_PROCESSED] += 1
    return _write(row, effects, memory, settings, np.nan, flags, work)


@in_place
def _angle(angle, elapsed, y, usable, effects, memory, settings, work):
    """Update with a measured angle [rad], if there is one that may be used. Returns flags of the estimate."""
    counts = memory.counts
    if not math.isfinite(angle):
        memory.encoder[_WITHOUT] += elapsed
        return _ANGLE_MISSING
    reading, before = angle - settings.angle_offset, memory.encoder[_VERDICT]
    usable_angle = _examine(
        reading, elapsed, y, usable, memory.held, memory.x, settings.parameter_sets[0], settings.measurement_noise,
        settings.angle_noise, settings.angle_step, memory.encoder, work,
    )  # fmt: skip
    if memory.encoder[_VERDICT] != before and usable:
        # A faulty encoder has spoilt the estimate: start again from the pressures.
        _start(y, effects, memory, settings, work)
    if usable_angle and _correct_angle(reading, memory, settings, work):
        counts[_ANGLES_USED] += 1
        return _NO_FLAGS
    counts[_ANGLES_REFUSED] += 1
    return _ANGLE_REFUSED


@merged
def _advance(elapsed, period, y, usable_1, usable_2, u, known_u, effects, memory, settings, work):
    """Predict over the time since the last sample [ns], missing samples included.

    The voltages of a sample were on the valves over the stream's period [s] that ends there.
    """
    steps, dt, gap, since = _steps_over(elapsed, period, settings.period, settings.step)
    for i in range(memory.x.shape[0]):
        memory.noise[i] = settings.process_noise[i] * (dt / settings.period)
    if since > 0:
        repaired = _over_gap(steps, since, dt, y, usable_1, usable_2, u, known_u, effects, memory, settings, work)
    else:
        repaired = _propagate(steps, since, dt, u, known_u, effects, memory, settings, work)
    return gap, repaired


@merged
def _gate(y, usable_1, usable_2, memory, settings):
    """Innovation of the pressures. Returns which pressures to use, and whether one was left out as an outlier."""
    innovation, covariance = memory.innovation, memory.innovation_covariance
    p = settings.parameter_sets[0]
    for i in range(2):
        innovation[i] = _pressure_behind(i, y[i], p)
    _innovate(memory.x, memory.covariance, innovation, settings.measurement_noise, innovation, covariance)
    use_1, use_2 = _select(innovation, covariance, usable_1, usable_2, settings.gate)
    if usable_1 and usable_2 and _jumped(_distance(innovation, covariance), p):
        _widen(memory.covariance, p)
    clock = memory.clock
    if use_1 == usable_1 and use_2 == usable_2:
        clock[REJECTED] = 0
        return use_1, use_2, False
    clock[REJECTED] += 1
    if clock[REJECTED] > _PATIENCE:
        return usable_1, usable_2, False
    return use_1, use_2, True


@merged
def _correct(use_1, use_2, memory, settings, work):
    """Update with the pressures in use, and clear the innovation of the others. Returns the NIS."""
    innovation = memory.innovation
    nis = np.nan
    if use_1 or use_2:
        nis = _update(
            memory.x,
            memory.covariance,
            memory.cross,
            innovation,
            settings.measurement_noise,
            settings.gain_noise,
            use_1,
            use_2,
            work,
        )
    else:
        memory.counts[_PREDICTED_ONLY] += 1
    if not use_1:
        innovation[0] = np.nan
    if not use_2:
        innovation[1] = np.nan
    return nis


@inlined
def _possible(value, bounds):
    """Whether a value is one that the rig can have; NaN and infinite ones are not."""
    return bounds[0] <= value <= bounds[1]


@in_place
def _flagged(usable_1, usable_2, known_u, outlier, gap, repaired, counts):
    """Flags of an estimate; also counts its sample by outcome."""
    flags = 0
    if not usable_1:
        flags |= MISSING_PRESSURE_1
    if not usable_2:
        flags |= MISSING_PRESSURE_2
    if not known_u:
        flags |= MISSING_VALVE
    if flags != 0:
        counts[_MISSING] += 1
    if outlier:
        counts[_OUTLIERS] += 1
        flags |= OUTLIER
    if gap:
        flags |= GAP
    if repaired:
        counts[_REPAIRS] += 1
        flags |= REPAIRED
    return flags


@merged
def process(stamp, y, u, angles, further, k, effects, memory, settings, work, row):
    """Process one sample.

    `stamp`: [ns]. `y`: both pressures [Pa], NaN where missing. `u`: both voltages [V] over the step that ends at the
    stamp, NaN where missing. `angles`: measured angles (N,) [rad], NaN where missing; None where none is used.
    `further`: further inputs of the model (N, 4 + 15); None for a model without any. `k`: index of the sample in both.
    `memory`: :class:`Memory` of the filter, changed in place. `settings`: its :class:`FilterSettings`. `row`: result, a
    record of ``ESTIMATE_DTYPE``. Returns True if ``row`` holds an estimate; False if the sample was dropped, or could
    not start the filter.
    """
    clock, counts = memory.clock, memory.counts
    bounds = settings.possible
    usable_1 = _possible(y[0], bounds[0])
    usable_2 = _possible(y[1], bounds[1])
    known_u = _possible(u[0], bounds[2]) and _possible(u[1], bounds[3])
    p = settings.parameter_sets[0]
    regulated = p[_REGULATED] > 0.0 and p[_REGULATED + 1] > 0.0
    complete = known_u and (regulated or (usable_1 and usable_2))
    # At rest a regulator holds its commanded pressure, which can replace a missing measured one.
    at_rest = (y[0] if usable_1 else u[0], y[1] if usable_2 else u[1])
    memory.innovation[:] = np.nan
    memory.innovation_covariance[:] = np.nan
    elapsed = stamp - clock[LAST]
    if _dropped(elapsed, memory.x, memory.covariance, clock, counts):
        return False
    if clock[RUNNING] == 0:
        if complete:
            return _begin(stamp, at_rest, u, angles, further, k, effects, memory, settings, work, row)
        counts[_MISSING] += 1
        return False

    held = _repeats(y, elapsed * 1e-9, memory.readings) and usable_1 and usable_2
    period = _own_period(elapsed, clock, settings.period)
    if further is not None:
        _put_further(further, k, 0.5, settings.parameter_sets, work.lane_sets)  # in the middle of the step
    gap, repaired = _advance(elapsed, period, y, usable_1, usable_2, u, known_u, effects, memory, settings, work)
    if further is not None:
        _put_further(further, k, 1.0, settings.parameter_sets, work.lane_sets)
    if gap:
        counts[_GAPS] += 1
    clock[LAST] = stamp
    if not _finite(memory.x, memory.covariance):
        # The estimate is lost: start again with this sample, or with the next complete one.
        clock[RUNNING] = 0
        counts[_RESTARTS] += 1
        return complete and _begin(stamp, at_rest, u, angles, further, k, effects, memory, settings, work, row)

    use_1, use_2, outlier = False, False, False
    if held:
        counts[_REPEATED] += 1
    else:
        use_1, use_2, outlier = _gate(y, usable_1, usable_2, memory, settings)
    nis = _correct(use_1, use_2, memory, settings, work)
    if not (usable_1 and usable_2 and known_u):
        # What is finite was there, but cannot be true.
        outlier = (
            outlier or (not usable_1 and math.isfinite(y[0])) or (not usable_2 and math.isfinite(y[1]))
            or (not known_u and math.isfinite(u[0]) and math.isfinite(u[1]))
        )  # fmt: skip
    flags = _flagged(usable_1, usable_2, known_u, outlier, gap, repaired > 0, counts)
    if angles is not None:
        flags |= _angle(angles[k], elapsed * 1e-9, y, usable_1 and usable_2, effects, memory, settings, work)
    counts[_PROCESSED] += 1
    return _write(row, effects, memory, settings, nis, flags, work)


@in_place
def process_all(
    stamps, pressures, voltages, angles, further, effects, memory_fields, settings_fields, work_fields, rows, states,
    index, started,
):  # fmt: skip
    """:func:`process` for every sample of a recording, called from Python.

    `stamps`: (N,) [ns]. `pressures`: (N, 2) [Pa]. `voltages`: (N, 2) [V]. `angles`: (N,) [rad]; None for a filter
    without an encoder, for which numba compiles a smaller version. `further`: (N, 4 + 15), or None likewise.
    `memory_fields`: fields of :class:`Memory` as a
    plain tuple: numba unpacks it in a third of a NamedTuple's time. `settings_fields`: fields of
    :class:`FilterSettings`, likewise. `work_fields`: those of :class:`pam_antagonist.estimation.ukf.FilterScratch`,
    likewise. `rows`: results (N,) of ``ESTIMATE_DTYPE``. `states`: result (N, n), the whole state of each estimate.
    `index`: result (N,), the index of each estimate's sample. `started`: result (N,), the stamp [ns] at which the
    filter of each estimate was started.
    """
    memory, settings, work = Memory(*memory_fields), FilterSettings(*settings_fields), FilterScratch(*work_fields)
    count = 0
    for k in range(stamps.shape[0]):
        y, u = (pressures[k, 0], pressures[k, 1]), (voltages[k, 0], voltages[k, 1])
        if process(stamps[k], y, u, angles, further, k, effects, memory, settings, work, rows[count]):
            for i in range(states.shape[1]):
                states[count, i] = memory.x[i]
            index[count] = k
            started[count] = memory.clock[STARTED]
            count += 1
    return count
