"""A recording once more through the estimator that runs live, and through the model alone.

What comes out is a :class:`Replay`: the numbers of ``report.json`` in :attr:`Replay.report`, and the arrays behind
them for figures. Keys of a report, one recording::

    samples, duration_s, realtime_factor
    ukf          {angle: {rmse_deg, max_deg, q, coverage95} | null, torque: {rmse_nm, max_nm, q, coverage95} | null,
                  pressure: {rmse_pa: [p1, p2], max_pa: [p1, p2], q: [p1, p2]},
                  external_torque: {rmse_nm, max_nm, q} | null: of a rig that estimates it, where it was recorded}
    model_alone  the same without coverage95
    innovation   {nis_mean, nis_in_95, whiteness_p, largest_correlation, samples}
    recording    {name, sha256, topics, first_stamp_ns, issues,
                  rigs: {node: {name, fingerprint, same: as the replay's}}, where the bag tells them}
    joint        {condition, lock_angle_rad | null, told_from}
    estimator    {started_ns: [...], counts: {...}}
    live_equal   null, or how the estimates recorded live compare with these, bit by bit
    live_without null, or how many recorded samples the live filter did not have, or not in whole: left out here as well
    timing       {read_s, filter_s, model_s, total_s}

Angles in degrees, torques in N m, pressures in Pa; `q` is a fraction. What was not recorded is null.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import ESTIMATE_DTYPE, EstimateRun, Estimator, metrics, simulate_model
from pam_antagonist.model import sensor
from pam_antagonist.recording import Recording, bag_hash, bag_name
from pam_antagonist.recording.joint import JointCondition, joint_condition
from pam_antagonist.recording.notes import sealed_muscles
from pam_antagonist.report.live import LiveInput, as_live, compare_with_live
from pam_antagonist.rig import Reading, Rig, RigIdentity, differences, fingerprint

FloatArray = NDArray[np.float64]

_CHUNK = 5000
"""Samples between two signs of progress."""


@dataclass(frozen=True, eq=False)
class ModelTrack:
    """The model alone at the samples with an estimate: angle (M,) [rad], torque (M,) [N m], pressure (M, 2) [Pa]."""

    angle: FloatArray
    torque: FloatArray
    pressure: FloatArray


@dataclass(frozen=True, eq=False)
class Replay:
    """A replayed recording.

    Attributes:
        recording: what was recorded.
        rig: the rig as configured.
        tuning: name of the filter's tuning.
        joint: whether the joint could move.
        run: the estimates, M of them; ``run.index`` are their samples in the recording.
        model: the model alone at the same samples.
        report: the recording's entry in ``report.json``, see the module's documentation.
    """

    recording: Recording
    rig: Rig
    tuning: str
    joint: JointCondition
    run: EstimateRun
    model: ModelTrack
    report: dict[str, Any]

    @cached_property
    def measured_angle(self) -> FloatArray | None:
        """Encoder at the estimates' samples, (M,) [rad]."""
        return None if self.recording.angle is None else self.recording.angle[self.run.index]

    @cached_property
    def measured_torque(self) -> FloatArray | None:
        """Torque meter at the estimates' samples, (M,) [N m]."""
        return None if self.recording.torque is None else self.recording.torque[self.run.index]

    @cached_property
    def measured_pressure(self) -> FloatArray:
        """Pressures at the estimates' samples, (M, 2) [Pa]."""
        return self.recording.pressure[self.run.index]


