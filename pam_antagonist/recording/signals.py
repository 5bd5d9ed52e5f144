"""Further signals, which may be causes of a joint's motion, and the beginnings of episodes.

A further signal is another joint's pressure or angle, or a temperature. In a bag it is a topic below ``also/`` in the
joint's namespace, or any topic of a type in ``KINDS`` that is requested by name. An episode begins at each stamp of the
topic ``episode`` (std_msgs/Header). The time between two episodes is not known, so that a model starts anew.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import stamps
from .cdr import CdrError, Decoded, Group, decode, encode
from .compression import CompressionError
from .notes import Issue
from .storage import RawBag, unpack_messages
from .topics import TOPICS, Topic

if TYPE_CHECKING:
    from .recording import Recording

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

EPISODE = Topic("episode", "episode", "std_msgs/msg/Header", "an episode begins: the sample before tells nothing of it")
"""Marks the first sample of each episode; written by ``import_csv``."""
ALSO = "also/"
"""Namespace of further signals, relative to the joint's."""
KINDS: Mapping[str, tuple[str, str]] = {
    "sensor_msgs/msg/FluidPressure": ("fluid_pressure", "Pa"),
    "sensor_msgs/msg/JointState": ("position", "rad"),
    "sensor_msgs/msg/Temperature": ("temperature", "degC"),
}
"""Message type -> field that holds the signal, and its unit."""
_MOST_RIGS = 100  # messages of the topic rig that are read, the last ones; each restart of a node adds one
_TEXT_HEAD = 8  # [bytes] of a std_msgs/String in CDR before its text: encapsulation, and length with the closing zero
_TYPE_OF = {unit: kind for kind, (_, unit) in KINDS.items()}


class FurtherSignal(NamedTuple):
    """A further signal.

    Attributes:
        values: at the samples (N,), NaN where missing.
    """

    values: Floats
    unit: str


def blocks(
    recording: Recording, header: Mapping[str, Any], stamp: Mapping[str, Any], frame_id: str
) -> dict[Topic, tuple[Stamps, NDArray[np.uint8]]]:
    """Messages of the further signals and of the episodes' beginnings.

    Returns:
        Topic -> stamps (K,) and messages (K, L).
    """
    out: dict[Topic, tuple[Stamps, NDArray[np.uint8]]] = {}
    size = len(recording)
    for name, (values, unit) in recording.signals.items():
        kind = _TYPE_OF[unit]
        field = KINDS[kind][0]
        fields: dict[str, Any] = {**header, field: values, "variance": 0.0}
        if unit == "rad":
            nothing = np.empty((size, 0))
            fields = {**header, "name": [name], "position": values[:, None], "velocity": nothing, "effort": nothing}
        there = np.isfinite(values)
        matrix = encode(kind, size, fields)[there]
        out[Topic(name, f"{ALSO}{name}", kind, "")] = recording.stamp_ns[there], matrix
    if recording.episode_ns is not None:
        columns = {**stamp, "frame_id": frame_id}
        out[EPISODE] = recording.episode_ns, encode(EPISODE.type, len(recording.episode_ns), columns)
    return out


def read_signals(bag: RawBag, namespace: str, samples: Stamps, wanted: Sequence[str] = ()) -> dict[str, FurtherSignal]:
    """Further signals of a bag at the samples.

    Args:
        samples: stamps (N,) [ns].
        wanted: names of further topics in the bag, in addition to those below ``also/``.

    Returns:
        Name -> signal; the name is the part after ``also/``, or the entry of ``wanted``.
    """
    prefix = f"{namespace}/{ALSO}"
    topics = {topic[len(prefix) :]: topic for topic in sorted(bag.topics) if topic.startswith(prefix)}
    topics = {name: topic for name, topic in topics.items() if bag.topics[topic].channel.msgtype in KINDS}
    for name in wanted:
        if name in topics:
            continue
        actual = name if name.startswith("/") else f"/{name}"
        if actual not in bag.topics:
            listed = ", ".join([*topics, *(t for t, raw in bag.topics.items() if raw.channel.msgtype in KINDS)])
            raise BadInput(f"{bag.path}: no signal {name!r}; expected one of {listed or 'none, there is no other'}")
        topics[name] = actual
    return {name: _read(bag, topic, samples) for name, topic in topics.items()}


