"""Topics with clocks of their own, and topics with two publishers: named, and refused where a result would be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fake_bags import PERIOD_NS, FakeRig

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import read_bag
from pam_antagonist.recording.corrections import Corrections

JOINT = "/pam/measured/joint_states"
SAMPLES = ("/pam/pressure_1", "/pam/pressure_2", "/pam/valve_state")


@pytest.fixture
def rig() -> FakeRig:
    """A joint that moves smoothly, so that interpolated values can be compared."""
    rig = FakeRig(600)
    time = rig.stamp_ns - rig.stamp_ns[0]
    rig.angle, rig.torque = 0.2 * np.sin(time * 8e-9), np.cos(time * 8e-9)
    rig.pressure = 400e3 + 50e3 * np.sin(time[:, None] * np.array([5e-9, 7e-9]))
    rig.voltage = 5.0 + np.sin(time[:, None] * np.array([3e-9, 4e-9]))
    return rig


def items(rig: FakeRig, topic: str, shift_ns: int = 0, add: float = 0.0, late_ns: int = 150_000) -> list:
    """Messages of a topic, stamped by another clock, or with other values."""
    out = []
    for k, stamp in enumerate(rig.stamp_ns.tolist()):
        log, at = stamp + late_ns, stamp + shift_ns
        if topic == JOINT:
            out.append(rig.joint_message(at, [rig.angle[k] + add], [rig.torque[k]], log_ns=log))
        elif topic == "/pam/valve_state":
            out.append(rig.valve_message(at, rig.voltage[k] + add, log_ns=log))
        else:
            out.append(rig.pressure_message(at, rig.pressure[k, int(topic[-1]) - 1] + 1e3 * add, log_ns=log))
    return out


@pytest.mark.parametrize(
    ("shift_s", "other"),
    [
        (-1.78e9, (JOINT,)), (-0.4, SAMPLES), (0.4, (JOINT,)), (2.0, ("/pam/valve_state",)),
        (-40.0, ("/pam/pressure_2", JOINT)),
    ],
)  # fmt: skip
def test_different_clocks_are_named_and_can_be_aligned(
    rig: FakeRig, tmp_path: Path, shift_s: float, other: tuple[str, ...]
) -> None:
    streams = rig.streams()
    del streams["/pam/measured/external_torque"]
    for topic in other:
        streams[topic].items = items(rig, topic, round(shift_s * 1e9), late_ns=170_000)
    bag = rig.write(tmp_path / "bag", streams)
    try:
        (said,) = [issue for issue in read_bag(bag).issues if issue.kind == "clock"][-1:]
        assert abs(shift_s) < 1.0
    except BadInput as refused:
        said = str(refused)
        assert abs(shift_s) > 0.3 and ("--align-clocks" in said or "share a stamp" in said)
    if "share a stamp" not in said:
        assert "they are stamped by different clocks" in said and "type --align-clocks" in said
    recording = read_bag(bag, corrections=Corrections(align_clocks=True))
    assert len(recording) == rig.size and np.isfinite(recording.voltage).all() and np.isfinite(recording.pressure).all()
    np.testing.assert_allclose(recording.angle[2:-2], rig.angle[2:-2], atol=1e-4)
    np.testing.assert_array_equal(recording.pressure, rig.pressure)
    assert any("--align-clocks" in issue for issue in recording.issues)


def test_a_clock_that_drifts_is_aligned_and_one_that_jumps_is_refused(rig: FakeRig, tmp_path: Path) -> None:
    since = rig.stamp_ns - rig.stamp_ns[0]
    drift, jump = 5 * 10**9 + since // 2, 3 * 10**9 * (since > since[300])
    for name, shift in (("drift", drift), ("jump", jump)):
        streams = rig.streams()
        streams[JOINT].items = [
            rig.joint_message(stamp + late, [angle], [0.0], log_ns=int(stamp) + 150_000)
            for stamp, late, angle in zip(rig.stamp_ns, shift, rig.angle, strict=True)
        ]
        rig.write(tmp_path / name, streams)
        with pytest.raises(BadInput, match="s at the beginning and .* s at the end later than .*type --align-clocks"):
            read_bag(tmp_path / name)
    aligned = read_bag(tmp_path / "drift", corrections=Corrections(align_clocks=True))
    np.testing.assert_allclose(aligned.angle[2:-2], rig.angle[2:-2], atol=1e-4)
    with pytest.raises(BadInput, match="has a clock that jumps"):
        read_bag(tmp_path / "jump", corrections=Corrections(align_clocks=True))


@pytest.mark.parametrize("topic", ["/pam/pressure_2", "/pam/valve_state", JOINT])
@pytest.mark.parametrize("shift_ns", [200_000, None])
def test_topics_without_shared_stamps_are_paired_on_request(
    rig: FakeRig, tmp_path: Path, topic: str, shift_ns: int | None
) -> None:
    streams = rig.streams()
    if shift_ns is None:  # never stamped
        other = FakeRig(0)
        for name in ("angle", "torque", "pressure", "voltage"):
            setattr(other, name, getattr(rig, name))
        other.stamp_ns = np.zeros(rig.size, np.int64)
        streams[topic].items = [
            (int(stamp) + 150_000, data) for stamp, (_, data) in zip(rig.stamp_ns, items(other, topic), strict=True)
        ]
    else:
        streams[topic].items = items(rig, topic, shift_ns)
    bag = rig.write(tmp_path / "bag", streams)
    if shift_ns is None or topic != JOINT:
        with pytest.raises(BadInput, match="type --align-clocks"):
            read_bag(bag)
    recording = read_bag(bag, corrections=Corrections(align_clocks=True))
    np.testing.assert_array_equal(recording.pressure, rig.pressure)
    np.testing.assert_array_equal(recording.voltage, rig.voltage)
    np.testing.assert_allclose(recording.angle[2:-2], rig.angle[2:-2], atol=1e-3)


def test_a_bag_without_times_of_reception_names_another_clock(rig: FakeRig, tmp_path: Path) -> None:
    streams = rig.streams()
    streams[JOINT].items = [(log - 10**18, data) for log, data in items(rig, JOINT, -(10**18))]
    recording = read_bag(rig.write(tmp_path / "bag", streams))
    assert recording.angle is None
    assert recording.issues[0].kind == "clock" and "different clocks, or another time" in recording.issues[0]


@pytest.mark.parametrize("topic", [*SAMPLES, JOINT])
def test_two_publishers_are_refused_where_they_contradict_and_noted_where_they_agree(
    rig: FakeRig, tmp_path: Path, topic: str
) -> None:
    for name, add in (("agree", 0.0), ("contradict", 0.5)):
        streams = rig.streams()
        streams[topic].items = items(rig, topic, add=add, late_ns=100_000) + streams[topic].items
        rig.write(tmp_path / name, streams)
    recording = read_bag(tmp_path / "agree")
    rig.assert_same(recording)
    assert [(issue.kind, issue.size) for issue in recording.issues] == [("repeated", 600)]
    with pytest.raises(BadInput, match=f"{topic} seems to have two publishers that contradict each other"):
        read_bag(tmp_path / "contradict")


@pytest.mark.parametrize(("topic", "first_ns"), [(JOINT, 0), (JOINT, PERIOD_NS // 4), ("/pam/pressure_2", 0)])
def test_two_publishers_with_stamps_of_their_own(rig: FakeRig, tmp_path: Path, topic: str, first_ns: int) -> None:
    for add, refused in ((10.0 if topic != JOINT else 0.5, True), (0.0, False)):
        streams = rig.streams()
        streams[topic].items = items(rig, topic, first_ns) + items(rig, topic, PERIOD_NS // 2, add=add)
        bag = rig.write(tmp_path / f"bag_{add}", streams)
        if refused:
            with pytest.raises(BadInput, match="two publishers that contradict each other.*: messages that follow"):
                read_bag(bag)
        else:
            read_bag(bag)


def test_issues_are_sorted_by_weight(rig: FakeRig, tmp_path: Path) -> None:
    rig.stamp_ns = rig.stamp_ns + 10**9 * (np.arange(rig.size) >= 300)
    streams = rig.streams()
    streams["/pam/pressure_1"].items.insert(0, rig.pressure_message(0, 4e5, log_ns=int(rig.stamp_ns[0])))
    streams[JOINT].items = items(rig, JOINT, 400_000_000)
    found = read_bag(rig.write(tmp_path / "bag", streams)).issues
    assert [issue.kind for issue in found] == ["clock", "hole", "missing", "missing", "unstamped"]
    assert (found[1].size, round(found[1].start_s, 3), round(found[1].length_s, 3)) == (1000, 0.299, 1.001)
