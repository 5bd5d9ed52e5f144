"""Bags that somebody broke, or built to break what reads them: a recording or one line, in time and in memory."""

from __future__ import annotations

import json
import os
import shutil
import struct
import time
from pathlib import Path

import pytest
from bombs import BOMBS, assert_refused_in_a_gigabyte, little_memory
from edits import EDIT, VALUES, Edit, edited, examples
from fake_bags import FakeRig
from hypothesis import given
from hypothesis import strategies as st
from mcap_bytes import records

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import read_bag
from pam_antagonist.recording.mcap import MAGIC
from pam_antagonist.recording.notes import read_notes

EDITS = st.lists(EDIT, min_size=1, max_size=4)
MANY = pytest.mark.parametrize("count", [50, pytest.param(1500, marks=pytest.mark.thorough(40))])
KINDS = [
    ("mcap", "none"), ("mcap", "chunk"), ("mcap", "message"), ("mcap", "file"), ("sqlite3", "none"), ("sqlite3", "file")
]  # fmt: skip


def record_starts(data: bytes) -> list[int]:
    """Where records of an MCAP file begin, those in its chunks as well; every page's start of another file."""
    if not data.startswith(MAGIC):
        return list(range(0, len(data), 4096))
    starts, stack = [], [(len(MAGIC), len(data))]
    while stack:
        for opcode, at, end in records(data, *stack.pop()):
            starts += [at, at + 9]
            if opcode == 6 and data[at + 37 : at + 41] == bytes(4):  # not compressed
                stack.append((at + 9 + 40, end))
    return [start for start in starts if start < len(data)]


def judged(path: Path, **options: object) -> str:
    """Read a bag as the commands do; what it came to, in one word."""
    try:
        read_notes(path)
        recording = read_bag(path, **options)
    except BadInput as error:
        said = str(error)
        assert "\n" not in said and len(said) < 3000 and str(path) in said, said
        return "refused"
    assert len(recording) > 0
    assert all("\n" not in issue for issue in recording.issues)
    return "read"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], Path]:
    folder = tmp_path_factory.mktemp("whole")
    rig = FakeRig(60)
    return {
        kind: rig.write(folder / "_".join(kind) / "bag", rig.streams(), storage=kind[0], compression=kind[1])
        for kind in KINDS
    }


@MANY
@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_damaged_messages(whole: dict, tmp_path: Path, kind: tuple[str, str], count: int) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(whole[kind], bag)
    file = next(path for path in bag.iterdir() if path.name != "metadata.yaml")
    data, metadata = file.read_bytes(), (bag / "metadata.yaml").read_bytes()
    places = record_starts(data)

    @examples(count)
    @given(EDITS, st.booleans(), st.booleans(), st.sampled_from(["refuse", "last"]))
    def run(edits: list[Edit], recover: bool, closed: bool, restarts: str) -> None:
        file.write_bytes(edited(data, edits, places))
        if closed:
            (bag / "metadata.yaml").write_bytes(metadata)
        else:
            (bag / "metadata.yaml").unlink(missing_ok=True)
        began = time.monotonic()
        with little_memory():
            judged(bag, recover=recover, restarts=restarts)
        assert time.monotonic() - began < 10.0

    run()


@MANY
def test_damaged_metadata(whole: dict, tmp_path: Path, count: int) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(whole["mcap", "none"], bag)
    text = (bag / "metadata.yaml").read_bytes()

    @examples(count)
    @given(data=st.data())
    def run(data: st.DataObject) -> None:
        if data.draw(st.booleans()):
            lines = text.decode().splitlines()
            at = data.draw(st.integers(0, len(lines) - 1))
            key = lines[at].partition(":")[0]
            lines[at] = f"{key}: {data.draw(st.sampled_from(VALUES))}"
            content = "\n".join(lines).encode("utf-8", "replace")
        else:
            content = edited(text, data.draw(EDITS), list(range(0, len(text), 7)))
        (bag / "metadata.yaml").write_bytes(content)
        with little_memory():
            judged(bag)

    run()


