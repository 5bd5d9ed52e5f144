"""The log book of a rig: a file of JSON lines beside its rig file, one line for each finding."""

from __future__ import annotations

import datetime
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field, ValidationError

from pam_antagonist.errors import BadInput
from pam_antagonist.paths import config_dir
from pam_antagonist.rig import Rig
from pam_antagonist.rig.fingerprint import RigIdentity, differences
from pam_antagonist.strict_yaml import JsonLine

_ENDING = ".log.jsonl"
_EARLIEST = datetime.datetime(2000, 1, 1, tzinfo=datetime.timezone.utc)
"""Stamps before it count from the start of a clock, not of the calendar."""


class Measured(JsonLine):
    """A value with its standard error, in the unit that it has."""

    value: float
    std: float | None = Field(None, ge=0.0)
    unit: str = ""


class RecordingSpan(JsonLine):
    """A recording: its name, when it began, how long it is, and the hash of its files."""

    name: str
    begin: datetime.datetime | None = None
    seconds: float = Field(0.0, ge=0.0)
    sha256: str = ""

    @classmethod
    def of(cls, name: str, begin_ns: int | None, seconds: float, sha256: str) -> RecordingSpan:
        """A recording that began at `begin_ns` [ns]; None where that is not known."""
        begin = datetime.datetime.fromtimestamp((begin_ns or 0) * 1e-9, datetime.timezone.utc)
        return cls(name=name, begin=begin if begin >= _EARLIEST else None, seconds=seconds, sha256=sha256)


class Entry(JsonLine):
    """What one command found."""

    at: datetime.datetime
    command: str
    rig: str
    """Identity of the rig that was given, as :class:`RigIdentity` writes it."""
    made: str = ""
    """Identity of the rig that came out, which may differ from the given one by more than two files of one rig may."""
    recordings: tuple[RecordingSpan, ...] = ()
    verdict: str = ""
    said: str = ""
    values: dict[str, Measured] = {}
    covariance: tuple[tuple[tuple[str, ...], tuple[tuple[float, ...], ...]], ...] = ()
    """Names of values that were fitted together, and the covariance of their errors."""

    @property
    def when(self) -> datetime.datetime:
        """Middle of the recordings; without their dates the time of the command."""
        dated = [(span.begin, datetime.timedelta(seconds=span.seconds)) for span in self.recordings if span.begin]
        if not dated:
            return self.at
        first = min(begin for begin, _ in dated)
        return first + 0.5 * (max(begin + length for begin, length in dated) - first)


class Logbook(NamedTuple):
    """The entries of one joint by the time of their recordings, and what is odd about their files."""

    entries: tuple[Entry, ...]
    notes: tuple[str, ...]


class _Read(NamedTuple):
    """An entry as it was read."""

    book: Path
    number: int  # of the line
    entry: Entry
    rigs: list[RigIdentity]  # the given one, and the one that came out

    def agrees(self, known: Sequence[RigIdentity]) -> bool:
        """Whether one of its rigs is one of those that are known."""
        return any(not differences(one, other) for one in known for other in self.rigs)


def book_of(rig: str | Path) -> Path | None:
    """The log book of a rig file; None for a rig of the package, which belongs to nobody."""
    path = Path(rig)
    if path.suffix not in (".yaml", ".yml") or path.resolve().is_relative_to(config_dir().resolve()):
        return None
    return path.with_name(f"{path.stem}{_ENDING}")


def append(books: Sequence[Path], entry: Entry, earlier: Path | None = None) -> None:
    """Append an entry to log books; a new one begins with the entries of an `earlier` one.

    Raises:
        BadInput: a file cannot be written.
    """
    line = entry.text() + "\n"
    for book in books:
        try:
            new = not book.exists()
            text = earlier.read_text(encoding="utf-8") if new and earlier is not None and earlier.exists() else ""
            whole = text + ("" if not text or text.endswith("\n") else "\n")
            # One write, so that two commands at the same time do not mix their lines.
            handle = os.open(book, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
            try:
                content = whole if line in whole else whole + line
                os.write(handle, (("" if new or _ended(book) else "\n") + content).encode())
            finally:
                os.close(handle)
        except (OSError, UnicodeDecodeError) as error:
            raise BadInput(f"{book}: the log book cannot be written: {error}") from None


def _ended(book: Path) -> bool:
    """Whether the last line of a file is whole: a crash may have cut it."""
    with book.open("rb") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return True
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


def read(books: Sequence[Path], rig: Rig) -> Logbook:
    """Read the log books of a rig.

    An entry is of this rig if the rig that it was made with, or the one that came out, is this one or one of another
    entry of this rig: so the history of a file goes on in those that were identified from it. Recordings count once for
    each command. Damaged entries, and those of other rigs, are left out.

    Raises:
        BadInput: a file cannot be read.
    """
    read, notes, found = list[_Read](), list[str](), list[Entry]()
    for book in books:
        try:
            lines = book.read_bytes().split(b"\n")
        except OSError as error:
            raise BadInput(f"{book}: the log book cannot be read: {error.strerror}") from None
        damaged = list[int]()
        for number, line in enumerate(lines, 1):
            if not line.strip():
                continue
            try:
                entry = Entry.read(line)
                rigs = [RigIdentity.read(text) for text in (entry.rig, entry.made) if text]
            except (ValidationError, BadInput):
                damaged.append(number)
                continue
            read.append(_Read(book, number, entry, rigs))
        if damaged:
            notes.append(
                f"{book}: {_lines(damaged)} cannot be read and {_are(damaged)} left out; the file is unchanged"
            )
    known = [RigIdentity.of(rig)]
    while ours := [one for one in read if one.agrees(known)]:
        found += [one.entry for one in ours]
        known += [rig for one in ours for rig in one.rigs]
        read = [one for one in read if one not in ours]
    others: dict[tuple[Path, str], list[int]] = {}
    for one in read:
        others.setdefault((one.book, differences(known[0], one.rigs[0])[0]), []).append(one.number)
    notes += [
        f"{book}: {_lines(numbers)} {_are(numbers)} of another rig ({why}) and left out"
        for (book, why), numbers in others.items()
    ]
    # The same recordings, worked on again by the same command, are one observation; so are copies of an entry.
    latest = {
        (entry.command, tuple(span.sha256 for span in entry.recordings) or entry.at): entry
        for entry in sorted(found, key=lambda entry: entry.at)
    }
    return Logbook(tuple(sorted(latest.values(), key=lambda entry: entry.when)), tuple(notes))


def _lines(numbers: Sequence[int]) -> str:
    text = ", ".join(map(str, numbers[:5])) + (", ..." if len(numbers) > 5 else "")
    return f"line {text}" if len(numbers) == 1 else f"lines {text}"


def _are(numbers: Sequence[int]) -> str:
    return "is" if len(numbers) == 1 else "are"


def identity(rig: Rig) -> str:
    """Identity of a rig, for an entry."""
    return RigIdentity.of(rig).text()


def measured(values: Mapping[str, tuple[float, float, str]]) -> dict[str, Any]:
    """Values with standard errors and units, for an entry."""
    return {name: Measured(value=value, std=std, unit=unit) for name, (value, std, unit) in values.items()}