def _read(bag: RawBag, topic: str, samples: Stamps) -> FurtherSignal:
    kind = bag.topics[topic].channel.msgtype
    if kind not in KINDS:
        raise BadInput(f"{bag.path}: {topic} is a {kind}, expected one of {', '.join(KINDS)}")
    field, unit = KINDS[kind]
    decoded, order = _decoded(bag, topic, "header.stamp")
    try:
        values = np.asarray(decoded.fixed(field), np.float64)[order]
    except KeyError:
        raise BadInput(f"{bag.path}: {topic} holds no {field}") from None
    if values.ndim > 1:
        if values.shape[1] != 1:
            raise BadInput(f"{bag.path}: {topic} holds {field} of {values.shape[1]} joints, expected one")
        values = values[:, 0]
    stamp_ns = decoded.stamp_ns("header.stamp")[order]
    own = np.isin(stamp_ns, samples, assume_unique=True)
    if 2 * np.count_nonzero(own) >= len(own):
        return FurtherSignal(stamps.spread(samples, stamp_ns, values), unit)
    values = stamps.interpolate(samples, stamp_ns, values)
    if not np.any(np.isfinite(values)):
        bag.issues.append(Issue(f"no sample has a value of {topic}: it has another clock", "missing", len(samples)))
    return FurtherSignal(values, unit)


def _decoded(bag: RawBag, topic: str, path: str) -> tuple[Decoded, NDArray[np.intp]]:
    """Messages of a topic, and their indices in the order of the stamps, one for each stamp."""
    try:
        raw = unpack_messages(bag.topics[topic])
        assert raw.payloads is not None
        decoded = decode(raw.payloads, raw.channel.msgtype)
        stamp_ns = decoded.stamp_ns(path)
    except (CdrError, CompressionError) as exc:
        raise BadInput(f"{bag.path}: {topic} cannot be read, {exc}") from exc
    return decoded, np.unique(stamp_ns, return_index=True)[1]


def read_episodes(bag: RawBag, namespace: str, samples: Stamps) -> Stamps | None:
    """Stamps of the first samples of episodes (E,) [ns]; None where the bag marks none.

    Args:
        samples: stamps (N,) [ns].
    """
    topic = EPISODE.resolve(namespace)
    raw = bag.topics.get(topic)
    if raw is None or raw.channel.msgtype != EPISODE.type or not len(raw.log_ns):
        return None
    decoded, order = _decoded(bag, topic, "stamp")
    marks = decoded.stamp_ns("stamp")[order]
    first = np.unique(np.searchsorted(samples, marks))
    first = first[first < len(samples)]
    # The samples before the first mark are an episode as well.
    return samples[np.union1d([0], first)] if len(first) else None


def rig_texts(bag: RawBag, namespace: str) -> tuple[str, ...]:
    """Texts of the topic ``rig``, in the order of reception; none where the topic is missing or not readable."""
    topic = TOPICS["rig"]
    raw = bag.topics.get(f"{namespace}/{topic.relative}")
    if raw is None or raw.channel.msgtype != topic.type or raw.channel.encoding != "cdr":
        return ()
    try:
        payloads = unpack_messages(raw).payloads
    except CompressionError:
        return ()
    if payloads is None:
        return ()
    texts: dict[str, None] = {}
    stop = payloads.length.cumsum().tolist()
    for k in raw.log_ns.argsort(kind="stable")[-_MOST_RIGS:].tolist():
        message = payloads.data[stop[k] - int(payloads.length[k]) : stop[k]].tobytes()
        order = "little" if message[1:2] == b"\x01" else "big"
        size = int.from_bytes(message[4:_TEXT_HEAD], order)  # type: ignore[arg-type]
        if 0 < size <= len(message) - _TEXT_HEAD:
            texts[message[_TEXT_HEAD : _TEXT_HEAD + size - 1].decode(errors="replace")] = None
    return tuple(texts)


