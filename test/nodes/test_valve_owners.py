"""What plant and bridge have in common, in the process of the tests: their messages, and what the valves get when."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
import yaml
from sent import MS, asked, command, stamp_of

from pam_antagonist.hardware.device import DeviceLost
from pam_antagonist.hardware.link import DeviceSample
from pam_antagonist.hardware.protocol import Status
from pam_antagonist.paths import config_dir
from pam_antagonist.rig import load_rig

pytestmark = pytest.mark.ros

T0 = 1_795_000_000 * 10**9
SAFE = (5.0, 5.25)


def absent() -> Any:
    """A device that is never there, but keeps what it was told."""
    device, commands = Mock(), list[tuple[float, float]]()
    device.start.side_effect = device.samples.side_effect = DeviceLost("absent")
    device.counters.return_value = {}
    device.command, device.commands = commands.append, commands
    return device


class Owner:
    """A node that owns valves, whose clock goes on with each sample."""

    def __init__(self, new_node: Callable[..., Any], kind: Any, *arguments: Any, **parameters: Any) -> None:
        self.now = T0
        self.node = new_node(kind, *arguments, safe_voltage=list(SAFE), **parameters)
        self.node.now_ns = lambda: self.now
        self.port = self.node.port
        self.port.listen()

    def keep(self, output: Any) -> None:
        pressures = {f"p{number}": one for number, one in enumerate(output.pressures, 1)}
        self.node.keep(**pressures, valves=output.valves, joint=output.joint)
        self.sent = self.node.sent

    def command(self, first: float, second: float) -> None:
        command(self.node, first, second, self.now)


class Simulated(Owner):
    """The plant."""

    REGULATORS: Mapping[str, Any] = {}

    def __init__(self, new_node: Callable[..., Any], _: Any, **parameters: Any) -> None:
        from pam_antagonist.nodes.plant import PlantNode

        super().__init__(new_node, PlantNode, **parameters)
        self.node.active = True
        self.keep(self.node._output)
        self.step, self.node._plant.step = self.node._plant.step, self.measure
        self.pressure: Callable[[float], float] | None = None

    def measure(self, *inputs: Any) -> Any:
        sample = self.step(*inputs)
        first, second = sample.pressure
        return sample._replace(pressure=(first, second if self.pressure is None else self.pressure(second)))

    def sample(self, second: Callable[[float], float] | None = None) -> tuple[float, float]:
        """Take a sample, with another pressure of muscle 2; the voltages on the valves."""
        self.pressure = second
        self.now += MS
        self.node._tick()
        newest = self.sent["valves"][-1]
        return tuple(newest.voltage if hasattr(newest, "voltage") else newest.pressure)


class Real(Owner):
    """The bridge."""

    REGULATORS: Mapping[str, Any] = {"hardware": "example_regulators"}

    def __init__(self, new_node: Callable[..., Any], patch: pytest.MonkeyPatch, **parameters: Any) -> None:
        from pam_antagonist.nodes import bridge

        super().__init__(new_node, bridge.BridgeNode, absent, **parameters)
        patch.setattr(bridge, "time", SimpleNamespace(monotonic_ns=lambda: self.now))
        self.keep(self.node._samples)

    def sample(self, second: Callable[[float], float] | None = None, **changes: Any) -> tuple[float, float]:
        self.now += MS
        sound = 3e5 + self.now // MS % 100
        pressure = (4e5 + sound, sound if second is None else second(sound))
        fields = {"voltage": (6.0, 5.0), "angle": 0.1, "torque": -0.5, "status": Status(0), **changes}
        self.node._attend()
        self.node._deliver(DeviceSample(self.now, pressure, **fields))
        return self.node._converter.asked(self.node._device.commands[-1])


@pytest.fixture(params=[Simulated, Real], ids=["plant", "bridge"])
def make(request: pytest.FixtureRequest, new_node: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> Any:
    def owner(regulators: bool = False, **parameters: Any) -> Owner:
        rig = {"rig": "shin2022_regulators", **request.param.REGULATORS} if regulators else {}
        return request.param(new_node, monkeypatch, **rig, **parameters)

    return owner


@pytest.fixture
def real(new_node: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> Real:
    return Real(new_node, monkeypatch)


def test_four_messages_of_a_sample_carry_one_stamp(make: Callable[..., Any]) -> None:
    owner = make()
    for _ in range(10):
        owner.sample()
    stamps = {name: [stamp_of(message) for message in messages] for name, messages in owner.sent.items()}
    assert stamps == dict.fromkeys(owner.sent, [T0 + k * MS for k in range(1, 11)])
    first, second, joint = (owner.sent[name][-1] for name in ("p1", "p2", "joint"))
    assert (first.header.frame_id, second.header.frame_id, joint.header.frame_id) == ("muscle_1", "muscle_2", "joint")
    assert (list(joint.name), len(joint.position), len(joint.velocity), len(joint.effort)) == (["joint"], 1, 0, 1)


def test_valves_are_safe_before_commands_and_after_the_time_out(make: Callable[..., Any]) -> None:
    owner = make()
    assert owner.sample() == SAFE
    owner.command(7.0, 4.0)
    voltages = [owner.sample() for _ in range(40)]
    assert voltages == [(7.0, 4.0)] * 20 + [SAFE] * 20
    assert owner.node.health(1)["commands"].level == 1


def test_commands_are_clipped_and_those_without_a_number_are_not_obeyed(make: Callable[..., Any]) -> None:
    owner = make(max_slew=1e5)
    owner.command(12.0, -3.0)
    assert owner.sample() == (10.0, 0.0)
    owner.command(math.nan, 5.0)
    assert owner.sample() == (10.0, 0.0)
    assert owner.node.health(1)["commands"].values["refused, not finite"] == 1


@pytest.mark.parametrize(
    ("sick", "after", "words"),
    [
        (lambda p: math.nan, 20, "pressure 2 is missing or not finite"),
        (lambda p: 4.4e5, 29, "pressure 2 is frozen at 440000.0 Pa"),
        (lambda p: 8e5 + p / 1e6, 5, "above 781.0 kPa"),
    ],
)
def test_a_sick_pressure_stops_the_valves_until_it_is_well_and_cleared(
    make: Callable[..., Any], sick: Callable[[float], float], after: int, words: str
) -> None:
    owner = make()

    def run(count: int, second: Callable[[float], float] | None = None) -> list[tuple[float, float]]:
        voltages = []
        for _ in range(count):
            owner.command(6.0, 4.9)
            voltages.append(owner.sample(second))
        return voltages

    assert set(run(100)) == {(6.0, 4.9)}
    voltages = run(100, sick)
    first = voltages.index(SAFE)
    assert after <= first <= after + 3 and set(voltages[first:]) == {SAFE}
    done, said = asked(owner.port._clear)
    assert not done and words in said
    health = owner.node.health(1)["safety"]
    assert health.level == 2 and words in health.message
    assert set(run(50)) == {SAFE}
    done, said = asked(owner.port._clear)
    assert done and words in said
    assert set(run(10)[1:]) == {(6.0, 4.9)}
    assert owner.node.health(2)["safety"].level == 0


def test_regulators_are_asked_for_what_is_safe_without_commands_and_stopped(make: Callable[..., Any]) -> None:
    safe, (_, high) = (311.3e3, 356.3e3), load_rig("shin2022_regulators", regulators=True).command_limits
    owner = make(regulators=True, safe_pressure=list(safe))
    assert owner.sample() == pytest.approx(safe)

    def commanded(first: float, count: int) -> tuple[float, float]:
        for _ in range(count):
            owner.command(first, safe[1])
            asked_for = owner.sample()
        return asked_for

    assert commanded(9e5, 1)[0] == pytest.approx(safe[0] + 20e3, abs=1.0), "slewed"
    assert commanded(9e5, 60) == pytest.approx((high, safe[1]))
    for _ in range(25):
        silent = owner.sample()
    assert silent == pytest.approx(safe)
    assert asked(owner.port._stop)[0] and commanded(6e5, 20) == pytest.approx(safe)


# ------------------------------------------------------------------------------------------------ the bridge alone


def test_without_pressure_sensors_none_is_published_or_missed(
    new_node: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    content = yaml.safe_load((config_dir() / "hardware" / "example_regulators.yaml").read_text(encoding="utf-8"))
    content["pressure_sensors"] = "none"
    del content["pressure_1"], content["pressure_2"]
    hardware = tmp_path / "hardware.yaml"
    hardware.write_text(yaml.safe_dump(content), encoding="utf-8")
    bridge = Real(new_node, monkeypatch, rig="shin2022_regulators", hardware=str(hardware))
    assert set(bridge.sent) == {"valves", "joint"}
    for _ in range(100):
        bridge.sample(lambda p: math.nan)
    assert not bridge.port.guard.stopped and len(bridge.sent["valves"]) == 100


@pytest.mark.parametrize(
    ("status", "words"),
    [(Status.STOPPED, "emergency stop at the device"), (Status.OUTPUT_FAULT, "could not put the voltages")],
)
def test_what_the_device_reports_stops_the_valves_and_latches(real: Real, status: Status, words: str) -> None:
    real.command(6.0, 4.9)
    real.sample(status=status)
    for _ in range(50):
        real.command(6.0, 4.9)
        assert real.sample() == SAFE
    assert words in real.port.guard.stopped


@pytest.mark.parametrize(
    ("angle", "torque", "position", "effort"),
    [(0.1, None, [0.1], []), (None, 0.5, [], [0.5]), (None, None, None, None)],
)
def test_joint_has_the_channels_that_there_are(real: Real, angle, torque, position, effort) -> None:
    published: list[Any] = []
    real.node._samples.joint.publisher.publish = published.append
    real.sample(angle=angle, torque=torque)
    assert real.sent["joint"] == []
    assert [(list(one.position), list(one.effort), stamp_of(one)) for one in published] == (
        [] if position is None else [(position, effort, T0 + MS)]
    )


def test_commands_go_to_the_device_at_once_and_every_period_without_one(real: Real) -> None:
    commands = real.node._device.commands
    real.node._attend()
    real.node._attend()
    assert commands == [SAFE]
    real.command(5.5, 4.5)
    real.node._attend()
    assert len(commands) == 2
    for _ in range(30):
        real.now += MS // 2
        real.node._attend()
    assert len(commands) == 2 + 15


def test_what_was_asked_for_before_a_new_session_is_not_obeyed_in_it(real: Real) -> None:
    real.sample()
    real.command(7.0, 4.0)
    real.node._link.counts.sessions += 1
    for _ in range(3):
        real.sample()
    assert set(real.node._device.commands) == {SAFE}


def test_rest_is_measured_and_used(real: Real) -> None:
    done, said = asked(real.node._measure_rest)
    assert not done and "0 samples so far" in said
    for k in range(1000):
        sample = DeviceSample(
            T0 + k * MS, (101.3e3 - 400.0 + k % 2, 101.3e3 + 250.0 + k % 2), SAFE, 0.1, -0.5, Status(0)
        )
        real.node._deliver(sample)
    done, said = asked(real.node._measure_rest)
    assert done and said.endswith("pressure_rest: [399.5, -250.5]")
    assert real.node._converter.pressure((0.5, 0.5)) == pytest.approx((101.3e3 + 399.5, 101.3e3 - 250.5))


def test_diagnostics_tell_that_there_is_no_device_and_simulated_time_is_refused(
    real: Real, new_node: Callable[..., Any]
) -> None:
    from pam_antagonist.errors import BadInput
    from pam_antagonist.nodes.bridge import BridgeNode

    real.node._link.start()
    real.node._link._stop.wait(0.05)
    health = real.node.health(1)
    assert health["device"].level == 2 and health["device"].message == "no device: absent"
    assert health["clock"].level == 1
    assert {"commands", "safety"} <= set(health)
    with pytest.raises(BadInput, match="hardware does not follow simulated time"):
        new_node(BridgeNode, absent, use_sim_time=True)
