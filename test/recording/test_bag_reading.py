"""Bags of every kind are read to the same arrays."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pytest
from fake_bags import ESTIMATE, FIRST_NS, JOINT, PERIOD_NS, REFERENCE, FakeRig, Stream

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import bag_hash, read_bag
from pam_antagonist.recording.cdr import typestore
from pam_antagonist.recording.corrections import Corrections


@pytest.mark.parametrize(
    ("storage", "compression"),
    [("mcap", "none"), ("mcap", "chunk"), ("mcap", "message"), ("mcap", "file")]
    + [("sqlite3", "none"), ("sqlite3", "message"), ("sqlite3", "file")],
)
def test_storages_and_compressions(rig: FakeRig, tmp_path: Path, storage: str, compression: str) -> None:
    recording = read_bag(rig.write(tmp_path / "bag", rig.streams(), storage=storage, compression=compression))
    rig.assert_same(recording)
    assert recording.issues == ()
    assert recording.path == tmp_path / "bag"
    assert recording.estimate is None and recording.reference is None
    np.testing.assert_array_equal(recording.received_ns["pressure_2"].log_ns, rig.stamp_ns + 150_000)
    np.testing.assert_array_equal(recording.received_ns["pressure_2"].stamp_ns, rig.stamp_ns)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_files_without_metadata(rig: FakeRig, tmp_path: Path, storage: str) -> None:
    bag = rig.write(tmp_path / "bag", rig.streams(), storage=storage)
    rig.assert_same(read_bag(bag / "metadata.yaml"))
    (bag / "metadata.yaml").unlink()
    file = next(bag.iterdir())
    bare = read_bag(file)
    rig.assert_same(bare)
    assert bare.issues == ()
    folder = read_bag(bag)
    rig.assert_same(folder)
    assert len(folder.issues) == 1 and "no metadata.yaml" in folder.issues[0]


@pytest.mark.parametrize("namespace", ["", "/lab/left", "/pam"])
def test_namespace_is_found(rig: FakeRig, tmp_path: Path, namespace: str) -> None:
    recording = read_bag(rig.write(tmp_path / "bag", rig.streams(namespace)))
    rig.assert_same(recording)
    assert recording.topics["measured_joint_states"] == f"{namespace}/measured/joint_states"


def test_two_rigs_in_one_bag_want_a_choice(rig: FakeRig, tmp_path: Path) -> None:
    other = FakeRig()
    other.pressure = other.pressure + 1e3
    bag = rig.write(tmp_path / "bag", rig.streams("/left") | other.streams("/right"))
    with pytest.raises(BadInput, match=r"several namespaces hold such topics \(/left, /right\)"):
        read_bag(bag)
    rig.assert_same(read_bag(bag, namespace="left"))
    other.assert_same(read_bag(bag, namespace="/right/"))


def test_missing_messages_are_nan(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    del streams["/pam/pressure_2"].items[3:5]
    del streams["/pam/valve_state"].items[7]
    del streams["/pam/measured/joint_states"].items[9]
    recording = read_bag(rig.write(tmp_path / "bag", streams))
    np.testing.assert_array_equal(recording.stamp_ns, rig.stamp_ns)
    assert np.flatnonzero(np.isnan(recording.pressure[:, 1])).tolist() == [3, 4]
    assert not np.any(np.isnan(recording.pressure[:, 0]))
    assert np.flatnonzero(np.isnan(recording.voltage).any(axis=1)).tolist() == [7]
    assert np.flatnonzero(np.isnan(recording.angle)).tolist() == [9]
    assert "2 of 40 samples without /pam/pressure_2" in recording.issues
    assert "1 of 40 samples without /pam/valve_state" in recording.issues


def test_values_that_are_not_finite_are_nan(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    for i, value in ((2, np.nan), (5, np.inf), (6, -np.inf)):
        streams["/pam/pressure_1"].items[i] = rig.pressure_message(rig.stamp_ns[i], value)
    streams["/pam/valve_state"].items[4] = rig.valve_message(rig.stamp_ns[4], [np.nan, 5.0])
    recording = read_bag(rig.write(tmp_path / "bag", streams))
    assert np.flatnonzero(np.isnan(recording.pressure[:, 0])).tolist() == [2, 5, 6]
    assert np.isnan(recording.voltage[4, 0]) and recording.voltage[4, 1] == 5.0
    assert "3 of 40 values of pressure on /pam/pressure_1 are not finite: left out" in recording.issues


def test_repeated_stamps_keep_the_first_message(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    stamp = rig.stamp_ns[6]
    streams["/pam/pressure_1"].items.append(rig.pressure_message(stamp, 123e3, log_ns=int(stamp) + 400_000))
    recording = read_bag(rig.write(tmp_path / "bag", streams))
    rig.assert_same(recording)
    (said,) = recording.issues
    assert "1 messages of /pam/pressure_1 repeat a stamp: the first of each stamp was kept; 1 of them" in said
    assert (said.kind, said.size, round(said.start_s, 6)) == ("publishers", 1, 0.006)


def test_late_messages_are_sorted(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    log, data = streams["/pam/pressure_1"].items[6]
    streams["/pam/pressure_1"].items[6] = (log + 3 * PERIOD_NS + 1, data)
    recording = read_bag(rig.write(tmp_path / "bag", streams))
    rig.assert_same(recording)
    assert recording.issues == ("1 messages of /pam/pressure_1 came out of order, by 3 ms at most: sorted by stamp",)
    assert recording.received_ns["pressure_1"].log_ns[6] == log + 3 * PERIOD_NS + 1


def restarted(rig: FakeRig) -> dict[str, Stream]:
    """Half a second recorded ten seconds later than the rest, but received before it."""
    streams = rig.streams()
    early = FakeRig(7)
    early.pressure = early.pressure + 5e3
    early.stamp_ns = early.stamp_ns + 10**10
    for topic, stream in early.streams().items():
        streams[topic].items.extend((log - 2 * 10**10, data) for log, data in stream.items)
    return streams


def test_last_restart_is_read_on_request(rig: FakeRig, tmp_path: Path) -> None:
    streams = restarted(rig)
    bag = rig.write(tmp_path / "bag", streams)
    with pytest.raises(BadInput, match="runs backwards on /pam/pressure_1, message 7 is stamped 17800000"):
        read_bag(bag)
    recording = read_bag(bag, restarts="last")
    rig.assert_same(recording)
    assert recording.issues == ("time runs backwards in the recording: read what follows the last restart",)
    with pytest.raises(ValueError, match="restarts is 'first'"):
        read_bag(bag, restarts="first")


def test_several_joints(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    names = ["elbow", "wrist"]
    for i, stamp in enumerate(rig.stamp_ns):
        order = [0, 1] if i % 2 else [1, 0]
        position, effort = np.array([[rig.angle[i], 1.0], [rig.torque[i], 2.0]])[:, order]
        message = rig.joint_message(stamp, position, effort, [names[k] for k in order])
        streams["/pam/measured/joint_states"].items[i] = message
    bag = rig.write(tmp_path / "bag", streams)
    rig.assert_same(read_bag(bag, joint_name="elbow"))
    with pytest.raises(BadInput, match=r"joint_states holds 2 joints \(elbow, wrist\).*type --joint-name"):
        read_bag(bag)
    with pytest.raises(BadInput, match="has no joint 'knee'; it has elbow, wrist"):
        read_bag(bag, joint_name="knee")
    streams["/pam/joint_states"] = Stream(JOINT, [rig.joint_message(rig.stamp_ns[0], [0.0], [0.0], ["elbow"])])
    recording = read_bag(rig.write(tmp_path / "live", streams))  # the estimator tells which joint is this one
    rig.assert_same(recording)
    assert "took elbow, the joint of the estimator" in recording.issues[0]


def test_joints_that_publish_by_themselves_are_no_second_publisher(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    items = streams["/pam/measured/joint_states"].items = []
    for stamp, angle, torque in zip(rig.stamp_ns, rig.angle, rig.torque, strict=True):
        items.append(rig.joint_message(stamp, [1.0], [2.0], ["wrist"]))
        items.append(rig.joint_message(stamp, [angle], [torque], ["elbow"]))
    recording = read_bag(rig.write(tmp_path / "bag", streams), joint_name="elbow")
    rig.assert_same(recording)
    assert recording.issues == ()


def test_joint_states_without_effort_or_names(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    streams["/pam/measured/joint_states"].items = [
        rig.joint_message(stamp, [angle], [], name=()) for stamp, angle in zip(rig.stamp_ns, rig.angle, strict=True)
    ]
    recording = read_bag(rig.write(tmp_path / "bag", streams))
    np.testing.assert_array_equal(recording.angle, rig.angle)
    assert recording.torque is None
    assert recording.issues == ("/pam/measured/joint_states holds no torque (field effort)",)


def test_encoder_with_stamps_of_its_own_is_interpolated(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    stamps = FIRST_NS + 300_000 + 2 * PERIOD_NS * np.arange(12)
    stamps = np.concatenate([stamps[:6], stamps[6:] + 40 * PERIOD_NS])  # with a gap
    ramp = (stamps - FIRST_NS) * 1e-9
    streams["/pam/measured/joint_states"].items = [
        rig.joint_message(stamp, [value], []) for stamp, value in zip(stamps, ramp, strict=True)
    ]
    recording = read_bag(rig.write(tmp_path / "bag", streams))
    expected = (rig.stamp_ns - FIRST_NS) * 1e-9
    outside = (rig.stamp_ns < stamps[0]) | ((rig.stamp_ns > stamps[5]) & (rig.stamp_ns < stamps[6]))
    assert np.count_nonzero(outside) == 30
    np.testing.assert_allclose(recording.angle, np.where(outside, np.nan, expected), atol=1e-12)
    assert (
        "position on /pam/measured/joint_states has stamps of its own: interpolated at the samples" in recording.issues
    )


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("former", [False, True])
def test_estimate_and_reference(rig: FakeRig, tmp_path: Path, former: bool, storage: str) -> None:
    """Also of a bag from before the messages had the torque from outside and the stiffness: those are not known."""
    streams = rig.streams()
    rig.store = typestore(former=former)
    time = typestore().types["builtin_interfaces/msg/Time"](1_780_000_000, 122_000_000)
    estimates, references = Stream(ESTIMATE), Stream(REFERENCE)
    for i, stamp in enumerate(rig.stamp_ns):
        fields = {"angle": 0.1 * i, "velocity": 0.2 * i, "torque": 0.3 * i, "covariance": np.arange(9.0) + i,
                  "pressure": np.array([1.0, 2.0]) * i, "force": np.array([3.0, 4.0]) * i, "stiffness": 5.0 * i,
                  "innovation": np.array([np.nan, 6.0]), "innovation_covariance": np.arange(4.0) - i, "nis": 7.0 * i,
                  "subsystem": i % 18 + 1, "flags": i % 128}  # fmt: skip
        if not former:
            fields |= {"external_torque": 8.0 * i, "external_torque_covariance": np.arange(4.0) + i}
        estimates.items.append(rig.message(ESTIMATE, stamp, started=time, **fields))
    more = {} if former else {"stiffness": 9.0, "damping": 0.25}
    references.items.append(rig.message(REFERENCE, FIRST_NS, mode=1, value=0.5, **more))
    references.items.append(rig.message(REFERENCE, 0, mode=0, value=-0.25, log_ns=FIRST_NS + 200_000, **more))
    streams |= {"/pam/joint_estimate": estimates, "/pam/reference": references}
    recording = read_bag(rig.write(tmp_path / "bag", streams, storage=storage))
    estimate, steps = recording.estimate, np.arange(rig.size)
    np.testing.assert_array_equal(estimate.stamp_ns, rig.stamp_ns)
    assert np.all(estimate.started_ns == 1_780_000_000_122_000_000)
    np.testing.assert_array_equal(estimate.torque, [0.3 * i for i in steps])
    np.testing.assert_array_equal(estimate.covariance[:, 1, 2], 5.0 + steps)
    np.testing.assert_array_equal(estimate.innovation_covariance[:, 1, 0], 2.0 - steps)
    np.testing.assert_array_equal(estimate.force, np.outer(steps, [3.0, 4.0]))
    assert np.all(np.isnan(estimate.innovation[:, 0])) and np.all(estimate.innovation[:, 1] == 6.0)
    np.testing.assert_array_equal(estimate.subsystem, steps % 18 + 1)
    np.testing.assert_array_equal(estimate.flags, steps % 128)
    np.testing.assert_array_equal(recording.reference.stamp_ns, [FIRST_NS, FIRST_NS + 200_000])
    np.testing.assert_array_equal(recording.reference.mode, [1, 0])
    np.testing.assert_array_equal(recording.reference.value, [0.5, -0.25])
    nothing = np.nan * steps
    np.testing.assert_array_equal(estimate.external_torque, nothing if former else 8.0 * steps)
    np.testing.assert_array_equal(estimate.external_torque_covariance[:, 3], nothing if former else 3.0 + steps)
    np.testing.assert_array_equal(recording.reference.stiffness, [np.nan if former else 9.0] * 2)
    np.testing.assert_array_equal(recording.reference.damping, [np.nan if former else 0.25] * 2)


def test_a_validation_topic_of_another_type_is_left_out_and_said(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    streams["/pam/measured/joint_states"] = streams["/pam/valve_state"]
    recording = read_bag(rig.write(tmp_path / "bag", streams))
    assert recording.angle is None
    assert recording.issues == (
        f"topic /pam/measured/joint_states is a pam_antagonist_msgs/msg/ValveCommand, expected {JOINT}: left out",
    )


def test_rare_outliers_stay_and_are_counted(rig: FakeRig, tmp_path: Path) -> None:
    rig.pressure[5, 0] = 0.0
    rig.voltage[6, 1] = 12.0
    recording = read_bag(rig.write(tmp_path / "bag", rig.streams()))
    rig.assert_same(recording)
    assert len(recording.issues) == 2
    assert "1 of 40 values on /pam/pressure_1 lie outside 50 to 2000 kPa absolute: kept" in recording.issues[0]
    assert "1 of 80 values on /pam/valve_state lie outside -10 to 10 V: kept" in recording.issues[1]


def test_hash_is_that_of_the_message_file(rig: FakeRig, tmp_path: Path) -> None:
    bag = rig.write(tmp_path / "bag", rig.streams())
    digest = hashlib.sha256((bag / "bag.mcap").read_bytes()).hexdigest()
    assert bag_hash(bag) == bag_hash(bag / "bag.mcap") == digest
    shutil.copytree(bag, tmp_path / "other")
    (tmp_path / "other" / "metadata.yaml").write_text((bag / "metadata.yaml").read_text() + "\n")
    assert bag_hash(tmp_path / "other") == digest
    rig.pressure[0, 0] += 1.0
    assert bag_hash(rig.write(tmp_path / "third", rig.streams())) != digest


def string_message(text: bytes, little_endian: bool = True) -> bytes:
    order = "little" if little_endian else "big"
    return bytes([0, int(little_endian), 0, 0]) + (len(text) + 1).to_bytes(4, order) + text + b"\0"


@pytest.mark.parametrize(("storage", "compression"), [("mcap", "chunk"), ("mcap", "message"), ("sqlite3", "none")])
def test_what_nodes_said_about_their_rigs(rig: FakeRig, tmp_path: Path, storage: str, compression: str) -> None:
    told = [b'{"node": "plant"}', b'{"node": "estimator"}', "µ".encode(), b'{"node": "plant"}']
    items = [(int(rig.stamp_ns[9 - k]), string_message(text, bool(k % 2))) for k, text in enumerate(told)]
    streams = rig.streams("/lab") | {"/lab/rig": Stream("std_msgs/msg/String", items)}
    streams |= {"/other/rig": Stream("std_msgs/msg/String", [(FIRST_NS, string_message(b"not ours"))])}
    recording = read_bag(rig.write(tmp_path / "bag", streams, storage=storage, compression=compression))
    rig.assert_same(recording)
    assert recording.rigs == ('{"node": "plant"}', "µ", '{"node": "estimator"}')  # in the order of reception
    assert recording.issues == () and "rig" not in recording.topics
    assert recording.slice(0.0, 0.01).rigs == recording.rigs


@pytest.mark.parametrize("data", [b"", b"\0", b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\xff", b"\0\1\0\0\0\0\0\0abc"])
def test_a_text_that_is_none_is_passed_over(rig: FakeRig, tmp_path: Path, data: bytes) -> None:
    streams = rig.streams() | {"/pam/rig": Stream("std_msgs/msg/String", [(FIRST_NS, data)])}
    assert read_bag(rig.write(tmp_path / "bag", streams)).rigs == ()


def test_an_absolute_encoder_is_named_and_unwrapped_on_request(rig: FakeRig, tmp_path: Path) -> None:
    rig.angle = 0.3 * np.sin(0.3 * np.arange(rig.size))
    streams = rig.streams()
    streams["/pam/measured/joint_states"].items = [
        rig.joint_message(stamp, [angle % (2.0 * np.pi)], [torque])
        for stamp, angle, torque in zip(rig.stamp_ns, rig.angle, rig.torque, strict=True)
    ]
    bag = rig.write(tmp_path / "bag", streams)
    with pytest.raises(BadInput, match="jumps by a turn, as an absolute encoder.*type --unwrap-angle"):
        read_bag(bag)
    np.testing.assert_allclose(read_bag(bag, corrections=Corrections(unwrap_angle=True)).angle, rig.angle, atol=1e-12)
