"""What is known of a recording beside its data: issues found when it was read, and its bag's metadata.yaml.

metadata.yaml is read as untrusted input and written atomically. It holds notes, texts by name under ``custom_data``,
the place that rosbag2 provides. They are optional: a bag without metadata.yaml, or a converted one, may have lost them.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import yaml

from ..errors import BadInput
from ..strict_yaml import dump, load_bounded

NAME = "metadata.yaml"
INFORMATION = "rosbag2_bagfile_information"
_MAX_BYTES = 1 << 20  # enough for some thousand files or topics
_MOST_VALUES = 500_000


def read_information(folder: Path, name: str = NAME) -> dict[str, Any] | None:
    """Content of a bag's metadata.yaml."""
    content = _read(folder / name)
    if content is None:
        return None
    with _as_metadata(folder / name):
        return dict(content[INFORMATION])


@contextmanager
def _as_metadata(file: Path) -> Iterator[None]:
    """Refuse metadata in which an entry is missing or of another kind."""
    try:
        yield
    except KeyError as error:
        raise BadInput(f"{file}: not the metadata of a rosbag2, entry {error} is missing") from None
    except (TypeError, ValueError, AttributeError, IndexError):
        raise BadInput(f"{file}: not the metadata of a rosbag2, an entry has an unexpected type or value") from None


def _read(file: Path) -> Any:
    try:
        if not file.exists():
            return None
        if not file.is_file():
            raise BadInput(f"{file}: not a file, expected the metadata of a rosbag2")
        size = file.stat().st_size
        if size > _MAX_BYTES:
            raise BadInput(f"{file}: {size} bytes, expected a short text")
        raw = file.read_bytes()
        if not raw.strip(b"\0 \r\n"):  # a power cut leaves a file without content, or one of zeros
            return None
        return load_bounded(raw.decode("utf-8"), _MOST_VALUES)
    except (yaml.YAMLError, RecursionError, ValueError, TypeError, OverflowError) as error:
        raise BadInput(f"{file}: not readable as YAML ({one_line(error)})") from None
    except OSError as error:
        raise BadInput(f"{file}: cannot be read: {error.strerror or error}") from None


def file_names(folder: Path, information: Mapping[str, Any]) -> list[str]:
    """Names of the message files; only files directly in the folder are accepted."""
    where = folder / NAME
    with _as_metadata(where):
        listed = information["relative_file_paths"]
        if not isinstance(listed, list) or not all(isinstance(name, str) and Path(name).name for name in listed):
            raise TypeError
    if not listed:
        raise BadInput(f"{where}: names no message files under relative_file_paths")
    names = [Path(name).name for name in listed]  # rosbag2 itself once wrote the folder's name in front
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise BadInput(f"{where}: names {twice[:80]!r} twice under relative_file_paths")
    for name in names:
        if "\0" in name or not (folder / name).is_file():
            raise BadInput(f"{folder}: metadata.yaml names {name[:80]!r}, which is not there")
    return names


def type_digests(folder: Path, information: Mapping[str, Any]) -> dict[tuple[str, str], str]:
    """(topic, message type) -> RIHS01 hash of the type, "" where the metadata has none."""
    found = {}
    with _as_metadata(folder / NAME):
        for entry in information.get("topics_with_message_count") or ():
            topic = entry["topic_metadata"]
            texts = topic["name"], topic["type"], topic.get("type_description_hash") or ""
            if not all(isinstance(text, str) for text in texts):
                raise TypeError
            found[texts[0], texts[1]] = texts[2]
    return found


def _custom_data(information: Any) -> dict[str, str]:
    found = information.get("custom_data") if isinstance(information, dict) else None
    if not isinstance(found, dict):
        return {}
    plain = (str, int, float, bool)  # no nested values
    return {str(name): str(text) for name, text in found.items() if isinstance(name, plain) and isinstance(text, plain)}


def write_information(folder: Path, information: Mapping[str, Any]) -> None:
    """Write metadata.yaml; after a power cut either the old or the new file is there."""
    part = folder / f".{NAME}.part"
    text = dump({INFORMATION: dict(information)})
    try:
        with part.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(folder / NAME)
    except OSError:
        with suppress(OSError):
            part.unlink()
        raise
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Flush a folder's list of names to the disk, where the file system supports it."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def in_order(files: list[Path]) -> list[Path]:
    """Files of a bag sorted by their numbers: bag_2 before bag_10."""

    def key(path: Path) -> tuple[str, int, str]:
        match = re.match(r"(.*)_(\d{1,9})(\.[a-z0-9.]+)$", path.name)
        return (match[1], int(match[2]), path.name) if match else (path.name, -1, path.name)

    return sorted(files, key=key)


