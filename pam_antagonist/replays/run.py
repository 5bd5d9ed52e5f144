"""Run a recording through the estimator and through the model alone, and judge both."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import COMPILING
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import EstimateRun, Estimator, metrics, simulate_model
from pam_antagonist.estimation.errors import (
    ChannelErrors,
    FilterErrors,
    ModelErrors,
    channel_errors,
    pressure_errors,
)
from pam_antagonist.model import sensor
from pam_antagonist.recording import Recording, bag_name, recording_hash
from pam_antagonist.recording.joint import JointCondition, joint_condition
from pam_antagonist.recording.notes import sealed_muscles
from pam_antagonist.replays.live import Apart, LiveComparison, LiveInput, as_live, compare_with_live, ended, taken
from pam_antagonist.replays.result import (
    FilterFacts,
    Innovation,
    JointFacts,
    ModelTrack,
    RecordedRig,
    RecordingFacts,
    Replay,
    ReplayReport,
    Timing,
)
from pam_antagonist.replays.segments import Plan, plan
from pam_antagonist.rig import Reading, Rig, RigIdentity, differences, fingerprint

FloatArray = NDArray[np.float64]

_CHUNK = 5000
"""Samples between two signs of progress."""


def replay(
    recording: Recording,
    rig: Rig,
    tuning: str = "default",
    joint: str = "auto",
    lock_angle: float | None = None,
    read_seconds: float = 0.0,
    progress: Callable[[int], None] | None = None,
    begin_s: float | None = None,
    angle_sensor: str = "auto",
) -> Replay:
    """Run a recording through the estimator and through the model alone, and judge both.

    The filter is started where the live one was, if its estimate was recorded, so that both can be compared bit by
    bit; else at the first sample. Where the live one was started before the recording, the filter goes on from the
    first checkpoint of the live one that the recording holds.

    Args:
        recording: the recording.
        rig: the rig.
        tuning: name of one of its tunings.
        joint: ``free``, ``locked`` or ``auto``.
        lock_angle: angle of a locked joint [rad], where it is known.
        read_seconds: what reading the recording took [s], for the real-time factor.
        progress: called now and then with the number of samples done since the last call.
        begin_s: time from the first sample from which on there is to be an estimate [s]; None: all of it. The filter
            goes on from the last checkpoint before, or runs from the start where none is of use. The estimates are the
            same as those of the whole.
        angle_sensor: ``none``, ``encoder``, or ``auto``: as the live filter, where a checkpoint of it tells, else none.

    Raises:
        BadInput: a tuning or joint condition that does not exist, no sample to start from, or none from that time on;
            a joint with regulators for one with valves.
    """
    begin = _clock()
    recording.driven_by(rig.drive)
    progress = progress or (lambda samples: None)
    begin_ns = None if begin_s is None else _stamp_at(recording, begin_s)
    state = joint_condition(recording, joint, lock_angle)
    sensor_used = _angle_sensor(recording, angle_sensor)
    estimator = Estimator(rig, tuning, state.condition, state.lock_angle, sensor_used)
    given = as_live(recording)
    planned = plan(recording, estimator, begin_ns)
    progress(planned.skipped)
    run = _estimate(recording, given, estimator, planned, progress)
    if len(run.rows) == 0:
        needed = "both pressures and valve voltages" if rig.drive == "valve" else "what both regulators were asked for"
        raise BadInput(f"{recording.path}: no sample has {needed}, so no filter can be started")
    filtered = _clock()
    model = _model_alone(recording, rig, state, run, planned, given)
    modelled = _clock()
    total = modelled - begin + read_seconds
    if begin_ns is not None:
        run, model = _from(recording, run, model, begin_ns)
    report = _judged(recording, rig, state, run, model, planned, begin_ns)
    from_here = slice(None) if begin_ns is None else recording.stamp_ns >= begin_ns
    report = dataclasses.replace(
        report,
        realtime_factor=report.duration_s / total,
        live_without=None if recording.estimate is None else int(given.lacked[from_here].sum()),
        timing=Timing(read_seconds, filtered - begin, modelled - filtered, total),
    )
    return Replay(recording, rig, tuning, state, run, model, report, planned)


def _angle_sensor(recording: Recording, wanted: str) -> str:
    """Which angle sensor the filter is to use."""
    if wanted == "auto":
        return "encoder" if any(len(item.angle_sensor) for item in recording.checkpoints) else "none"
    if wanted == "encoder" and recording.angle_sensor is None:
        raise BadInput(
            f"{recording.path}: has no topic angle_sensor; record one (parameter angle_sensor: encoder of plant or "
            "bridge), or name it by --topic angle_sensor=/NAME"
        )
    return wanted


def _clock() -> float:
    """Time that went into work [s]; compiling, which is done once on each machine, does not count."""
    return time.perf_counter() - COMPILING.seconds


def _stamp_at(recording: Recording, begin_s: float) -> int:
    if not 0.0 <= begin_s <= recording.duration_s:
        raise BadInput(
            f"{recording.path}: cannot begin at {begin_s:g} s, expected 0 to {recording.duration_s:.3f} s, its length"
        )
    return int(recording.stamp_ns[0]) + round(begin_s * 1e9)


def after(whole: Replay, begin_s: float) -> Replay:
    """The part of a replay from a time on, judged by itself; filter and model still run from the recording's start.

    Args:
        whole: a replay.
        begin_s: time from its first sample on [s].

    Raises:
        BadInput: there is no estimate from then on.
    """
    recording = whole.recording
    begin_ns = int(recording.stamp_ns[0]) + round(begin_s * 1e9)
    part, track = _from(recording, whole.run, whole.model, begin_ns)
    report = dataclasses.replace(
        _judged(recording, whole.rig, whole.joint, part, track, whole.plan, begin_ns),
        realtime_factor=whole.report.realtime_factor,
        live_without=whole.report.live_without,
        timing=whole.report.timing,
    )
    return Replay(recording, whole.rig, whole.tuning, whole.joint, part, track, report, whole.plan)


def _from(recording: Recording, run: EstimateRun, model: ModelTrack, begin_ns: int) -> tuple[EstimateRun, ModelTrack]:
    """Estimates and model from a stamp on."""
    kept = run.stamp_ns >= begin_ns
    if not kept.any():
        seconds = (begin_ns - int(recording.stamp_ns[0])) * 1e-9
        raise BadInput(f"{recording.path}: no estimate from {seconds:g} s on")
    return taken(run, kept), ModelTrack(model.angle[kept], model.torque[kept], model.pressure[kept])


def _estimate(
    recording: Recording, given: LiveInput, estimator: Estimator, planned: Plan, progress: Callable[[int], None]
) -> EstimateRun:
    """Run the filter over the recording, begun afresh, or from a checkpoint, as planned."""
    stamps = recording.stamp_ns
    parts: list[EstimateRun] = []
    ends = [*(segment.first for segment in planned.segments[1:]), len(stamps)]
    for segment, end in zip(planned.segments, ends, strict=True):
        estimator.reset()
        if segment.checkpoint is not None:
            estimator.restore(segment.checkpoint)
        for low in range(segment.first, end, _CHUNK):
            high = min(low + _CHUNK, end)
            kept = low + np.flatnonzero(given.had[low:high])
            part = estimator.run(stamps[kept], given.pressure[kept], given.voltage[kept], given.angle[kept])
            parts.append(dataclasses.replace(part, index=kept[part.index]))
            progress(high - low)
    if not parts:
        parts.append(estimator.run(stamps[:0], given.pressure[:0], given.voltage[:0]))
    return EstimateRun(
        rows=np.concatenate([part.rows for part in parts]),
        added={name: np.concatenate([part.added[name] for part in parts]) for name in parts[0].added},
        stamp_ns=np.concatenate([part.stamp_ns for part in parts]),
        index=np.concatenate([part.index for part in parts]),
        started_ns=np.concatenate([part.started_ns for part in parts]),
        counts=estimator.counts,
    )


def _model_alone(
    recording: Recording, rig: Rig, joint: JointCondition, run: EstimateRun, planned: Plan, given: LiveInput
) -> ModelTrack:
    """The model without any measurement, begun anew at the first pressures wherever the filter was started.

    A checkpoint is no start of the model: it runs on through it, also through what the filter skipped.
    """
    period, points = recording.even_grid(rig.sample_period)
    resumed = [segment.first for segment in planned.segments if segment.checkpoint is not None]
    begins = np.flatnonzero(np.diff(run.started_ns) != 0) + 1
    begins = np.setdiff1d(begins, np.searchsorted(run.index, resumed))
    index = run.index
    if planned.model_first < planned.skipped:
        complete = given.had & np.isfinite(given.pressure).all(axis=1) & np.isfinite(given.voltage).all(axis=1)
        first = planned.model_first + int(np.argmax(complete[planned.model_first :]))
        before = first + np.flatnonzero(given.had[first : planned.skipped])
        index, begins = np.concatenate((before, index)), begins + len(before)
    count = len(index)
    track = ModelTrack(np.empty(count), np.empty(count), np.empty((count, 2)))
    for first, end in zip([0, *begins], [*begins, count], strict=True):
        # On the recording's grid; samples that are missing are stepped over with the voltages held.
        own = index[first:end]
        step = points[own] - points[own[0]]
        voltage = np.full((int(step[-1]) + 1, 2), np.nan)
        voltage[step] = recording.voltage[own]
        external = None
        if recording.external_torque is not None:
            external = np.zeros(len(voltage))
            external[step] = recording.external_torque[own]
        alone = simulate_model(
            rig,
            voltage,
            _first_pressure(recording, own[0]),
            joint=joint.condition,
            lock_angle=joint.lock_angle,
            external_torque=external,
            period=period,
        )
        track.angle[first:end] = alone.angle[step]
        track.torque[first:end] = alone.torque[step]
        track.pressure[first:end] = alone.pressure[step]
    skipped = count - len(run.index)
    return ModelTrack(track.angle[skipped:], track.torque[skipped:], track.pressure[skipped:])


def _first_pressure(recording: Recording, at: int) -> FloatArray:
    """Pressures (2,) [Pa] with which the model starts; a regulator without a sensor holds what it is asked for."""
    measured = recording.pressure[at]
    if recording.drive == "valve":
        return measured
    return np.where(np.isfinite(measured), measured, recording.voltage[at])


def _judged(
    recording: Recording,
    rig: Rig,
    joint: JointCondition,
    run: EstimateRun,
    model: ModelTrack,
    planned: Plan,
    begin_ns: int | None,
) -> ReplayReport:
    """The report of a recording, or of its part from a stamp on, without what depends on the clock of the machine."""
    rows, index = run.rows, run.index
    first_ns = int(recording.stamp_ns[0]) if begin_ns is None else int(run.stamp_ns[0])
    pressure = recording.pressure[index]
    angle = None if recording.angle is None else recording.angle[index]
    torque = None if recording.torque is None else recording.torque[index]
    variance, reading = rows["covariance"], rig.sensors.reading
    nis = metrics.nis_consistency(rows["nis"], rows["innovation"])
    whitened = metrics.normalised_innovation(rows["innovation"], rows["innovation_covariance"])
    return ReplayReport(
        samples=len(recording.stamp_ns) if begin_ns is None else len(run.rows),
        duration_s=float(recording.stamp_ns[-1] - first_ns) * 1e-9 + recording.even_grid(rig.sample_period)[0],
        realtime_factor=float("nan"),
        ukf=FilterErrors(
            channel_errors(angle, rows["angle"], "deg", variance[:, 0, 0], reading("angle")),
            channel_errors(torque, rows["torque"], "nm", variance[:, 2, 2], reading("torque")),
            pressure_errors(pressure, _readings(rig, rows["pressure"])),
            _external(recording, run),
        ),
        model_alone=ModelErrors(
            channel_errors(angle, model.angle, "deg"),
            channel_errors(torque, model.torque, "nm"),
            pressure_errors(pressure, model.pressure),
        ),
        innovation=Innovation(
            nis.mean,
            nis.in_95,
            metrics.whiteness_p(whitened),
            metrics.largest_autocorrelation(whitened),
            nis.samples,
            _nees(angle, rows["angle"], variance[:, 0, 0], reading("angle")),
            _nees(torque, rows["torque"], variance[:, 2, 2], reading("torque")),
        ),
        recording=RecordingFacts(
            f"{bag_name(recording.path)} {recording.namespace}".strip(),
            recording_hash(recording),
            dict(recording.topics),
            int(recording.stamp_ns[0]),
            (*recording.issues, *_episodes(recording), *_sealed(recording, rig), *_other_joint(recording, rig)),
            _rigs(recording, rig),
        ),
        joint=JointFacts.of(joint),
        estimator=FilterFacts(
            tuple(int(stamp) for stamp in np.unique(run.started_ns)),
            run.counts,
            tuple(segment.checkpoint.stamp_ns for segment in planned.segments if segment.checkpoint is not None),
            tuple(planned.refused),
        ),
        live_equal=_live(recording, run, planned, begin_ns),
        live_without=None,
        timing=Timing(0.0, 0.0, 0.0, 0.0),
    )


def _live(recording: Recording, run: EstimateRun, planned: Plan, begin_ns: int | None) -> LiveComparison | None:
    """The comparison with the live estimate, where that was recorded."""
    if recording.estimate is None:
        return None
    live = recording.estimate
    if begin_ns is not None:
        live = live.take(live.stamp_ns >= begin_ns)
    stamps, firsts = recording.stamp_ns, [segment.first for segment in planned.segments]
    ends = [int(stamps[k]) if k < len(stamps) else int(stamps[-1]) + 1 for k in (*firsts[1:], len(stamps))]
    apart = [
        Apart(int(stamps[segment.first]), end, segment.why_not)
        for segment, end in zip(planned.segments, ends, strict=False)
        if segment.why_not
    ]
    end = ended(recording)
    apart += [] if end is None else [end]
    return compare_with_live(live, run, apart)


def _readings(rig: Rig, pressure: FloatArray) -> FloatArray:
    """What the rig's sensors show at pressures (M, 2) [Pa]."""
    return np.asarray(sensor.readings(pressure, rig.parameters()))


