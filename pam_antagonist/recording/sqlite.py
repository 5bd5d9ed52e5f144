"""sqlite3 files of rosbag2, read as untrusted input.

A malicious database can run computations (views, checks, generated columns), and damaged pages can form endless loops.
So only plain tables are read, all pages are checked first, and the number of steps is limited by the size of the file.
Nothing is ever written; journals beside the file are ignored.
"""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Collection
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

import numpy as np

from .cdr import Payloads
from .raw import Channel, Collector, RawTopic

MAGIC = b"SQLite format 3\0"

_COMPUTED = re.compile(r"\b(check|generated|virtual|as|where|collate)\b", re.IGNORECASE)
_EVERY = 100_000  # steps of sqlite's virtual machine between two checks of the budget
_STEPS_A_BYTE, _STEPS = 20, 10_000_000  # budget for each byte, and constant; a row of ten bytes takes some twenty steps
_NEEDED = {"topics": ("id", "name", "type", "serialization_format"), "messages": ("topic_id", "timestamp", "data")}


class SqliteDamage(Exception):
    """The file is no valid rosbag2 database; the text says why."""


def cut_off(file: Path) -> str | None:
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


def read_sqlite(file: Path, types: Collection[str]) -> list[RawTopic]:
    """Read all messages of the given types.

    Args:
        file: The file.
        types: Message types whose payloads are wanted; messages of other types are only counted.

    Raises:
        SqliteDamage: Damaged, or not the database of a rosbag2.
    """
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
            database.text_factory = lambda raw: raw.decode("utf-8", "replace")
            _check(database)
            return _read(database, types, size)
    except sqlite3.Error as exc:
        why = "it is not a rosbag2 database" if "interrupt" in str(exc) else str(exc)
        raise SqliteDamage(" ".join(why.split())) from None


def _check(database: sqlite3.Connection) -> None:
    """Refuse anything but plain tables, and pages that are damaged or used twice."""
    for kind, name, sql in database.execute("SELECT type, name, sql FROM sqlite_master"):
        if kind in ("table", "index") and _COMPUTED.search(str(sql or "").partition("(")[2] or str(sql or "")):
            raise SqliteDamage(f"its {kind} {str(name)[:40]!r} computes something, expected plain columns")
        if kind == "view" and name in _NEEDED:
            raise SqliteDamage(f"its {name!r} is a view, expected a table")
    for table, needed in _NEEDED.items():
        if missing := set(needed) - set(_columns(database, table)):
            raise SqliteDamage(f"its table {table!r} has no column {sorted(missing)[0]!r}, expected a rosbag2 database")
    (verdict,) = database.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise SqliteDamage(" ".join(str(verdict).split())[:200])


def _columns(database: sqlite3.Connection, table: str) -> list[str]:
    return [str(row[1]) for row in database.execute(f"PRAGMA table_info({table})")]


def _read(database: sqlite3.Connection, types: Collection[str], size: int) -> list[RawTopic]:
    definitions: dict[str, str] = {}
    if {"topic_type", "encoded_message_definition"} <= set(_columns(database, "message_definitions")):
        rows = database.execute("SELECT topic_type, encoded_message_definition FROM message_definitions")
        definitions = {str(name): str(text or "") for name, text in rows}
    digest = "type_description_hash" if "type_description_hash" in _columns(database, "topics") else "''"
    collectors: dict[int, Collector] = {}
    for key, topic, msgtype, encoding, digest_text in database.execute(
        f"SELECT id, name, type, serialization_format, {digest} FROM topics"
    ):
        if not isinstance(key, int) or not all(isinstance(text, str) for text in (topic, msgtype, encoding)):
            raise SqliteDamage("a row of its table 'topics' has an unexpected type or value")
        channel = Channel(topic, msgtype, encoding, definitions.get(msgtype, ""), str(digest_text or ""))
        collectors[key] = Collector(channel, msgtype in types)
    times: dict[int, list[int]] = {key: [] for key in collectors}
    messages: dict[int, list[bytes]] = {key: [] for key in collectors}
    total = 0
    for key, log_ns, data in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"):
        collector = collectors.get(key) if isinstance(key, int) else None
        if collector is None or not isinstance(log_ns, int) or not isinstance(data, bytes) or log_ns < 0:
            raise SqliteDamage("a row of its table 'messages' has an unexpected type or value")
        total += len(data) + 1
        if total > size:
            raise SqliteDamage("its messages are larger than the file")
        times[key].append(log_ns)
        if collector.wanted:
            messages[key].append(data)
    for key, collector in collectors.items():
        collector.add(np.array(times[key], np.int64), Payloads.of(messages[key]) if collector.wanted else None)
    return [collector.finish() for collector in collectors.values()]
