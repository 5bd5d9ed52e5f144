"""Recordings that end as recordings on a rig do: split, killed, without power, on a full disk."""

from __future__ import annotations

import itertools
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fake_bags import FakeRig
from mcap_bytes import chunks, records
from rosbags.rosbag2 import Reader

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import BagWriter, bag_files, read_bag, writer
from pam_antagonist.recording.bag_files import FileLimits
from pam_antagonist.recording.mcap import MAGIC


def items_of(rig: FakeRig) -> Iterator[list[tuple[str, int, bytes]]]:
    """The messages sample by sample."""
    streams = rig.streams()
    for i in range(rig.size):
        yield [(topic, *stream.items[i]) for topic, stream in streams.items()]


def write(bag: BagWriter, rig: FakeRig, pause_s: float = 0.0) -> None:
    for topic, stream in rig.streams().items():
        bag.add_topic(topic, stream.type)
    for items in items_of(rig):
        bag.write_many(items)
        time.sleep(pause_s)


def assert_a_beginning(recording, rig: FakeRig, least: int) -> None:
    """Bit for bit what was written first; of the last sample, a message may be missing."""
    size = len(recording)
    assert least <= size <= rig.size
    np.testing.assert_array_equal(recording.stamp_ns, rig.stamp_ns[:size])
    whole = np.isfinite(recording.pressure).all(axis=1)
    assert np.count_nonzero(~whole) <= 1
    np.testing.assert_array_equal(recording.pressure[whole], rig.pressure[:size][whole])


def test_a_split_bag_is_one_recording(tmp_path: Path) -> None:
    rig = FakeRig(5000)
    with BagWriter(tmp_path / "bag", limits=FileLimits(size=100_000)) as bag:
        write(bag, rig)
    names = [path.name for path in (tmp_path / "bag").iterdir()]
    assert 11 < bag.files < 30
    assert set(names) == {*(f"bag_{k}.mcap" for k in range(bag.files)), "metadata.yaml"}
    rig.assert_same(read_bag(tmp_path / "bag"))
    assert read_bag(tmp_path / "bag").issues == ()
    with Reader(tmp_path / "bag") as reader:  # as other readers see it
        assert reader.message_count == 5 * rig.size
        assert reader.start_time == rig.stamp_ns[0] + 150_000
        assert reader.end_time == rig.stamp_ns[-1] + 150_000 + 1
        assert sum(1 for _ in reader.messages()) == 5 * rig.size
    sizes = []
    for k in range(bag.files):  # each file stands for itself
        with Reader(tmp_path / "bag" / f"bag_{k}.mcap") as reader:
            sizes.append(reader.message_count)
    assert sum(sizes) == 5 * rig.size and min(sizes) > 0
    (tmp_path / "bag" / "metadata.yaml").unlink()
    recording = read_bag(tmp_path / "bag")  # in the order of their numbers
    rig.assert_same(recording)
    assert len(recording.issues) == 1


def test_files_of_a_duration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = FakeRig(40)
    # A clock that each sample moves on: by the machine's own, the thread that writes may fall behind.
    ticks = itertools.count()
    monkeypatch.setattr(bag_files, "time", SimpleNamespace(monotonic=lambda: 0.01 * next(ticks)))
    with BagWriter(tmp_path / "bag", limits=FileLimits(duration=0.1)) as bag:
        write(bag, rig)
    assert 3 <= bag.files <= 5
    rig.assert_same(read_bag(tmp_path / "bag"))


RECORDER = """
import sys, time
sys.path[:0] = {path!r}
import pam_antagonist.recording.writer as writer
from pam_antagonist.recording.bag_files import FileLimits
from fake_bags import FakeRig
writer._FLUSH_S = 0.02
rig = FakeRig(3000)
streams = rig.streams()
bag = writer.BagWriter({bag!r}, limits=FileLimits({limits}), durable=True)
for topic, stream in streams.items():
    bag.add_topic(topic, stream.type)
try:
    for i in range(rig.size):
        if i == 200:
            print("go", flush=True)
        bag.write_many([(topic, *stream.items[i]) for topic, stream in streams.items()])
        time.sleep(0.0002)
    {end}
except OSError as error:
    print(error.strerror, bag.kept, flush=True)
finally:
    {last}
"""


