"""Message definitions, and CDR payloads <-> arrays, many messages at a time.

Definitions are those of ROS 2 Jazzy, and this project's own, which come with the package as files. The payloads of one
topic nearly always have one layout: the same byte order, lengths of strings and counts of sequences. So one message is
walked by its definition, which gives a numpy structure, and all messages of that layout are rows of it. Layout: XCDR
version 1 (OMG DDSI-RTPS 2.3, 10.2; CORBA 3.3 part 2, 9.3): four bytes of encapsulation,
then members in order, primitives aligned to their size relative to the end of the encapsulation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ..paths import config_dir
from .raw import Payloads

_PACKAGE = "pam_antagonist_msgs"
LATER = {
    f"{_PACKAGE}/msg/JointReference": ("stiffness", "damping"),
    f"{_PACKAGE}/msg/JointEstimate": ("external_torque", "external_torque_covariance"),
    f"{_PACKAGE}/msg/FilterCheckpoint": ("angle_sensor",),
}
"""Message type -> the fields that messages of version 0.1.0 lack. They are read as NaN, or as nothing."""


@cache
def typestore(*, former: bool = False) -> Typestore:
    """Types of ROS 2 Jazzy with this project's messages registered, as they were in version 0.1.0 where asked for."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in (config_dir().parent / _PACKAGE / "msg").glob("*.msg"):
        name = f"{_PACKAGE}/msg/{file.stem}"
        left_out = LATER.get(name, ()) if former else ()
        lines = [
            line for line in file.read_text(encoding="utf-8").splitlines() if not {*line.split()[1:2]} & {*left_out}
        ]
        store.register(get_types_from_msg("\n".join(lines), name))
    return store


def stores_of(msgtype: str, digest: str, definition: str) -> tuple[Typestore, ...]:
    """Type stores whose definition of a message type agrees with the bag's.

    `digest`: RIHS01 hash that the bag states, or "". `definition`: in .msg or .idl syntax, or "".
    """
    stores = (typestore(), typestore(former=True)) if msgtype in LATER else (typestore(),)
    return tuple(store for store in stores if _agrees(store, msgtype, digest, definition))


def _agrees(store: Typestore, msgtype: str, digest: str, definition: str) -> bool:
    if digest:
        return digest == store.hash_rihs01(msgtype)
    if not definition:
        return True
    try:
        is_idl = definition.startswith("=" * 80 + "\nIDL: ")
        theirs = get_types_from_idl(definition) if is_idl else get_types_from_msg(definition, msgtype)
    except Exception:  # any error of the parser: an unreadable definition proves no difference
        return True
    return all(
        [(field.lower(), kind) for field, kind in fields] == [(f.lower(), k) for f, k in store.fielddefs[name][1]]
        for name, (_, fields) in theirs.items()
        if name in store.fielddefs
    )


_HEADER = 4  # bytes of encapsulation
_MAX_PADDING = 3  # bytes that a writer may append to fill the last word
_MAX_EMPTY = 8  # further bytes for each empty sequence: Fast DDS aligns for elements although there are none
_MOST_LAYOUTS = 1000  # of one topic: more are no recording of a joint
_PRIMITIVES = {
    "bool": "u1", "byte": "u1", "char": "u1", "octet": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip


class CdrError(ValueError):
    """A payload is no CDR message of its type; the text names the message and the field."""


@dataclass
class _Layout:
    """Members of a message, one behind the other."""

    order: str
    # Path -> format of a numpy structure, and place [bytes]. Members of messages are written "header.stamp.sec",
    # elements "name[0]"; "#" before a path is the length of a string or sequence.
    fields: dict[str, tuple[Any, int]] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)  # path -> length of a string or sequence
    counts: dict[str, int] = field(default_factory=dict)  # path of an array or sequence -> number of its elements
    end: int = _HEADER

    def add(self, path: str, kind: str, count: int | None = None) -> None:
        """Add a number, an array of ``count`` numbers, or a string of ``count`` bytes."""
        if kind not in _PRIMITIVES and kind != "string":
            raise CdrError(f"field {path} is a {kind}, which cannot be read")
        one = np.dtype(f"S{count or 1}" if kind == "string" else self.order + _PRIMITIVES[kind])
        width = 1 if kind == "string" else one.itemsize
        if count != 0:
            self.end += -(self.end - _HEADER) % width
        self.fields[path] = one if count is None or kind == "string" else (one, (count,)), self.end
        self.end += width * (1 if count is None else count)

    def dtype(self, size: int) -> np.dtype:
        """The structure of a message of ``size`` bytes."""
        names = [path for path in self.fields if self.sizes.get(path) != 0 or path in self.counts]
        formats, offsets = zip(*(self.fields[name] for name in names), strict=True)
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


def _layout(msgtype: str, store: Typestore, order: str, size_of: Callable[[str, _Layout], int]) -> _Layout:
    """The layout of a message; ``size_of`` says how long a string or sequence is whose length was added last."""
    out = _Layout(order)
    pending = _members("", msgtype, store)
    base: Any
    count: Any
    while pending:
        path, (kind, what) = pending.pop()
        if kind == Nodetype.NAME:
            pending.extend(_members(path, what, store))
            continue
        base, count = (what[0], None) if kind == Nodetype.BASE else what
        if kind == Nodetype.SEQUENCE or base == "string":
            out.add(f"#{path}", "uint32")
            out.sizes[path] = count = size_of(path, out)
        if kind != Nodetype.BASE:
            out.counts[path] = count
            if base[0] != Nodetype.BASE or base[1][0] == "string":
                pending.extend((f"{path}[{i}]", base) for i in reversed(range(count)))
                continue
            base = base[1][0]
        out.add(path, base, count)
    return out