def replay(
    recording: Recording,
    rig: Rig,
    tuning: str = "default",
    joint: str = "auto",
    lock_angle: float | None = None,
    read_seconds: float = 0.0,
    progress: Callable[[int], None] | None = None,
) -> Replay:
    """Run a recording through the estimator and through the model alone, and judge both.

    The filter is started where the live one was, if its estimate was recorded, so that both can be compared bit by
    bit; else at the first sample.

    Args:
        recording: the recording.
        rig: the rig.
        tuning: name of one of its tunings.
        joint: ``free``, ``locked`` or ``auto``.
        lock_angle: angle of a locked joint [rad], where it is known.
        read_seconds: what reading the recording took [s], for the real-time factor.
        progress: called now and then with the number of samples done since the last call.

    Raises:
        BadInput: a tuning or joint condition that does not exist, or no sample to start from.
    """
    begin = time.perf_counter()
    state = joint_condition(recording, joint, lock_angle)
    estimator = Estimator(rig, tuning=tuning, joint=state.condition, lock_angle=state.lock_angle)
    given = as_live(recording)
    run = _estimate(recording, given, estimator, progress or (lambda samples: None))
    if len(run.rows) == 0:
        raise BadInput(
            f"{recording.path}: no sample has both pressures and valve voltages, so no filter can be started"
        )
    filtered = time.perf_counter()
    model = _model_alone(recording, rig, state, run)
    modelled = time.perf_counter()
    report = _judge(recording, rig, state, run, model)
    report["live_without"] = None if recording.estimate is None else given.without
    total = time.perf_counter() - begin + read_seconds
    report["realtime_factor"] = report["duration_s"] / total
    report["timing"] = {
        "read_s": read_seconds,
        "filter_s": filtered - begin,
        "model_s": modelled - filtered,
        "total_s": total,
    }
    return Replay(recording, rig, tuning, state, run, model, report)


def replay_recording(recording: Recording, rig: Rig, tuning: str = "default", joint: str = "auto") -> dict[str, Any]:
    """The report of :func:`replay` alone, for those who need the numbers and not the curves.

    Args:
        recording: the recording.
        rig: the rig.
        tuning: name of one of its tunings.
        joint: ``free``, ``locked`` or ``auto``.
    """
    return replay(recording, rig, tuning, joint).report


def after(whole: Replay, begin_s: float) -> Replay:
    """The part of a replay from a time on, judged by itself; filter and model still run from the recording's start.

    Args:
        whole: a replay.
        begin_s: time from its first sample on [s].

    Raises:
        BadInput: there is no estimate from then on.
    """
    recording, run, model = whole.recording, whole.run, whole.model
    kept = run.stamp_ns >= int(recording.stamp_ns[0]) + round(begin_s * 1e9)
    if not kept.any():
        raise BadInput(f"{recording.path}: no estimate from {begin_s:g} s on")
    arrays = {name: getattr(run, name)[kept] for name in ("rows", "stamp_ns", "index", "started_ns")}
    part = dataclasses.replace(run, added={name: values[kept] for name, values in run.added.items()}, **arrays)
    track = ModelTrack(model.angle[kept], model.torque[kept], model.pressure[kept])
    report = {**whole.report, **_judge(recording, whole.rig, whole.joint, part, track)}
    report["samples"] = int(kept.sum())
    report["duration_s"] = float(part.stamp_ns[-1] - part.stamp_ns[0]) * 1e-9 + whole.rig.sample_period
    report["realtime_factor"] = whole.report["realtime_factor"]
    return Replay(recording, whole.rig, whole.tuning, whole.joint, part, track, report)


def _estimate(
    recording: Recording, given: LiveInput, estimator: Estimator, progress: Callable[[int], None]
) -> EstimateRun:
    """Run the filter over the recording, begun afresh wherever the live one was."""
    stamps = recording.stamp_ns
    begins = np.zeros(1, dtype=np.int64)
    if recording.estimate is not None:
        starts = np.unique(recording.estimate.started_ns)
        known = np.searchsorted(stamps, starts)
        here = (known < len(stamps)) & (stamps[np.minimum(known, len(stamps) - 1)] == starts)
        if here.any():
            begins = known[here]
    parts: list[EstimateRun] = []
    for first, end in zip(begins, [*begins[1:], len(stamps)], strict=True):
        estimator.reset()
        for low in range(int(first), int(end), _CHUNK):
            high = min(low + _CHUNK, int(end))
            kept = low + np.flatnonzero(given.had[low:high])
            part = estimator.run(stamps[kept], given.pressure[kept], given.voltage[kept])
            parts.append(dataclasses.replace(part, index=kept[part.index]))
            progress(high - low)
    return EstimateRun(
        rows=np.concatenate([part.rows for part in parts]) if parts else np.zeros(0, ESTIMATE_DTYPE),
        added={name: np.concatenate([part.added[name] for part in parts]) for name in parts[0].added} if parts else {},
        stamp_ns=np.concatenate([part.stamp_ns for part in parts]),
        index=np.concatenate([part.index for part in parts]),
        started_ns=np.concatenate([part.started_ns for part in parts]),
        counts=estimator.counts,
    )


