"""A bag -> one :class:`~pam_antagonist.recording.recording.Recording`."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import plausible, signals, stamps
from .cdr import CdrError, Decoded, decode, stores_of
from .corrections import Corrections
from .naming import READ_TOPICS, choose_topics, joints_in, values_of_joint
from .notes import Issue, noted_issues
from .plausible import UNITS
from .raw import CompressionError, RawBag, RawTopic, unpack_messages
from .recording import ESTIMATE_SHAPES, Arrival, RecordedEstimate, RecordedReference, Recording
from .stamps import Restarts
from .storage import read_raw
from .topics import STATE_TOPICS, TOPICS

Floats = NDArray[np.float64]
_Convert = Callable[["_Topic", str, str, Floats], Floats]


@dataclass
class _Topic:
    """Decoded messages of one topic; ``keep`` lists those to use, sorted by stamp after :func:`_sort`."""

    name: str
    actual: str
    decoded: Decoded
    log_ns: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    keep: NDArray[np.intp]
    # of one joint, or of a part of a message, in all messages: field -> (N,) or (N, n).
    joint: Mapping[str, Floats] | None = None

    def values(self, path: str) -> NDArray[Any]:
        """A field of the kept messages (K,) or (K, n); of the one joint, where messages hold several."""
        return (self.joint[path] if self.joint is not None else self.decoded.fixed(path))[self.keep]

    def compared(self) -> Floats | None:
        """What two messages with one stamp must agree in (K, m); None for topics that no result is made from."""
        fields = _OF_JOINT if self.name in _JOINT_STATES else _SIGNALS.get(self.name, ())[:1]
        return np.column_stack([np.asarray(self.values(name), float) for name in fields]) if fields else None

    def values_or_nan(self, path: str, *shape: int) -> NDArray[Any]:
        """A field of numbers (K, *shape), NaN where the message definition in the bag has no such field."""
        there = self.decoded.has(path)
        return self.values(path).reshape(-1, *shape) if there else np.full((len(self.keep), *shape), np.nan)

    @property
    def arrival(self) -> Arrival:
        return Arrival(self.log_ns[self.keep], self.stamp_ns[self.keep])


def read_bag(
    path: str | Path,
    *,
    topics: Mapping[str, str] | None = None,
    namespace: str | None = None,
    joint_name: str | None = None,
    restarts: Restarts = "refuse",
    recover: bool = False,
    corrections: Corrections | None = None,
    judge: bool = True,
    also: Sequence[str] = (),
    known: Sequence[str] = (),
) -> Recording:
    """Read a rosbag2 recording of a rig.

    Samples are the union of the stamps of the two pressures and the valve state; a value without a message at a stamp
    is NaN. Pressures are absolute, in Pa. For a joint with pressure regulators, ``pressure_state`` replaces the valve
    state, and the measured pressures may be missing.

    Args:
        path: Bag folder, or one .mcap or .db3 file; compressed or not.
        topics: Logical name (see ``TOPICS``) -> topic in the bag, where it has another name there.
        namespace: Namespace of the topics; None to find it.
        joint_name: Name of the joint in ``measured/joint_states``; None for the only one, or for that of the estimator.
        restarts: What to do where stamps jump backwards by more than 0.5 s: "refuse" the bag, or read only the part
            after the "last" restart.
        recover: Read what is left of a damaged or cut off bag instead of refusing it.
        corrections: Corrections of the recorded values; None for none.
        judge: False reads values in any unit, for :mod:`pam_antagonist.checks`.
        also: Topics of further signals, in addition to those below ``also/`` in the joint's namespace.
        known: Names of further signals that are read where the bag has them: those of a rig file.

    Raises:
        SeveralJoints: The bag holds several joints, and ``namespace`` names none.
        BadInput: Not a bag, damaged, a topic missing or of another type, no samples, time running backwards, topics of
            different clocks, publishers that contradict each other, several joints of which none was chosen, or values
            that are implausible in their unit (gauge pressure, other units).

    Example:
        >>> from pam_antagonist import read_bag
        >>> recording = read_bag("examples/recordings/leak_free")
        >>> len(recording), round(recording.duration_s, 3), recording.pressure.shape
        (30000, 29.999, (30000, 2))
    """
    if not isinstance(path, (str, Path)):
        raise BadInput(f"bag: found a value of type {type(path).__name__}, expected its path")
    if restarts not in ("refuse", "last"):
        raise ValueError(f"restarts is {restarts!r}, expected 'refuse' or 'last'")
    path, fixes = Path(path), corrections or Corrections()
    try:
        types = {TOPICS[name].type for name in (*READ_TOPICS, "rig")}
        bag = read_raw(path, types | set(signals.KINDS) | {signals.EPISODE.type}, recover=recover)
        if path.is_dir():
            bag.issues += noted_issues(path)
        chosen = _chosen(bag, topics, namespace, joint_name, restarts == "last", fixes.align_clocks)
        there = [name for name in known if signals.topic_of(name) in bag.topics]
        recording = _recording(bag, chosen, partial(_converted, bag, fixes, judge), [*also, *there])
        recording = recording if corrections is None else corrections.arranged(recording)
    except MemoryError:
        what = "needs more memory than there is; split the recording, or use a larger machine"
        raise BadInput(f"{path}: {what}") from None
    _return_memory()
    return recording


def _chosen(
    bag: RawBag,
    topics: Mapping[str, str] | None,
    namespace: str | None,
    joint_name: str | None,
    cut: bool,
    align: bool,
) -> dict[str, _Topic]:
    """The package's topics by logical name, decoded and in order, of one joint and one clock."""
    chosen = {name: _decode(bag.path, name, raw) for name, raw in choose_topics(bag, topics, namespace).items()}
    whole = chosen.pop("joint_sample", None)
    if whole is not None:
        chosen = {name: topic for name, topic in chosen.items() if name not in _OF_WHOLE}
    live = chosen["joint_states"].decoded if "joint_states" in chosen else None
    for topic in (chosen[name] for name in _JOINT_STATES if name in chosen):
        topic.joint, there = values_of_joint(bag, topic.actual, topic.decoded, joint_name, live)
        topic.keep = topic.keep[there[topic.keep]]
    chosen = chosen if whole is None else _parts(whole) | chosen
    if cut:
        _cut(chosen, bag.issues)
    for topic in chosen.values():
        if align and not np.any(topic.stamp_ns):
            topic.stamp_ns = topic.log_ns.copy()
            bag.issues.append(Issue(f"{topic.actual} without stamps: took the times of reception", "clock"))
        _sort(bag.path, topic, bag.issues)
    _one_clock(bag.path, chosen, bag.issues, align)
    return chosen


