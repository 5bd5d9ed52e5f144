"""Bags that were cut off or damaged: refused in one line, or read as far as they go on request."""

from __future__ import annotations

import shutil
import sqlite3
import struct
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from backports import zstd
from bombs import little_memory
from fake_bags import FakeRig, refusal
from mcap_bytes import FOOTER, HEADER, chunk, chunks, record

from pam_antagonist.recording import bag_hash, read_bag
from pam_antagonist.recording.mcap import MAGIC, MAX_CHUNK


def test_a_cut_says_where(rig: FakeRig, tmp_path: Path) -> None:
    bag = rig.write(tmp_path / "bag", rig.streams())
    file = bag / "bag.mcap"
    whole = file.read_bytes()
    (header,) = struct.unpack_from("<Q", whole, len(MAGIC) + 1)
    start = len(MAGIC) + 9 + header  # the first record after the header is the one chunk
    file.write_bytes(whole[:2000])
    assert f"the chunk record at byte {start} has" in refusal(bag)
    assert "bytes, of which" in refusal(bag)
    file.write_bytes(whole[:-37])  # footer and closing magic
    assert f"it ends at byte {len(whole) - 37} without a footer; 200 messages stand before that" in refusal(bag)


@pytest.mark.parametrize(
    ("storage", "compression", "size", "said"),
    [("mcap", "file", 6000, "its zstd data end early"), ("sqlite3", "none", 3000, "reads the messages that are left")],
)
def test_what_stands_before_a_cut_is_read_on_request(
    tmp_path: Path, storage: str, compression: str, size: int, said: str
) -> None:
    long = FakeRig(size)
    bag = long.write(tmp_path / "bag", long.streams(), storage=storage, compression=compression)
    (file,) = (path for path in bag.iterdir() if path.name != "metadata.yaml")
    file.write_bytes(file.read_bytes()[: int(0.7 * file.stat().st_size)])
    assert said in refusal(bag)
    recording = read_bag(bag, recover=True)
    assert size // 3 < len(recording) < size - 100
    np.testing.assert_array_equal(recording.angle[:-1], long.angle[: len(recording) - 1])


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (record(6, b"", size=2**62), "record at byte 33 has 4611686018427387904 bytes, of which 37 are there"),
        (record(5, b"", size=2**63), "the message record at byte 33 has 9223372036854775808 bytes"),
        (record(5, bytes(5)), "a message record at byte 33 has 5 bytes, expected 22 or more"),
        (record(5, bytes(30)), "a message at byte 33 belongs to channel 0, which is not declared"),
        (record(4, bytes(4) + struct.pack("<I", 2**32 - 1)), "the channel record at byte 33 is damaged (a text of"),
        (record(3, b"\0\0" + struct.pack("<I", 2) + b"\xff\xff"), "the schema record at byte 33 is damaged"),
        (bytes(64), "there is no record at byte 33"),
        (chunk(b"", "", 2**50), f"claims 1125899906842624 bytes, expected {MAX_CHUNK} at most"),
        (chunk(b"abc", "", 3, packed=2**50), "claims 1125899906842624 packed bytes, but has 3"),
        (chunk(b"abc", "", 4), "4 bytes were announced, 3 are there"),
        (chunk(b"abc", "rar", 4), "compression 'rar' is not known, expected zstd, lz4 or none"),
        (chunk(b"abc", "zstd", 4), "the chunk record at byte 33 is damaged"),
        (chunk(b"abc", "lz4", 4), "the chunk record at byte 33 is damaged"),
        (chunk(bytes(9), "", 9, crc=1), "the chunk at byte 33 does not match its checksum"),
        (chunk(record(9, b"", size=77), "", 9), "the attachment record at byte 0 of the chunk at byte 33 has 77 bytes"),
        (chunk(zstd.compress(bytes(100 << 20), 1), "zstd", 1000), "1000 bytes were announced, more are there"),
        (chunk(chunk(b"", "", 0), "", 49), "there is a chunk inside the chunk at byte 33"),
    ],
)  # fmt: skip
def test_impossible_records_are_refused_at_once(tmp_path: Path, body: bytes, said: str) -> None:
    file = tmp_path / "bag.mcap"
    file.write_bytes(HEADER + body + FOOTER)
    began = time.monotonic()
    with little_memory(16 << 20):
        assert said in refusal(file)
    assert time.monotonic() - began < 2.0


def test_file_that_unpacks_without_end(tmp_path: Path, monkeypatch) -> None:
    file = tmp_path / "bag.mcap.zstd"
    file.write_bytes(zstd.compress(HEADER + bytes(64 << 20), 1))
    monkeypatch.setattr("pam_antagonist.recording.storage.MAX_UNPACKED", 16 << 20)
    assert "it unpacks to more than" in refusal(file)


