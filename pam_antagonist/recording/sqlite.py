"""sqlite3 files of rosbag2, read as untrusted input.

A malicious database can run computations (views, checks, generated columns), and damaged pages can form endless loops.
So only plain tables are read, all pages are checked first, and the number of steps is limited by the size of the file.
Nothing is ever written beside the file. A write-ahead log there is brought in, in a copy. A rollback journal is not: it
may name any file of the machine, which sqlite3 would delete.
"""

from __future__ import annotations

import re
import shutil
import sqlite3
from collections.abc import Collection, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

import numpy as np

from .raw import Payloads, RawTopic

MAGIC = b"SQLite format 3\0"

_COMPUTED = re.compile(r"\b(check|generated|virtual|as|where|collate)\b", re.IGNORECASE)
_EVERY = 100_000  # steps of sqlite's virtual machine between two checks of the budget
_STEPS_A_BYTE, _STEPS = 20, 10_000_000  # budget for each byte, and constant; a row of ten bytes takes some twenty steps
_ROWS = "SELECT topic_id, timestamp, data FROM messages "
_LEAST_ROW, _LONGEST_STEP = 10, 1024  # bytes of a row; rows that are skipped at once behind damage
_NEEDED = {"topics": ("id", "name", "type", "serialization_format"), "messages": ("topic_id", "timestamp", "data")}


class SqliteDamage(Exception):
    """The file is no valid rosbag2 database; the text says why."""


def log_of(file: Path) -> Path | None:
    """The write-ahead log beside a file, with what a recorder that was killed had not yet brought into the file."""
    log = file.with_name(f"{file.name}-wal")
    return log if log.is_file() and log.stat().st_size else None


@contextmanager
def with_log(file: Path) -> Iterator[tuple[Path, int]]:
    """The file, or a copy of it with its write-ahead log brought in; with the number of pages that the log held."""
    log = log_of(file)
    if log is None:
        yield file, 0
        return
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "copy.db3"
        shutil.copyfile(file, copy)
        shutil.copyfile(log, f"{copy}-wal")
        if not copy.stat().st_size:
            copy.write_bytes(_first_page(log))  # sqlite3 deletes the log of an empty file
        try:
            with closing(sqlite3.connect(copy)) as database:
                _, pages, _ = database.execute("PRAGMA wal_checkpoint(FULL)").fetchone()
        except sqlite3.Error:  # what is wrong is said of the file, when it is read
            pages = 0
        yield copy, max(int(pages), 0)


def _first_page(log: Path) -> bytes:
    """The first page of a database as its log holds it (file format, section 4.1); empty where it holds none."""
    with log.open("rb") as stream:
        size = int.from_bytes(stream.read(32)[8:12], "big")
        while 512 <= size <= 65536 and len(frame := stream.read(24 + size)) == 24 + size:
            if int.from_bytes(frame[:4], "big") == 1:
                return frame[24:]
    return b""


def _cut_off(file: Path) -> str | None:
    """Error text where an sqlite3 file is shorter than its header says (file format, section 1.3), else None."""
    with file.open("rb") as stream:
        head = stream.read(100)
    if len(head) < 100:
        return f"it ends at byte {len(head)}, within its header"
    page_size, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    page_size = 65536 if page_size == 1 else page_size
    trusted = head[24:28] == head[92:96]  # otherwise an old library wrote the count, which may be stale
    size = file.stat().st_size
    if trusted and size < page_size * pages:
        return f"it ends at byte {size} of {page_size * pages}"
    return None


def read_sqlite(file: Path, types: Collection[str], *, whole: bool = True) -> tuple[list[RawTopic], str | None]:
    """Read all messages of the given types.

    `types`: Message types whose payloads are wanted; messages of other types are only counted. `whole`: Whether a
    damaged file is not read at all; otherwise the rows on whole pages are.
    """
    damage = _cut_off(file)
    if damage is not None and whole:
        return [], damage
    size = file.stat().st_size
    budget = _STEPS + _STEPS_A_BYTE * size
    spent = 0

    def tick() -> int:
        nonlocal spent
        spent += _EVERY
        return int(spent > budget)

    uri = f"file:{quote(str(file.absolute()))}?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(uri, uri=True)) as database:
            database.set_progress_handler(tick, _EVERY)
            database.execute("PRAGMA trusted_schema = OFF")
            if not whole:  # otherwise sqlite3 refuses a file that was cut off; nothing can be written all the same
                database.execute("PRAGMA writable_schema = ON")
            database.text_factory = lambda raw: raw.decode("utf-8", "replace")
            _check(database)
            damage = damage or _damage(database)
            if damage is not None and whole:
                return [], damage
            rows = database.execute(_ROWS + "ORDER BY timestamp, id") if damage is None else _left(database, size)
            return _read(database, types, size, rows, lenient=damage is not None), damage
    except SqliteDamage as exc:
        return [], str(exc)
    except sqlite3.Error as exc:
        why = "it is not a rosbag2 database" if "interrupt" in str(exc) else str(exc)
        return [], damage or " ".join(why.split())


