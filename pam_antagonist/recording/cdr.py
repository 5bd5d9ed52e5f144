"""CDR payloads <-> arrays, many messages at a time.

The payloads of one topic nearly always have one byte layout: the same byte order, lengths of strings and counts of
sequences. So the messages are stacked as rows of a matrix of bytes, and the message definition is walked once for all
of them. Each field is then a strided piece of the matrix. Where a length or a count differs between messages, the rows
are split by this number and each part is walked by itself. Layout: XCDR version 1 (OMG DDSI-RTPS 2.3, 10.2; CORBA 3.3
part 2, 9.3): four bytes of encapsulation, then members in order, primitives aligned to their size relative to the end
of the encapsulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from .messages import typestore

HEADER = 4  # bytes of encapsulation
_MAX_PADDING = 3  # bytes that a writer may append to fill the last word
_MAX_EMPTY = 8  # further bytes for each empty sequence: Fast DDS aligns for elements although there are none
_PRIMITIVES = {
    "bool": "u1", "byte": "u1", "char": "u1", "octet": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip


class CdrError(ValueError):
    """A payload is no CDR message of its type; the text names the message and the field."""


@dataclass(frozen=True)
class Payloads:
    """Raw messages of one topic, end to end."""

    data: NDArray[np.uint8]  # All payloads (B,) uint8
    length: NDArray[np.int64]  # Length of each payload (N,) int64 [bytes]

    @classmethod
    def of(cls, messages: Sequence[bytes | bytearray | memoryview]) -> Payloads:
        """Join a list of payloads."""
        length = np.fromiter(map(len, messages), np.int64, len(messages))
        return cls(np.frombuffer(b"".join(messages), np.uint8), length)

    def __len__(self) -> int:
        return len(self.length)


@dataclass
class Group:
    """Messages of one layout, being decoded."""

    rows: NDArray[np.intp]  # numbers of the messages (k,)
    matrix: NDArray[np.uint8]  # their bytes (k, size)
    order: str
    position: int  # where decoding goes on, from the end of the encapsulation [bytes]
    pending: list[tuple[str, Any]]  # path and type of the fields that are still to be decoded, the next one last
    # Field path -> values (k,) or, for arrays and sequences of primitives, (k, count); strings are (k,) bytes. Members
    # of messages are written "header.stamp.sec", elements "name[0]".
    columns: dict[str, NDArray[Any]] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)  # Path of every array or sequence -> number of its elements


@dataclass(frozen=True)
class Decoded:
    """Messages of one topic as arrays."""

    size: int
    groups: tuple[Group, ...]

    def fixed(self, path: str) -> NDArray[Any]:
        """Values of a field that every message has: (N,) or (N, count) in native byte order."""
        first = self.groups[0].columns[path]
        result = np.empty((self.size, *first.shape[1:]), first.dtype.newbyteorder("="))
        for group in self.groups:
            result[group.rows] = group.columns[path]
        return result

    def has(self, path: str) -> bool:
        """Whether the messages have a field; those of a former definition lack the fields that were added later."""
        return not self.groups or path in self.groups[0].columns

    def stamp_ns(self, path: str) -> NDArray[np.int64]:
        """Times of a builtin_interfaces/Time field (N,) [ns]."""
        nanosec = self.fixed(f"{path}.nanosec").astype(np.int64)
        if np.any(nanosec >= 1_000_000_000):
            index = int(np.argmax(nanosec >= 1_000_000_000))
            raise CdrError(f"message {index}: {path}.nanosec is {nanosec[index]}, expected less than 1000000000")
        return self.fixed(f"{path}.sec").astype(np.int64) * 1_000_000_000 + nanosec


def decode(payloads: Payloads, msgtype: str, stores: Sequence[Typestore] = ()) -> Decoded:
    """Decode all messages of one topic.

    `msgtype`: Message type known to :func:`~pam_antagonist.recording.messages.typestore`. `stores`: definitions to try
    in order; the first that fits all payloads is taken. Default: the present one.
    """
    first: CdrError | None = None
    for store in stores or (typestore(),):
        try:
            return _decode(payloads, msgtype, store)
        except CdrError as error:
            first = first or error
    assert first is not None
    raise first


def _decode(payloads: Payloads, msgtype: str, store: Typestore) -> Decoded:
    done: list[Group] = []
    todo = _by_length_and_order(payloads, msgtype, store)
    while todo:
        group = todo.pop()
        parts = _walk(group, msgtype, store)
        if parts is None:
            done.append(group)
        else:
            todo.extend(parts)
    return Decoded(len(payloads), tuple(done))


def _by_length_and_order(payloads: Payloads, msgtype: str, store: Typestore) -> list[Group]:
    length = payloads.length
    if len(length) == 0:
        return []
    if length.min() < HEADER:
        raise CdrError(f"message {int(length.argmin())} has {length.min()} bytes, less than its CDR header")
    start = np.cumsum(length) - length
    kinds = payloads.data[start].astype(np.uint16) << 8 | payloads.data[start + 1]
    if np.any(kinds > 1):
        index = int(np.argmax(kinds > 1))
        raise CdrError(f"message {index} begins with 0x{kinds[index]:04x}, expected plain CDR (0x0000 or 0x0001)")
    groups = []
    for size in np.unique(length):
        for kind in (0, 1):
            rows = np.flatnonzero((length == size) & (kinds == kind))
            if not len(rows):
                continue
            if len(rows) == len(length):
                matrix = payloads.data.reshape(len(rows), size)
            else:
                matrix = payloads.data[start[rows, None] + np.arange(size)]
            groups.append(Group(rows, matrix, "<" if kind else ">", 0, _members("", msgtype, store)))
    return groups


def _members(prefix: str, msgtype: str, store: Typestore) -> list[tuple[str, Any]]:
    """Members of a message as a stack, the first one on top."""
    dot = f"{prefix}." if prefix else ""
    return [(dot + name, description) for name, description in reversed(store.fielddefs[msgtype][1])]


def _walk(group: Group, msgtype: str, store: Typestore) -> list[Group] | None:
    """Decode the rows in place; None at the end, or the groups to go on with where the rows' layouts differ."""
    while group.pending:
        path, (kind, what) = group.pending.pop()
        if kind == Nodetype.BASE and what[0] != "string":
            group.columns[path] = _take(group, path, what[0], 1)[:, 0]
        elif kind == Nodetype.NAME:
            group.pending.extend(_members(path, what, store))
        elif kind == Nodetype.ARRAY:
            _elements(group, path, what[0], what[1])
        else:
            parts = _sized(group, path, kind, what)
            if parts is not None:
                return parts
    rest = group.matrix.shape[1] - HEADER - group.position
    if rest > _MAX_PADDING + _MAX_EMPTY * list(group.counts.values()).count(0):
        raise CdrError(f"message {group.rows[0]} is {rest} bytes longer than a {msgtype}")
    return None