_OF_WHOLE = ("pressure_1", "pressure_2", "valve_state", "pressure_state", "angle_sensor", "measured_joint_states")
"""Topics whose content ``joint_sample`` has as well; beside it they may have a lower rate."""


def _parts(whole: _Topic) -> dict[str, _Topic]:
    """What the messages of ``joint_sample`` say, as the topics that say it otherwise."""
    first, second = whole.decoded.fixed("pressure").T
    voltage, asked = whole.decoded.fixed("voltage"), whole.decoded.fixed("asked_pressure")
    angle, torque, sensor = (whole.decoded.fixed(name) for name in ("angle", "torque", "angle_sensor"))
    regulated = np.isfinite(asked).any() and not np.isfinite(voltage).any()
    fields: dict[str, dict[str, Floats]] = {
        "pressure_1": {"fluid_pressure": first},
        "pressure_2": {"fluid_pressure": second},
        **({"pressure_state": {"pressure": asked}} if regulated else {"valve_state": {"voltage": voltage}}),
        "measured_joint_states": {"position": angle, "effort": torque},
        "angle_sensor": {"position": sensor, "effort": np.full(len(sensor), np.nan)},
    }
    needed = () if regulated else ("pressure_1", "pressure_2", "valve_state")
    return {
        name: replace(whole, name=name, stamp_ns=whole.stamp_ns.copy(), keep=whole.keep.copy(), joint=values)
        for name, values in fields.items()
        if name in needed or any(np.isfinite(column).any() for column in values.values())
    }