def _check(database: sqlite3.Connection) -> None:
    """Refuse anything but plain tables."""
    for kind, name, sql in database.execute("SELECT type, name, sql FROM sqlite_master"):
        if kind in ("table", "index") and _COMPUTED.search(str(sql or "").partition("(")[2] or str(sql or "")):
            raise SqliteDamage(f"its {kind} {str(name)[:40]!r} computes something, expected plain columns")
        if kind == "view" and name in _NEEDED:
            raise SqliteDamage(f"its {name!r} is a view, expected a table")
    for table, needed in _NEEDED.items():
        if missing := set(needed) - set(_columns(database, table)):
            raise SqliteDamage(f"its table {table!r} has no column {sorted(missing)[0]!r}, expected a rosbag2 database")


def _damage(database: sqlite3.Connection) -> str | None:
    """What is wrong with the pages: some are damaged or used twice; None for nothing."""
    try:
        (verdict,) = database.execute("PRAGMA quick_check(1)").fetchone()
    except sqlite3.DatabaseError as exc:
        if "interrupt" in str(exc):
            raise
        verdict = exc
    return None if verdict == "ok" else " ".join(str(verdict).split())[:200]


def _left(database: sqlite3.Connection, size: int) -> Iterator[tuple[Any, Any, Any]]:
    """The rows of messages on whole pages; behind each damaged one, the search goes on in growing steps."""
    query = f"{_ROWS.replace('SELECT', 'SELECT rowid,')} NOT INDEXED WHERE rowid >= ? ORDER BY rowid"
    (page,) = database.execute("PRAGMA page_size").fetchone()
    at, step = 0, 1
    while at <= size // _LEAST_ROW:
        before: list[tuple[Any, Any, Any]] = []  # rows of a page at least, which damage behind them may have reached
        waiting: list[tuple[Any, Any, Any]] = []
        held = 0
        try:
            for number, *row in database.execute(query, (at,)):
                at, step = max(at, number) + 1, 1
                waiting.append((row[0], row[1], row[2]))
                held += _LEAST_ROW + (len(row[2]) if isinstance(row[2], bytes) else 0)
                if held > page:
                    yield from before
                    before, waiting, held = waiting, [], 0
            yield from [*before, *waiting]
            return
        except sqlite3.DatabaseError as exc:
            if "interrupt" in str(exc):
                return
            at, step = at + step, min(2 * step, _LONGEST_STEP)


def _columns(database: sqlite3.Connection, table: str) -> list[str]:
    return [str(row[1]) for row in database.execute(f"PRAGMA table_info({table})")]


def _read(
    database: sqlite3.Connection, types: Collection[str], size: int, rows: Iterable[tuple[Any, Any, Any]], lenient: bool
) -> list[RawTopic]:
    definitions: dict[str, str] = {}
    if {"topic_type", "encoded_message_definition"} <= set(_columns(database, "message_definitions")):
        found = database.execute("SELECT topic_type, encoded_message_definition FROM message_definitions")
        definitions = {str(name): str(text or "") for name, text in found}
    digest = "type_description_hash" if "type_description_hash" in _columns(database, "topics") else "''"
    topics: dict[int, RawTopic] = {}
    for key, name, msgtype, encoding, stated in database.execute(
        f"SELECT id, name, type, serialization_format, {digest} FROM topics"
    ):
        if not isinstance(key, int) or not all(isinstance(text, str) for text in (name, msgtype, encoding)):
            raise SqliteDamage("a row of its table 'topics' has an unexpected type or value")
        topics[key] = RawTopic(name, msgtype, encoding, definitions.get(msgtype, ""), str(stated or ""))
    times: dict[int, list[int]] = {key: [] for key in topics}
    messages: dict[int, list[bytes]] = {key: [] for key, topic in topics.items() if topic.msgtype in types}
    total = 0
    for key, log_ns, data in rows:
        known = isinstance(key, int) and key in topics
        if not known or not isinstance(log_ns, int) or not isinstance(data, bytes) or log_ns < 0:
            if lenient:
                continue
            raise SqliteDamage("a row of its table 'messages' has an unexpected type or value")
        total += len(data) + 1
        if total > size:
            raise SqliteDamage("its messages are larger than the file")
        times[key].append(log_ns)
        if key in messages:
            messages[key].append(data)
    return [
        replace(
            topic,
            log_ns=np.array(times[key], np.int64),
            payloads=Payloads.of(messages[key]) if key in messages else None,
        )
        for key, topic in topics.items()
    ]