def test_lengths_in_the_metadata_are_not_believed(rig: FakeRig, tmp_path: Path) -> None:
    bag = rig.write(tmp_path / "bag", rig.streams())
    metadata = (bag / "metadata.yaml").read_text()
    assert "message_count: 40" in metadata
    (bag / "metadata.yaml").write_text(metadata.replace("message_count: 40", "message_count: 4000000000000"))
    with little_memory():
        rig.assert_same(read_bag(bag))


def killed(bag: Path, main: str) -> tuple[Path, Path]:
    """Turn a bag of sqlite3 into one whose recorder was killed before it brought the last rows into the file."""
    file, whole, live = bag / "bag.db3", bag.parent / "whole.db3", bag.parent / "live.db3"
    file.rename(whole)
    with closing(sqlite3.connect(live, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        database.execute("ATTACH ? AS whole", (str(whole),))
        tables = database.execute("SELECT name, sql FROM whole.sqlite_master WHERE type = 'table'").fetchall()
        for name, sql in tables:
            database.execute(sql)
            rest = " WHERE id % 2" if name == "messages" and main == "half" else ""
            database.execute(f"INSERT INTO main.{name} SELECT * FROM whole.{name}{rest}")
        if main == "half":
            database.execute("PRAGMA main.wal_checkpoint(TRUNCATE)")
            database.execute("INSERT INTO main.messages SELECT * FROM whole.messages WHERE NOT id % 2")
        shutil.copy(live, file)
        shutil.copy(f"{live}-wal", f"{file}-wal")
    if main == "nothing":
        file.write_bytes(b"")
    (bag / "metadata.yaml").unlink()
    return file, file.with_name("bag.db3-wal")


@pytest.mark.parametrize("main", ["head", "half", "nothing"])
def test_a_write_ahead_log_beside_an_sqlite3_file_is_read(rig: FakeRig, tmp_path: Path, main: str) -> None:
    file, log = killed(rig.write(tmp_path / "bag", rig.streams(), storage="sqlite3"), main)
    before, mark = [path.read_bytes() for path in (file, log)], bag_hash(file.parent)
    recording = read_bag(file.parent)
    rig.assert_same(recording)
    assert any("bag.db3-wal was read as well" in text for text in recording.issues), recording.issues
    assert sorted(path.name for path in file.parent.iterdir()) == ["bag.db3", "bag.db3-wal"]
    assert [path.read_bytes() for path in (file, log)] == before
    log.write_bytes(log.read_bytes()[:-1])
    assert bag_hash(file.parent) != mark  # other messages, another recording


def test_a_log_beside_an_sqlite3_file_that_holds_nothing_is_mentioned(rig: FakeRig, tmp_path: Path) -> None:
    bag = rig.write(tmp_path / "bag", rig.streams(), storage="sqlite3")
    (bag / "bag.db3-wal").write_bytes(bytes(4096))
    recording = read_bag(bag)
    rig.assert_same(recording)
    assert len(recording.issues) == 1
    assert "bag.db3-wal holds nothing that can be read" in recording.issues[0]


@pytest.mark.parametrize("place", ["begin", "middle", "head"])
@pytest.mark.parametrize(("storage", "compression"), [("mcap", "none"), ("mcap", "chunk"), ("sqlite3", "none")])
def test_what_stands_behind_damage_is_read_on_request(
    tmp_path: Path, storage: str, compression: str, place: str
) -> None:
    bag = tmp_path / "bag"
    long = FakeRig(6000)
    long.write(bag, long.streams(), storage=storage, compression=compression)
    file = next(path for path in bag.iterdir() if path.name != "metadata.yaml")
    whole = bytearray(file.read_bytes())
    where = chunks(whole) if storage == "mcap" else [(80_000, 400_000), (400_000, 1_000_000), (0, 0)]
    assert len(where) > 2
    begin, end = where[0 if place == "begin" else 1]
    at = begin - 100 if place == "head" else (begin + end) // 2
    whole[at : at + 5000] = bytes(5000)
    file.write_bytes(whole)
    assert "--recover reads the" in refusal(bag)
    recording = read_bag(bag, recover=True)
    index = np.searchsorted(long.stamp_ns, recording.stamp_ns)
    assert 3000 < len(recording) < 6000 and index[-1] == 5999
    for mine, theirs in ((recording.pressure, long.pressure), (recording.voltage, long.voltage)):
        there = np.isfinite(mine)
        assert np.array_equal(mine[there], theirs[index][there])
    damage = [issue for issue in recording.issues if issue.kind == "damage"]
    assert recording.issues[: len(damage)] == tuple(damage)
    if storage == "mcap":
        lost = damage[1]
        assert f"{lost.size} bytes are lost, from byte" in lost and lost.size > 100_000
        assert (place == "begin" and compression == "chunk") or 0.5 < lost.length_s < 6.0