def _recording(bag: RawBag, chosen: Mapping[str, _Topic], convert: _Convert, also: Sequence[str]) -> Recording:
    """Samples at the stamps of pressures and commands, and everything else at these samples."""
    drive = "valve" if "valve_state" in chosen else "regulator"
    state = STATE_TOPICS[drive]
    names = tuple(name for name in ("pressure_1", "pressure_2", state) if name in chosen)
    samples = stamps.union([chosen[name].arrival.stamp_ns for name in names])
    beside = chosen[state].actual.rpartition("/")[0]
    episode_ns = signals.read_episodes(bag, beside, samples)
    pressure, voltage = _samples(bag, {name: chosen[name] for name in names}, samples, convert, episode_ns)

    validation = [("measured_joint_states", (field, field, quantity)) for field, quantity in _OF_JOINT.items()]
    validation.append(("measured_external_torque", _SIGNALS["measured_external_torque"]))
    angle, torque, external = (
        _validation(bag, chosen[name], samples, convert, *signal) if name in chosen else None
        for name, signal in validation
    )
    estimate, reference, sensor = (chosen.get(name) for name in ("joint_estimate", "reference", "angle_sensor"))
    remembered, joints = chosen.get("filter_checkpoint"), joints_in(bag)
    own = (TOPICS[state], TOPICS["joint_sample"])
    mine = [joint for joint in joints if chosen[state].actual in [topic.resolve(joint) for topic in own]]
    return Recording(
        path=bag.path,
        stamp_ns=samples,
        pressure=pressure,
        voltage=voltage,
        angle=angle,
        torque=torque,
        external_torque=external,
        angle_sensor=None if sensor is None else _angle_sensor(bag, sensor, samples),
        estimate=None if estimate is None else _estimate(estimate),
        reference=None if reference is None else _reference(reference),
        received_ns={name: topic.arrival for name, topic in chosen.items()},
        topics={name: topic.actual for name, topic in chosen.items()},
        rigs=signals.rig_texts(bag, beside),
        checkpoints=() if remembered is None else signals.read_checkpoints(remembered.decoded, remembered.keep),
        namespace=mine[0] if mine and len(joints) > 1 else "",
        signals=signals.read_signals(bag, beside, samples, also),
        episode_ns=episode_ns,
        drive=drive,
        issues=Issue.sorted(bag.issues),
    )


def _decode(path: Path, name: str, raw: RawTopic) -> _Topic:
    """Decode one topic and order its messages by reception."""
    try:
        stores = stores_of(raw.msgtype, raw.digest, raw.definition)
        decoded = decode(unpack_messages(raw), raw.msgtype, stores)
        stamp_ns = decoded.stamp_ns("header.stamp")
    except (CdrError, CompressionError) as exc:
        raise BadInput(f"{path}: {raw.topic} cannot be read as {raw.msgtype}, {exc}") from exc
    return _Topic(name, raw.topic, decoded, raw.log_ns, stamp_ns, np.argsort(raw.log_ns, kind="stable"))


def _cut(chosen: Mapping[str, _Topic], issues: list[str]) -> None:
    """Keep only messages after the last restart; topics without a restart of their own are cut at the earliest one."""
    starts = {name: stamps.last_restart(topic.stamp_ns[topic.keep]) for name, topic in chosen.items()}
    restarted = [int(chosen[name].log_ns[chosen[name].keep[start]]) for name, start in starts.items() if start]
    if not restarted:
        return
    for name, topic in chosen.items():
        late = topic.log_ns[topic.keep] >= min(restarted)
        topic.keep = topic.keep[starts[name] :] if starts[name] else topic.keep[late]
    issues.append(Issue("time runs backwards in the recording: read what follows the last restart", "restart"))


