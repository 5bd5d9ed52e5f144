"""Writing rosbag2 bags: message by message while a rig runs, or a whole Recording at once."""

from __future__ import annotations

import atexit
import contextlib
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import signals
from .bag_files import BagFiles, FileLimits
from .cdr import encode, typestore
from .recording import ESTIMATE_SHAPES, RecordedEstimate, Recording
from .topics import ALSO, DEFAULT_NAMESPACE, STATE_TOPICS, TOPICS, Topic

_FLUSH_S = 1.0  # [s] between flushes: the most that is lost when the recorder is killed or loses power
_BATCH = 4096  # messages that are handed to the writing thread at once
_PART = 65_536  # messages of a Recording that are in memory at once
_AHEAD = 8  # batches of it that may wait for the disk

Item = tuple[str, int, bytes | memoryview]


class BagWriter:
    """Writes one bag of compressed MCAP files; use it as a context manager.

    All file work is done by a separate thread. So ``write`` never waits for a disk, and an interrupt, which Python
    raises in the main thread, never leaves half a message. Leaving the context for any reason writes all messages so
    far. Once a second all messages go to the file as a complete chunk, so that ``read_bag`` reads the bag of a killed
    process up to the last second. When a write fails, as on a full disk, the complete chunks are kept and the file is
    closed if possible.

    Args:
        path: Bag folder to be made; parents are made as well.
        limits: When to begin the next file; default: never.
        durable: Whether flushed data must survive a power cut as well; costs one fsync a second.
        backlog: Bytes that may wait for the disk; with more, messages are dropped and counted. None: no limit.

    Attributes:
        dropped: Messages that were dropped because the disk did not keep up.
        kept: After a failed write, the number of messages that can be read; else None.

    Raises:
        BadInput: The path exists already, or cannot be made.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        limits: FileLimits = FileLimits(),  # noqa: B008  (frozen)
        durable: bool = False,
        backlog: int | None = None,
    ) -> None:
        self.path = Path(path)
        try:
            if self.path.exists() or self.path.is_symlink():
                raise BadInput(f"{path}: exists already, and nothing is overwritten; choose another output")
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except (OSError, ValueError) as exc:
            raise BadInput(f"{path}: cannot be made ({exc})") from exc
        self._files = BagFiles(self.path, limits, durable)
        self._types: dict[str, str] = {}
        self._queue: queue.SimpleQueue[list[Item] | tuple[str, str] | None] = queue.SimpleQueue()
        self._limit = backlog
        self._given = self._written = self.dropped = 0
        self.kept: int | None = None
        self._opened = threading.Event()
        self._error: BaseException | None = None
        self._reported = False
        self._thread = threading.Thread(target=self._run, name=f"bag {self.path.name}", daemon=True)
        self._thread.start()
        self._opened.wait()
        if self._error is not None:
            raise BadInput(f"{path}: cannot be made ({self._error})") from self._error
        atexit.register(self.close)

    @property
    def backlog(self) -> int:
        """Bytes that wait for the disk; counted only with a limit."""
        return self._given - self._written

    @property
    def size(self) -> int:
        """Bytes in the files as of the last flush."""
        return self._files.size

    @property
    def files(self) -> int:
        """Number of message files that were begun."""
        return self._files.files

    def add_topic(self, topic: str, msgtype: str) -> None:
        """Announce a topic, so that the bag lists it even without messages.

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

    def write_many(self, items: Sequence[Item]) -> int:
        """Write messages of announced topics: (topic, time of reception [ns], CDR) each.

        Returns:
            Number of messages taken; the others exceed the backlog and are dropped. With a limit, for one thread only.
        """
        for first in range(0, len(items), _BATCH):
            batch = list(items[first : first + _BATCH])
            if self._limit is not None:
                if self.backlog > self._limit:
                    self.dropped += len(items) - first
                    return first
                self._given += _size(batch)
            self._put(batch)
        return len(items)

    def keep_up(self) -> None:
        """Wait until little waits for the disk, so that a long recording does not fill the memory."""
        while self._thread.is_alive() and self._queue.qsize() > _AHEAD:
            time.sleep(0.001)

    def close(self) -> None:
        """Write the remaining messages and finish the files; a second call does nothing.

        Raises:
            OSError: A write failed, such as on a full disk, and no other method has reported it.
        """
        interrupt: KeyboardInterrupt | None = None
        self._queue.put(None)
        while self._thread.is_alive():
            try:
                self._thread.join()
            except KeyboardInterrupt as exc:  # raised again after the data are written
                interrupt = exc
        atexit.unregister(self.close)
        error, self._error = self._error, None
        if error is not None and not self._reported:
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
            self._reported = True
            raise self._error or ValueError(f"{self.path} is closed")
        self._queue.put(item)

    def _run(self) -> None:
        """Main function of the thread: open the files, write messages, finish."""
        files = self._files
        begun = False
        try:
            files.open()
            begun = True
            self._opened.set()
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
                    files.add_topic(*item)
                else:
                    files.write_many(item)
                    unflushed = unflushed or bool(item)
                    if self._limit is not None:
                        self._written += _size(item)
                if unflushed and time.monotonic() - flushed >= _FLUSH_S:
                    files.flush()
                    flushed, unflushed = time.monotonic(), False
            files.close()
        except BaseException as exc:  # raised in the next call of write or close
            if begun:
                with contextlib.suppress(Exception):  # the first error is the one to report
                    self.kept = files.rescue()
            self._error = exc
        finally:
            self._opened.set()