def _nees(measured: FloatArray | None, value: FloatArray, variance: FloatArray, reading: Reading) -> float | None:
    """Mean normalised error squared, None where nothing was measured."""
    if measured is None or not np.isfinite(measured).any():
        return None
    return metrics.nees(value - measured, variance, reading)


def _external(recording: Recording, run: EstimateRun) -> ChannelErrors | None:
    """The external torque: what a filter with that state makes of it, against what was applied."""
    if recording.external_torque is None or "external_torque" not in run.added:
        return None
    variance = run.rows["external_torque_covariance"][:, 3]
    applied, estimate = recording.external_torque[run.index], run.rows["external_torque"]
    errors = channel_errors(applied, estimate, "nm", variance)
    late = (
        metrics.delay(applied, estimate, float(np.median(np.diff(run.stamp_ns))) * 1e-9) if len(run.rows) > 1 else None
    )
    return None if errors is None else dataclasses.replace(errors, delay_s=late)


def _episodes(recording: Recording) -> list[str]:
    """What to say of a recording of episodes."""
    if recording.episode_ns is None or recording.estimate is not None:
        return []
    return [f"{len(recording.episode_ns)} episodes: filter and model start anew with each, all are scored together"]


def _sealed(recording: Recording, rig: Rig) -> list[str]:
    """What to say of a recording whose muscles were sealed where the rig's are not."""
    sealed = sealed_muscles(recording.path)
    if not sealed or rig.valves.sealed:
        return []
    which = f"muscle {sealed[0]} was" if len(sealed) == 1 else "both muscles were"
    return [f"{which} sealed, as the bag says, but rig {rig.name} lets air through its valves: expect large errors"]


def _rigs_in_bag(recording: Recording) -> dict[str, RigIdentity]:
    """Node -> the rig that it was given last while the bag was recorded."""
    found = {}
    for text in recording.rigs:
        try:
            identity = RigIdentity.read(text)
        except BadInput:
            continue  # not ours to judge: a bag may hold anything
        found[identity.node] = identity
    return found


def _rigs(recording: Recording, rig: Rig) -> dict[str, RecordedRig]:
    own = fingerprint(rig)
    return {
        node: RecordedRig(given.name, given.fingerprint, given.fingerprint == own)
        for node, given in _rigs_in_bag(recording).items()
    }


def _other_joint(recording: Recording, rig: Rig) -> list[str]:
    """What to say where the rig is another joint's than the one of the recording."""
    own = RigIdentity.of(rig)
    out = []
    for given in {given.fingerprint: given for given in _rigs_in_bag(recording).values()}.values():
        found = differences(given, own)
        if found:
            more = f", and {len(found) - 1} more" if len(found) > 1 else ""
            out.append(
                f"recorded with rig {given}, as its {given.node} said; rig {own} is another joint's: {found[0]}{more}"
            )
    return out