_TEXTS = ("rig", "fingerprint", "tuning", "joint", "settings")
_ARRAYS = ("state", "covariance", "cross", "voltage")
_SECOND = 1_000_000_000


@dataclass(frozen=True, eq=False)
class RecordedCheckpoint:
    """One unchecked message ``pam_antagonist_msgs/msg/FilterCheckpoint``: n states, m consider parameters.

    Attributes:
        stamp_ns: stamp of the last sample that the filter had used [ns].
        started_ns: stamp of the sample that started the filter [ns].
        joint: ``free`` or ``locked``.
        lock_angle: of a locked joint [rad].
        state: (n,).
        covariance: row-major (n n,).
        cross: row-major (n m,).
        voltage: (2,) [V].
        distances: number of distances between stamps so far, then the last nine distances [ns], (10,).
        angle_sensor: the filter's memory of a measured angle; empty where none was read.
    """

    stamp_ns: int
    started_ns: int
    rig: str
    fingerprint: str
    tuning: str
    joint: str
    lock_angle: float
    settings: str
    added: tuple[str, ...]
    state: NDArray[np.float64]
    covariance: NDArray[np.float64]
    cross: NDArray[np.float64]
    voltage: NDArray[np.float64]
    rejected: int
    distances: NDArray[np.int64]
    angle_sensor: NDArray[np.float64]


def read(decoded: Decoded, keep: NDArray[np.intp]) -> tuple[RecordedCheckpoint, ...]:
    """Records of decoded messages.

    Args:
        keep: numbers of the messages to take, in the order of the result (K,).
    """
    if len(keep) == 0:
        return ()
    stamps, started = decoded.stamp_ns("header.stamp").tolist(), decoded.stamp_ns("started").tolist()
    records = {row: fields for group in decoded.groups for row, fields in _fields(group)}
    return tuple(RecordedCheckpoint(stamps[row], started[row], **records[row]) for row in keep.tolist())


def _fields(group: Group) -> Iterator[tuple[int, dict[str, Any]]]:
    names = [f"added[{k}]" for k in range(group.counts["added"])]
    columns, has_angle_sensor = group.columns, "angle_sensor" in group.columns
    for place, row in enumerate(group.rows.tolist()):
        yield (
            row,
            {
                **{name: _text(columns[name][place]) for name in _TEXTS},
                **{name: np.array(columns[name][place], dtype=np.float64) for name in _ARRAYS},
                "added": tuple(_text(columns[name][place]) for name in names),
                "lock_angle": float(columns["lock_angle"][place]),
                "rejected": int(columns["rejected"][place]),
                "distances": np.array(columns["distances"][place], dtype=np.int64),
                "angle_sensor": np.array(columns["angle_sensor"][place] if has_angle_sensor else [], dtype=np.float64),
            },
        )


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")


def messages(checkpoints: Sequence[RecordedCheckpoint], frame_id: str) -> Iterator[tuple[int, bytes]]:
    """Stamp [ns] and CDR of each checkpoint."""
    for item in checkpoints:
        columns: dict[str, Any] = {name: getattr(item, name) for name in _TEXTS}
        arrays = (*_ARRAYS, "distances", "angle_sensor")
        columns |= {name: np.asarray(getattr(item, name)).reshape(1, -1) for name in arrays}
        columns |= {name: getattr(item, name) for name in ("lock_angle", "rejected")}
        columns |= {"header.frame_id": frame_id, "added": list(item.added)}
        for path, time_ns in (("header.stamp", item.stamp_ns), ("started", item.started_ns)):
            columns[f"{path}.sec"], columns[f"{path}.nanosec"] = divmod(time_ns, _SECOND)
        yield item.stamp_ns, encode(TOPICS["filter_checkpoint"].type, 1, columns)[0].tobytes()