def _size(items: Sequence[Item]) -> int:
    return sum(len(data) for _, _, data in items)


def write_bag(
    path: str | Path,
    recording: Recording,
    *,
    namespace: str = DEFAULT_NAMESPACE,
    estimate: RecordedEstimate | None = None,
    pressure_variance: float = 0.0,
    progress: Callable[[float], object] | None = None,
) -> None:
    """Write a Recording as a bag with the package's topics.

    A missing value (NaN) gets no message. Messages are logged at the times in ``recording.received_ns`` where known,
    otherwise at their stamps.

    Args:
        path: Bag folder to be made.
        recording: What to write.
        namespace: Namespace of the topics.
        estimate: Estimate to write in place of ``recording.estimate``.
        pressure_variance: Variance of the pressures to state [Pa^2]; 0 means unknown.
        progress: Called with the share of all messages that was written since the last call (0 to 1).

    Raises:
        BadInput: The path exists already, or cannot be made.
    """
    if not isinstance(path, (str, Path)):
        raise BadInput(f"bag: found a value of type {type(path).__name__}, expected the path of a new folder")
    if not isinstance(recording, Recording):
        raise BadInput(f"recording: found a value of type {type(recording).__name__}, expected a Recording")
    blocks = _blocks(recording, recording.estimate if estimate is None else estimate, pressure_variance)
    topics = [(topic.resolve(namespace), topic.type) for topic in blocks]
    times = [_log_times(recording, topic.name, block.stamp_ns) for topic, block in blocks.items()]
    # Which message comes next: its topic and its row. Messages of one time keep the order of the topics.
    kind = np.repeat(np.arange(len(times), dtype=np.int8), [len(its) for its in times])
    order = np.argsort(np.concatenate(times), kind="stable")
    first = np.cumsum([0, *map(len, times)])
    with BagWriter(path) as bag:
        for topic, msgtype in topics:
            bag.add_topic(topic, msgtype)
        for begin in range(0, len(order), _PART):
            part = order[begin : begin + _PART]
            items = dict[int, Item]()
            for number, ((topic, msgtype), block) in enumerate(zip(topics, blocks.values(), strict=True)):
                place = np.flatnonzero(kind[part] == number)
                rows = part[place] - first[number]
                messages = block.messages(msgtype, rows)
                log_ns = times[number][rows].tolist()
                for k, log, data in zip(place.tolist(), log_ns, messages, strict=True):
                    items[k] = (topic, log, data)
            bag.write_many([items[k] for k in range(len(part))])
            bag.keep_up()
            if progress is not None:
                progress(len(part) / len(order))


