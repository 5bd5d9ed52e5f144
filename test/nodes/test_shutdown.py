"""A node that is asked to shut down, over the standard service of its life cycle."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from pam_antagonist.nodes.processes import Processes, ros_arguments

pytestmark = pytest.mark.ros

SAFE = (5.0, 5.2)


def test_a_signal_that_the_compiler_swallows_ends_the_node_without_a_traceback() -> None:
    code = """
import os, signal
from pam_antagonist.nodes.spin import run_node
def create(*arguments, **options):
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except BaseException:
        pass
    raise RuntimeError("no compiled object yet")
raise SystemExit(run_node(create, [], name="plant", description="", table=()))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr


@pytest.mark.realtime
def test_a_controller_that_is_shut_down_leaves_safe_voltages_and_ends(tmp_path: Path, module_domain: None) -> None:
    from probe import Probe

    with Processes(tmp_path) as processes, Probe("valve_command") as probe:
        processes.start("controller", ros_arguments({"safe_voltage": list(SAFE)}, {}))
        processes.start("estimator", ros_arguments({}, {}))
        processes.start("plant", ros_arguments({"safe_voltage": list(SAFE)}, {}))
        probe.until(lambda: len(probe.seen["valve_command"]) > 50, 60.0, "commands")
        probe.refer(0, 0.2)
        other = lambda: tuple(probe.seen["valve_command"][-1][1].voltage) != SAFE  # noqa: E731
        probe.until(other, 15.0, "commands that follow a reference")
        assert probe.transition("controller", "shutdown")
        process = processes.running.pop("controller").popen
        assert process.wait(10.0) == 0
        probe.wait(0.1)
        assert tuple(probe.seen["valve_command"][-1][1].voltage) == SAFE
        processes.check()
        logs = [running.log.read_text() for running in processes.running.values()]
        assert not any("Traceback" in log for log in logs)
