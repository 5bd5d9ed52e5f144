"""Life cycles and services of the nodes, as processes that are asked over the standard services; and simulated time."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from sent import stamp_of

from pam_antagonist.nodes.processes import Processes, ros_arguments

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

SAFE = (5.0, 5.2)
SECOND = 10**9
COMMON = {"use_sim_time": True, "safe_voltage": list(SAFE), "diagnostics_period": 0.2}

RUNS = 20.0
"""[1/s] Messages of a node that runs, at least: of a thousand, 49 came beside other work. A stopped one sends none."""


class Clock:
    """``/clock`` at the pace of the real one, from a time of its own that can be set."""

    def __init__(self, probe: Any) -> None:
        from rosgraph_msgs.msg import Clock as Message

        from pam_antagonist.nodes import qos

        self._message = Message
        self._publisher = probe.node.create_publisher(Message, "/clock", qos.DIAGNOSTICS)
        self.offset_ns = 1000 * SECOND - time.monotonic_ns()
        self._running = True
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while self._running:
            message = self._message()
            message.clock.sec, message.clock.nanosec = divmod(time.monotonic_ns() + self.offset_ns, SECOND)
            self._publisher.publish(message)
            time.sleep(0.004)  # every node hears it: a tick a sample would be half the work of a slow machine

    def stop(self) -> None:
        self._running = False
        self._thread.join()


@pytest.fixture(scope="module")
def pipeline(tmp_path_factory: pytest.TempPathFactory, module_domain: None) -> Iterator[tuple[Processes, Any, Clock]]:
    """Three nodes in simulated time; the controller waits to be told to configure itself."""
    from probe import Probe

    with (
        Processes(tmp_path_factory.mktemp("lifecycle")) as processes,
        Probe("valve_command", "valve_state", "joint_estimate", "diagnostics", "measured_joint_states") as probe,
    ):
        processes.start("estimator", ros_arguments(COMMON, {}))
        processes.start("controller", ros_arguments({**COMMON, "autostart": False}, {}))
        processes.start("plant", ros_arguments(COMMON, {}))
        clock = Clock(probe)
        try:
            probe.until(lambda: len(probe.seen["joint_estimate"]) > 50, 60.0, "estimates")
            yield processes, probe, clock
        finally:
            clock.stop()


def rate(probe: Any, topic: str, seconds: float = 0.25) -> int:
    """Messages of a topic within a time."""
    probe.wait(0.1)  # what is still under way
    probe.clear()
    probe.wait(seconds)
    return len(probe.seen[topic])


def refer(probe: Any, degrees: float) -> None:
    """Wait until the loop follows a reference.

    Pressures that jump, as those of a plant that was configured anew, or a state that was set to something else, are a
    reason for the controller to stop.
    """
    controlling(probe)
    probe.until(lambda: probe.trigger("controller/clear_stop").success, 10.0, "a clear")
    probe.follow(degrees, apart=0.2)


def controlling(probe: Any) -> None:
    """Let the controller be active, whatever it was."""
    for state, label in (("unconfigured", "configure"), ("inactive", "activate")):
        if probe.state("controller") == state:
            assert probe.transition("controller", label)


def current(probe: Any, clock: Clock) -> None:
    """Wait until the estimates are those of now: a machine that is busy elsewhere lets them fall behind."""

    def age() -> int:
        return time.monotonic_ns() + clock.offset_ns - stamp_of(probe.seen["joint_estimate"][-1][1])

    probe.until(lambda: bool(probe.seen["joint_estimate"]) and 0 <= age() < SECOND // 4, 30.0, "estimates of now")


def test_without_autostart_a_node_waits_for_its_transitions(pipeline: tuple[Processes, Any, Clock]) -> None:
    _, probe, _ = pipeline
    for state, label in (("active", "deactivate"), ("inactive", "cleanup")):  # left by another test
        if probe.state("controller") == state:
            assert probe.transition("controller", label)
    assert probe.state("controller") == "unconfigured"
    assert (probe.state("plant"), probe.state("estimator")) == ("active", "active")
    assert rate(probe, "valve_command") == 0
    assert not probe.transition("controller", "activate")  # there is no such way
    assert probe.transition("controller", "configure")
    assert probe.state("controller") == "inactive"
    assert rate(probe, "valve_command") == 0
    assert probe.transition("controller", "activate")
    assert rate(probe, "valve_command") > RUNS
    refer(probe, 10.0)


def test_stamps_are_those_of_simulated_time(pipeline: tuple[Processes, Any, Clock]) -> None:
    _, probe, clock = pipeline
    controlling(probe)
    rate(probe, "joint_estimate")
    for topic in ("valve_state", "joint_estimate", "valve_command"):
        now = time.monotonic_ns() + clock.offset_ns
        assert 0 <= now - stamp_of(probe.seen[topic][-1][1]) < SECOND, topic


def test_inactive_controller_leaves_safe_voltages_and_is_silent(pipeline: tuple[Processes, Any, Clock]) -> None:
    _, probe, _ = pipeline
    refer(probe, 10.0)
    assert probe.transition("controller", "deactivate")
    probe.wait(0.1)
    assert tuple(probe.seen["valve_command"][-1][1].voltage) == SAFE
    assert rate(probe, "valve_command") == 0
    assert {tuple(message.voltage) for _, message in probe.seen["valve_state"]} == {SAFE}
    assert probe.transition("controller", "activate")
    assert rate(probe, "valve_command") > RUNS
    # Whoever wanted something before is not obeyed again without being asked.
    assert {tuple(message.voltage) for _, message in probe.seen["valve_state"]} == {SAFE}


def test_inactive_plant_has_safe_voltages_while_its_joint_lives_on(pipeline: tuple[Processes, Any, Clock]) -> None:
    """In silence: samples of that time are neither published nor made up for later."""
    _, probe, clock = pipeline
    refer(probe, 15.0)
    assert probe.transition("plant", "deactivate")
    assert rate(probe, "valve_state", 0.5) == 0
    at = time.monotonic_ns() + clock.offset_ns
    assert probe.transition("plant", "activate")
    probe.until(lambda: len(probe.seen["measured_joint_states"]) > 20, 10.0, "samples")
    assert tuple(probe.seen["valve_state"][0][1].voltage) == SAFE
    stamps = np.array([stamp_of(message) for _, message in probe.seen["valve_state"]])
    assert stamps[0] > at - 0.3 * SECOND
    assert np.all(np.diff(stamps) > 0)


@pytest.mark.parametrize("node", ["estimator", "plant", "controller"])
def test_a_node_can_be_cleaned_up_and_started_again(pipeline: tuple[Processes, Any, Clock], node: str) -> None:
    processes, probe, _ = pipeline
    controlling(probe)
    for label in ("deactivate", "cleanup"):
        assert probe.transition(node, label), label
    assert probe.state(node) == "unconfigured"
    topic = {"estimator": "joint_estimate", "plant": "valve_state", "controller": "valve_command"}[node]
    assert rate(probe, topic) == 0
    for label in ("configure", "activate"):
        assert probe.transition(node, label), label
    assert rate(probe, topic, 0.4) > RUNS
    processes.check()


def test_estimator_is_reset_and_set(pipeline: tuple[Processes, Any, Clock]) -> None:
    from pam_antagonist_msgs.srv import SetState

    _, probe, _ = pipeline
    started = lambda: probe.seen["joint_estimate"][-1][1].started  # noqa: E731
    angles = lambda: [math.degrees(message.angle) for _, message in probe.seen["joint_estimate"]]  # noqa: E731
    rate(probe, "joint_estimate")
    before = started()
    assert probe.trigger("estimator/reset").success
    rate(probe, "joint_estimate")
    assert started() != before
    state = {"angle": math.radians(6.0), "velocity": 0.0, "pressure": [450e3, 450e3]}
    assert all(abs(angle - 6.0) > 0.6 for angle in angles())
    assert probe.call(SetState, "estimator/set_state", **state).success
    near = lambda: any(abs(angle - 6.0) < 0.5 for angle in angles())  # noqa: E731
    probe.until(near, 10.0, "an estimate beside what was set")  # the filter leaves it as soon as the pressures say so
    for wrong in ({"angle": math.nan}, {"angle": 2.0}, {"velocity": math.inf}, {"pressure": [350.0, 450e3]}):
        answer = probe.call(SetState, "estimator/set_state", **{**state, **wrong})
        assert not answer.success and "expected" in answer.message
    assert rate(probe, "joint_estimate") > RUNS


def test_another_tuning_is_taken_and_an_unknown_one_is_refused_with_the_reason(
    pipeline: tuple[Processes, Any, Clock],
) -> None:
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    _, probe, _ = pipeline
    nis = lambda: np.nanmean([message.nis for _, message in probe.seen["joint_estimate"]])  # noqa: E731

    def choose(name: str) -> Any:
        parameters = [Parameter("tuning", value=name).to_parameter_msg()]
        return probe.call(SetParameters, "estimator/set_parameters", parameters=parameters).results[0]

    rate(probe, "joint_estimate")
    assert nis() > 0.5
    assert choose("published").successful
    rate(probe, "joint_estimate")
    assert nis() < 0.1  # see docs/explanation/model.md, correction 11
    refused = choose("no_such_tuning")
    assert not refused.successful and "published" in refused.reason
    assert choose("default").successful


def test_a_clock_that_is_set_back_resets_and_is_said_once(pipeline: tuple[Processes, Any, Clock]) -> None:
    processes, probe, clock = pipeline
    refer(probe, 8.0)
    current(probe, clock)
    before = probe.seen["joint_estimate"][-1][1].started
    back, ahead = (
        lambda sign=sign: processes.running["plant"].log.read_text().count(f"the clock is {sign}") for sign in "-+"
    )
    before_back, before_ahead = back(), ahead()
    probe.clear()
    clock.offset_ns -= 5 * SECOND
    probe.wait(1.2)
    current(probe, clock)
    processes.check()
    estimates = [message for _, message in probe.seen["joint_estimate"]]
    now = time.monotonic_ns() + clock.offset_ns
    assert 0 <= now - stamp_of(estimates[-1]) < SECOND
    assert estimates[-1].started != before and estimates[-1].started.sec <= now // SECOND
    assert all(math.isfinite(message.angle) for message in estimates)
    for part in ("plant: sampling", "estimator: samples", "controller: commands"):
        said = [status for status in probe.statuses(f"pam/{part}") if "jumped" in status.message]
        # To the plant, a clock that it cannot catch up with on a busy machine has jumped as well, but ahead.
        assert 1 <= len(said) <= 1 + (ahead() - before_ahead if part == "plant: sampling" else 0), part
    assert back() - before_back == 1
    assert stamp_of(probe.seen["valve_command"][-1][1]) == pytest.approx(stamp_of(estimates[-1]), abs=0.5 * SECOND)
    refer(probe, 12.0)