def recorder(
    bag: Path, limits: str = "", end: str = "time.sleep(60)", before: str = "", last: str = "pass"
) -> subprocess.Popen[bytes]:
    path = [str(Path(__file__).parent), *sys.path]
    code = RECORDER.format(path=path, bag=str(bag), limits=limits, end=end, last=last)
    return subprocess.Popen([sys.executable, "-c", before + code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)


@pytest.mark.parametrize(
    "seed", [*range(3), *(pytest.param(seed, marks=pytest.mark.thorough(1)) for seed in range(3, 12))]
)
@pytest.mark.parametrize("limits", ["", "size=20_000"])
def test_killed_at_any_moment(tmp_path: Path, seed: int, limits: str) -> None:
    with recorder(tmp_path / "bag", limits) as process:
        assert process.stdout is not None and process.stdout.readline() == b"go\n"
        time.sleep(random.Random(seed).uniform(0.05, 0.6))
        process.send_signal(signal.SIGKILL)
        process.wait(20)
    recording = read_bag(tmp_path / "bag")
    assert_a_beginning(recording, FakeRig(3000), 10)  # a busy machine writes less
    said = "\n".join(recording.issues)
    assert "bag has no metadata.yaml, as after a recording that was not closed" in said
    # Killed between two files, a recorder leaves the last one whole, or empty.
    last = max((tmp_path / "bag").glob("*.mcap"), key=lambda path: (len(path.stem), path.stem))
    whole = last.read_bytes().endswith(b"\x89MCAP0\r\n")
    assert whole or not last.stat().st_size or f"{last.name} was not closed" in said or f"{last.name} holds no" in said


@pytest.mark.parametrize("last", ["bag.close()", "pass"])
def test_ctrl_c_leaves_a_whole_bag(tmp_path: Path, last: str) -> None:
    # A shell that starts the tests in the background has its children ignore Ctrl-C.
    heard = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    with recorder(tmp_path / "bag", last=last, before=heard) as process:
        assert process.stdout is not None and process.stdout.readline() == b"go\n"
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) != 0
    recording = read_bag(tmp_path / "bag")
    assert_a_beginning(recording, FakeRig(3000), 200)
    assert recording.issues == ()


@pytest.fixture(scope="module")
def unclosed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FakeRig]:
    """A bag of several chunks without metadata."""
    folder = tmp_path_factory.mktemp("unclosed") / "bag"
    rig = FakeRig(600)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer, "_FLUSH_S", 0.02)
        with BagWriter(folder) as bag:
            write(bag, rig, 0.0005)
    (folder / "metadata.yaml").unlink()
    return folder, rig


@pytest.mark.parametrize("count", [25, pytest.param(300, marks=pytest.mark.thorough(5))])
@pytest.mark.parametrize("tail", [b"", bytes(5000), b"\xa5" * 5000])
def test_without_power_at_any_byte(unclosed: tuple[Path, FakeRig], tmp_path: Path, tail: bytes, count: int) -> None:
    folder, rig = unclosed
    whole = (folder / "bag.mcap").read_bytes()
    ends = [end for _, end in chunks(whole)]
    assert len(ends) > 5
    cuts = {end + shift for end in ends for shift in (-1, 0, 1, 9)}
    cuts |= set(np.linspace(9, len(whole) - 1, count).astype(int).tolist())
    bag = tmp_path / "bag"
    bag.mkdir()
    sizes = []
    for cut in sorted(cuts):
        (bag / "bag.mcap").write_bytes(whole[:cut] + tail)
        if cut < ends[0]:
            with pytest.raises(BadInput):
                read_bag(bag)
            continue
        recording = read_bag(bag)
        assert_a_beginning(recording, rig, 1)
        assert any("read the" in issue for issue in recording.issues)
        sizes.append(len(recording))
    assert sizes == sorted(sizes)  # what is on the disk longer is never lost
    assert sizes[-1] == rig.size


