"""Run a recording through the estimator and through the model alone, and compute the errors of both."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import COMPILING
from pam_antagonist.errors import BadInput, number
from pam_antagonist.estimation import EstimateRun, Estimator, metrics, possible, simulate_model
from pam_antagonist.estimation.further import FurtherInputs
from pam_antagonist.estimation.memory import read_angle
from pam_antagonist.estimation.metrics import (
    ChannelErrors,
    FilterErrors,
    ModelAloneErrors,
    channel_errors,
    pressure_errors,
)
from pam_antagonist.model import dynamics
from pam_antagonist.recording import Recording, bag_name, recording_hash, seen_in_words
from pam_antagonist.recording.joint import JointCondition, joint_condition
from pam_antagonist.recording.notes import Issue, sealed_muscles
from pam_antagonist.recording.rows import own_readings, slow, slow_sentence
from pam_antagonist.replays.live import (
    Apart,
    LiveComparison,
    LiveInput,
    ReplayPlan,
    as_live,
    compare_with_live,
    ended,
    plan,
    subset,
)
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
from pam_antagonist.rig import Reading, Rig, RigIdentity, differences, fingerprint
from pam_antagonist.shown import percent

FloatArray = NDArray[np.float64]

_CHUNK = 5000
"""Samples between two reports of progress."""


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
    """Run a recording through the estimator and through the model alone, and compute the errors of both.

    If the live estimate was recorded, the filter starts at the same sample as the live one, so that both can be
    compared bit by bit; otherwise at the first sample. If the live filter was started before the recording, the replay
    goes on from its first checkpoint in the recording.

    Args:
        recording: the recording.
        rig: the rig.
        tuning: name of one of its tunings.
        joint: ``free``, ``locked`` or ``auto``.
        lock_angle: angle of a locked joint [rad], where it is known.
        read_seconds: time that reading the recording took [s], for the real-time factor.
        progress: called regularly with the number of samples done since the last call.
        begin_s: time from the first sample at which the estimates begin [s]; None: at the start. The filter goes on
            from the last checkpoint before, or runs from the start where no checkpoint can be used. The estimates equal
            those of a complete replay.
        angle_sensor: ``none``, ``encoder``, or ``auto``: as in the live filter's checkpoints, without any ``none``.

    Raises:
        BadInput: a tuning or joint condition that does not exist, no complete sample to start from, no estimate after
            ``begin_s``, or a recording whose drive is not the rig's.
    """
    begin = _clock()
    recording.driven_by(rig.drive)
    progress = progress or (lambda samples: None)
    begin_ns = None if begin_s is None else _stamp_at(recording, number("begin_s", begin_s))
    state = joint_condition(recording, joint, lock_angle, rig.joint.stop)
    sensor_used = _angle_sensor(recording, angle_sensor)
    estimator = Estimator(rig, tuning, state.condition, state.lock_angle, sensor_used)
    impossible = possible.impossible(estimator.possible, recording.pressure, recording.voltage)
    given = as_live(recording, impossible)
    complaint = possible.complaint(estimator.possible, rig.drive, recording.pressure, recording.voltage)
    if complaint:
        recording = dataclasses.replace(
            recording,
            issues=(*recording.issues, Issue(f"{complaint}: taken for missing")),
            pressure=np.where(impossible[:, :2], np.nan, recording.pressure),
            voltage=np.where(impossible[:, 2:], np.nan, recording.voltage),
        )
    told = tuple(Issue(slow_sentence(name, again)) for name, again in slow(recording).items())
    if told and told[0] not in recording.issues:
        recording = dataclasses.replace(recording, issues=(*recording.issues, *told))
    planned = plan(recording, estimator, begin_ns)
    progress(planned.skipped)
    run = _estimate(recording, given, estimator, planned, progress)
    if len(run.rows) == 0:
        if complaint:
            raise BadInput(f"{recording.path}: {complaint}; so no filter can be started")
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
        return "encoder" if any(read_angle(item) for item in recording.checkpoints) else "none"
    if wanted == "encoder" and recording.angle_sensor is None:
        raise BadInput(
            f"{recording.path}: has no topic angle_sensor; record it (parameter angle_sensor: encoder of plant or "
            "bridge), or name it by --topic angle_sensor=/NAME"
        )
    return wanted


def _clock() -> float:
    """Time [s] without compiling, which is done only once on each machine."""
    return time.perf_counter() - COMPILING.seconds


def _stamp_at(recording: Recording, begin_s: float) -> int:
    if not 0.0 <= begin_s <= recording.duration_s:
        raise BadInput(
            f"{recording.path}: cannot begin at {begin_s:g} s, expected 0 to {recording.duration_s:.3f} s, its length"
        )
    return int(recording.stamp_ns[0]) + round(begin_s * 1e9)


def after(whole: Replay, begin_s: float) -> Replay:
    """The part of a replay from a time on, with errors of its own; filter and model run from the recording's start.

    Args:
        whole: a replay.
        begin_s: time from the first sample at which the part begins [s].

    Raises:
        BadInput: there is no estimate after that time.
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
    return subset(run, kept), ModelTrack(model.angle[kept], model.torque[kept], model.pressure[kept])


