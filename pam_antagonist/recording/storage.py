"""Files of a bag -> raw messages by topic: MCAP or sqlite3, with or without compression and metadata.yaml."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from ..errors import BadInput
from .cdr import Payloads
from .compression import ZSTD_MAGIC, CompressionError, inflate_file, inflate_message
from .mcap import MAGIC as MCAP_MAGIC
from .mcap import scan_mcap
from .raw import Channel, Collector, RawTopic

_SQLITE_MAGIC = b"SQLite format 3\0"
_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_EXPECTED = "expected a folder with metadata.yaml, a .mcap or a .db3 file"
_MAX_METADATA = 64 << 20  # [bytes]
MAX_UNPACKED = 4 << 30
"""Largest file that is unpacked from zstd [bytes]."""


@dataclass
class RawBag:
    """All of a bag.

    Attributes:
        path: What was opened.
        topics: Topic name -> messages. A name with two message types is in ``conflicts`` as well.
        conflicts: Topic name -> the message types that it was recorded with, where there is more than one.
        issues: What was found and did not hinder reading.
    """

    path: Path
    topics: dict[str, RawTopic] = field(default_factory=dict)
    conflicts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    issues: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _Files:
    paths: list[Path]
    digests: Mapping[tuple[str, str], str]
    issues: list[str]


def read_raw(path: Path, types: Collection[str], *, recover: bool = False) -> RawBag:
    """Read the messages of the given types from a bag.

    Args:
        path: Bag folder, or one .mcap or .db3 file, itself or packed with zstd.
        types: Message types whose payloads are wanted; other topics are listed and counted.
        recover: Take what stands before a damaged or cut off place instead of refusing the bag.

    Raises:
        BadInput: Not a bag, damaged, or not readable.
    """
    try:
        files = _locate(path)
        bag = RawBag(path, issues=list(files.issues))
        parts: list[RawTopic] = []
        for file in files.paths:
            parts.extend(_read_file(bag, file, types, recover))
    except BadInput:
        raise
    except OSError as exc:
        raise BadInput(f"{path}: cannot be read ({exc.strerror or exc})") from exc
    except Exception as exc:  # damaged files make sqlite, zstd and rosbags raise whatever they like
        raise BadInput(f"{path}: damaged, or not a rosbag2 ({_one_line(exc)})") from exc
    _merge(bag, parts, files.digests)
    return bag


def bag_hash(path: str | Path) -> str:
    """SHA-256 of a bag's messages files, as 64 hex digits.

    For a bag of one file this is what ``sha256sum`` prints for that file; for several, the hash of their hashes in
    order. ``metadata.yaml`` is left out: editing a name there does not change what was recorded.

    Raises:
        BadInput: Not a bag, or not readable.
    """
    path = Path(path)
    digests = []
    try:
        for file in _locate(path).paths:
            digest = hashlib.sha256()
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
            digests.append(digest)
    except OSError as exc:
        raise BadInput(f"{path}: cannot be read ({exc.strerror or exc})") from exc
    if len(digests) == 1:
        return digests[0].hexdigest()
    return hashlib.sha256(b"".join(digest.digest() for digest in digests)).hexdigest()


def _locate(path: Path) -> _Files:
    """Find the message files of a bag."""
    if path.name == "metadata.yaml" and path.is_file():
        path = path.parent
    if not path.exists():
        raise BadInput(f"{path}: there is no such bag")
    if path.is_file():
        if path.suffix == ".bag":
            raise BadInput(f"{path}: this is a ROS 1 bag, expected a rosbag2; convert it with rosbags-convert")
        return _Files([path], {}, [])
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        found = sorted(file for file in path.iterdir() if file.name.endswith(_SUFFIXES))
        if not found:
            raise BadInput(f"{path}: not a rosbag2, {_EXPECTED}")
        return _Files(found, {}, [f"{path} has no metadata.yaml, as after a recording that was not closed"])
    if metadata.stat().st_size > _MAX_METADATA:
        raise BadInput(f"{metadata}: {metadata.stat().st_size} bytes, expected a short text")
    try:
        content = yaml.safe_load(metadata.read_text())
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as exc:
        raise BadInput(f"{metadata}: not readable as YAML ({_one_line(exc)})") from exc
    try:
        information = content["rosbag2_bagfile_information"]
        names = [Path(name).name for name in information["relative_file_paths"]]
        digests = dict(_digests(information))
    except KeyError as exc:
        raise BadInput(f"{metadata}: not the metadata of a rosbag2, entry {exc} is missing") from exc
    except (TypeError, AttributeError) as exc:
        raise BadInput(f"{metadata}: not the metadata of a rosbag2, an entry is not what it should be") from exc
    if not names:
        raise BadInput(f"{metadata}: names no message files under relative_file_paths")
    for name in names:
        if not (path / name).is_file():
            raise BadInput(f"{path}: metadata.yaml names {name}, which is not there")
    return _Files([path / name for name in names], digests, [])


def _digests(information: Mapping[str, Any]) -> Iterator[tuple[tuple[str, str], str]]:
    for entry in information.get("topics_with_message_count") or ():
        topic = entry["topic_metadata"]
        yield (str(topic["name"]), str(topic["type"])), str(topic.get("type_description_hash") or "")


def _read_file(bag: RawBag, file: Path, types: Collection[str], recover: bool) -> list[RawTopic]:
    """Read one message file, unpacking it first where needed."""
    with _unpacked(file) as (plain, packing_damage):
        with plain.open("rb") as stream:
            magic = stream.read(len(_SQLITE_MAGIC))
        if not magic and packing_damage is None:
            raise BadInput(f"{file}: is empty")
        damage = packing_damage
        if magic.startswith(MCAP_MAGIC):
            contents = scan_mcap(plain, types)
            parts, damage = contents.topics, packing_damage or contents.damage
        elif magic == _SQLITE_MAGIC and damage is None:
            damage = _sqlite_cut(plain)
            parts = [] if damage else _read_sqlite(plain, types)
            log = file.with_name(f"{file.name}-wal")
            if log.exists() and log.stat().st_size:
                bag.issues.append(f"{log} holds messages that were not read; let sqlite3 bring them into {file.name}")
        elif damage is None:
            raise BadInput(f"{file}: neither MCAP nor sqlite3, {_EXPECTED}")
        else:
            parts = []
    if damage is not None:
        kept = sum(len(part.log_ns) for part in parts)
        if not recover:
            hint = f"{kept} messages stand before that" + (" (--recover reads them)" if kept else "")
            raise BadInput(f"{file}: truncated or damaged, {damage}; {hint}")
        bag.issues.append(f"{file} is truncated or damaged, {damage}: read the {kept} messages before that")
    return parts


@contextmanager
def _unpacked(file: Path) -> Iterator[tuple[Path, str | None]]:
    """The file itself, or an unpacked copy of it and how it was damaged."""
    with file.open("rb") as stream:
        packed = stream.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
    if not packed:
        yield file, None
        return
    with TemporaryDirectory() as folder:
        target = Path(folder) / (file.stem if file.suffix in (".zstd", ".zst") else file.name)
        try:
            damage = inflate_file(file, target, MAX_UNPACKED)
        except CompressionError as exc:
            raise BadInput(f"{file}: {exc}") from exc
        yield target, damage


def _sqlite_cut(file: Path) -> str | None:
    """Hold the size of an sqlite3 file against the pages its header counts (file format, section 1.3)."""
    with file.open("rb") as stream:
        head = stream.read(100)
    if len(head) < 100:
        return f"it ends at byte {len(head)}, within its header"
    page_size, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    page_size = 65536 if page_size == 1 else page_size
    trusted = head[24:28] == head[92:96]  # else the count is that of an old library, and may be stale
    size = file.stat().st_size
    if trusted and size < page_size * pages:
        return f"it ends at byte {size} of {page_size * pages}"
    return None


def _read_sqlite(file: Path, types: Collection[str]) -> list[RawTopic]:
    """Read an sqlite3 file through rosbags, which checks what it opens."""
    if file.suffix != ".db3":
        raise BadInput(f"{file}: an sqlite3 bag whose name does not end with .db3, as rosbag2 names it")
    collectors: dict[int, Collector] = {}
    with Reader(file) as reader:
        for connection in reader.connections:
            encoding = connection.ext.serialization_format if isinstance(connection.ext, ConnectionExtRosbag2) else ""
            channel = Channel(connection.topic, connection.msgtype, encoding, connection.msgdef.data, connection.digest)
            collectors[connection.id] = Collector(channel, connection.msgtype in types)
        for connection, log_ns, data in reader.messages():
            collector = collectors[connection.id]
            collector.log_ns.append(log_ns)
            if collector.wanted:
                collector.pieces.append(data)
    return [collector.finish() for collector in collectors.values()]


def _merge(bag: RawBag, parts: list[RawTopic], digests: Mapping[tuple[str, str], str]) -> None:
    """Bring together the pieces of each topic."""
    by_topic: dict[str, dict[str, list[RawTopic]]] = {}
    for part in parts:
        by_topic.setdefault(part.channel.topic, {}).setdefault(part.channel.msgtype, []).append(part)
    for topic, by_type in by_topic.items():
        if len(by_type) > 1:
            bag.conflicts[topic] = tuple(sorted(by_type))
        msgtype, pieces = max(by_type.items(), key=lambda item: sum(len(piece.log_ns) for piece in item[1]))
        channel = pieces[0].channel
        channel = replace(channel, digest=channel.digest or digests.get((topic, msgtype), ""))
        raw = pieces[0] if len(pieces) == 1 else RawTopic.joined(channel, pieces)
        bag.topics[topic] = replace(raw, channel=channel)


def unpack_messages(raw: RawTopic) -> RawTopic:
    """Undo rosbag2's message compression; told from the messages, since a plain one never starts like zstd.

    Raises:
        CompressionError: A packed message is damaged.
    """
    payloads = raw.payloads
    if payloads is None or not len(payloads) or payloads.data[:4].tobytes() != ZSTD_MAGIC:
        return raw
    stop = payloads.length.cumsum()
    view = payloads.data.data
    messages = [inflate_message(view[b - n : b]) for b, n in zip(stop.tolist(), payloads.length.tolist(), strict=True)]
    return replace(raw, payloads=Payloads.of(messages))


def _one_line(exc: BaseException) -> str:
    """Text of an exception without line breaks."""
    return " ".join(str(exc).split()) or type(exc).__name__
