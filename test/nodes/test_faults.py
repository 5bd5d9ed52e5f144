"""What the valves get when a process dies, falls silent, or sends what is no number."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pam_antagonist.nodes.processes import Processes, ros_arguments

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

SAFE = (5.0, 5.2)  # not the default, so that nothing else can be taken for it
LIMIT_MS = 50.0


ARGUMENTS = {
    "controller": ros_arguments({"safe_voltage": list(SAFE), "max_angle": math.radians(18.0)}, {}),
    "plant": ros_arguments({"safe_voltage": list(SAFE)}, {}),
}


@pytest.fixture(scope="module")
def around(tmp_path_factory: pytest.TempPathFactory, module_domain: None) -> Iterator[tuple[Processes, Any]]:
    from probe import Probe

    with (
        Processes(tmp_path_factory.mktemp("faults")) as processes,
        Probe("valve_command", "valve_state", "joint_estimate") as probe,
    ):
        yield processes, probe


@pytest.fixture
def pipeline(around: tuple[Processes, Any]) -> tuple[Processes, Any]:
    """Plant, estimator and controller; what another test has killed runs again."""
    processes, probe = around
    missing = [name for name in ("estimator", "controller", "plant") if name not in processes.running]
    for name in missing:
        processes.start(name, ARGUMENTS.get(name, []))
    if missing:
        probe.clear()
        probe.until(lambda: len(probe.seen["valve_command"]) > 100, 60.0, "commands")
    return processes, probe


def follow(processes: Processes, probe: Any, degrees: float = 15.0) -> None:
    """Wait until the loop follows a reference, with voltages that are not the safe ones."""
    from pam_antagonist_msgs.msg import JointReference

    probe.until(lambda: probe.matched("reference"), 30.0, "a controller")

    def following() -> bool:
        processes.check()
        probe.refer(JointReference.ANGLE, math.radians(degrees))
        return bool(probe.seen["valve_state"]) and is_apart(probe.seen["valve_state"][-1][1])

    probe.clear()
    probe.until(following, 30.0, "voltages that follow the reference")


def is_safe(message: Any) -> bool:
    return tuple(message.voltage) == SAFE


def is_apart(message: Any) -> bool:
    return abs(message.voltage[0] - message.voltage[1]) > 0.3


def kill(processes: Processes, name: str) -> int:
    """Kill a process; the time right before that [ns]."""
    popen = processes.running.pop(name).popen
    now = time.time_ns()
    popen.send_signal(signal.SIGKILL)
    popen.wait()
    return now


def first_safe_after(probe: Any, topic: str, time_ns: int) -> float:
    """How long after a time the first safe voltages came, after which no others came [ms]."""
    probe.collect()
    received = probe.seen[topic]
    unsafe = [index for index, (_, message) in enumerate(received) if not is_safe(message)]
    first = (unsafe[-1] + 1) if unsafe else 0
    assert first < len(received), f"{topic} never became safe"
    return (received[first][0] - time_ns) * 1e-6


def test_estimator_killed(pipeline: tuple[Processes, Any]) -> None:
    processes, probe = pipeline
    follow(processes, probe)
    probe.clear()
    at = kill(processes, "estimator")
    probe.wait(0.3)
    assert 0.0 < first_safe_after(probe, "valve_command", at) < LIMIT_MS
    assert 0.0 < first_safe_after(probe, "valve_state", at) < LIMIT_MS
    headers = [message.header.stamp for _, message in probe.seen["valve_command"]]
    stamps = [stamp.sec * 10**9 + stamp.nanosec for stamp in headers]
    assert stamps == sorted(stamps)


def test_a_new_estimator_is_taken_without_a_bump(pipeline: tuple[Processes, Any]) -> None:
    processes, probe = pipeline
    follow(processes, probe)
    kill(processes, "estimator")
    probe.wait(0.3)
    probe.clear()
    processes.start("estimator")
    unsafe = lambda: any(not is_safe(message) for _, message in probe.seen["valve_command"])  # noqa: E731
    probe.until(unsafe, 30.0, "voltages that follow the reference")
    commands = [message for _, message in probe.seen["valve_command"]]
    first = next(index for index, message in enumerate(commands) if not is_safe(message))
    # from the safe voltages, by less than an integral of 15° or a blend of 0.5 s moves in a millisecond
    assert abs(commands[first].voltage[0] - SAFE[0]) < 0.05
    assert abs(commands[first].voltage[1] - SAFE[1]) < 0.05


def test_controller_killed(pipeline: tuple[Processes, Any]) -> None:
    processes, probe = pipeline
    follow(processes, probe)
    probe.clear()
    at = kill(processes, "controller")
    probe.wait(0.3)
    assert 0.0 < first_safe_after(probe, "valve_state", at) < LIMIT_MS


@pytest.mark.parametrize("way", ["signal", "service of its life cycle"])
def test_controller_leaves_safe_voltages_behind_when_it_is_told_to_end(
    pipeline: tuple[Processes, Any], way: str
) -> None:
    processes, probe = pipeline
    follow(processes, probe)
    if way == "signal":
        assert processes.stop("controller") == {"controller": 0}
    else:
        assert probe.transition("controller", "shutdown")
        assert processes.running.pop("controller").popen.wait(10.0) == 0
    probe.wait(0.1)
    assert is_safe(probe.seen["valve_command"][-1][1])


def test_logs_hold_no_traceback(pipeline: tuple[Processes, Any]) -> None:
    processes, _ = pipeline
    logs = {path.name: path.read_text() for path in Path(processes.running["plant"].log).parent.glob("*.log")}
    assert set(logs) == {"plant.log", "estimator.log", "controller.log"}
    assert not any("Traceback" in text for text in logs.values())
