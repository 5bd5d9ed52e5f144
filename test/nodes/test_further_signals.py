"""Further signals of a rig, live: paired with the samples, waited for in reason, recorded, and said where they lack."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sent import MS

from pam_antagonist import load_rig, replay
from pam_antagonist.estimation import Estimator
from pam_antagonist.nodes.pairing import PRESSURE_1, PRESSURE_2, VOLTAGES, Sample, SamplePairing
from pam_antagonist.nodes.processes import Processes, ros_arguments
from pam_antagonist.recording import read_bag
from pam_antagonist.simulation.plant import Plant

pytestmark = pytest.mark.ros

RIG = """\
based_on: shin2022
name: pulled
signals: {other: 400.0e3}
effects:
  load_by_signal: {slope1: 2.0e-6}
"""


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "pulled.yaml"
    path.write_text(RIG, encoding="utf-8")
    return path


class Queue:
    """A pairing with one further signal; a sample comes each millisecond."""

    def __init__(self) -> None:
        from pam_antagonist.nodes.further import SignalValues

        self.signals = SignalValues(1)
        self.now = 0
        self.pairing = SamplePairing(0.02, lambda: self.now, signals=self.signals)

    def sample(self, k: int) -> list[Sample]:
        self.now = k * MS
        self.pairing.add(PRESSURE_1, k * MS, 1.0)
        self.pairing.add(VOLTAGES, k * MS, 3.0, 4.0)
        return self.pairing.add(PRESSURE_2, k * MS, 2.0)

    def signal(self, k: int) -> list[Sample]:
        return self.pairing.add_signal(0, k * MS, 10.0 * k)


@pytest.mark.parametrize("signal_first", [True, False])
def test_a_signal_with_the_samples_stamps_is_waited_for_whatever_comes_first(signal_first: bool) -> None:
    queue, out = Queue(), list[Sample]()
    for k in range(1, 20):
        for step in (queue.signal, queue.sample) if signal_first else (queue.sample, queue.signal):
            out += step(k)
    assert [one.stamp_ns for one in out] == [k * MS for k in range(1, 20)]
    # Before the first message nobody knows that it will share the stamps.
    assert [one.signals for one in out[1:]] == [(10.0 * k,) for k in range(2, 20)]


def test_a_signal_that_has_gone_holds_samples_up_for_twenty_milliseconds_at_most_and_is_missing_then() -> None:
    queue, out = Queue(), list[Sample]()
    for k in range(1, 60):
        out += queue.sample(k)
        out += queue.signal(k) if k <= 10 else []
        out += queue.pairing.expire() if k % 10 == 5 else []  # as the node's timer
        assert k * MS - out[-1].stamp_ns <= (20 * MS if k < 30 else 0)
    assert [one.stamp_ns for one in out] == [k * MS for k in range(1, 60)], "none is lost"
    assert [one.signals[0] for one in out[1:10]] == [10.0 * k for k in range(2, 11)]
    assert all(math.isnan(one.signals[0]) for one in out[10:])
    # It is waited for again as soon as it is back.
    queue.signal(60)
    assert queue.sample(60)[0].signals == (600.0,) and queue.sample(61) == []


def test_after_a_stall_messages_of_one_topic_may_all_come_before_those_of_the_signal() -> None:
    queue, out = Queue(), list[Sample]()
    for k in range(1, 10):
        out += queue.signal(k) + queue.sample(k)
    out += [one for k in range(10, 110) for one in queue.sample(k)]
    out += [one for k in range(10, 110) for one in queue.signal(k)]
    assert [one.signals for one in out[1:]] == [(10.0 * k,) for k in range(2, 110)]


def test_a_signal_with_stamps_of_its_own_holds_for_a_second_and_is_not_waited_for() -> None:
    queue, out = Queue(), list[Sample]()
    for k in range(1, 2000):
        new = queue.sample(k)
        assert [one.stamp_ns for one in new] == [k * MS]
        out += new
        if k <= 500 and k % 100 == 0:
            queue.pairing.add_signal(0, k * MS + MS // 2, float(k))
    values = np.array([one.signals[0] for one in out])
    assert np.isnan(values[:100]).all() and np.all(values[100:200] == 100.0) and np.all(values[500:1500] == 500.0)
    assert np.isnan(values[1501:]).all()


def test_what_nobody_publishes_is_said_and_its_value_in_the_file_is_taken(
    new_node: Callable[..., Any], rig: Path
) -> None:
    from sent import measure

    from pam_antagonist.nodes.estimator import EstimatorNode

    node = new_node(EstimatorNode, rig=str(rig))
    node.keep(estimates=node._estimates)
    begin = node.now_ns()
    for k in range(50):
        measure(node, begin + k * MS)
    rows = Estimator(load_rig(rig)).run(
        begin + MS * np.arange(50), np.full((50, 2), 450e3), np.full((50, 2), 5.5), signals={"other": np.full(50, 4e5)}
    )
    assert node.sent["estimates"][-1].angle == rows.rows["angle"][-1]
    health = node.health(1)["signals"]
    assert health.level == 1 and "nobody publishes also/other: their values in the rig file are taken" in health.message
    assert health.values["samples without other"] == 50


@pytest.mark.realtime
@pytest.mark.slow(8)
def test_what_was_estimated_with_a_signal_is_replayed_bit_by_bit(tmp_path: Path, domain: None, rig: Path) -> None:
    from probe import Probe
    from sensor_msgs.msg import FluidPressure

    from pam_antagonist.nodes import qos
    from pam_antagonist_msgs.msg import ValveCommand

    Estimator(load_rig(rig))  # compiles, or loads; the processes then find it
    bag = tmp_path / "bag"
    with Processes(tmp_path) as processes, Probe() as probe:
        processes.start("record", ["--out", str(bag)])
        processes.start("estimator", ros_arguments({"rig": str(rig), "max_age": 5.0}, {}))
        beside = probe.node.create_publisher(FluidPressure, "also/other", qos.STREAM)
        for topic in ("pressure_1", "pressure_2", "valve_state"):
            probe.until(
                lambda topic=topic: processes.check() or probe.matched(topic, 2), 60.0, f"two readers of {topic}"
            )  # type: ignore[misc]
        probe.until(lambda: beside.get_subscription_count() == 2, 10.0, "estimator and recorder of the signal")
        probe.wait(1.0)  # the readers know of the match a little later
        begin = time.monotonic()
        for k in itertools.count():
            other = FluidPressure(fluid_pressure=4e5 + 1e5 * math.sin(0.01 * k))
            pressures = [FluidPressure(fluid_pressure=value) for value in (450e3 + 50.0 * k % 7e3, 440e3)]
            valves = ValveCommand(voltage=[5.5, 5.4])
            now = probe.now_ns()
            for message in (*pressures, valves, other):
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
            beside.publish(other)  # first: one that comes 10 to 20 ms after its sample is not used
            probe.publisher("pressure_1").publish(pressures[0])
            probe.publisher("valve_state").publish(valves)
            probe.publisher("pressure_2").publish(pressures[1])
            if time.monotonic() - begin > 4.0:
                break
            time.sleep(1e-3)
        probe.wait(0.5)
        processes.stop("estimator", "record")
    recording = read_bag(bag, known=["other"])
    assert np.isfinite(recording.signals["other"].values).mean() > 0.95
    live = replay(bag, rig).report.live_equal
    assert live is not None and live.compared > 1000
    apart = int(np.searchsorted(recording.stamp_ns, live.first_difference_ns)) if live.differing else None
    assert live.equal == live.compared, f"from row {apart} of {len(recording.stamp_ns)} on"
    # Without it another torque is estimated.
    taken = replay(bag, load_rig(rig).replaced(effects={}))
    assert taken.report.live_equal is not None and taken.report.live_equal.equal < 10


@pytest.mark.slow(6)
def test_the_simulated_joint_goes_by_a_signal_while_it_comes(tmp_path: Path, domain: None, rig: Path) -> None:
    from probe import Probe
    from sensor_msgs.msg import FluidPressure

    from pam_antagonist.nodes import qos

    # The signal is a torque from outside, of 2e-6 N m a pascal above what the file says.
    joint, pushed = (Plant(load_rig(rig), noise=False) for _ in range(2))
    for _ in range(300):
        truth = joint.step((5.5, 5.5), signals=(550e3,)).truth
        assert np.array_equal(truth, pushed.step((5.5, 5.5), external_torque=0.3).truth)
    assert math.degrees(truth[0]) > 1.0
    with Processes(tmp_path) as processes, Probe("measured_joint_states") as probe:
        processes.start("plant", ros_arguments({"rig": str(rig), "noise": False}, {}))
        beside = probe.node.create_publisher(FluidPressure, "also/other", qos.STREAM)
        states = probe.seen["measured_joint_states"]
        probe.until(lambda: beside.get_subscription_count() == 1, 60.0, "a plant that listens to the signal")
        probe.until(lambda: len(states) > 100, 10.0, "a joint that moves")
        at_rest = states[-1][1].position[0]

        def deflected() -> bool:
            message = FluidPressure(fluid_pressure=550e3)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(probe.now_ns(), 10**9)
            beside.publish(message)
            return bool(states[-1][1].position[0] > at_rest + math.radians(1.0))

        probe.until(deflected, 10.0, "a joint that the signal turns")
        processes.stop("plant")
