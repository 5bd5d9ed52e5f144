"""Bags that were built to break what reads them: small files that claim, unpack to, or compute without end."""

from __future__ import annotations

import json
import resource
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
from backports import zstd
from edits import laughs
from fake_bags import FLUID
from mcap_bytes import FOOTER, HEADER, chunk, message, record, text

CHILD = """
import json, resource, sys, time
sys.path[:0] = {path!r}
from pathlib import Path
from pam_antagonist.errors import BadInput
{imports}
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (1 << 30), used + (1 << 30)))
began = time.monotonic()
try:
    {reads}
    said = "read"
except BadInput as error:
    said = str(error)
seconds = time.monotonic() - began
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps([said, seconds, int(peak.split()[1]) / 1024]))
"""


def assert_refused_in_a_gigabyte(imports: str, reads: str, *words: str, seconds: float) -> None:
    """In a process of its own that may not have more than 1 GB; what it reads is ``sys.argv``."""
    code = CHILD.format(path=sys.path, imports=imports, reads=reads)
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    said, took, megabytes = json.loads(done.stdout)
    assert said != "read" and "\n" not in said and len(said) < 1000
    assert "memory" not in said.lower()  # refused, not starved
    assert took < seconds and megabytes < 1000.0
    print(f"{words[0]}: {took:.2f} s, {megabytes:.0f} MB: {said}")


@contextmanager
def little_memory(limit: int = 1 << 30) -> Iterator[None]:
    """Let nothing allocate more than ``limit`` bytes on top of what the process has."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def mcap(*bodies: bytes) -> bytes:
    schema = record(3, struct.pack("<H", 1) + text(FLUID) + text("ros2msg") + text(""))
    channels = [
        record(4, struct.pack("<HH", k, 1) + text(f"/pam/pressure_{k}") + text("cdr") + struct.pack("<I", 0))
        for k in (1, 2)
    ]
    return b"".join([HEADER, schema, *channels, *bodies, FOOTER])


def bomb_chunk(data: bytes, packer: str) -> bytes:
    return chunk(zstd.compress(data, 3) if packer == "zstd" else lz4.frame.compress(data), packer, len(data))


def many_chunks(folder: Path) -> Path:
    """Chunks within the limit for one, without end: 40 × 120 MB from 160 kB, each one message."""
    one = bomb_chunk(message(1, bytes(120_000_000)), "zstd")
    (folder / "bag.mcap").write_bytes(mcap(one * 40))
    return folder / "bag.mcap"


def many_messages(folder: Path) -> Path:
    """The same of small messages."""
    one = bomb_chunk(message(1, bytes(100)) * 200_000, "zstd")
    (folder / "bag.mcap").write_bytes(mcap(one * 12))
    return folder / "bag.mcap"


def many_files(folder: Path) -> Path:
    """The same in many files."""
    data = mcap(bomb_chunk(message(1, bytes(900_000)) * 120, "lz4"))
    for k in range(12):
        (folder / f"bag_{k}.mcap").write_bytes(data)
    return folder


def bomb_in_bomb(folder: Path) -> Path:
    """A packed file of packed chunks."""
    one = bomb_chunk(message(1, bytes(900_000)) * 120, "zstd")
    (folder / "bag.mcap.zstd").write_bytes(zstd.compress(mcap(one * 2000), 3))
    return folder / "bag.mcap.zstd"


def packed_messages(folder: Path) -> Path:
    """Messages that are packed one by one."""
    one = message(1, zstd.compress(bytes(1_000_000), 3)) + message(2, zstd.compress(bytes(1_000_000), 3))
    (folder / "bag.mcap").write_bytes(mcap(one * 3000))
    return folder / "bag.mcap"


def laughing_metadata(folder: Path) -> Path:
    custom = "\n    ".join(["  custom_data:", *laughs("[ha, ha]", "[{}]", 12)])
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n{custom}\n  relative_file_paths: [bag.mcap]\n"
    )
    (folder / "bag.mcap").write_bytes(mcap())
    return folder


def merging_metadata(folder: Path) -> Path:
    (folder / "metadata.yaml").write_text("\n".join(laughs("{x: 1}", "{{<<: [{}]}}", 12)))
    return folder


def database(folder: Path, *statements: str) -> Path:
    path = folder / "bag.db3"
    topics = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
    messages = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
    with sqlite3.connect(path) as connection:
        for statement in statements:
            connection.execute(statement.replace("TOPICS", topics).replace("MESSAGES", messages))
        connection.execute(f"INSERT INTO topics VALUES (1, '/pam/pressure_1', '{FLUID}', 'cdr')")
        connection.execute(f"INSERT INTO topics VALUES (2, '/pam/pressure_2', '{FLUID}', 'cdr')")
    connection.close()
    return path


def endless_view(folder: Path) -> Path:
    rows = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 1 AS topic_id, "
    return database(folder, "TOPICS", f"CREATE VIEW messages AS {rows} i AS timestamp, x'00' AS data FROM n")


def generated_column(folder: Path) -> Path:
    columns = "id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB AS (hex(zeroblob(400000000)))"
    return database(
        folder, "TOPICS", f"CREATE TABLE messages({columns})",
        "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1), (1, 2), (1, 3)",
    )  # fmt: skip


def expensive_check(folder: Path) -> Path:
    columns = "id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB CHECK (length(hex({}))>0)"
    return database(
        folder, "TOPICS", f"CREATE TABLE messages({columns.format('zeroblob(400000000)')})",
        "PRAGMA ignore_check_constraints = ON", "INSERT INTO messages VALUES (1, 1, 1, x'00'), (2, 1, 1, x'00')",
    )  # fmt: skip


def tree_of_one_page(folder: Path) -> Path:
    """A table whose inner page names one and the same leaf hundreds of times, and that page itself as well."""
    path = database(folder, "TOPICS", "MESSAGES")
    with sqlite3.connect(path) as connection:
        connection.executemany("INSERT INTO messages VALUES (?, 1, 5, x'00')", ((k,) for k in range(200_000)))
        (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
        (size,) = connection.execute("PRAGMA page_size").fetchone()
    connection.close()
    data = bytearray(path.read_bytes())
    at = (root - 1) * size
    assert data[at] == 5  # an inner page
    (cells,) = struct.unpack_from(">H", data, at + 3)
    inner = struct.unpack_from(">I", data, at + struct.unpack_from(">H", data, at + 12)[0])[0]
    for page in (root, inner):
        base = (page - 1) * size
        (count,) = struct.unpack_from(">H", data, base + 3)
        for k in range(count):
            (cell,) = struct.unpack_from(">H", data, base + 12 + 2 * k)
            data[base + cell : base + cell + 4] = struct.pack(">I", inner)
    path.write_bytes(data)
    assert cells > 0
    return path


BOMBS: dict[str, Callable[[Path], Path]] = {
    function.__name__: function
    for function in (
        many_chunks, many_messages, many_files, bomb_in_bomb, packed_messages, laughing_metadata, merging_metadata,
        endless_view, generated_column, expensive_check, tree_of_one_page,
    )
}  # fmt: skip