def _sort(path: Path, topic: _Topic, issues: list[str]) -> None:
    """Bring the kept messages into the order of their stamps."""
    stamp_ns = topic.stamp_ns[topic.keep]
    if topic.name == "reference":  # stays in order of reception; one that is published by hand has stamp 0
        unset = stamp_ns == 0
        topic.stamp_ns = topic.stamp_ns.copy()
        topic.stamp_ns[topic.keep[unset]] = topic.log_ns[topic.keep[unset]]
        return
    if topic.name == "filter_checkpoint":  # each one is useful by itself, in any order
        return
    if len(stamp_ns):
        topic.keep = topic.keep[stamps.order(str(path), topic.actual, stamp_ns, issues, topic.compared())]


def _one_clock(path: Path, chosen: Mapping[str, _Topic], issues: list[str], align: bool) -> None:
    """Judge whether one clock stamps all topics that a recording is made from; pair topics as asked."""
    names = [name for name in (*_SIGNALS, *_JOINT_STATES) if name in chosen and len(chosen[name].keep)]
    times = {chosen[name].actual: (chosen[name].arrival.log_ns, chosen[name].arrival.stamp_ns) for name in names}
    shifts = stamps.clock_shifts(str(path), times, issues, align)
    samples = chosen[names[0]].arrival.stamp_ns
    for topic in (chosen[name] for name in names[1:] if align):
        its = topic.arrival.stamp_ns + shifts.get(topic.actual, 0)
        if not topic.name.startswith("measured") and len(samples) > 1:
            its = stamps.nearest(its, samples)
        topic.stamp_ns = topic.stamp_ns.copy()
        topic.stamp_ns[topic.keep] = its
        topic.keep = topic.keep[np.diff(its, prepend=0) > 0]


_SIGNALS: Mapping[str, tuple[str, str, str]] = {
    "pressure_1": ("fluid_pressure", "pressure", "pressure"),
    "pressure_2": ("fluid_pressure", "pressure", "pressure"),
    "valve_state": ("voltage", "voltage", "voltage"),
    "pressure_state": ("pressure", "command", "pressure"),
    "measured_external_torque": ("wrench.torque.z", "torque about z", "torque"),
}
"""Topics that samples are made from -> field of the message, its name and its quantity. Messages with one stamp must
agree in that field."""
_JOINT_STATES = ("measured_joint_states", "angle_sensor")
_OF_JOINT = {"position": "angle", "effort": "torque"}
"""Field of a JointState -> its quantity."""


def _converted(
    bag: RawBag, fixes: Corrections, judge: bool, topic: _Topic, what: str, quantity: str, values: Floats
) -> Floats:
    """Values of one quantity of a topic, corrected, in SI units, NaN where not finite; refused if implausible."""
    values = plausible.finite_only(f"{what} on {topic.actual}", values, bag.issues)
    correct = {"pressure": fixes.pressure, "position": fixes.angle, "effort": fixes.torque}.get(what)
    values = values if correct is None else correct(values)
    if judge:
        name = "torque" if what == "effort" else what
        label = topic.actual if quantity in ("pressure", "voltage") else f"the {name} on {topic.actual}"
        signal = plausible.Signal(label, quantity, values, next(iter(UNITS[quantity])))
        plausible.judge(str(bag.path), signal, bag.issues)
    return values


