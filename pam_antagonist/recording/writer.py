"""Writing rosbag2 bags: message by message while a rig runs, or a whole Recording at once."""

from __future__ import annotations

import atexit
import queue
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from ..errors import BadInput
from .cdr import encode
from .messages import typestore
from .recording import ESTIMATE_SHAPES, RecordedEstimate, Recording
from .topics import DEFAULT_NAMESPACE, TOPICS

Storage = Literal["mcap", "sqlite3"]
Compression = Literal["none", "chunk", "message", "file"]

_PLUGINS = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
_MODES = {
    "none": CompressionMode.NONE,
    "chunk": CompressionMode.STORAGE,
    "message": CompressionMode.MESSAGE,
    "file": CompressionMode.FILE,
}
_FLUSH_S = 1.0  # what a killed recorder may lose [s]
_BATCH = 4096  # messages that are handed to the writing thread at once

Item = tuple[str, int, bytes | memoryview]


class BagWriter:
    """Writes one bag; use it as a context manager.

    All file work is done by a thread of its own. So ``write`` never waits for a disk, and an interrupt, which Python
    raises in the main thread, cannot tear a half-written message: leaving the context writes everything that was
    handed over, whatever the reason for leaving. Once a second all messages so far go to the file as a whole chunk, so
    that a process that is killed leaves a bag that ``read_bag(..., recover=True)`` reads up to the last second.

    Args:
        path: Bag folder to be made; parents are made as well.
        storage: "mcap" or "sqlite3".
        compression: "chunk" (MCAP only), "message", "file" or "none"; None is "chunk" for MCAP and "none" for sqlite3.

    Raises:
        BadInput: The path exists already, or cannot be made.
    """

    def __init__(self, path: str | Path, *, storage: Storage = "mcap", compression: Compression | None = None) -> None:
        self.path = Path(path)
        if storage not in _PLUGINS:
            raise BadInput(f"storage {storage!r} of {path} is unknown, expected mcap or sqlite3")
        compression = compression or ("chunk" if storage == "mcap" else "none")
        if compression not in _MODES or (compression == "chunk" and storage != "mcap"):
            raise BadInput(f"compression {compression!r} of {path} is not possible with {storage}")
        try:
            if self.path.exists() or self.path.is_symlink():
                raise BadInput(f"{path}: exists already, and nothing is overwritten; choose another output")
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = Writer(self.path, version=9, storage_plugin=_PLUGINS[storage])
            self._writer.set_compression(_MODES[compression], CompressionFormat.ZSTD)
        except OSError as exc:
            raise BadInput(f"{path}: cannot be made ({exc})") from exc
        self._types: dict[str, str] = {}
        self._queue: queue.SimpleQueue[list[Item] | tuple[str, str] | None] = queue.SimpleQueue()
        self._opened = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=f"bag {self.path.name}", daemon=True)
        self._thread.start()
        self._opened.wait()
        if self._error is not None:
            raise BadInput(f"{path}: cannot be made ({self._error})") from self._error
        atexit.register(self.close)

    def add_topic(self, topic: str, msgtype: str) -> None:
        """Announce a topic, so that it stands in the bag even if no message ever comes.

        Args:
            topic: Absolute topic name.
            msgtype: Message type.

        Raises:
            BadInput: The type is unknown, or the topic has another one already.
        """
        known = self._types.get(topic)
        if known == msgtype:
            return
        if known is not None:
            raise BadInput(f"{self.path}: topic {topic} is a {known}, cannot also be a {msgtype}")
        if msgtype not in typestore().fielddefs:
            raise BadInput(f"{self.path}: message type {msgtype!r} of {topic} is unknown")
        self._types[topic] = msgtype
        self._put((topic, msgtype))

    def write(self, topic: str, msgtype: str, log_ns: int, data: bytes | memoryview) -> None:
        """Write one message.

        Args:
            topic: Absolute topic name.
            msgtype: Message type.
            log_ns: Time of reception [ns].
            data: The message as CDR, with its encapsulation.

        Raises:
            BadInput: As ``add_topic``.
            ValueError: The writer is closed.
        """
        self.add_topic(topic, msgtype)
        self._put([(topic, int(log_ns), data)])

    def write_many(self, items: Sequence[Item]) -> None:
        """Write messages of announced topics: (topic, time of reception [ns], CDR) each."""
        for first in range(0, len(items), _BATCH):
            self._put(list(items[first : first + _BATCH]))

    def close(self) -> None:
        """Write what is left and finish the files; a second call does nothing.

        Raises:
            OSError: Something could not be written, such as on a full disk.
        """
        interrupt: KeyboardInterrupt | None = None
        self._queue.put(None)
        while self._thread.is_alive():
            try:
                self._thread.join()
            except KeyboardInterrupt as exc:  # the data come first
                interrupt = exc
        atexit.unregister(self.close)
        error, self._error = self._error, None
        if error is not None:
            raise error
        if interrupt is not None:
            raise interrupt

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _put(self, item: list[Item] | tuple[str, str]) -> None:
        if not self._thread.is_alive():
            raise self._error or ValueError(f"{self.path} is closed")
        self._queue.put(item)

    def _run(self) -> None:
        """The thread: open, write what comes, finish."""
        try:
            self._writer.open()
            self._opened.set()
            connections: dict[str, Connection] = {}
            flushed = time.monotonic()
            unflushed = False
            while True:
                try:
                    item = self._queue.get(timeout=_FLUSH_S if unflushed else None)
                except queue.Empty:
                    item = []
                if item is None:
                    break
                if isinstance(item, tuple):
                    connections[item[0]] = self._writer.add_connection(*item, typestore=typestore())
                else:
                    for topic, log_ns, data in item:
                        self._writer.write(connections[topic], log_ns, data)
                    unflushed = unflushed or bool(item)
                if unflushed and time.monotonic() - flushed >= _FLUSH_S:
                    self._flush()
                    flushed, unflushed = time.monotonic(), False
            self._writer.close()
        except BaseException as exc:  # handed over to whoever writes or closes
            self._error = exc
            self._writer.abort()
        finally:
            self._opened.set()

    def _flush(self) -> None:
        """Bring everything so far into the file, as far as the storage has a way to do so."""
        storage: Any = self._writer.storage
        if hasattr(storage, "close_chunk"):
            storage.close_chunk()
            storage.bio.flush()
        elif hasattr(storage, "conn"):
            storage.conn.commit()


