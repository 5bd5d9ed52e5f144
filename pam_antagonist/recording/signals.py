"""What a bag holds beside the samples: further signals, beginnings of episodes, rigs, checkpoints of the filter.

A further signal is another joint's pressure or angle, or a temperature. In a bag it is a topic below ``also/`` in the
joint's namespace, or any topic of a type in ``KINDS`` that is requested by name. An episode begins at each stamp of the
topic ``episode`` (std_msgs/Header). The time between two episodes is not known, so that a model starts anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import stamps
from .cdr import CdrError, Decoded, MessageLayout, decode, encode
from .notes import Issue
from .raw import CompressionError, RawBag, unpack_messages
from .recording import FurtherSignal
from .topics import ALSO, TOPICS, Topic

if TYPE_CHECKING:
    from ..estimation.memory import Checkpoint

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

EPISODE = Topic("episode", "episode", "std_msgs/msg/Header", "an episode begins: the sample before tells nothing of it")
"""Marks the first sample of each episode; written by ``import_csv``."""
KINDS: Mapping[str, tuple[str, str]] = {
    "sensor_msgs/msg/FluidPressure": ("fluid_pressure", "Pa"),
    "sensor_msgs/msg/JointState": ("position", "rad"),
    "sensor_msgs/msg/Temperature": ("temperature", "degC"),
}
"""Message type -> field that holds the signal, and its unit."""
_MOST_RIGS = 100  # messages of the topic rig that are read, the last ones; each restart of a node adds one
_TEXT_HEAD = 8  # [bytes] of a std_msgs/String in CDR before its text: encapsulation, and length with the closing zero
FRAME = "joint"
"""Frame and joint name in the messages that are written."""


def topic_of(name: str) -> str:
    """The topic that the name of a further signal means, if it is none below ``also/``."""
    return name if name.startswith("/") else f"/{name}"


def read_signals(bag: RawBag, namespace: str, samples: Stamps, wanted: Sequence[str] = ()) -> dict[str, FurtherSignal]:
    """Further signals of a bag at the samples (N,), by the part after ``also/``, or the entry of ``wanted``.

    `wanted`: names of further topics in the bag, in addition to those below ``also/``.
    """
    prefix = f"{namespace}/{ALSO}"
    topics = {topic[len(prefix) :]: topic for topic in sorted(bag.topics) if topic.startswith(prefix)}
    topics = {name: topic for name, topic in topics.items() if bag.topics[topic].msgtype in KINDS}
    for name in wanted:
        if name in topics:
            continue
        actual = topic_of(name)
        if actual not in bag.topics:
            listed = ", ".join([*topics, *(t for t, raw in bag.topics.items() if raw.msgtype in KINDS)])
            raise BadInput(f"{bag.path}: no signal {name!r}; expected one of {listed or 'none, there is no other'}")
        topics[name] = actual
    return {name: _read(bag, topic, samples) for name, topic in topics.items()}


def _read(bag: RawBag, topic: str, samples: Stamps) -> FurtherSignal:
    kind = bag.topics[topic].msgtype
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
        decoded = decode(unpack_messages(bag.topics[topic]), bag.topics[topic].msgtype)
        stamp_ns = decoded.stamp_ns(path)
    except (CdrError, CompressionError) as exc:
        raise BadInput(f"{bag.path}: {topic} cannot be read, {exc}") from exc
    return decoded, np.unique(stamp_ns, return_index=True)[1]


def read_episodes(bag: RawBag, namespace: str, samples: Stamps) -> Stamps | None:
    """Stamps of the first samples of episodes (E,) [ns]; None where the bag marks none. `samples`: stamps (N,) [ns]."""
    topic = EPISODE.resolve(namespace)
    raw = bag.topics.get(topic)
    if raw is None or raw.msgtype != EPISODE.type or not len(raw):
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
    if raw is None or raw.msgtype != topic.type or raw.encoding != "cdr":
        return ()
    try:
        messages = list(unpack_messages(raw).each())
    except CompressionError:
        return ()
    texts: dict[str, None] = {}
    for k in raw.log_ns.argsort(kind="stable")[-_MOST_RIGS:].tolist():
        message = bytes(messages[k])
        order = "little" if message[1:2] == b"\x01" else "big"
        size = int.from_bytes(message[4:_TEXT_HEAD], order)  # type: ignore[arg-type]
        if 0 < size <= len(message) - _TEXT_HEAD:
            texts[message[_TEXT_HEAD : _TEXT_HEAD + size - 1].decode(errors="replace")] = None
    return tuple(texts)


_TEXTS = ("rig", "fingerprint", "tuning", "joint", "settings")
_ARRAYS = ("state", "covariance", "cross", "voltage", "distances", "angle_sensor")


def read_checkpoints(decoded: Decoded, keep: NDArray[np.intp]) -> tuple[Checkpoint, ...]:
    """Checkpoints of the live filter in some messages, unchecked: a filter that is given one checks it."""
    if len(keep) == 0:
        return ()
    stamps, started = decoded.stamp_ns("header.stamp").tolist(), decoded.stamp_ns("started").tolist()
    found = {
        row: _checkpoint(group, place, stamps[row], started[row])
        for group in decoded.groups
        for place, row in enumerate(group.rows.tolist())
    }
    return tuple(found[row] for row in keep.tolist())


def _checkpoint(group: MessageLayout, place: int, stamp_ns: int, started_ns: int) -> Checkpoint:
    from ..estimation.memory import Checkpoint, FilterIdentity  # takes a second that a bag alone does not need

    columns = group.columns
    texts = {name: columns[name][place].decode(errors="replace") for name in _TEXTS}
    added = (columns[f"added[{k}]"][place].decode(errors="replace") for k in range(group.counts["added"]))
    arrays: dict[str, Any] = {
        name: np.array(columns[name][place]) if name in columns else np.empty(0) for name in _ARRAYS
    }
    n = max(1, len(arrays["state"]))
    for name in ("covariance", "cross"):
        if len(arrays[name]) % n == 0:  # the filter refuses one of a wrong size
            arrays[name] = arrays[name].reshape(n, -1)
    kinds = {"distances": np.int64}
    arrays = {name: values.astype(kinds.get(name, np.float64)) for name, values in arrays.items()}
    identity = FilterIdentity(**texts, lock_angle=float(columns["lock_angle"][place]), added=tuple(added))
    return Checkpoint(stamp_ns, started_ns, identity, rejected=int(columns["rejected"][place]), **arrays)


def checkpoint_message(checkpoint: Checkpoint) -> bytes:
    """A checkpoint as a serialised message."""
    columns: dict[str, Any] = {name: np.asarray(getattr(checkpoint, name)).reshape(1, -1) for name in _ARRAYS}
    columns |= vars(checkpoint.identity) | {"rejected": checkpoint.rejected, "header.frame_id": FRAME}
    for path, time_ns in (("header.stamp", checkpoint.stamp_ns), ("started", checkpoint.started_ns)):
        columns[f"{path}.sec"], columns[f"{path}.nanosec"] = divmod(time_ns, 1_000_000_000)
    return encode(TOPICS["filter_checkpoint"].type, 1, columns)[0].tobytes()