def _model_alone(recording: Recording, rig: Rig, joint: JointCondition, run: EstimateRun) -> ModelTrack:
    """The model without any measurement, begun anew at the first pressures wherever the filter was started."""
    count = len(run.index)
    track = ModelTrack(np.empty(count), np.empty(count), np.empty((count, 2)))
    first_of = np.flatnonzero(np.concatenate(([True], np.diff(run.started_ns) != 0)))
    for first, end in zip(first_of, [*first_of[1:], count], strict=True):
        stamps = run.stamp_ns[first:end]
        # The model steps at a constant period; samples that are missing are stepped over with the voltages held.
        step = np.rint((stamps - stamps[0]) / (rig.sample_period * 1e9)).astype(np.int64)
        voltage = np.full((int(step[-1]) + 1, 2), np.nan)
        voltage[step] = recording.voltage[run.index[first:end]]
        external = None
        if recording.external_torque is not None:
            external = np.zeros(len(voltage))
            external[step] = recording.external_torque[run.index[first:end]]
        alone = simulate_model(
            rig,
            voltage,
            recording.pressure[run.index[first]],
            joint=joint.condition,
            lock_angle=joint.lock_angle,
            external_torque=external,
        )
        track.angle[first:end] = alone.angle[step]
        track.torque[first:end] = alone.torque[step]
        track.pressure[first:end] = alone.pressure[step]
    return track


def _judge(
    recording: Recording, rig: Rig, joint: JointCondition, run: EstimateRun, model: ModelTrack
) -> dict[str, Any]:
    """The recording's entry in the report, without what depends on the clock of the machine."""
    rows, index = run.rows, run.index
    pressure = recording.pressure[index]
    angle = None if recording.angle is None else recording.angle[index]
    torque = None if recording.torque is None else recording.torque[index]
    variance = rows["covariance"]
    sensors = rig.sensors
    nis = metrics.nis_consistency(rows["nis"], rows["innovation"])
    whitened = metrics.normalised_innovation(rows["innovation"], rows["innovation_covariance"])
    return {
        "samples": len(recording.stamp_ns),
        "duration_s": float(recording.stamp_ns[-1] - recording.stamp_ns[0]) * 1e-9 + rig.sample_period,
        "realtime_factor": None,
        "ukf": {
            "angle": _angle(angle, rows["angle"], variance[:, 0, 0], sensors.reading("angle")),
            "torque": _torque(torque, rows["torque"], variance[:, 2, 2], sensors.reading("torque")),
            "pressure": _pressure(pressure, _readings(rig, rows["pressure"])),
            "external_torque": _external(recording, run),
        },
        "model_alone": {
            "angle": _angle(angle, model.angle),
            "torque": _torque(torque, model.torque),
            "pressure": _pressure(pressure, model.pressure),
        },
        "innovation": {
            "nis_mean": nis.mean,
            "nis_in_95": nis.in_95,
            "whiteness_p": metrics.whiteness_p(whitened),
            "largest_correlation": metrics.largest_autocorrelation(whitened),
            "samples": nis.samples,
        },
        "recording": {
            "name": bag_name(Path(recording.path)),
            "sha256": bag_hash(recording.path),
            "topics": dict(recording.topics),
            "first_stamp_ns": int(recording.stamp_ns[0]),
            "issues": [*recording.issues, *_sealed(recording, rig), *_other_joint(recording, rig)],
            "rigs": _rigs(recording, rig),
        },
        "joint": {
            "condition": joint.condition,
            "lock_angle_rad": joint.lock_angle if joint.condition == "locked" else None,
            "told_from": joint.told_from,
        },
        "estimator": {
            "started_ns": [int(stamp) for stamp in np.unique(run.started_ns)],
            "counts": dataclasses.asdict(run.counts),
        },
        "live_equal": None if recording.estimate is None else compare_with_live(recording.estimate, run),
    }