def write_bag(
    path: str | Path,
    recording: Recording,
    *,
    namespace: str = DEFAULT_NAMESPACE,
    estimate: RecordedEstimate | None = None,
    storage: Storage = "mcap",
    compression: Compression | None = None,
    frame_id: str = "joint",
    pressure_variance: float = 0.0,
) -> None:
    """Write a Recording as a bag with the package's topics.

    A sample that misses a value (NaN) gets no message for it. Messages are logged at the times in
    ``recording.received_ns`` where those are known, otherwise at their stamps.

    Args:
        path: Bag folder to be made.
        recording: What to write.
        namespace: Namespace of the topics.
        estimate: Estimate to write in place of ``recording.estimate``.
        storage: "mcap" or "sqlite3".
        compression: As for :class:`BagWriter`.
        frame_id: Frame and joint name in the messages.
        pressure_variance: Variance of the pressures to state [Pa^2]; 0 means unknown.

    Raises:
        BadInput: The path exists already, or cannot be made.
    """
    blocks = _blocks(recording, recording.estimate if estimate is None else estimate, frame_id, pressure_variance)
    with BagWriter(path, storage=storage, compression=compression) as bag:
        items: list[Item] = []
        for name, (stamp_ns, matrix) in blocks.items():
            topic = TOPICS[name].resolve(namespace)
            bag.add_topic(topic, TOPICS[name].type)
            width, view = matrix.shape[1], np.ascontiguousarray(matrix).reshape(-1).data
            times = _log_times(recording, name, stamp_ns)
            items.extend((topic, log, view[i * width : (i + 1) * width]) for i, log in enumerate(times.tolist()))
        items.sort(key=lambda item: item[1])  # stable: messages of one time keep the order of the topics
        bag.write_many(items)


