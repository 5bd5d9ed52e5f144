"""Messages: CDR as arrays, held against rosbags' message-by-message code; definitions; the topic table."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype

from pam_antagonist.recording.cdr import LATER, CdrError, decode, encode, stores_of, typestore
from pam_antagonist.recording.raw import Payloads

JOINT = "sensor_msgs/msg/JointState"
FLUID = "sensor_msgs/msg/FluidPressure"
ESTIMATE = "pam_antagonist_msgs/msg/JointEstimate"

floats = st.floats(width=64)
joint_states = st.tuples(
    st.integers(-(2**31), 2**31 - 1),
    st.integers(0, 10**9 - 1),
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=5),
    st.lists(st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=4), max_size=3),
    st.lists(floats, max_size=3),
    st.lists(floats, max_size=2),
    st.lists(floats, max_size=2),
    st.booleans(),
)


def header(sec: int, nanosec: int, frame: str):
    types = typestore().types
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](sec, nanosec), frame)


@settings(max_examples=150)
@given(st.lists(joint_states, min_size=1, max_size=6))
def test_any_mix_of_layouts_decodes_like_message_by_message(messages) -> None:
    payloads = []
    for sec, nanosec, frame, names, position, velocity, effort, little in messages:
        arrays = (np.array(values, np.float64) for values in (position, velocity, effort))
        message = typestore().types[JOINT](header(sec, nanosec, frame), names, *arrays)
        payloads.append(bytes(typestore().serialize_cdr(message, JOINT, little_endian=little)))
    decoded = decode(Payloads.of(payloads), JOINT)
    seen = []
    for group in decoded.groups:
        for k, row in enumerate(group.rows):
            sec, nanosec, frame, names, position, velocity, effort, _ = messages[row]
            seen.append(row)
            assert group.columns["header.stamp.sec"][k] == sec
            assert group.columns["header.stamp.nanosec"][k] == nanosec
            assert group.columns["header.frame_id"][k] == frame.encode()
            assert [group.columns[f"name[{i}]"][k].decode() for i in range(group.counts["name"])] == names
            for field, values in (("position", position), ("velocity", velocity), ("effort", effort)):
                np.testing.assert_array_equal(group.columns[field][k], np.array(values, np.float64))
    assert sorted(seen) == list(range(len(messages)))


PLAIN = bytes(encode(FLUID, 1, {"header.stamp.sec": 1, "header.stamp.nanosec": 2, "header.frame_id": "joint",
                                "fluid_pressure": 1.0, "variance": 0.0})[0])  # fmt: skip


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"\0\1\0", "message 1 has 3 bytes"),
        (b"\0\7" + PLAIN[2:], "message 1 begins with 0x0007"),
        (PLAIN[:-8], "message 1 ends after 36 bytes, where variance needs 44"),
        (PLAIN + bytes(8), "message 1 is 8 bytes longer"),
        (PLAIN[:12] + b"\xff\xff\xff\x7f" + PLAIN[16:], "header.frame_id needs 2147483663"),
        (PLAIN[:21] + b"x" + PLAIN[22:], "does not end with a zero byte"),
    ],
)
def test_damaged_payload_is_named(payload: bytes, said: str) -> None:
    with pytest.raises(CdrError, match=said):
        decode(Payloads.of([PLAIN, payload]), FLUID)


def test_absurd_counts_are_refused_before_anything_is_allocated() -> None:
    columns = {"header.stamp.sec": 1, "header.stamp.nanosec": 2, "header.frame_id": "", "name": []}
    arrays = {"position": np.empty((1, 0)), "velocity": np.empty((1, 0)), "effort": np.empty((1, 0))}
    raw = encode(JOINT, 1, {**columns, **arrays})[0].tobytes()
    for position in range(20, len(raw), 4):  # each of the four counts in turn
        with pytest.raises(CdrError):
            decode(Payloads.of([raw[:position] + b"\xff\xff\xff\xff" + raw[position + 4 :]]), JOINT)


def test_messages_as_fast_dds_serializes_them() -> None:
    """rclpy's serialize_message: what is in the gaps is left over, and the length is an upper bound."""
    empty = bytes.fromhex(
        "00010000 00000000 00000000 06000000 6a6f696e 74005f74 00000000 00000000 00000000 00000000"
        "7470735f 632e736f 00000000"
    )
    group = decode(Payloads.of([empty]), JOINT).groups[0]
    assert group.columns["header.frame_id"][0] == b"joint"
    assert group.counts == {"name": 0, "position": 0, "velocity": 0, "effort": 0}
    two_names = bytes.fromhex(
        "00010000 00000000 00000000 06000000 6a6f696e 74000000 02000000 02000000 6100728f 04000000 62636400 02000000"
        "70617273 00000000 0000f03f 00000000 00000040 00000000 00000000 72080000 00723500"
    )
    group = decode(Payloads.of([two_names]), JOINT).groups[0]
    assert [group.columns[f"name[{i}]"][0] for i in (0, 1)] == [b"a", b"bcd"]
    np.testing.assert_array_equal(group.columns["position"], [[1.0, 2.0]])
    assert group.columns["effort"].shape == (1, 0)
    valve = bytes.fromhex(
        "00010000 00000000 00000000 06000000 6a6f696e 74007367 3a3a6464 00000000 0000f03f 00000000 00000040"
    )
    decoded = decode(Payloads.of([valve]), "pam_antagonist_msgs/msg/ValveCommand")
    np.testing.assert_array_equal(decoded.fixed("voltage"), [[1.0, 2.0]])