def _log_times(recording: Recording, name: str, stamp_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Time of reception of each message (K,) [ns]; its stamp where the time is not known."""
    times = stamp_ns.copy()
    arrival = recording.received_ns.get(name)
    if arrival is not None and len(arrival.stamp_ns):
        by_stamp = np.argsort(arrival.stamp_ns, kind="stable")
        index = np.minimum(np.searchsorted(arrival.stamp_ns[by_stamp], stamp_ns), len(by_stamp) - 1)
        known = arrival.stamp_ns[by_stamp[index]] == stamp_ns
        times[known] = arrival.log_ns[by_stamp[index[known]]]
    return times


def _time(path: str, stamp_ns: NDArray[np.int64]) -> dict[str, Any]:
    return {f"{path}.sec": stamp_ns // 1_000_000_000, f"{path}.nanosec": stamp_ns % 1_000_000_000}


class _Block(NamedTuple):
    """Messages of one topic: their stamps (K,) [ns], and the columns of :func:`encode`; K values, or one for all."""

    stamp_ns: NDArray[np.int64]
    columns: Mapping[str, Any]
    stamps: Mapping[str, NDArray[np.int64]]  # path of a time in the message -> times (K,) [ns]

    def messages(self, msgtype: str, rows: NDArray[np.intp]) -> Sequence[bytes | memoryview]:
        """The messages of some rows (M,), as CDR."""
        columns = {
            path: values[rows] if isinstance(values, np.ndarray) else values for path, values in self.columns.items()
        }
        for path, stamp_ns in self.stamps.items():
            columns |= _time(path, stamp_ns[rows])
        matrix = encode(msgtype, len(rows), columns)
        width, view = matrix.shape[1], np.ascontiguousarray(matrix).reshape(-1).data
        return [view[k * width : (k + 1) * width] for k in range(len(rows))]


def _joint_fields(name: str, **given: NDArray[np.float64]) -> dict[str, Any]:
    """Fields of JointState messages of one joint beside their headers."""
    nothing = np.empty((len(next(iter(given.values()))), 0))
    fields = dict.fromkeys(("position", "velocity", "effort"), nothing)
    return {"name": [name], **fields, **{field: values[:, None] for field, values in given.items()}}


class _Ready(NamedTuple):
    """The same, of messages that are few and serialised."""

    stamp_ns: NDArray[np.int64]
    data: Sequence[bytes]

    def messages(self, _msgtype: str, rows: NDArray[np.intp]) -> Sequence[bytes | memoryview]:
        """The messages of some rows (M,), as CDR."""
        return [self.data[k] for k in rows.tolist()]


def _blocks(recording: Recording, estimate: RecordedEstimate | None, variance: float) -> dict[Topic, _Block | _Ready]:
    """The messages of each topic."""
    blocks: dict[Topic, _Block | _Ready] = {}

    def add(
        topic: Topic, stamp_ns: NDArray[np.int64], fields: dict[str, Any], frame: str = signals.FRAME,
        **stamps: NDArray[np.int64],
    ) -> None:  # fmt: skip
        columns = {"header.frame_id": frame, **fields}
        blocks[topic] = _Block(stamp_ns, columns, {"header.stamp": stamp_ns, **stamps})

    stamp_ns = recording.stamp_ns
    there: Any  # mask of the samples that have a value (N,)
    for muscle in (0, 1):
        there = np.isfinite(recording.pressure[:, muscle])
        if recording.drive == "regulator" and not there.any():
            continue  # the pressures were not measured or not recorded
        fields = {"fluid_pressure": recording.pressure[there, muscle], "variance": variance}
        add(TOPICS[f"pressure_{muscle + 1}"], stamp_ns[there], fields, f"muscle_{muscle + 1}")
    there = np.isfinite(recording.voltage).any(axis=1)
    field = {"valve": "voltage", "regulator": "pressure"}[recording.drive]
    add(TOPICS[STATE_TOPICS[recording.drive]], stamp_ns[there], {field: recording.voltage[there]})
    joints = {
        "measured_joint_states": {"position": recording.angle, "effort": recording.torque},
        "angle_sensor": {"position": recording.angle_sensor},
    }
    for name, given in joints.items():
        known = {field: values for field, values in given.items() if values is not None}
        if known:
            there = np.isfinite(np.column_stack(list(known.values()))).any(axis=1)
            seen = {field: values[there] for field, values in known.items()}
            add(TOPICS[name], stamp_ns[there], _joint_fields(signals.FRAME, **seen))
    if recording.external_torque is not None:
        there = np.isfinite(recording.external_torque)
        wrench: dict[str, Any] = {f"wrench.{kind}.{axis}": 0.0 for kind in ("force", "torque") for axis in "xyz"}
        wrench["wrench.torque.z"] = recording.external_torque[there]
        add(TOPICS["measured_external_torque"], stamp_ns[there], wrench)
    if recording.reference is not None:
        reference = recording.reference
        names = ("mode", "value", "stiffness", "damping")
        add(TOPICS["reference"], reference.stamp_ns, {name: getattr(reference, name) for name in names})
    if estimate is not None:
        columns = {name: getattr(estimate, name).reshape(len(estimate), -1) for name in ESTIMATE_SHAPES}
        columns = {name: values if values.shape[1] > 1 else values[:, 0] for name, values in columns.items()}
        add(TOPICS["joint_estimate"], estimate.stamp_ns, columns, started=estimate.started_ns)
    for name, (values, unit) in recording.signals.items():
        kind, field = next((kind, field) for kind, (field, its) in signals.KINDS.items() if its == unit)
        there = np.isfinite(values)
        fields = {field: values[there], "variance": 0.0}
        fields = _joint_fields(name, position=values[there]) if unit == "rad" else fields
        add(Topic(name, f"{ALSO}{name}", kind, ""), stamp_ns[there], fields)
    if (marks := recording.episode_ns) is not None:
        blocks[signals.EPISODE] = _Block(marks, {"frame_id": signals.FRAME}, {"stamp": marks})
    if recording.checkpoints:
        stamps = np.array([item.stamp_ns for item in recording.checkpoints], np.int64)
        data = [signals.checkpoint_message(item) for item in recording.checkpoints]
        blocks[TOPICS["filter_checkpoint"]] = _Ready(stamps, data)
    return blocks