def _sized(group: Group, path: str, kind: int, what: Any) -> list[Group] | None:
    """Decode a string or sequence whose length is the same in all rows; otherwise split the rows by length."""
    before = group.position
    sizes = _take(group, path, "uint32", 1)[:, 0]
    size = int(sizes[0])
    if np.any(sizes != size):
        group.position = before
        parts = []
        for value in np.unique(sizes):
            mask = sizes == value
            parts.append(
                Group(
                    group.rows[mask], group.matrix[mask], group.order, before, [*group.pending, (path, (kind, what))],
                    {name: column[mask] for name, column in group.columns.items()}, dict(group.counts),
                )
            )  # fmt: skip
        return parts
    if kind == Nodetype.SEQUENCE:
        _elements(group, path, what[0], size)
        return None
    text = _take(group, path, "uint8", size)
    if size > 0 and np.any(text[:, -1]):
        index = group.rows[int(np.argmax(text[:, -1] != 0))]
        raise CdrError(f"message {index}: string {path} of length {size} does not end with a zero byte")
    if size > 1:
        group.columns[path] = np.ascontiguousarray(text[:, :-1]).view(f"S{size - 1}")[:, 0]
    else:
        group.columns[path] = np.zeros(len(group.rows), dtype="S1")
    return None


def _elements(group: Group, path: str, element: Any, count: int) -> None:
    """Decode a known number of elements: primitives at once, others one by one."""
    group.counts[path] = count
    kind, what = element
    if kind == Nodetype.BASE and what[0] != "string":
        group.columns[path] = _take(group, path, what[0], count)
        return
    if count > group.matrix.shape[1]:  # each element needs a byte at least, so the count is damaged
        raise CdrError(f"message {group.rows[0]}: {path} claims {count} elements, more than the message has bytes")
    group.pending.extend((f"{path}[{i}]", element) for i in reversed(range(count)))


def _take(group: Group, path: str, primitive: str, count: int) -> NDArray[Any]:
    """The next ``count`` primitives of every row: (k, count)."""
    if primitive not in _PRIMITIVES:
        raise CdrError(f"field {path} is a {primitive}, which cannot be read")
    dtype = np.dtype(group.order + _PRIMITIVES[primitive])
    if count == 0:
        return np.empty((len(group.rows), 0), dtype)
    start = HEADER + _aligned(group.position, dtype.itemsize)
    stop = start + count * dtype.itemsize
    if stop > group.matrix.shape[1]:
        raise CdrError(
            f"message {group.rows[0]} ends after {group.matrix.shape[1]} bytes, where {path} needs {stop} bytes"
        )
    group.position = stop - HEADER
    return np.ascontiguousarray(group.matrix[:, start:stop]).view(dtype)


def _aligned(position: int, size: int) -> int:
    return (position + size - 1) // size * size


