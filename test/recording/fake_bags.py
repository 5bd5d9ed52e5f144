"""Small bags for the tests, written message by message with rosbags, independently of the package's own writer."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import read_bag
from pam_antagonist.recording.cdr import typestore

FLUID = "sensor_msgs/msg/FluidPressure"
VALVE = "pam_antagonist_msgs/msg/ValveCommand"
JOINT = "sensor_msgs/msg/JointState"
WRENCH = "geometry_msgs/msg/WrenchStamped"
REFERENCE = "pam_antagonist_msgs/msg/JointReference"
ESTIMATE = "pam_antagonist_msgs/msg/JointEstimate"
FIRST_NS = 1_780_000_000_123_000_000
PERIOD_NS = 1_000_000

COMPRESSIONS = {
    "none": CompressionMode.NONE,
    "chunk": CompressionMode.STORAGE,
    "message": CompressionMode.MESSAGE,
    "file": CompressionMode.FILE,
}


@dataclass
class Stream:
    """Messages of one topic: (time of reception [ns], CDR)."""

    type: str
    items: list[tuple[int, bytes]] = field(default_factory=list)


class FakeRig:
    """Samples of a rig that nobody mistakes for one another, and bags of them."""

    def __init__(self, size: int = 40) -> None:
        rng = np.random.default_rng(2)
        self.size = size
        self.stamp_ns = FIRST_NS + PERIOD_NS * np.arange(size)
        self.pressure = np.array([350e3, 550e3]) + rng.uniform(-60e3, 60e3, (size, 2))
        self.voltage = rng.uniform(3.0, 8.0, (size, 2))
        self.angle = rng.uniform(-0.3, 0.3, size)
        self.torque = rng.uniform(-2.0, 2.0, size)
        self.external = rng.uniform(-1.0, 1.0, size)
        self.little_endian = True
        self.store = typestore()

    def message(self, msgtype: str, stamp_ns: int, *, frame: str = "joint", log_ns: int | None = None, **values):
        """One message as (time of reception, CDR); ``values`` are the fields beside the header."""
        store = self.store
        stamp_ns = int(stamp_ns)
        time = store.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        header = store.types["std_msgs/msg/Header"](time, frame)
        message = store.types[msgtype](header=header, **values)
        data = bytes(store.serialize_cdr(message, msgtype, little_endian=self.little_endian))
        return (stamp_ns + 150_000 if log_ns is None else log_ns), data

    def pressure_message(self, stamp_ns: int, value: float, **more):
        return self.message(FLUID, stamp_ns, fluid_pressure=float(value), variance=1.0, **more)

    def valve_message(self, stamp_ns: int, value, **more):
        return self.message(VALVE, stamp_ns, voltage=np.array(value, np.float64), **more)

    def joint_message(self, stamp_ns: int, position, effort, name=("joint",), **more):
        arrays = {"position": position, "velocity": (), "effort": effort}
        arrays = {key: np.array(values, np.float64) for key, values in arrays.items()}
        return self.message(JOINT, stamp_ns, name=list(name), **arrays, **more)

    def wrench_message(self, stamp_ns: int, z: float, **more):
        vector = typestore().types["geometry_msgs/msg/Vector3"]
        wrench = typestore().types["geometry_msgs/msg/Wrench"](vector(1.0, 2.0, 3.0), vector(4.0, 5.0, float(z)))
        return self.message(WRENCH, stamp_ns, wrench=wrench, **more)

    def streams(self, namespace: str = "/pam") -> dict[str, Stream]:
        """The three sample topics and the measured ones."""
        p1, p2, valve, joint, wrench = (Stream(t) for t in (FLUID, FLUID, VALVE, JOINT, WRENCH))
        for i, stamp in enumerate(self.stamp_ns):
            p1.items.append(self.pressure_message(stamp, self.pressure[i, 0], frame="muscle_1"))
            p2.items.append(self.pressure_message(stamp, self.pressure[i, 1], frame="muscle_2"))
            valve.items.append(self.valve_message(stamp, self.voltage[i]))
            joint.items.append(self.joint_message(stamp, [self.angle[i]], [self.torque[i]]))
            wrench.items.append(self.wrench_message(stamp, self.external[i]))
        return {
            f"{namespace}/pressure_1": p1, f"{namespace}/pressure_2": p2, f"{namespace}/valve_state": valve,
            f"{namespace}/measured/joint_states": joint, f"{namespace}/measured/external_torque": wrench,
        }  # fmt: skip

    def write(
        self, path: Path, streams: dict[str, Stream], *, storage: str = "mcap", compression: str = "none"
    ) -> Path:
        """Write streams as a bag, interleaved by time of reception."""
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        writer = Writer(path, version=9, storage_plugin=plugin)
        writer.set_compression(COMPRESSIONS[compression], CompressionFormat.ZSTD)
        with writer:
            items = []
            for topic, stream in streams.items():
                connection = writer.add_connection(topic, stream.type, typestore=self.store)
                items.extend((log, connection, data) for log, data in stream.items)
            for log, connection, data in sorted(items, key=lambda item: item[0]):
                writer.write(connection, log, data)
        return path

    def assert_same(self, recording) -> None:
        """Hold a recording against the samples, bit for bit."""
        np.testing.assert_array_equal(recording.stamp_ns, self.stamp_ns)
        np.testing.assert_array_equal(recording.pressure, self.pressure)
        np.testing.assert_array_equal(recording.voltage, self.voltage)
        np.testing.assert_array_equal(recording.angle, self.angle)
        np.testing.assert_array_equal(recording.torque, self.torque)
        np.testing.assert_array_equal(recording.external_torque, self.external)


def refusal(path: Path, **options: object) -> str:
    """What is said instead of reading: one line that names the bag."""
    with pytest.raises(BadInput) as caught:
        read_bag(path, **options)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    return text