def _log_times(recording: Recording, name: str, stamp_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Time of reception of each message (K,) [ns]; the stamp where it is not known."""
    times = stamp_ns.copy()
    arrival = recording.received_ns.get(name)
    if arrival is not None and len(arrival.stamp_ns):
        by_stamp = np.argsort(arrival.stamp_ns, kind="stable")
        index = np.minimum(np.searchsorted(arrival.stamp_ns[by_stamp], stamp_ns), len(by_stamp) - 1)
        known = arrival.stamp_ns[by_stamp[index]] == stamp_ns
        times[known] = arrival.log_ns[by_stamp[index[known]]]
    return times


def _header(stamp_ns: NDArray[np.int64], frame_id: str) -> dict[str, Any]:
    return {**_time("header.stamp", stamp_ns), "header.frame_id": frame_id}


def _time(path: str, stamp_ns: NDArray[np.int64]) -> dict[str, Any]:
    return {f"{path}.sec": stamp_ns // 1_000_000_000, f"{path}.nanosec": stamp_ns % 1_000_000_000}


def _blocks(
    recording: Recording, estimate: RecordedEstimate | None, frame_id: str, variance: float
) -> dict[str, tuple[NDArray[np.int64], NDArray[np.uint8]]]:
    """Logical topic name -> stamps (K,) and messages (K, L)."""
    blocks = {}

    def add(name: str, stamp_ns: NDArray[np.int64], fields: dict[str, Any], frame: str = frame_id) -> None:
        columns = {**_header(stamp_ns, frame), **fields}
        blocks[name] = (stamp_ns, encode(TOPICS[name].type, len(stamp_ns), columns))

    stamp_ns = recording.stamp_ns
    there: Any  # mask of the samples that have a value (N,)
    for muscle in (0, 1):
        there = np.isfinite(recording.pressure[:, muscle])
        fields = {"fluid_pressure": recording.pressure[there, muscle], "variance": variance}
        add(f"pressure_{muscle + 1}", stamp_ns[there], fields, f"muscle_{muscle + 1}")
    there = np.isfinite(recording.voltage).any(axis=1)
    add("valve_state", stamp_ns[there], {"voltage": recording.voltage[there]})
    signals = {"position": recording.angle, "effort": recording.torque}
    known = {name: values for name, values in signals.items() if values is not None}
    if known:
        there = np.isfinite(np.column_stack(list(known.values()))).any(axis=1)
        fields = {name: values[there, None] for name, values in known.items()}
        nothing = np.empty((np.count_nonzero(there), 0))
        joint = {"name": [frame_id], "position": nothing, "velocity": nothing, "effort": nothing, **fields}
        add("measured_joint_states", stamp_ns[there], joint)
    if recording.external_torque is not None:
        there = np.isfinite(recording.external_torque)
        wrench: dict[str, Any] = {f"wrench.{kind}.{axis}": 0.0 for kind in ("force", "torque") for axis in "xyz"}
        wrench["wrench.torque.z"] = recording.external_torque[there]
        add("measured_external_torque", stamp_ns[there], wrench)
    if recording.reference is not None:
        reference = recording.reference
        add("reference", reference.stamp_ns, {"mode": reference.mode, "value": reference.value})
    if estimate is not None:
        columns = {name: getattr(estimate, name).reshape(len(estimate), -1) for name in ESTIMATE_SHAPES}
        columns = {name: values if values.shape[1] > 1 else values[:, 0] for name, values in columns.items()}
        add("joint_estimate", estimate.stamp_ns, {**_time("started", estimate.started_ns), **columns})
    return blocks
