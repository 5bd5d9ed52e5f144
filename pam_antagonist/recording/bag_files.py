"""MCAP files of a bag while it is written: split, flushed every second, readable after a failure.

rosbags writes a bag of one file. Here each file is such a bag by itself, and their metadata are merged at the end. A
file that a power cut or a kill cuts off still has every chunk that was flushed. It lacks the index at its end and
metadata.yaml; the reader of this package needs neither.
"""

from __future__ import annotations

import io
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from typing_extensions import override

from . import notes
from .cdr import typestore


@dataclass(frozen=True)
class FileLimits:
    """When to begin the next file of a bag; checked after every batch of messages."""

    size: int | None = None  # size of a full file, which may be exceeded by one chunk (1 MB) [bytes]; None: no limit
    duration: float | None = None  # time since the file's first message [s]; None: no limit

    @property
    def split(self) -> bool:
        """Whether there may be more than one file."""
        return self.size is not None or self.duration is not None


class _File(Writer):
    """One file, with metadata of its own until all metadata are merged."""

    storage: Any

    def __init__(self, folder: Path, name: str) -> None:
        super().__init__(folder / f".{name}.new", version=9, storage_plugin=StoragePlugin.MCAP)
        self.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._folder, self._name = folder, name
        self.metapath = folder / f".{name}.yaml"
        self.safe = 0  # bytes up to the end of the last complete chunk
        self._safe_counts: dict[int, int] = {}
        self._chunks = 0

    @override
    def open(self) -> None:
        self.storage = self.STORAGE_PLUGINS[self.storage_plugin](self._folder, self.compression_mode)
        self.storage.path = self.storage.path.rename(self._folder / f"{self._name}.mcap")

    def size(self) -> int:
        """Bytes so far, including those that wait to be written."""
        return int(self.storage.bio.tell() + self.storage.chunk.bio.tell())

    def whole_chunks(self) -> None:
        """Hand complete chunks to the operating system, and remember where the last one ends."""
        storage = self.storage
        if len(storage.chunks) != self._chunks:
            storage.bio.flush()
            self.safe, self._chunks = storage.bio.tell(), len(storage.chunks)
            pending = {key: len(messages) for key, messages in storage.chunk.msgs.items()}
            self._safe_counts = {key: count - pending.get(key, 0) for key, count in self.counts.items()}

    def flush(self, durable: bool) -> None:
        """Write everything so far to the file."""
        if self.storage.chunk.bio.tell():
            self.storage.close_chunk()
        self.whole_chunks()
        self.storage.bio.flush()
        if durable:
            os.fsync(self.storage.bio.fileno())

    def finish(self, durable: bool) -> dict[str, Any]:
        """Close the file; returns its metadata."""
        self.flush(False)  # messages first: a file without its index is still readable
        path = self.storage.path
        self.close()
        if durable:
            with path.open("rb") as stream:
                os.fsync(stream.fileno())
        information = notes.read_information(self._folder, self.metapath.name)
        assert information is not None  # rosbags has just written it
        self.metapath.unlink()
        return information

    def rescue(self) -> dict[str, Any] | None:
        """After a failed write, drop the incomplete chunk and close the file before it."""
        storage = self.storage
        if storage is None:
            return None
        with suppress(OSError):
            storage.bio.close()  # tries once more to write what could not be written
        self.counts.update(self._safe_counts or dict.fromkeys(self.counts, 0))
        storage.channel_stats.update(self.counts)
        storage.chunk.bio = io.BytesIO()
        storage.chunk.msgs.clear()
        try:
            os.truncate(storage.path, self.safe)
            storage.bio = storage.path.open("r+b")
            storage.bio.seek(self.safe)
            return self.finish(False)
        except Exception:  # no room for the index either
            with suppress(OSError):
                storage.bio.close()
            with suppress(OSError):
                os.truncate(storage.path, self.safe)
            for left in (self.metapath, self.metapath.with_suffix(".yaml.tmp")):
                with suppress(OSError):
                    left.unlink()
        return None


