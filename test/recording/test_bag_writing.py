"""Bags that the package writes: read back the same, never overwritten, never lost."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
from fake_bags import FLUID, FakeRig
from rosbags.rosbag2 import Reader

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import (
    ESTIMATE_SHAPES,
    Arrival,
    BagWriter,
    RecordedEstimate,
    RecordedReference,
    Recording,
    read_bag,
    write_bag,
)

SIZE = 30
STAMPS = 1_780_000_000 * 10**9 + 10**6 * np.arange(SIZE)


def make_recording() -> Recording:
    rng = np.random.default_rng(4)
    columns = {name: rng.normal(size=(SIZE, *shape)) for name, shape in ESTIMATE_SHAPES.items()}
    columns["innovation"][3] = np.nan
    columns |= {"subsystem": rng.integers(1, 19, SIZE), "flags": rng.integers(0, 128, SIZE)}
    pressure = rng.uniform(2e5, 7e5, (SIZE, 2))
    pressure[4, 1] = np.nan
    voltage = rng.uniform(0.0, 10.0, (SIZE, 2))
    voltage[5] = np.nan
    angle, torque = rng.normal(size=(2, SIZE))
    angle[6] = torque[6] = np.nan
    return Recording(
        path=Path("nowhere"),
        stamp_ns=STAMPS,
        pressure=pressure,
        voltage=voltage,
        angle=angle,
        torque=torque,
        external_torque=rng.normal(size=SIZE),
        estimate=RecordedEstimate(STAMPS, np.full(SIZE, STAMPS[0]), **columns),
        reference=RecordedReference(STAMPS[[2, 9]], [0, 2], [0.1, -0.5], [np.nan, 7.0], [np.nan, 0.2]),
        received_ns={"pressure_1": Arrival(STAMPS + 12345, STAMPS)},
    )


def assert_equal(left: Recording, right: Recording) -> None:
    for name in ("stamp_ns", "pressure", "voltage", "angle", "torque", "external_torque"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name), err_msg=name)
    for name in ("stamp_ns", "started_ns", *ESTIMATE_SHAPES):
        np.testing.assert_array_equal(getattr(left.estimate, name), getattr(right.estimate, name), err_msg=name)
    for name in ("stamp_ns", "mode", "value", "stiffness", "damping"):
        np.testing.assert_array_equal(getattr(left.reference, name), getattr(right.reference, name), err_msg=name)


def test_a_recording_survives_the_round_trip(tmp_path: Path) -> None:
    recording = make_recording()
    write_bag(tmp_path / "a" / "bag", recording, namespace="/lab")
    back = read_bag(tmp_path / "a" / "bag")
    assert_equal(back, recording)
    assert back.topics["joint_estimate"] == "/lab/joint_estimate"
    np.testing.assert_array_equal(back.received_ns["pressure_1"].log_ns, STAMPS + 12345)
    np.testing.assert_array_equal(back.received_ns["valve_state"].log_ns, np.delete(STAMPS, 5))


def test_other_readers_see_a_bag_of_jazzy(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", make_recording(), pressure_variance=2.5)
    with Reader(tmp_path / "bag") as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts["/pam/pressure_1"] == SIZE and counts["/pam/pressure_2"] == SIZE - 1
        times = [time for _, time, _ in reader.messages()]
        assert times == sorted(times)
        connection = next(c for c in reader.connections if c.topic == "/pam/measured/joint_states")
        assert connection.digest.startswith("RIHS01_a13ee3a330e346c9")


@pytest.mark.parametrize("kind", ["folder", "file", "dangling link"])
def test_nothing_is_overwritten(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "bag"
    if kind == "folder":
        path.mkdir()
    elif kind == "file":
        path.write_text("mine")
    else:
        path.symlink_to(tmp_path / "gone")
    with pytest.raises(BadInput, match="bag: exists already, and nothing is overwritten"):
        BagWriter(path)
    with pytest.raises(BadInput, match="exists already"):
        write_bag(path, make_recording())
    assert path.is_symlink() or (path.read_text() == "mine" if kind == "file" else not any(path.iterdir()))


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match=r"file/bag: cannot be made \("):
        BagWriter(tmp_path / "file" / "bag")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_topics_keep_their_type(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/pam/pressure_1", FLUID)
        bag.add_topic("/pam/pressure_1", FLUID)
        with pytest.raises(BadInput, match="topic /pam/pressure_1 is a sensor_msgs/msg/FluidPressure, cannot also be"):
            bag.add_topic("/pam/pressure_1", "sensor_msgs/msg/JointState")
        with pytest.raises(BadInput, match="message type 'foo/msg/Bar' of /x is unknown"):
            bag.write("/x", "foo/msg/Bar", 1, b"")
    with Reader(tmp_path / "bag") as reader:
        assert [(c.topic, c.msgcount) for c in reader.connections] == [("/pam/pressure_1", 0)]


def test_messages_of_many_threads_all_arrive(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    with BagWriter(tmp_path / "bag") as bag:

        def send(topic: str) -> None:
            for log_ns, data in streams[topic].items:
                bag.write(topic, streams[topic].type, log_ns, data)

        threads = [threading.Thread(target=send, args=(topic,)) for topic in streams]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    rig.assert_same(read_bag(tmp_path / "bag"))


def test_an_exception_loses_nothing(rig: FakeRig, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "bag") as bag:
        for topic, stream in rig.streams().items():
            for log_ns, data in stream.items:
                bag.write(topic, stream.type, log_ns, data)
        raise KeyboardInterrupt
    rig.assert_same(read_bag(tmp_path / "bag"))
    bag.close()
    with pytest.raises(ValueError, match="bag is closed"):
        bag.write("/pam/pressure_1", FLUID, 1, b"")


def test_a_long_recording_is_written_part_by_part_in_the_order_of_its_times(
    rig: FakeRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bag is the same, its memory is not; and progress is told as messages are written."""
    recording, shares = read_bag(rig.write(tmp_path / "bag", rig.streams())), list[float]()
    written = []
    for part in (7, 1 << 16):
        monkeypatch.setattr("pam_antagonist.recording.writer._PART", part)
        shares.clear()
        write_bag(tmp_path / str(part), recording, progress=shares.append)
        assert sum(shares) == pytest.approx(1.0) and len(shares) == -(-200 // part)
        rig.assert_same(read_bag(tmp_path / str(part)))
        written.append(messages(tmp_path / str(part)))
    assert written[0] == written[1]
    assert [log for log, _, _ in written[0]] == sorted(log for log, _, _ in written[0])


def messages(bag: Path) -> list[tuple[int, str, bytes]]:
    """All messages as they stand in a bag."""
    with Reader(bag) as reader:
        return [(log, connection.topic, bytes(data)) for connection, log, data in reader.messages()]