def sha256(path: Path) -> bytes:
    """SHA-256 of a file."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.digest()


def one_line(error: BaseException) -> str:
    """Text of an exception without line breaks."""
    return " ".join(str(error).split())[:300] or type(error).__name__


KINDS = (
    "clock", "publishers", "damage", "restart", "hole", "jump", "missing", "unstamped", "repeated", "dropped", "late",
    "resampled", "remark",
)  # fmt: skip
"""Kinds of issues, the one that changes results most first."""


class Issue(str):
    """A sentence about repaired, dropped or doubtful data, with what a program needs of it.

    Args:
        kind: one of ``KINDS``.
        size: number of messages, rows, samples or bytes that it concerns; 0 where nothing is counted.
        start_s: where it begins, from the first sample that was read [s]; NaN where it has no place.
        length_s: how long it lasts [s]; NaN where it has no length.
    """

    kind: str
    size: int
    start_s: float
    length_s: float

    def __new__(
        cls, text: str, kind: str = "remark", size: int = 0, start_s: float = math.nan, length_s: float = math.nan
    ) -> Issue:
        """Make one."""
        out = super().__new__(cls, text)
        out.kind, out.size, out.start_s, out.length_s = kind, int(size), float(start_s), float(length_s)
        return out

    @staticmethod
    def sorted(texts: Iterable[str]) -> tuple[Issue, ...]:
        """Issues in the order of ``KINDS``; a text of no kind is a remark."""
        issues = [text if isinstance(text, Issue) else Issue(text) for text in texts]
        return tuple(sorted(issues, key=lambda issue: KINDS.index(issue.kind)))


SEALED = "pam_antagonist.sealed"
"""Name of the note that lists the muscles whose chambers are sealed: "1", "2" or "1 2"."""
REGULATOR = "pam_antagonist.regulator"
"""Name of the note that says of a bag that its valve voltages are placeholders: pressure regulators drove the joint.

Like the note of the source, it is for people and for programs of other packages who open the bag: nothing else in it
distinguishes these voltages from those of closed valves. No command of this package reads it, since the rig file says
what drives the joint."""


ISSUES = "pam_antagonist.issues"
"""Name of the note that lists what was found when a table was imported: a line with kind, size and text for each."""
_IN_THE_BAG = ("hole", "missing")  # found again when the bag is read


def issues_note(issues: Iterable[Issue]) -> dict[str, str]:
    """The note of what the import found and a bag does not show; none where there is nothing."""
    lines = [f"{issue.kind} {issue.size} {issue}" for issue in issues if issue.kind not in _IN_THE_BAG]
    return {ISSUES: "\n".join(lines)} if lines else {}


def noted_issues(path: Path) -> list[Issue]:
    """What the import of a bag found, according to its note."""
    lines = [line.split(" ", 2) for line in read_notes(path).get(ISSUES, "").splitlines()]
    return [
        Issue(f"import: {line[2]}", line[0], int(line[1]))
        for line in lines
        if len(line) == 3 and line[0] in KINDS and line[1].isdecimal()
    ]


def write_notes(path: Path, notes: Mapping[str, str]) -> None:
    """Add notes to a bag."""
    information = read_information(path)
    if information is None:
        raise BadInput(f"{path}: has no metadata.yaml, expected a finished bag")
    information["custom_data"] = {**_custom_data(information), **notes}
    write_information(path, information)


def read_notes(path: str | Path) -> dict[str, str]:
    """Notes of a bag, by name; empty without metadata or notes, or with metadata of another kind."""
    path = Path(path)
    content = _read((path if path.is_dir() else path.parent) / NAME)
    return _custom_data(content.get(INFORMATION) if isinstance(content, dict) else None)


def sealed_muscles(path: str | Path) -> tuple[int, ...]:
    """Numbers of the muscles that are sealed according to a bag's note; their valves pass no air at any voltage."""
    text = read_notes(path).get(SEALED, "")
    if not all(part in ("1", "2") for part in text.split()):
        raise BadInput(f"{path}: {SEALED} in metadata.yaml is {text[:40]!r}, expected '1', '2' or '1 2'")
    return tuple(sorted({int(part) for part in text.split()}))