class BagFiles:
    """All files of one bag; for one thread. ``size`` may be read from any thread: bytes as of the last flush."""

    def __init__(self, path: Path, limits: FileLimits, durable: bool) -> None:
        self._path, self._limits, self._durable = path, limits, durable
        self._topics: list[tuple[str, str]] = []
        self._connections: dict[str, Connection] = {}
        self._done: list[dict[str, Any]] = []
        self._file: _File
        self._first: float | None = None
        self._open = False
        self.files = self.size = self._finished = 0

    def open(self) -> None:
        """Make the folder and the first file."""
        self._path.mkdir(mode=0o755, parents=True)
        self._begin()
        if self._durable:
            notes.sync_folder(self._path.parent)

    def add_topic(self, topic: str, msgtype: str) -> None:
        """Announce a topic."""
        self._topics.append((topic, msgtype))
        self._connect(topic, msgtype)

    def write_many(self, items: Sequence[tuple[str, int, bytes | memoryview]]) -> None:
        """Write messages of announced topics: (topic, time of reception [ns], CDR) each."""
        for topic, log_ns, data in items:
            self._file.write(self._connections[topic], log_ns, data)
        if items and self._first is None:
            self._first = time.monotonic()
        self._file.whole_chunks()
        if self._limits.split and self._full():
            self._finish()
            self._begin()

    def flush(self) -> None:
        """Write everything so far to the file."""
        self._file.flush(self._durable)
        self.size = self._finished + self._file.size()

    def close(self) -> None:
        """Finish the last file and write metadata.yaml."""
        self._finish()
        notes.write_information(self._path, _together(self._done))

    def rescue(self) -> int:
        """After a failed write, keep as many messages as possible."""
        kept = 0
        if self._open:
            last = self._file.rescue()
            if last is None:
                kept = sum(self._file.counts.values())
            else:
                self._done.append(last)
                with suppress(OSError):
                    notes.write_information(self._path, _together(self._done))
        return kept + sum(int(part["message_count"]) for part in self._done)

    def _finish(self) -> None:
        self._done.append(self._file.finish(self._durable))
        self._open = False
        self._finished += sum((self._path / name).stat().st_size for name in self._done[-1]["relative_file_paths"])
        self.size = self._finished

    def _begin(self) -> None:
        self._file = _File(self._path, self._path.name + (f"_{len(self._done)}" if self._limits.split else ""))
        self._file.open()
        self._open = True
        self._first = None
        self.files += 1
        for topic, msgtype in self._topics:
            self._connect(topic, msgtype)
        if self._durable:
            notes.sync_folder(self._path)

    def _connect(self, topic: str, msgtype: str) -> None:
        self._connections[topic] = self._file.add_connection(topic, msgtype, typestore=typestore())

    def _full(self) -> bool:
        size, duration = self._limits.size, self._limits.duration
        if size is not None and self._file.size() >= size:
            return True
        return duration is not None and self._first is not None and time.monotonic() - self._first >= duration


def _together(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Metadata of a bag of several files."""
    if len(parts) == 1:
        return parts[0]
    filled = [part for part in parts if part["message_count"]] or list(parts[:1])
    start = min(part["starting_time"]["nanoseconds_since_epoch"] for part in filled)
    end = max(part["starting_time"]["nanoseconds_since_epoch"] + part["duration"]["nanoseconds"] for part in filled)
    topics = []
    for index, entry in enumerate(parts[-1]["topics_with_message_count"]):
        # All files list the topics in the order of their announcement; an early file may lack the last ones.
        lists = [part["topics_with_message_count"] for part in parts]
        count = sum(listed[index]["message_count"] for listed in lists if index < len(listed))
        topics.append({**entry, "message_count": count})
    return {
        **parts[-1],
        "relative_file_paths": [name for part in parts for name in part["relative_file_paths"]],
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(part["message_count"] for part in parts),
        "topics_with_message_count": topics,
        "files": [entry for part in parts for entry in part["files"]],
    }
