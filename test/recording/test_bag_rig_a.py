"""The recordings of rig A, which another simulator made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from pam_antagonist.recording import bag_hash, read_bag, write_bag
from pam_antagonist.recording.joint import joint_condition
from pam_antagonist.recording.messages import typestore


@pytest.mark.parametrize("joint", ["free", "locked"])
def test_nominal(rig_a: Path, tmp_path: Path, joint: str) -> None:
    bag = rig_a / "nominal" / joint
    recording = read_bag(bag)
    assert recording.issues == ()
    assert len(recording) == 60_000
    assert recording.duration_s == pytest.approx(59.999)
    assert recording.sample_period_s == pytest.approx(1e-3)
    assert joint_condition(recording).condition == joint
    assert np.all(np.isfinite(recording.pressure)) and np.all(np.isfinite(recording.voltage))
    np.testing.assert_allclose(recording.pressure[:100].mean(axis=0), 450e3, rtol=0.01)
    assert len(bag_hash(bag)) == 64
    part = recording.slice(1.0, 3.0)
    write_bag(tmp_path / "part", part)
    np.testing.assert_array_equal(read_bag(tmp_path / "part").pressure, part.pressure)


def test_every_message_decodes_as_with_rosbags(rig_a: Path) -> None:
    bag = rig_a / "case_leak" / "free"
    recording = read_bag(bag)
    store, checked = typestore(), 0
    with Reader(bag) as reader:
        start = reader.start_time + 30 * 10**9
        for connection, _, raw in reader.messages(start=start, stop=start + 5 * 10**8):
            message = store.deserialize_cdr(raw, connection.msgtype)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            i = int(np.searchsorted(recording.stamp_ns, stamp))
            assert recording.stamp_ns[i] == stamp
            name = connection.topic.removeprefix("/pam/")
            if name.startswith("pressure"):
                assert recording.pressure[i, int(name[-1]) - 1] == message.fluid_pressure
            elif name == "valve_state":
                np.testing.assert_array_equal(recording.voltage[i], message.voltage)
            else:
                assert (recording.angle[i], recording.torque[i]) == (message.position[0], message.effort[0])
            checked += 1
    assert checked == 2000