def test_nanoseconds_of_a_second_are_refused() -> None:
    payload = PLAIN[:8] + (10**9).to_bytes(4, "little") + PLAIN[12:]
    with pytest.raises(CdrError, match=r"message 0: header.stamp.nanosec is 1000000000"):
        decode(Payloads.of([payload]), FLUID).stamp_ns("header.stamp")


def test_a_thousand_layouts_are_no_recording() -> None:
    columns = {"header.stamp.sec": 1, "header.stamp.nanosec": 2, "fluid_pressure": 1.0, "variance": 0.0}
    texts = ["x" * size for size in range(1002)]
    payloads = [encode(FLUID, 1, {**columns, "header.frame_id": text})[0].tobytes() for text in texts]
    decoded = decode(Payloads.of(payloads[:1000]), FLUID)
    assert len(decoded.groups) == 1000 and np.all(decoded.fixed("fluid_pressure") == 1.0)
    with pytest.raises(CdrError, match="has a layout of its own, as 1000 before it"):
        decode(Payloads.of(payloads), FLUID)


VALVE = "pam_antagonist_msgs/msg/ValveCommand"


def test_valve_command_has_the_hash_of_existing_recordings(rig_a: Path) -> None:
    metadata = yaml.safe_load((rig_a / "nominal" / "free" / "metadata.yaml").read_text())
    topics = metadata["rosbag2_bagfile_information"]["topics_with_message_count"]
    hashes = {entry["topic_metadata"]["type"]: entry["topic_metadata"]["type_description_hash"] for entry in topics}
    assert VALVE in hashes
    for msgtype, digest in hashes.items():
        assert typestore().hash_rihs01(msgtype) == digest


def test_topic_table_needs_no_bag_library() -> None:
    code = (
        "import sys, pam_antagonist.recording as r; r.TOPICS; print('rosbags' in sys.modules or 'numpy' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"


@pytest.mark.parametrize(
    ("digest", "definition", "differs"),
    [
        ("", "", False), (typestore().hash_rihs01(VALVE), "", False), ("RIHS01_" + "0" * 64, "", True),
        ("", typestore().generate_msgdef(VALVE, ros_version=2)[0], False),
        ("", "std_msgs/Header header\nfloat64[3] voltage\n", True),
        ("", "std_msgs/Header header\nfloat32[2] voltage\n", True), ("", "@@@", False),
    ],
)  # fmt: skip
def test_other_definitions_are_noticed(digest: str, definition: str, differs: bool) -> None:
    assert (stores_of(VALVE, digest, definition) == ()) is differs


@pytest.mark.parametrize("msgtype", LATER)
def test_a_former_definition_is_taken_where_the_bag_declares_it_or_the_length_fits(msgtype: str) -> None:
    old, new = typestore(former=True), typestore()
    assert stores_of(msgtype, old.hash_rihs01(msgtype), "") == (old,)
    assert stores_of(msgtype, "", old.generate_msgdef(msgtype, ros_version=2)[0]) == (old,)
    assert stores_of(msgtype, new.hash_rihs01(msgtype), "") == (new,)
    undeclared = stores_of(msgtype, "", "")
    assert undeclared == (new, old)
    for store in (old, new):
        time = store.types["builtin_interfaces/msg/Time"](1, 2)
        values: dict[str, Any] = {"header": store.types["std_msgs/msg/Header"](time, "ab"), "started": time}
        numbers = []
        for name, (kind, what) in store.fielddefs[msgtype][1]:
            if name in values:
                continue
            element = what[0] if kind == Nodetype.BASE else what[0][1][0]
            if element == "string":
                values[name] = "1" if kind == Nodetype.BASE else ["1"]
            else:
                values[name] = 1 if kind == Nodetype.BASE else np.ones(what[1] or 1, element)
                numbers.append(name)
        fields = {name: values[name] for name, _ in store.fielddefs[msgtype][1]}
        data = Payloads.of([bytes(store.serialize_cdr(store.types[msgtype](**fields), msgtype))])
        decoded = decode(data, msgtype, undeclared)
        for name in numbers:
            assert np.all(decoded.fixed(name) == 1)
        assert decoded.has(LATER[msgtype][0]) is (store is new)
        cut = Payloads.of([data.data[:-9].tobytes()])
        with pytest.raises(CdrError, match="needs"):
            decode(cut, msgtype, undeclared)
