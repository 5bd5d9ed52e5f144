"""The recordings of rig A, which another simulator made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import Reader

from pam_antagonist.recording import read_bag
from pam_antagonist.recording.messages import typestore


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