@pytest.mark.parametrize("metadata", [b"", bytes(800)])
def test_metadata_without_content_after_a_power_cut(
    unclosed: tuple[Path, FakeRig], tmp_path: Path, metadata: bytes
) -> None:
    folder, rig = unclosed
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag.mcap").write_bytes((folder / "bag.mcap").read_bytes())
    (bag / "metadata.yaml").write_bytes(metadata)
    recording = read_bag(bag)
    rig.assert_same(recording)
    assert any("not closed" in issue for issue in recording.issues)


def test_the_next_file_was_begun_and_holds_nothing(tmp_path: Path) -> None:
    rig = FakeRig(2000)
    with BagWriter(tmp_path / "bag", limits=FileLimits(size=50_000)) as bag:
        write(bag, rig)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    for content in (b"", bytes(4096)):
        (tmp_path / "bag" / f"bag_{bag.files}.mcap").write_bytes(content)
        recording = read_bag(tmp_path / "bag")
        rig.assert_same(recording)
        assert any(f"bag_{bag.files}.mcap holds no messages" in issue for issue in recording.issues)


def test_every_flush_reaches_the_disk_with_whole_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    really = os.fsync

    def fsync(handle: int) -> None:
        if os.path.isfile(f"/proc/self/fd/{handle}") and os.readlink(f"/proc/self/fd/{handle}").endswith(".mcap"):
            data = Path(f"/proc/self/fd/{handle}").read_bytes()
            synced.append(len(data))
            *_, (_, _, end) = records(data)
            assert end == len(data) or data.endswith(MAGIC), "no record is cut off"
        really(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(writer, "_FLUSH_S", 0.02)
    rig = FakeRig(100)
    with BagWriter(tmp_path / "bag", durable=True) as bag:
        write(bag, rig, 0.001)
    assert len(synced) > 3
    assert synced[-1] == (tmp_path / "bag" / "bag.mcap").stat().st_size


FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}))\n"


@pytest.mark.slow(4)
@pytest.mark.parametrize(
    ("size", "limits"),
    [
        (20_000, ""),
        (60_000, ""),
        (12_000, "size=15_000"),
        (12_000, "size=9_000"),  # no file is too large, but metadata.yaml of so many is
    ],
)
def test_a_full_disk_keeps_what_was_written(tmp_path: Path, size: int, limits: str) -> None:
    with recorder(tmp_path / "bag", limits, "bag.close()", FULL.format(size=size)) as process:
        out, err = process.communicate(timeout=60)
    assert err == b""
    said, _, number = out.decode().splitlines()[-1].rpartition(" ")
    assert said == "File too large"
    recording = read_bag(tmp_path / "bag")
    assert_a_beginning(recording, FakeRig(3000), 10)
    assert int(number) == sum(len(arrival.stamp_ns) for arrival in recording.received_ns.values())
    assert all(path.stat().st_size <= size for path in (tmp_path / "bag").iterdir())
    assert not [path for path in (tmp_path / "bag").iterdir() if path.name.startswith(".")]


def test_a_disk_that_does_not_keep_up_costs_messages_and_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig(500)
    bag = BagWriter(tmp_path / "bag", backlog=20_000)
    really = bag._files.write_many

    def slowly(items) -> None:
        time.sleep(0.02)
        really(items)

    monkeypatch.setattr(bag._files, "write_many", slowly)
    for topic, stream in rig.streams().items():
        bag.add_topic(topic, stream.type)
    began, most, taken = time.monotonic(), 0, 0
    for items in items_of(rig):
        taken += bag.write_many(items)
        most = max(most, bag.backlog)
    assert time.monotonic() - began < 1.0  # nobody waited
    bag.close()
    assert most < 21_000
    assert bag.dropped > 0 and taken + bag.dropped == 5 * rig.size
    assert sum(len(a.stamp_ns) for a in read_bag(tmp_path / "bag").received_ns.values()) == taken
