"""A sample as one message, joint_sample, and the same as topics of their own: the same bits, live and in a bag."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sent import MS

from pam_antagonist import replay
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import wire
from pam_antagonist.nodes.pairing import WHOLE
from pam_antagonist.nodes.processes import Processes, ros_arguments
from pam_antagonist.recording import BagWriter, Recording, read_bag
from pam_antagonist.recording.topics import TOPICS

pytestmark = pytest.mark.ros

T0 = 1_795_000_000 * 10**9
PLACES = {"pressure_1": 0, "pressure_2": 1, "valve_state": 2, "pressure_state": 2, "angle_sensor": 3, "joint_sample": 4}


class Bus:
    """What nodes publish, as bytes in order; each output is a topic."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, int, bytes]] = []

    def take(self, node: Any) -> Any:
        """A plant whose messages come here instead."""
        output = node._output
        topics = {
            "valves": TOPICS[f"{'pressure' if output._regulated else 'valve'}_state"].name,
            "joint": "measured_joint_states",
        }
        outputs = {f"pressure_{i}": one for i, one in enumerate(output.pressures, 1)}
        outputs |= {"joint_sample": output._one, topics["valves"]: output.valves, topics["joint"]: output.joint}
        outputs["angle_sensor"] = output.encoder
        for name, one in outputs.items():
            if one is not None:
                one._publish = lambda data, name=name: self.sent.append((name, node.time, bytes(data)))  # type: ignore[misc]
        return node

    def of(self, name: str) -> list[bytes]:
        return [data for topic, _, data in self.sent if topic == name]

    def write(self, path: Path, *names: str) -> Recording:
        """A bag of some topics, read."""
        with BagWriter(path) as bag:
            for name, at, data in self.sent:
                if name in names:
                    bag.write(TOPICS[name].resolve("/pam"), TOPICS[name].type, at, data)
        return read_bag(path)


def recorded(new_node: Callable[..., Any], samples: int = 200, **parameters: Any) -> Bus:
    """Samples of a plant that moves, with both kinds of messages."""
    from pam_antagonist.nodes.plant import PlantNode

    node, bus = new_node(PlantNode, samples="one", seed=5, **parameters), Bus()
    node.time = T0
    node.now_ns = lambda: node.time
    node.trigger_activate()
    bus.take(node)
    regulated = node._output._regulated
    for k in range(samples):
        node.time += MS
        first = (250e3 + 200.0 * k) if regulated else 5.0 + 0.01 * k
        node.port.command(node.time, (first, 300e3 if regulated else 5.2), node.time)
        node._tick()
    return bus


RIGS = pytest.mark.parametrize(
    "parameters",
    [
        {}, {"angle_sensor": "encoder", "rig": "encoder"}, {"rig": "shin2022_regulators"},
        {"rig": "shin2022_regulators", "pressure_sensors": "none"},
    ],
    ids=["valves", "encoder", "regulators", "no pressures"],
)  # fmt: skip


def given(parameters: dict[str, Any], folder: Path) -> dict[str, Any]:
    if parameters.get("rig") != "encoder":
        return parameters
    path = folder / "encoder.yaml"
    path.write_text("based_on: shin2022\nname: encoder\nencoder: {std: 1.0e-3}\n", encoding="utf-8")
    return {**parameters, "rig": str(path)}


@RIGS
def test_both_ways_give_the_same_estimates_bit_by_bit(
    new_node: Callable[..., Any], tmp_path: Path, parameters: dict[str, Any]
) -> None:
    from pam_antagonist.nodes.estimator import EstimatorNode

    parameters = given(parameters, tmp_path)
    bus = recorded(new_node, **parameters)
    estimates = {}
    for samples in ("one", "topics"):
        node = new_node(EstimatorNode, samples=samples, max_age=10.0, **parameters)
        node.keep(estimates=node._estimates)
        for name, _, data in bus.sent:
            if (
                PLACES.get(name) in node._inputs
                and TOPICS[name].relative == TOPICS[node._inputs[PLACES[name]][0]].relative
            ):
                node.take_message(PLACES[name], data)
        estimates[samples] = [(one.angle, one.torque, one.nis, one.flags & 31) for one in node.sent["estimates"]]
    assert len(estimates["one"]) > 190
    assert np.array_equal(np.array(estimates["one"]), np.array(estimates["topics"]), equal_nan=True)


