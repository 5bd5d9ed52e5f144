"""The bridge node in the process of the tests, without a device: its messages, its stops, its services."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from sent import MS, asked, command, stamp_of

from pam_antagonist.hardware.device import DeviceInfo, RawSample
from pam_antagonist.hardware.link import Sample
from pam_antagonist.hardware.protocol import Status
from pam_antagonist.hardware.transport import DeviceLost
from pam_antagonist.safety import SafeAction

pytestmark = pytest.mark.ros

T0 = 1_795_000_000 * 10**9


class Absent:
    """A device that is never there, but keeps what it was told."""

    def __init__(self) -> None:
        self.commands: list[tuple[float, float]] = []

    def start(self, action: SafeAction) -> DeviceInfo:
        raise DeviceLost("absent")

    def samples(self, timeout_s: float) -> list[RawSample]:
        raise DeviceLost("absent")

    def command(self, voltage: tuple[float, float]) -> None:
        self.commands.append(voltage)

    def close(self) -> None:
        pass

    def counters(self) -> Mapping[str, float]:
        return {}


@pytest.fixture
def make(new_node: Callable[..., Any]) -> Callable[..., Any]:
    from pam_antagonist.nodes.bridge import BridgeNode

    def factory(**parameters: Any) -> Any:
        node = new_node(BridgeNode, Absent, **parameters)
        output = node._samples
        node.keep(p1=output.pressures[0], p2=output.pressures[1], valves=output.valves, joint=output.joint)
        return node

    return factory


def sample(k: int = 0, pressure: tuple[float, float] = (4e5, 3e5), **changes: Any) -> Sample:
    fields = {"voltage": (6.0, 5.0), "angle": 0.1, "torque": -0.5, "status": Status(0), **changes}
    return Sample(T0 + k * MS, pressure, **fields)


def test_four_messages_of_a_sample_carry_one_stamp_and_its_values(make: Callable[..., Any]) -> None:
    node = make()
    for k in range(3):
        node._deliver(sample(k))
    assert {name: [stamp_of(message) for message in messages] for name, messages in node.sent.items()} == dict.fromkeys(
        node.sent, [T0, T0 + MS, T0 + 2 * MS]
    )
    first, second, valves, joint = (node.sent[name][-1] for name in ("p1", "p2", "valves", "joint"))
    assert (first.fluid_pressure, second.fluid_pressure) == (4e5, 3e5)
    assert (first.header.frame_id, second.header.frame_id, joint.header.frame_id) == ("muscle_1", "muscle_2", "joint")
    assert tuple(valves.voltage) == (6.0, 5.0)
    assert (list(joint.position), list(joint.velocity), list(joint.effort)) == ([0.1], [], [-0.5])


@pytest.mark.parametrize(
    ("angle", "torque", "position", "effort"),
    [(0.1, None, [0.1], []), (None, 0.5, [], [0.5]), (None, None, None, None)],
)
def test_joint_has_the_channels_that_there_are(make: Callable[..., Any], angle, torque, position, effort) -> None:
    node = make()
    published: list[Any] = []
    node._samples.joint.publisher.publish = published.append
    node._deliver(sample(angle=angle, torque=torque))
    assert node.sent["joint"] == []
    if position is None:
        assert published == []
    else:
        (message,) = published
        assert (list(message.position), list(message.effort), stamp_of(message)) == (position, effort, T0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"status": Status.STOPPED}, "emergency stop at the device"),
        ({"status": Status.OUTPUT_FAULT}, "could not put the voltages"),
        ({"pressure": (math.nan, 3e5)}, "pressure 1 is missing"),
        ({"pressure": (4e5, 9e5)}, "pressure 2 is 900.0 kPa"),
        ({"pressure": (4e5, 3e5)}, "frozen"),
    ],
)
def test_what_is_wrong_at_the_device_stops_the_valves_and_latches(
    make: Callable[..., Any], changes: dict[str, Any], words: str
) -> None:
    node = make(safe_voltage=[5.0, 5.25])
    node.port.listen()
    for k in range(200):
        node._deliver(sample(k, **changes))
    assert words in node.port.guard.stopped
    for k in range(200, 400):
        node._deliver(sample(k, (4e5 + k, 3e5 + k)))
    assert words in node.port.guard.stopped
    node._attend()
    assert node._device.commands[-1] == (5.0, 5.25)


def test_commands_go_to_the_device_at_once_and_every_period_without_one(make: Callable[..., Any]) -> None:
    node = make(safe_voltage=[5.0, 5.25])
    node.port.listen()
    node._attend()
    node._attend()
    assert node._device.commands == [(5.0, 5.25)]
    command(node, 5.5, 4.5, time.monotonic_ns())
    node._attend()
    assert len(node._device.commands) == 2
    end = time.monotonic() + 0.015
    while time.monotonic() < end:
        node._attend()
    assert 5 <= len(node._device.commands) <= 18
    time.sleep(0.03)
    node._attend()
    assert node._device.commands[-1] == (5.0, 5.25)


def test_what_was_asked_for_before_a_new_session_is_not_obeyed_in_it(make: Callable[..., Any]) -> None:
    node = make(safe_voltage=[5.0, 5.25])
    node.port.listen()
    node._attend()
    command(node, 7.0, 4.0, time.monotonic_ns())
    node._link.counts.sessions += 1
    node._attend()
    time.sleep(0.002)
    node._attend()
    assert set(node._device.commands) == {(5.0, 5.25)}


def test_rest_is_measured_and_used(make: Callable[..., Any]) -> None:
    node = make()
    done, said = asked(node._measure_rest)
    assert not done and "0 samples so far" in said
    for k in range(1000):
        node._deliver(sample(k, (101.3e3 - 400.0 + k % 2, 101.3e3 + 250.0 + k % 2)))
    done, said = asked(node._measure_rest)
    assert done and said.endswith("pressure_rest: [399.5, -250.5]")
    assert node._converter.pressure((0.5, 0.5)) == pytest.approx((101.3e3 + 399.5, 101.3e3 - 250.5))


def test_diagnostics_tell_that_there_is_no_device(make: Callable[..., Any]) -> None:
    node = make()
    node._link.start()
    time.sleep(0.05)
    health = node.health(time.monotonic_ns())
    assert health["device"].level == 2 and health["device"].message == "no device: absent"
    assert health["clock"].level == 1
    assert {"commands", "safety"} <= set(health)


def test_simulated_time_is_refused(make: Callable[..., Any]) -> None:
    from pam_antagonist.errors import BadInput

    with pytest.raises(BadInput, match="hardware does not follow simulated time"):
        make(use_sim_time=True)