# ---------------------------------------------------------------- built to break

IMPORTS = """
from pam_antagonist.recording import read_bag
from pam_antagonist.recording.notes import read_notes
import pam_antagonist.recording.reader
"""
READS = """read_notes(sys.argv[1])
    read_bag(sys.argv[1], recover="recover" in sys.argv)"""


@pytest.mark.slow(4)
@pytest.mark.parametrize("recover", [[], pytest.param(["recover"], marks=pytest.mark.thorough(4))], ids=["", "recover"])
@pytest.mark.parametrize("name", BOMBS)
def test_bombs(tmp_path: Path, name: str, recover: list[str]) -> None:
    assert_refused_in_a_gigabyte(IMPORTS, READS, str(BOMBS[name](tmp_path)), *recover, seconds=30.0)


# ---------------------------------------------------------------- paths


@pytest.mark.parametrize("name", ["../secret.mcap", "/etc/passwd", "a/../../secret.mcap", "..", ".", "/", ""])
def test_paths_in_the_metadata_lead_nowhere(tmp_path: Path, name: str) -> None:
    rig = FakeRig(10)
    rig.write(tmp_path / "other", rig.streams())
    (tmp_path / "other" / "other.mcap").rename(tmp_path / "secret.mcap")
    bag = tmp_path / "bag"
    bag.mkdir()
    content = {"rosbag2_bagfile_information": {"relative_file_paths": [name]}}
    (bag / "metadata.yaml").write_text(json.dumps(content))
    with pytest.raises(BadInput, match="which is not there|has an unexpected type or value"):
        read_bag(bag)


def test_links_and_devices(tmp_path: Path) -> None:
    rig = FakeRig(10)
    rig.write(tmp_path / "other", rig.streams())
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag.mcap").symlink_to(tmp_path / "other" / "other.mcap")  # data on another disk, say
    rig.assert_same(read_bag(bag))
    for target in ("/dev/zero", str(bag), "bag.mcap"):
        (bag / "bag.mcap").unlink()
        (bag / "bag.mcap").symlink_to(target)
        with pytest.raises(BadInput):
            read_bag(bag)
    (bag / "bag.mcap").unlink()
    os.mkfifo(bag / "bag.mcap")
    with pytest.raises(BadInput):
        read_bag(bag)
    with pytest.raises(BadInput):
        read_bag(bag / "bag.mcap")
    with pytest.raises(BadInput):
        read_bag(tmp_path / "a\0b")


@pytest.mark.parametrize("name", ["a b", "50%", "what?mode=rw", "run#3", "ü", "x&y", "it's"])
def test_any_name_will_do(tmp_path: Path, name: str) -> None:
    rig = FakeRig(10)
    bag = rig.write(tmp_path / "bag", rig.streams(), storage="sqlite3").rename(tmp_path / name)
    (bag / "bag.db3").rename(bag / f"{name}.db3")
    metadata = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(metadata.replace("bag.db3", json.dumps(f"{name}.db3")))
    rig.assert_same(read_bag(bag))


def test_a_journal_beside_a_database_is_left_alone(tmp_path: Path) -> None:
    """sqlite3 would play a journal back into the file, and delete the file that the journal names as its master."""
    rig = FakeRig(10)
    bag = rig.write(tmp_path / "bag", rig.streams(), storage="sqlite3")
    precious = tmp_path / "precious"
    precious.write_text("data")
    name = str(precious).encode()
    journal = bytearray(512) + struct.pack(">I", 1) + name
    journal[:12] = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7" + struct.pack(">I", 0)
    journal += struct.pack(">II", len(name), sum(name)) + b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
    (bag / "bag.db3-journal").write_bytes(journal)
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    rig.assert_same(read_bag(bag))
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before
    assert precious.read_text() == "data"


def test_nothing_is_left_behind(whole: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    for kind, bag in whole.items():
        before = sorted(path.name for path in bag.iterdir())
        judged(bag)
        assert sorted(path.name for path in bag.iterdir()) == before, kind
    assert not list(tmp_path.iterdir())