def _samples(
    bag: RawBag,
    chosen: Mapping[str, _Topic],
    samples: NDArray[np.int64],
    convert: _Convert,
    episode_ns: NDArray[np.int64] | None,
) -> tuple[Floats, Floats]:
    """Pressures, and voltages or pressure commands, at the sample stamps (N, 2) each."""
    where = str(bag.path)
    columns: dict[str, Floats] = {}
    present: dict[str, NDArray[np.bool_]] = {}
    for name, topic in chosen.items():
        if len(topic.keep) == 0:
            raise BadInput(f"{where}: {topic.actual} has no samples after the last restart")
        field, what, quantity = _SIGNALS[name]
        values = convert(topic, what, quantity, topic.values(field))
        stamp_ns = topic.arrival.stamp_ns
        others = [other.arrival.stamp_ns for other in chosen.values() if other is not topic]
        if others and len(stamp_ns) > 1.1 * min(map(len, others)):
            paired = np.isin(stamp_ns, np.concatenate(others))
            for column in values.reshape(len(values), -1).T if np.any(paired) else ():
                stamps.judge_publishers(where, topic.actual, stamp_ns, column, paired)
        columns[name] = np.column_stack(
            [stamps.spread(samples, stamp_ns, column) for column in values.reshape(len(values), -1).T]
        )
        present[topic.actual] = np.isin(samples, stamp_ns, assume_unique=True)
    stamps.judge_pairing(where, samples, present, bag.issues, episode_ns)
    unknown = np.full((len(samples), 1), np.nan)  # a joint with regulators may have no sensors
    pressure = np.column_stack([columns.get("pressure_1", unknown), columns.get("pressure_2", unknown)])
    return pressure, next(columns[name] for name in STATE_TOPICS.values() if name in columns)


def _angle_sensor(bag: RawBag, topic: _Topic, samples: NDArray[np.int64]) -> Floats:
    """The encoder's angle at the sample stamps (N,) [rad]; a filter input, so never interpolated or corrected."""
    stamp_ns = topic.arrival.stamp_ns
    alone = int(np.count_nonzero(~np.isin(stamp_ns, samples, assume_unique=True)))
    if alone:
        bag.issues.append(Issue(f"{alone} angles on {topic.actual} belong to no sample: left out", "dropped", alone))
    return stamps.spread(samples, stamp_ns, topic.values("position"))


def _validation(
    bag: RawBag, topic: _Topic, samples: NDArray[np.int64], convert: _Convert, field: str, what: str, quantity: str
) -> Floats | None:
    """A validation signal at the sample stamps (N,), None where it has no finite value.

    A signal with the stamps of the samples is not changed. A signal with stamps of its own (another driver, another
    rate) is interpolated, which is reported as an issue.
    """
    values = topic.values(field)
    if not np.any(np.isfinite(values)):
        shown = {"position": "angle (field position)", "effort": "torque (field effort)"}.get(what, what)
        bag.issues.append(f"{topic.actual} holds no {shown}")
        return None
    values = convert(topic, what, quantity, values)
    stamp_ns = topic.arrival.stamp_ns
    paired = np.isin(stamp_ns, samples, assume_unique=True)
    stamps.judge_publishers(str(bag.path), topic.actual, stamp_ns, values, paired)
    alone = int(np.count_nonzero(~paired))
    if 2 * alone <= len(stamp_ns):
        if alone:
            text = f"{alone} values of {what} on {topic.actual} belong to no sample: left out"
            bag.issues.append(Issue(text, "dropped", alone))
        return stamps.spread(samples, stamp_ns, values)
    result = stamps.interpolate(samples, stamp_ns, values)
    if not np.any(np.isfinite(result)):
        bag.issues.append(Issue(f"no sample has a value of {what} on {topic.actual}", "missing", len(samples)))
        return None
    text = f"{what} on {topic.actual} has stamps of its own: interpolated at the samples"
    bag.issues.append(Issue(text, "resampled", len(stamp_ns)))
    return result


def _estimate(topic: _Topic) -> RecordedEstimate:
    columns = {name: topic.values_or_nan(name, *shape) for name, shape in ESTIMATE_SHAPES.items()}
    started_ns = topic.decoded.stamp_ns("started")[topic.keep]
    return RecordedEstimate(topic.arrival.stamp_ns, started_ns, **columns)


def _reference(topic: _Topic) -> RecordedReference:
    fields = (topic.values_or_nan(name) for name in ("mode", "value", "stiffness", "damping"))
    return RecordedReference(topic.arrival.stamp_ns, *fields)


def _return_memory() -> None:
    """Return freed memory to the system, where the C library can (glibc): 0.7 GB after a bag of half an hour."""
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
