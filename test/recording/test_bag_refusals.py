"""What is no usable recording is refused in one line that says what, where and what was expected."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_bags import FLUID, FakeRig, Stream, refusal

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import read_bag

TEXT = b"t_s,torque_Nm\n0.0,1.0\n"


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("gone", None, "there is no such bag"),
        ("notes.txt", TEXT, "neither MCAP nor sqlite3, expected a folder with metadata.yaml"),
        ("free.mcap", TEXT, "neither MCAP nor sqlite3, expected a folder with metadata.yaml"),
        ("free.db3", TEXT, "neither MCAP nor sqlite3, expected a folder with metadata.yaml"),
        ("old.bag", b"#ROSBAG V2.0\n", "ROS 1 bag"),
        ("bag.mcap", b"", "is empty"),
        ("bag.db3", b"", "is empty"),
        ("", None, "not a rosbag2, expected a folder with metadata.yaml"),
    ],
)
def test_what_is_no_bag(tmp_path: Path, name: str, content: bytes | None, said: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert said in refusal(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not readable as YAML"),
        ("", "not a rosbag2"),
        ("a: 1", "entry 'rosbag2_bagfile_information' is missing"),
        ("rosbag2_bagfile_information: 7", "not the metadata of a rosbag2"),
        ("rosbag2_bagfile_information:\n  relative_file_paths: []", "names no message files"),
        ("rosbag2_bagfile_information:\n  relative_file_paths: [gone.mcap]", "names 'gone.mcap', which is not there"),
        ("rosbag2_bagfile_information:\n  relative_file_paths: [3]", "not the metadata of a rosbag2"),
        ("[" * 1500, "not readable as YAML"),
        ("\xff\xfe\x00", "not readable as YAML"),
    ],
)
def test_metadata_that_makes_no_sense(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "metadata.yaml").write_bytes(text.encode("latin-1"))
    assert said in refusal(tmp_path)


Streams = dict[str, Stream]
P1, P2, JOINT = "/pam/pressure_1", "/pam/pressure_2", "/pam/measured/joint_states"


def of_somebody_else(rig: FakeRig, streams: Streams) -> Streams:
    return {f"/tank_{k}": streams[P1] for k in range(15)}


def another_payload(rig: FakeRig, streams: Streams) -> None:
    streams[P1].items[3] = (streams[P1].items[3][0], streams[JOINT].items[3][1])


def without_stamps(rig: FakeRig, streams: Streams) -> None:
    streams[P1].items = [rig.pressure_message(0, 4e5, log_ns=log) for log, _ in streams[P1].items]


def stamps_of_its_own(rig: FakeRig, streams: Streams) -> None:
    pairs = zip(rig.stamp_ns, rig.pressure[:, 1], strict=True)
    streams[P2].items = [rig.pressure_message(stamp + 1000, value) for stamp, value in pairs]


def joints_of(*names: str) -> Callable[[FakeRig, Streams], None]:
    def change(rig: FakeRig, streams: Streams) -> None:
        streams[JOINT].items = [rig.joint_message(stamp, [0.1, 0.2], [], names) for stamp in rig.stamp_ns]

    return change


TOPICS: dict[str, tuple[Callable[[FakeRig, Streams], Streams | None], tuple[str, ...]]] = {
    "no topics": (lambda rig, streams: {}, ("no samples, the bag holds no messages",)),
    "no messages": (lambda rig, streams: {P1: Stream(FLUID)}, ("no samples, the bag holds no messages",)),
    "an empty topic": (lambda rig, streams: streams[P2].items.clear(), (f"topic {P2} has no samples",)),
    "a missing topic": (
        lambda rig, streams: streams.pop(P2) and None,
        (f"topic {P2} is missing", f"{P1} (sensor_msgs/msg/FluidPressure)", "--topic pressure_2=/NAME"),
    ),
    "another bag": (of_somebody_else, (f"topic {P1} is missing", "/tank_0 (", "and 3 more")),
    "another type": (
        lambda rig, streams: streams.update({P1: streams[JOINT]}),
        (f"topic {P1} is a sensor_msgs/msg/JointState, expected sensor_msgs/msg/FluidPressure",),
    ),
    "a payload of another type": (
        another_payload,
        (f"{P1} cannot be read as sensor_msgs/msg/FluidPressure, message 3",),
    ),
    "no stamps": (without_stamps, (f"no message of {P1} carries a stamp",)),
    "two joints without names": (joints_of(), (f"{JOINT} holds 2 joints without names",)),
    "a joint that is named twice": (joints_of("a", "a"), ("names a twice in one message",)),
    "no shared stamps": (stamps_of_its_own, (f"{P1} and {P2} share a stamp in 0 of 80 samples",)),
}


@pytest.mark.parametrize(("change", "words"), TOPICS.values(), ids=TOPICS.keys())
def test_topics_that_make_no_recording(rig: FakeRig, tmp_path: Path, change: Any, words: tuple[str, ...]) -> None:
    streams = rig.streams()
    changed = change(rig, streams)
    text = refusal(rig.write(tmp_path / "bag", streams if changed is None else changed))
    assert all(word in text for word in words), text


def test_commands_are_not_taken_for_the_valve_state(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    streams["/pam/valve_command"] = streams.pop("/pam/valve_state")
    bag = rig.write(tmp_path / "bag", streams)
    assert "--topic valve_state=/pam/valve_command" in refusal(bag)
    rig.assert_same(read_bag(bag, topics={"valve_state": "/pam/valve_command"}))


def test_names_that_were_given_and_do_not_fit(rig: FakeRig, tmp_path: Path) -> None:
    bag = rig.write(tmp_path / "bag", rig.streams())
    text = refusal(bag, topics={"measured_joint_states": "/pam/valve_state"})
    assert "expected sensor_msgs/msg/JointState" in text
    assert "topic /gone is missing" in refusal(bag, topics={"pressure_1": "/gone"})
    assert "topic /lab/pressure_1 is missing" in refusal(bag, namespace="lab")
    with pytest.raises(BadInput, match="topic name 'presure_1' is unknown, expected one of pressure_1, pressure_2"):
        read_bag(bag, topics={"presure_1": "/x"})


def test_other_definition_of_a_message(rig: FakeRig, tmp_path: Path) -> None:
    bag = rig.write(tmp_path / "bag", rig.streams())
    text = (bag / "metadata.yaml").read_text()
    assert "RIHS01_ffe012138403d148" in text
    (bag / "metadata.yaml").write_text(text.replace("RIHS01_ffe012138403d148", "RIHS01_0000000000000000"))
    assert "topic /pam/valve_state was recorded with another definition" in refusal(bag)


@pytest.mark.parametrize("options", [{}, {"restarts": "last"}])
def test_time_that_creeps_backwards(rig: FakeRig, tmp_path: Path, options: dict[str, str]) -> None:
    streams = rig.streams()
    for topic in list(streams):
        log = [log for log, _ in streams[topic].items]
        streams[topic].items = [
            (time, rig.pressure_message(int(rig.stamp_ns[0]) - 100_000_000 * i, 4e5)[1])
            if topic == "/pam/pressure_1"
            else streams[topic].items[i]
            for i, time in enumerate(log)
        ]
    text = refusal(rig.write(tmp_path / "bag", streams), **options)
    assert "time runs backwards on /pam/pressure_1, message 6 is stamped" in text


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("pressure", lambda p: np.linspace(0.0, 3e5, len(p)), "; 2.97e+05 looks like gauge pressure"),
        ("pressure", lambda p: p / 1e3, "/pam/pressure_2 goes from 494.6 to 606.8 Pa absolute, which makes 0.49"),
        ("pressure", lambda p: p * np.nan, "/pam/pressure_2 holds no finite pressure"),
        ("voltage", lambda v: 11.5, "/pam/valve_state goes from 11.5 to 11.5 V, expected -10 to 10 V"),
        ("voltage", lambda x: 10.0 * x, "expected -10 to 10 V; 78.9 looks like percent"),
        ("voltage", lambda x: -1.0 * x, "expected -10 to 10 V; none is above 0: is the sign right?"),
        ("voltage", lambda v: np.nan, "/pam/valve_state holds no finite voltage"),
        ("angle", lambda x: 57.3 * x, "the position on /pam/measured/joint_states goes from -16.71"),
        ("torque", lambda x: 1000.0 * x, "the torque on /pam/measured/joint_states goes from -"),
        ("external", lambda x: 1e4 * x, "the torque about z on /pam/measured/external_torque goes from -"),
    ],
)
def test_values_in_another_unit(
    rig: FakeRig, tmp_path: Path, name: str, change: Callable[[np.ndarray], np.ndarray | float], said: str
) -> None:
    values = rig.pressure[:, 1] if name == "pressure" else getattr(rig, name)
    values[...] = change(values)
    assert said in refusal(rig.write(tmp_path / "bag", rig.streams()))


def test_vented_and_full_muscles_are_fine(rig: FakeRig, tmp_path: Path) -> None:
    rig.pressure[:20] = 101325.0
    rig.pressure[20:] = 850e3
    rig.voltage[:20], rig.voltage[20:] = 0.0, 10.0
    recording = read_bag(rig.write(tmp_path / "bag", rig.streams()))
    rig.assert_same(recording)
    assert recording.issues == ()


def test_files_of_several_bags_in_one_folder_are_no_bag(rig: FakeRig, tmp_path: Path) -> None:
    for name in ("monday", "tuesday"):
        rig.write(tmp_path / name, rig.streams())
    with pytest.raises(BadInput, match="expected a folder with metadata.yaml.*folders in it are: monday, tuesday"):
        read_bag(tmp_path)
    for name in ("monday", "tuesday"):
        (tmp_path / name / f"{name}.mcap").rename(tmp_path / f"{name}.mcap")
    with pytest.raises(BadInput, match=r"files of several bags \(monday.mcap, tuesday.mcap\)"):
        read_bag(tmp_path)


def test_names_without_a_slash_are_those_of_a_converted_bag(rig: FakeRig, tmp_path: Path) -> None:
    streams = {topic.lstrip("/"): stream for topic, stream in rig.streams().items()}
    rig.assert_same(read_bag(rig.write(tmp_path / "bag", streams)))
