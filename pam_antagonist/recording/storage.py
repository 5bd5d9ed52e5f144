"""Files of a bag -> raw messages by topic: MCAP or sqlite3, with or without compression and metadata.yaml."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from ..errors import BadInput
from . import notes
from .mcap import MAGIC as MCAP_MAGIC
from .mcap import Lost, scan_mcap
from .notes import Issue, one_line
from .raw import ZSTD_MAGIC, CompressionError, RawBag, RawTopic, Room, inflate_file, most_unpacked
from .sqlite import MAGIC as SQLITE_MAGIC
from .sqlite import log_of, read_sqlite, with_log

if TYPE_CHECKING:
    from .recording import Recording

SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
"""Endings of the message files of bags."""
_EXPECTED = "expected a folder with metadata.yaml, a .mcap or a .db3 file"
_LISTED = 5
MAX_UNPACKED = 4 << 30
"""Largest file that is unpacked from zstd [bytes]."""


_Digests = Mapping[tuple[str, str], str]


def read_raw(path: Path, types: Collection[str], *, recover: bool = False) -> RawBag:
    """Read the messages of the given types from a bag; other topics are listed and counted.

    `recover`: Read what is left of a damaged or cut off bag instead of refusing it.
    """
    try:
        files, digests = _locate(path)
        bag, parts = RawBag(path), list[RawTopic]()
        if digests is None:
            bag.issues.append(f"{files[0].parent} has no metadata.yaml, as after a recording that was not closed")
        room = Room(sum(file.stat().st_size for file in files))
        for file in files:
            parts.extend(_read_file(bag, file, types, room, recover, digests is not None))
    except (BadInput, MemoryError):
        raise
    except OSError as exc:
        raise BadInput(f"{path}: cannot be read ({exc.strerror or exc})") from exc
    except Exception as exc:  # on damaged files sqlite, zstd and rosbags raise exceptions of any type
        raise BadInput(f"{path}: damaged, or not a rosbag2 ({one_line(exc)})") from exc
    _merge(bag, parts, digests or {})
    return bag


def bag_hash(path: str | Path) -> str:
    """SHA-256 of a bag's message files, as 64 hex digits.

    For a bag of one file this equals the output of ``sha256sum``; for several files it is the hash of their hashes in
    order. A write-ahead log counts as a file. ``metadata.yaml`` is left out, because editing a name there does not
    change the recording.

    Raises:
        BadInput: Not a bag, or not readable.
    """
    path = Path(path)
    try:
        files = [one for file in _locate(path)[0] for one in (file, log_of(file)) if one is not None]
        digests = [notes.sha256(file) for file in files]
    except OSError as exc:
        raise BadInput(f"{path}: cannot be read ({exc.strerror or exc})") from exc
    return digests[0].hex() if len(digests) == 1 else hashlib.sha256(b"".join(digests)).hexdigest()


def recording_hash(recording: Recording) -> str:
    """SHA-256 of a recording: of its bag, or of its arrays where it was made in memory.

    Args:
        recording: the recording.
    """
    if recording.path.exists():
        return bag_hash(recording.path)
    digest = hashlib.sha256(recording.stamp_ns.tobytes())
    for values in (recording.pressure, recording.voltage, recording.angle, recording.torque, recording.external_torque):
        digest.update(b"" if values is None else values.tobytes())
    return digest.hexdigest()


def seen_until(recording: Recording, fitted: Mapping[str, float]) -> float:
    """End of the part of a recording that a rig was fitted to [s]; 0 where it was not.

    Args:
        recording: the recording.
        fitted: of a rig file: SHA-256 of each recording, and the end of its part [s].
    """
    return fitted.get(recording_hash(recording), 0.0) if fitted else 0.0


def seen_in_words(recording: Recording, fitted: Mapping[str, float], rig: str) -> str:
    """A sentence where a rig was fitted to a recording, so that no error on that part is held out; else empty.

    Args:
        recording: the recording.
        fitted: of the rig file, see :func:`seen_until`.
        rig: its name.
    """
    until = seen_until(recording, fitted)
    if not until:
        return ""
    part = "all" if until >= recording.duration_s else f"the first {until:.1f} s"
    return f"rig {rig} was fitted to {part} of it: errors of this rig there are not those on new data"


def bag_name(path: str | Path) -> str:
    """A bag's name for reports: only its folder and the folder above, so that no private path is shown.

    Args:
        path: of the bag; ``/home/me/nominal/free`` gives ``nominal/free``.
    """
    return "/".join(Path(path).resolve().parts[-2:]).lstrip("/")


def _locate(path: Path) -> tuple[list[Path], _Digests | None]:
    """The message files of a bag, and the hashes of its types; None where the recorder did not finish the files."""
    if "\0" in str(path):
        raise BadInput(f"{path}: no bag can have this name")
    if path.name == notes.NAME and path.is_file():
        path = path.parent
    if not path.exists():
        raise BadInput(f"{path}: there is no such bag")
    if path.is_file():
        if path.suffix == ".bag":
            raise BadInput(f"{path}: this is a ROS 1 bag, expected a rosbag2; convert it with rosbags-convert")
        return [path], {}
    if not path.is_dir():
        raise BadInput(f"{path}: neither a file nor a folder, {_EXPECTED}")
    information = notes.read_information(path)
    if information is None:
        found = [file for file in path.iterdir() if file.name.endswith(SUFFIXES) and file.is_file()]
        if not found:
            bags = sorted(file.parent.name for file in path.glob(f"*/{notes.NAME}"))[:_LISTED]
            inside = f"; folders in it are: {', '.join(bags)}" if bags else ""
            raise BadInput(f"{path}: not a rosbag2, {_EXPECTED}{inside}")
        if len({re.sub(r"(_\d+)?\.(mcap|db3)(\.zstd)?$", r".\2", file.name) for file in found}) > 1:
            several = ", ".join(sorted(file.name for file in found)[:_LISTED])
            raise BadInput(f"{path}: has no metadata.yaml, and files of several bags ({several}); expected one of them")
        return notes.in_order(found), None
    names = notes.file_names(path, information)
    return [path / name for name in names], notes.type_digests(path, information)


def _read_file(
    bag: RawBag, file: Path, types: Collection[str], room: Room, recover: bool, closed: bool
) -> list[RawTopic]:
    """Read one message file, unpacking it first where needed.

    In a recording that was not closed, an incomplete end is expected: what is left is read, with an issue. In a closed
    recording damage is unexpected, and the user decides by ``recover``.
    """
    with _unpacked(file) as (unpacked, packing_damage), with_log(unpacked) as (plain, pages):
        with plain.open("rb") as stream:
            magic = stream.read(len(SQLITE_MAGIC))
        if not magic.strip(b"\0") and packing_damage is None:
            if closed:
                raise BadInput(f"{file}: is empty")
            bag.issues.append(f"{file} holds no messages: the recording ended right after its start")
            return []
        damage, lost = packing_damage, list[Lost]()
        if magic.startswith(MCAP_MAGIC):
            parts, damage, lost = scan_mcap(plain, types, room)
            damage = packing_damage or damage
        elif magic == SQLITE_MAGIC and damage is None:
            parts, damage = read_sqlite(plain, types, whole=closed and not recover)
            if (log := log_of(file)) is not None:
                held = f"was read as well: it holds what a killed recorder had not yet brought into {file.name}"
                bag.issues.append(f"{log} {held if pages else 'holds nothing that can be read'}")
        elif damage is None:
            raise BadInput(f"{file}: neither MCAP nor sqlite3, {_EXPECTED}")
        else:
            parts = []
    if damage is not None:
        kept = sum(map(len, parts))
        where = "before that" if magic.startswith(MCAP_MAGIC) and not lost else "that are left"
        if closed and not recover:
            hint = f"{kept} messages stand before that" + (" (--recover reads them)" if kept else "")
            if where == "that are left":
                hint = f"--recover reads the {f'{kept} ' if kept else ''}messages that are left"
            raise BadInput(f"{file}: truncated or damaged, {damage}; {hint}")
        state = "is truncated or damaged" if closed else "was not closed"
        bag.issues.append(Issue(f"{file} {state}, {damage}: read the {kept} messages {where}", "damage"))
        for part in lost:
            size, length = part.end - part.begin, part.until - part.since
            since = f"{part.since:.3f}" if length > 0.0 else "before"
            text = (
                f"{file}: {size} bytes are lost, from byte {part.begin} to {part.end}, received {since} to "
                f"{part.until:.3f} s after the first message"
            )
            bag.issues.append(Issue(text, "damage", size, part.since, length))
    return parts


@contextmanager
def _unpacked(file: Path) -> Iterator[tuple[Path, str | None]]:
    """The file itself, or an unpacked copy; with a text about damage of the packed data, or None."""
    with file.open("rb") as stream:
        packed = stream.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
    if not packed:
        yield file, None
        return
    with TemporaryDirectory() as folder:
        target = Path(folder) / (file.stem if file.suffix in (".zstd", ".zst") else file.name)
        try:
            damage = inflate_file(file, target, min(MAX_UNPACKED, most_unpacked(file.stat().st_size)))
        except CompressionError as exc:
            raise BadInput(f"{file}: {exc}") from exc
        yield target, damage


def _merge(bag: RawBag, parts: list[RawTopic], digests: _Digests) -> None:
    """Join the pieces of each topic."""
    by_topic: dict[str, dict[str, list[RawTopic]]] = {}
    for part in parts:
        name = f"/{part.topic.lstrip('/')}"  # a converted bag may lack the slash
        by_topic.setdefault(name, {}).setdefault(part.msgtype, []).append(part)
    for topic, by_type in by_topic.items():
        if len(by_type) > 1:
            bag.conflicts[topic] = tuple(sorted(by_type))
        msgtype, pieces = max(by_type.items(), key=lambda item: sum(map(len, item[1])))
        first = replace(pieces[0], topic=topic, digest=pieces[0].digest or digests.get((topic, msgtype), ""))
        bag.topics[topic] = first.joined(pieces[1:])