def _estimate(
    recording: Recording, given: LiveInput, estimator: Estimator, planned: ReplayPlan, progress: Callable[[int], None]
) -> EstimateRun:
    """Run the filter over the recording; each planned segment starts it anew or from a checkpoint."""
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
            signals = {name: one.values[kept] for name, one in recording.signals.items() if name in estimator.signals}
            part = estimator.run(stamps[kept], given.pressure[kept], given.voltage[kept], given.angle[kept], signals)
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
    recording: Recording, rig: Rig, joint: JointCondition, run: EstimateRun, planned: ReplayPlan, given: LiveInput
) -> ModelTrack:
    """The model alone, which starts anew at the first pressures wherever the filter was started.

    The model does not restart at a checkpoint. It also runs over the samples that the filter skips before one.
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
    inputs = FurtherInputs.of(rig)
    for first, end in zip([0, *begins], [*begins, count], strict=True):
        # The model runs on the recording's grid and holds the voltages over missing samples.
        samples = index[first:end]
        step = points[samples] - points[samples[0]]
        voltage = np.full((int(step[-1]) + 1, 2), np.nan)
        voltage[step] = recording.voltage[samples]
        external = None
        if recording.external_torque is not None:
            external = np.zeros(len(voltage))
            external[step] = recording.external_torque[samples]
        further = None
        if inputs is not None:
            inputs.reset()
            signals = {name: one.values[samples] for name, one in recording.signals.items()}
            known = inputs.follow(
                recording.stamp_ns[samples], recording.pressure[samples], inputs.columns(signals, len(samples))
            )
            # On the grid, the inputs of the last sample hold over missing ones.
            further = known[np.searchsorted(step, np.arange(len(voltage)), side="right") - 1]
        alone = simulate_model(
            rig,
            voltage,
            _first_pressure(recording, samples[0]),
            joint=joint.condition,
            lock_angle=joint.lock_angle,
            external_torque=external,
            period=period,
            further=further,
        )
        track.angle[first:end] = alone.angle[step]
        track.torque[first:end] = alone.torque[step]
        track.pressure[first:end] = alone.pressure[step]
    skipped = count - len(run.index)
    return ModelTrack(track.angle[skipped:], track.torque[skipped:], track.pressure[skipped:])


def _first_pressure(recording: Recording, at: int) -> FloatArray:
    """Pressures (2,) [Pa] at which the model starts; the command replaces a regulated pressure that is not measured."""
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
    planned: ReplayPlan,
    begin_ns: int | None,
) -> ReplayReport:
    """The report of a recording, or of its part from a stamp on; its timings are filled in later."""
    rows, index = run.rows, run.index
    first_ns = int(recording.stamp_ns[0]) if begin_ns is None else int(run.stamp_ns[0])
    pressure, angle, torque = (None if values is None else values[index] for values in own_readings(recording))
    assert pressure is not None
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
        model_alone=ModelAloneErrors(
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
            (
                *recording.issues,
                *_episodes(recording),
                *_sealed(recording, rig),
                *_other_joint(recording, rig),
                *filter(None, [seen_in_words(recording, rig.fitted, rig.name)]),
                *_signals(recording, rig),
            ),
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


def _signals(recording: Recording, rig: Rig) -> list[str]:
    """Issues for further signals of a rig that a recording does not have, or not throughout."""
    out = []
    for name, reference in rig.signals.items():
        known = recording.signals.get(name)
        lost = 1.0 if known is None else float(np.mean(~np.isfinite(known.values)))
        if lost > 0.0:
            where = "throughout" if lost == 1.0 else f"in {percent(lost)} of the samples"
            out.append(
                f"signal {name} is missing {where}: the model takes its value in the rig file there "
                f"({reference:.4g} in SI units), and errors may be larger than their intervals say"
            )
    return out


def _live(recording: Recording, run: EstimateRun, planned: ReplayPlan, begin_ns: int | None) -> LiveComparison | None:
    """The comparison with the live estimate; None where none was recorded."""
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
    """Readings of the rig's sensors at pressures (M, 2) [Pa]."""
    return np.asarray(dynamics.readings(pressure, rig.parameters()))


def _nees(measured: FloatArray | None, value: FloatArray, variance: FloatArray, reading: Reading) -> float | None:
    """Mean normalised error squared, None where nothing was measured."""
    if measured is None or not np.isfinite(measured).any():
        return None
    return metrics.nees(value - measured, variance, reading)


def _external(recording: Recording, run: EstimateRun) -> ChannelErrors | None:
    """Errors of the estimated external torque against the applied one; None where either is missing."""
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
    """Issue for a recording of episodes."""
    if recording.episode_ns is None or recording.estimate is not None:
        return []
    return [f"{len(recording.episode_ns)} episodes: filter and model start anew with each, all are scored together"]


def _sealed(recording: Recording, rig: Rig) -> list[str]:
    """Issue for a recording with sealed muscles and a rig without."""
    sealed = sealed_muscles(recording.path)
    if not sealed or rig.valves.sealed:
        return []
    which = f"muscle {sealed[0]} was" if len(sealed) == 1 else "both muscles were"
    return [f"{which} sealed, as the bag says, but rig {rig.name} lets air through its valves: expect large errors"]


def _rigs_in_bag(recording: Recording) -> dict[str, RigIdentity]:
    """Node -> its last rig in the recording."""
    found = {}
    for text in recording.rigs:
        try:
            identity = RigIdentity.read(text)
        except BadInput:
            continue  # no message of this package
        found[identity.node] = identity
    return found


def _rigs(recording: Recording, rig: Rig) -> dict[str, RecordedRig]:
    own = fingerprint(rig)
    return {
        node: RecordedRig(given.name, given.fingerprint, given.fingerprint == own)
        for node, given in _rigs_in_bag(recording).items()
    }


def _other_joint(recording: Recording, rig: Rig) -> list[str]:
    """Issues where the recording was made with the rig of another joint."""
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