def _members(prefix: str, msgtype: str, store: Typestore) -> list[tuple[str, Any]]:
    """Members of a message as a stack, the first one on top."""
    dot = f"{prefix}." if prefix else ""
    return [(dot + name, description) for name, description in reversed(store.fielddefs[msgtype][1])]


@dataclass(frozen=True)
class MessageLayout:
    """Messages of one layout."""

    rows: NDArray[np.intp]  # numbers of the messages (k,)
    # Field path -> values (k,) or, for arrays and sequences of primitives, (k, count); strings are (k,) bytes.
    columns: Mapping[str, NDArray[Any]]
    counts: Mapping[str, int]  # path of every array or sequence -> number of its elements


@dataclass(frozen=True)
class Decoded:
    """Messages of one topic as arrays."""

    size: int
    groups: tuple[MessageLayout, ...]

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

    `stores`: definitions to try in order; the first that fits all payloads is taken. Default: the present one.
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
    length = payloads.length
    if len(length) == 0:
        return Decoded(0, ())
    if length.min() < _HEADER:
        raise CdrError(f"message {int(length.argmin())} has {length.min()} bytes, less than its CDR header")
    start = np.cumsum(length) - length
    kinds = payloads.data[start].astype(np.uint16) << 8 | payloads.data[start + 1]
    if np.any(kinds > 1):
        index = int(np.argmax(kinds > 1))
        raise CdrError(f"message {index} begins with 0x{kinds[index]:04x}, expected plain CDR (0x0000 or 0x0001)")
    done: list[MessageLayout] = []
    sorts = 2 * length + kinds  # by length and byte order
    for sort in np.unique(sorts).tolist():
        rows, (size, kind) = np.flatnonzero(sorts == sort), divmod(sort, 2)
        if len(rows) == len(length):
            matrix = payloads.data.reshape(len(rows), size)
        else:
            matrix = payloads.data[start[rows, None] + np.arange(size)]
        while len(rows):
            if len(done) == _MOST_LAYOUTS:
                raise CdrError(f"message {rows[0]} has a layout of its own, as {_MOST_LAYOUTS} before it")
            group, there = _first_layout(rows, matrix, msgtype, store, "<" if kind else ">")
            done.append(group)
            rows, matrix = rows[~there], matrix[~there]
    return Decoded(len(payloads), tuple(done))


def _first_layout(
    rows: NDArray[np.intp], matrix: NDArray[np.uint8], msgtype: str, store: Typestore, order: str
) -> tuple[MessageLayout, NDArray[np.bool_]]:
    """The messages that have the layout of the first row, and which ones they are."""
    size, first = matrix.shape[1], matrix[0].tobytes()
    there = np.ones(len(rows), bool)

    def size_of(path: str, layout: _Layout) -> int:
        at = layout.end - 4
        _check_end(f"#{path}"[1:], layout, size, rows[0])
        own = np.ascontiguousarray(matrix[:, at : at + 4]).view(f"{order}u4")[:, 0]
        there[own != own[0]] = False
        count = int(own[0])
        if count > len(first):  # each element needs a byte at least, so the count is damaged
            raise CdrError(f"message {rows[0]} ends after {size} bytes, where {path} needs {at + 4 + count} bytes")
        return count

    layout = _layout(msgtype, store, order, size_of)
    _check_end(next(reversed(layout.fields)), layout, size, rows[0])
    rest = size - layout.end
    if rest > _MAX_PADDING + _MAX_EMPTY * list(layout.counts.values()).count(0):
        raise CdrError(f"message {rows[0]} is {rest} bytes longer than a {msgtype}")
    if not there.all():
        rows, matrix = rows[there], matrix[there]
    table = np.ascontiguousarray(matrix).view(layout.dtype(size))[:, 0]
    columns = {path: table[path] for path in table.dtype.names or () if not path.startswith("#")}
    for path, length in layout.sizes.items():
        if path in layout.counts:
            continue
        if length == 0:
            columns[path] = np.zeros(len(rows), "S1")
        elif np.any(last := matrix[:, layout.fields[path][1] + length - 1]):
            index = rows[int(np.argmax(last != 0))]
            raise CdrError(f"message {index}: string {path} of length {length} does not end with a zero byte")
    return MessageLayout(rows, columns, layout.counts), there


def _check_end(path: str, layout: _Layout, size: int, message: int) -> None:
    if layout.end > size:
        raise CdrError(f"message {message} ends after {size} bytes, where {path} needs {layout.end} bytes")


def encode(msgtype: str, size: int, columns: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Encode ``size`` messages of one type and one layout, in little endian byte order.

    `columns`: Field path -> values: a primitive (N,) or one number for all; an array or sequence (N, count); one string
    for all; a list of strings for a sequence of strings. Every field of the type is needed. Returns one message a row
    (N, L) uint8.
    """
    given = dict(columns)
    for path, values in columns.items():
        if isinstance(values, str):
            given[path] = values.encode()
        elif isinstance(values, (list, tuple)):
            given |= {f"{path}[{i}]": text.encode() for i, text in enumerate(values)}

    def size_of(path: str, layout: _Layout) -> int:
        values = given[path]
        if isinstance(values, bytes):
            return len(values) + 1
        return len(values) if isinstance(values, (list, tuple)) else int(np.shape(values)[-1])

    layout = _layout(msgtype, typestore(), "<", size_of)
    if unused := set(columns) - set(layout.fields) - set(layout.counts):
        raise KeyError(f"{msgtype} has no field {sorted(unused)[0]!r}")
    table = np.zeros(size, layout.dtype(layout.end))
    for path in table.dtype.names or ():
        table[path] = layout.sizes[path[1:]] if path.startswith("#") else given[path]
    out = table.view(np.uint8).reshape(size, layout.end)
    out[:, 1] = 1  # little endian
    return out