@RIGS
def test_a_bag_of_either_is_the_same_recording(
    new_node: Callable[..., Any], tmp_path: Path, parameters: dict[str, Any]
) -> None:
    bus = recorded(new_node, **given(parameters, tmp_path))
    one = bus.write(tmp_path / "one", "joint_sample")
    topics = bus.write(
        tmp_path / "topics", *(name for name in PLACES if name != "joint_sample"), "measured_joint_states"
    )
    assert one.drive == topics.drive and np.array_equal(one.stamp_ns, topics.stamp_ns)
    for name in ("pressure", "voltage", "angle", "torque", "angle_sensor"):
        first, second = getattr(one, name), getattr(topics, name)
        assert (first is None) == (second is None), name
        assert first is None or np.array_equal(first, second, equal_nan=True), name
    # Beside it the other topics may be fewer: it alone counts.
    both = bus.write(tmp_path / "both", "joint_sample", "measured_joint_states", "valve_state", "pressure_state")
    assert np.array_equal(both.pressure, one.pressure, equal_nan=True)
    assert both.topics["pressure_1" if "pressure_1" in both.topics else "pressure_state"] == "/pam/joint_sample"


def test_the_topics_beside_come_at_their_rate_and_from_the_first_sample_on(new_node: Callable[..., Any]) -> None:
    bus = recorded(new_node, topic_rate=100.0)
    assert len(bus.of("joint_sample")) == 200 and len(bus.of("pressure_1")) in (20, 21)
    assert bus.sent[1][0] == "pressure_1"
    stamps = [wire.Incoming(wire.PRESSURE_ALONE)(data)[0] for data in bus.of("pressure_1")]
    assert set(np.diff(stamps[1:])) == {10 * MS}
    assert len(recorded(new_node).of("pressure_1")) == 200, "0: all"


def test_a_rate_is_that_of_the_stamps_also_after_they_jump_back() -> None:
    thin = wire.Thinned(100.0)
    assert [k for k in range(35) if thin.is_due(T0 + k * MS)] == [0, 10, 20, 30]
    assert thin.is_due(T0 - 10**9) and not thin.is_due(T0 - 10**9 + MS)
    assert all(wire.Thinned(0.0).is_due(T0 + k) for k in range(3))


def test_an_estimator_that_waits_for_the_other_kind_says_so(new_node: Callable[..., Any]) -> None:
    from pam_antagonist.nodes.estimator import EstimatorNode

    node = new_node(EstimatorNode, samples="one")
    assert list(node._inputs) == [WHOLE]
    health = node.health(1)["samples"]
    assert health.level == 1 and "/pam/joint_sample" in health.message and "nobody publishes" in health.message
    with pytest.raises(BadInput, match="one of topics, one"):
        new_node(EstimatorNode, samples="both")


@pytest.mark.realtime
@pytest.mark.slow(10)
def test_a_pipeline_with_one_message_a_sample_is_replayed_bit_by_bit(tmp_path: Path, domain: None) -> None:
    from probe import Probe

    one = {"samples": "one", "topic_rate": 50.0}
    with Processes(tmp_path) as processes, Probe("valve_command") as probe:
        processes.start("record", ["--out", str(tmp_path / "bag")])
        processes.start("estimator", ros_arguments(one, {}))
        processes.start("controller", ros_arguments({}, {}))
        processes.start("plant", ros_arguments({**one, "mismatch": 0.01, "seed": 3, "wait_for_subscribers": 2}, {}))
        probe.until(lambda: probe.matched("reference", 2) and len(probe.seen["valve_command"]) > 200, 60.0, "a start")
        probe.refer(0, 0.0)
        probe.wait(0.7)
        probe.refer(0, math.radians(8.0))
        probe.wait(2.5)
        processes.stop("plant", "controller", "estimator", "record")
    recording = read_bag(tmp_path / "bag")
    assert recording.topics["pressure_1"] == "/pam/joint_sample"
    assert recording.angle is not None and math.degrees(np.nanmean(recording.angle[-200:])) > 2.0
    live = replay(recording, "shin2022").report.live_equal
    assert live is not None and live.equal == live.compared > 1500