class _Encoder:
    """Messages of one layout that grow field by field: pieces (N, bytes) uint8, side by side."""

    def __init__(self, size: int, little_endian: bool) -> None:
        self.pieces = [np.tile(np.array([0, little_endian, 0, 0], np.uint8), (size, 1))]
        self._size, self._order, self._position = size, "<" if little_endian else ">", 0

    def put(self, values: Any, dtype: str, count: int) -> None:
        """Append ``count`` aligned numbers to each message."""
        shape = (self._size, count)
        block = np.ascontiguousarray(np.broadcast_to(np.asarray(values), shape), np.dtype(self._order + dtype))
        padding = _aligned(self._position, block.itemsize) - self._position if count else 0
        self.pieces.append(np.zeros((self._size, padding), np.uint8))
        self.pieces.append(block.view(np.uint8).reshape(self._size, -1))
        self._position += padding + self.pieces[-1].shape[1]

    def put_single(self, primitive: str, values: Any) -> None:
        """Append a number of each message (N,), or a number or string that all messages share."""
        if primitive == "string":
            raw = np.frombuffer((values.encode() if isinstance(values, str) else values) + b"\0", np.uint8)
            self.put(len(raw), "u4", 1)
            self.put(raw, "u1", len(raw))
        else:
            array = np.asarray(values)
            self.put(array.reshape(-1, 1) if array.ndim else array, _PRIMITIVES[primitive], 1)

    def put_list(self, name: str, primitive: str, values: Any, length: int | None) -> None:
        """Append an array of a fixed length, or a sequence with its length in front (``length`` None)."""
        count = len(values) if primitive == "string" else cast(int, np.asarray(values).shape[-1])
        if length is None:
            self.put(count, "u4", 1)
        elif count != length:
            raise ValueError(f"{name} has {length} elements, got {count}")
        if primitive == "string":
            for text in values:
                self.put_single("string", text)
        else:
            self.put(values, _PRIMITIVES[primitive], count)


def encode(msgtype: str, size: int, columns: Mapping[str, Any], *, little_endian: bool = True) -> NDArray[np.uint8]:
    """Encode ``size`` messages of one type and one layout.

    `columns`: Field path -> values: a primitive (N,) or one number for all; an array or sequence (N, count); one string
    for all; a list of strings for a sequence of strings. Every field of the type is needed. Returns one message a row
    (N, L) uint8.
    """
    out = _Encoder(size, little_endian)
    pending = _members("", msgtype, typestore())
    unused = set(columns)
    while pending:
        path, (kind, what) = pending.pop()
        if kind == Nodetype.NAME:
            pending.extend(_members(path, what, typestore()))
            continue
        unused.discard(path)
        values = columns[path]
        if kind == Nodetype.BASE:
            out.put_single(what[0], values)
        elif what[0][0] == Nodetype.BASE:
            out.put_list(f"{path} of {msgtype}", what[0][1][0], values, what[1] if kind == Nodetype.ARRAY else None)
        else:
            raise ValueError(f"{path} of {msgtype} is a list of messages, which cannot be written from arrays")
    if unused:
        raise KeyError(f"{msgtype} has no field {sorted(unused)[0]!r}")
    return np.concatenate(out.pieces, axis=1)


@dataclass(frozen=True)
class Channel:
    """A bag's description of one of its topics."""

    topic: str
    msgtype: str  # Message type, such as "sensor_msgs/msg/FluidPressure"; "" where the bag does not say
    encoding: str  # Serialization, "cdr" for ROS 2
    definition: str = ""
    digest: str = ""  # RIHS01 hash of the type, or ""


@dataclass(frozen=True)
class RawTopic:
    """Messages of one channel in the order of the file."""

    channel: Channel
    log_ns: NDArray[np.int64]  # Time of reception of each message (N,) [ns]
    payloads: Payloads | None  # The messages, or None where this type was not requested

    @staticmethod
    def joined(channel: Channel, parts: list[RawTopic]) -> RawTopic:
        """Join pieces of one topic (files of a split bag, several publishers)."""
        log_ns = np.concatenate([part.log_ns for part in parts])
        chosen = [part.payloads for part in parts if part.payloads is not None]
        if len(chosen) != len(parts):
            return RawTopic(channel, log_ns, None)
        data = np.concatenate([payloads.data for payloads in chosen])
        return RawTopic(channel, log_ns, Payloads(data, np.concatenate([payloads.length for payloads in chosen])))


@dataclass
class Collector:
    """Gathers messages of one channel, block by block."""

    channel: Channel
    wanted: bool  # whether the messages are kept; otherwise only their times are
    _blocks: list[RawTopic] = field(default_factory=list)

    def add(self, log_ns: NDArray[np.int64], payloads: Payloads | None) -> None:
        """Append messages. `log_ns`: times of reception (N,) [ns]."""
        self._blocks.append(RawTopic(self.channel, log_ns, payloads))

    def __len__(self) -> int:
        return sum(len(block.log_ns) for block in self._blocks)

    def cut(self, size: int) -> None:
        """Forget all messages but the first ones."""
        whole = self.finish()
        payloads = whole.payloads
        if payloads is not None:
            data = payloads.data[: int(payloads.length[:size].sum())]
            payloads = Payloads(data, payloads.length[:size])
        self._blocks = [RawTopic(self.channel, whole.log_ns[:size], payloads)]

    def finish(self) -> RawTopic:
        """All collected messages as one topic."""
        if not self._blocks:
            return RawTopic(self.channel, np.empty(0, np.int64), Payloads.of([]) if self.wanted else None)
        return RawTopic.joined(self.channel, self._blocks)
