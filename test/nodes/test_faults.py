"""What the valves get when a process dies, falls silent, or sends what is no number."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sent import stamp_of

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
    probe.until(lambda: probe.matched("reference"), 30.0, "a controller")

    def following() -> bool:
        processes.check()
        probe.refer(0, math.radians(degrees))
        return bool(probe.seen["valve_state"]) and abs(np.diff(probe.voltage())[0]) > 0.3

    probe.clear()
    probe.until(following, 30.0, "voltages that follow the reference")


def first_safe_after(probe: Any, topic: str, time_ns: int) -> float:
    """How long after a time the first safe voltages came, after which no others came [ms]."""
    unsafe = [index for index, voltage in enumerate(probe.voltages(topic)) if voltage != SAFE]
    received = probe.seen[topic][unsafe[-1] + 1 if unsafe else 0 :]
    assert received, f"{topic} never became safe"
    return (received[0][0] - time_ns) * 1e-6


@pytest.mark.parametrize(
    ("name", "topics"), [("estimator", ("valve_command", "valve_state")), ("controller", ("valve_state",))]
)
def test_a_process_is_killed(pipeline: tuple[Processes, Any], name: str, topics: tuple[str, ...]) -> None:
    from probe import kill

    processes, probe = pipeline
    follow(processes, probe)
    probe.clear()
    at = kill(processes, name)
    probe.wait(0.3)
    for topic in topics:
        assert 0.0 < first_safe_after(probe, topic, at) < LIMIT_MS
    stamps = [stamp_of(message) for _, message in probe.seen["valve_command"]]
    assert stamps == sorted(stamps)
    if name == "controller":
        return
    probe.clear()
    processes.start("estimator")
    unsafe = lambda: bool(probe.seen["valve_command"]) and probe.voltage("valve_command") != SAFE  # noqa: E731
    probe.until(unsafe, 30.0, "voltages that follow the reference")
    first = next(voltage for voltage in probe.voltages("valve_command") if voltage != SAFE)
    # from the safe voltages, by less than an integral of 15° or a blend of 0.5 s moves in a millisecond
    assert first == pytest.approx(SAFE, abs=0.05)


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
    assert probe.voltages("valve_command")[-1] == SAFE


def test_logs_hold_no_traceback(pipeline: tuple[Processes, Any]) -> None:
    processes, _ = pipeline
    logs = {path.name: path.read_text() for path in Path(processes.running["plant"].log).parent.glob("*.log")}
    assert set(logs) == {"plant.log", "estimator.log", "controller.log"}
    assert not any("Traceback" in text for text in logs.values())