def _readings(rig: Rig, pressure: FloatArray) -> FloatArray:
    """What the rig's sensors show at pressures (M, 2) [Pa]."""
    p = rig.parameters()
    return np.column_stack([sensor.reading(muscle, pressure[:, muscle], p) for muscle in (0, 1)])


def _external(recording: Recording, run: EstimateRun) -> dict[str, float] | None:
    """The torque from outside: what a filter with that state makes of it, against what was applied."""
    if recording.external_torque is None or "external_torque" not in run.added:
        return None
    return _torque(recording.external_torque[run.index], run.added["external_torque"])


def _sealed(recording: Recording, rig: Rig) -> list[str]:
    """What to say of a recording whose muscles were sealed where the rig's are not."""
    sealed = sealed_muscles(recording.path)
    if not sealed or rig.valves.sealed:
        return []
    which = f"muscle {sealed[0]} was" if len(sealed) == 1 else "both muscles were"
    return [f"{which} sealed, as the bag says, but rig {rig.name} lets air through its valves: expect large errors"]


def _told(recording: Recording) -> dict[str, RigIdentity]:
    """Node -> the rig that it was given last while the bag was recorded."""
    told = {}
    for text in recording.rigs:
        try:
            identity = RigIdentity.read(text)
        except BadInput:
            continue  # not ours to judge: a bag may hold anything
        told[identity.node] = identity
    return told


def _rigs(recording: Recording, rig: Rig) -> dict[str, dict[str, Any]]:
    own = fingerprint(rig)
    return {
        node: {"name": told.name, "fingerprint": told.fingerprint, "same": told.fingerprint == own}
        for node, told in _told(recording).items()
    }


def _other_joint(recording: Recording, rig: Rig) -> list[str]:
    """What to say where the rig is another joint's than the one of the recording."""
    own = RigIdentity.of(rig)
    out = []
    for told in {told.fingerprint: told for told in _told(recording).values()}.values():
        found = differences(told, own)
        if found:
            more = f", and {len(found) - 1} more" if len(found) > 1 else ""
            out.append(
                f"recorded with rig {told}, as its {told.node} said; rig {own} is another joint's: {found[0]}{more}"
            )
    return out


def _figures(measured: FloatArray, value: FloatArray, unit: str, scale: float) -> dict[str, float]:
    error = value - measured
    return {
        f"rmse_{unit}": metrics.rmse(error) * scale,
        f"max_{unit}": metrics.max_error(error) * scale,
        "q": metrics.estimation_ratio(error, measured),
    }


def _judged(
    measured: FloatArray | None,
    value: FloatArray,
    variance: FloatArray | None,
    reading: Reading,
    unit: str,
    scale: float,
) -> dict[str, float] | None:
    if measured is None or not np.isfinite(measured).any():
        return None
    out = _figures(measured, value, unit, scale)
    if variance is not None:
        out["coverage95"] = metrics.coverage(value - measured, variance, reading)
    return out


def _angle(
    measured: FloatArray | None, value: FloatArray, variance: FloatArray | None = None, reading: Reading = metrics.EXACT
) -> dict[str, float] | None:
    return _judged(measured, value, variance, reading, "deg", math.degrees(1.0))


def _torque(
    measured: FloatArray | None, value: FloatArray, variance: FloatArray | None = None, reading: Reading = metrics.EXACT
) -> dict[str, float] | None:
    return _judged(measured, value, variance, reading, "nm", 1.0)


def _pressure(measured: FloatArray, value: FloatArray) -> dict[str, list[float]]:
    both = [_figures(measured[:, muscle], value[:, muscle], "pa", 1.0) for muscle in (0, 1)]
    return {key: [figures[key] for figures in both] for key in both[0]}
