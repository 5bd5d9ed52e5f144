"""The executables: what they refuse, what they tell about themselves, how they end."""

from __future__ import annotations

import importlib
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from pam_antagonist.nodes import bridge, controller, estimator, joints, plant, recorder
from pam_antagonist.nodes.processes import Processes, ProcessFailed, ros_arguments

NODES = {"plant": plant, "bridge": bridge, "estimator": estimator, "controller": controller}


@pytest.mark.parametrize("name", [*NODES, "recorder"])
def test_help_names_topics_and_every_parameter(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    module = importlib.import_module(f"pam_antagonist.nodes.{name}")
    assert module.main(["--help"]) == 0
    said = capsys.readouterr().out
    assert "subscribes:" in said
    for parameter in module.PARAMETERS:
        assert f"\n  {parameter.name} (default {parameter.default!r})\n" in said
        assert parameter.description in said


@pytest.mark.ros
@pytest.mark.parametrize(
    ("module", "arguments", "words"),
    [
        (plant, ["-p", "rig:=shin2023"], ["unknown rig 'shin2023'", "shin2022"]),
        (plant, ["-p", "mismatch:=0.5"], ["mismatch", "0.5", "from 0 to 0.29"]),
        (plant, ["-p", "seed:=one"], ["seed", "'one'", "an integer"]),
        (plant, ["-p", "joint_name:=left elbow"], ["joint_name", "without spaces"]),
        (plant, ["-p", "safe_voltage:=[5.0, 11.0]"], ["safe_voltage", "11.0", "from -10 to 10"]),
        (plant, ["-p", "mismach:=0.01"], ["unknown parameter 'mismach'", "did you mean 'mismatch'"]),
        (plant, ["-p", "initial_pressure:=[349000.0, 90000.0]"], ["initial pressures", "absolute"]),
        (plant, ["-r", "__ns:=/1pam"], ["plant", "remap rule", "/1pam"]),
        (plant, ["-r", "__node:=1plant"], ["plant", "1plant"]),
        (plant, ["--params-file", "/no/such/file.yaml"], ["plant", "/no/such/file.yaml"]),
        (bridge, ["-p", "hardware:=exmaple"], ["unknown hardware 'exmaple'", "example"]),
        (bridge, ["-p", "hardware:=/no/such.yaml"], ["/no/such.yaml", "no such hardware file"]),
        (bridge, ["-p", "pressure_rest:=[1.0e5, 0.0]"], ["pressure_rest", "100000.0"]),
        (bridge, ["-p", "use_sim_time:=true"], ["use_sim_time", "hardware does not follow simulated time"]),
        # an integer is taken where a number is expected: the error is about the tuning
        (estimator, ["-p", "lock_angle:=0", "-p", "tuning:=perfect"], ["tuning 'perfect'", "default", "published"]),
        (estimator, ["-p", "max_age:=-1.0"], ["max_age", "-1.0"]),
        (controller, ["-p", "bias:=10.0"], ["bias", "10 V"]),
        (joints, ["-r", "__ns:=/arm"], ["__ns:=/arm would rename all nodes of the process"]),
        (joints, ["-p", "joints:=[a, a]", "-p", "joint_name:=x"], ["/a is given twice"]),
        (joints, ["-p", "joints:=['/']"], ["is the root"]),
        (joints, ["-p", "joints:=[a, b]"], ["/a and /b have one joint_name, 'joint'"]),
        (joints, ["-p", "source:=plnat"], ["one of plant, bridge, none"]),
        (joints, ["-p", "jonts:=[a]"], ["did you mean 'joints'"]),
        (joints, ["-p", "mismatch:=0.5"], ["mismatch"]),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(
    module: Any, arguments: list[str], words: list[str], domain: None, capfd: pytest.CaptureFixture[str]
) -> None:
    assert module.main(["--ros-args", *arguments]) == 2
    # beside warnings of ROS itself
    lines = [line for line in capfd.readouterr().err.splitlines() if line and not line.startswith(("[WARN]", "[INFO]"))]
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert all(word in lines[0] for word in words), lines[0]


@pytest.mark.ros
@pytest.mark.parametrize(
    ("module", "arguments", "words"),
    [
        (plant, ["shin2022"], "unknown argument 'shin2022'"),
        (plant, ["--rig", "shin2022"], "unknown argument '--rig'"),
        (recorder, [], "--out"),
        (recorder, ["--out", "bag", "--duration", "0"], "--duration"),
        (recorder, ["--out", "bag", "--duration", "nan"], "--duration"),
        (recorder, ["--out", "bag", "--compress"], "--compress"),
        (recorder, ["--out", "bag", "--max-size", "0"], "--max-size 0.0: expected a number of megabytes above 0.1"),
        (recorder, ["--out", "bag", "--max-duration", "-1"], "--max-duration"),
        (recorder, ["--out", "bag", "--max-duration", "inf"], "--max-duration"),
        (recorder, ["--out", "bag", "--namespace", "/"], "--namespace /"),
        (recorder, ["--out", "bag", "--namespace", "/1a"], "--namespace /1a"),
        (recorder, ["--out", "bag", "--namespace", "a", "--namespace", "/a"], "each once"),
    ],
)
def test_arguments_that_are_not_for_ros_are_refused_in_one_line(
    module: Any, arguments: list[str], words: str, domain: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert module.main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and words in error and error.count("\n") == 1


@pytest.mark.slow(12)
@pytest.mark.ros
def test_signals_end_every_node_quickly_with_status_0(tmp_path: Path, domain: None) -> None:
    from probe import Probe

    with Processes(tmp_path) as processes, Probe() as probe:
        for name in NODES:
            processes.start(name)
        processes.start("record", ["--out", str(tmp_path / "bag")])

        def there() -> bool:
            processes.check()
            # the services of a node come last but one; then it spins
            names = set(probe.node.get_node_names())
            return {*NODES, "recorder"} <= names and probe.node.count_publishers("/diagnostics") == len(NODES) + 1

        probe.until(there, 60.0, "a start")
        probe.wait(0.3)
        begin = time.monotonic()
        for number, process in enumerate(processes.running.values()):
            process.popen.send_signal((signal.SIGINT, signal.SIGTERM)[number % 2])
        statuses = {name: process.popen.wait(5.0) for name, process in processes.running.items()}
        assert time.monotonic() - begin < 6.0  # a slow machine took 3.4
        assert statuses == dict.fromkeys([*NODES, "record"], 0)
        logs = {name: process.log.read_text() for name, process in processes.running.items()}
        assert not any("Traceback" in text for text in logs.values()), logs


_SLOW = """
import sys, time
from pam_antagonist.nodes import plant

def compile(self):
    print("begun", flush=True)
    for _ in range(600):
        time.sleep(0.1)  # a function that compiles goes on after a signal handler has returned

plant.PlantNode.configure = compile
sys.exit(plant.main([]))
"""


@pytest.mark.ros
def test_a_signal_ends_a_node_that_is_still_compiling_with_status_0(domain: None) -> None:
    with subprocess.Popen([sys.executable, "-c", _SLOW], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == b"begun\n"
        begin = time.monotonic()
        process.send_signal(signal.SIGTERM)
        assert process.wait(20.0) == 0
        assert time.monotonic() - begin < 5.0
        assert process.stderr.read() == b""


@pytest.mark.ros
def test_a_signal_that_the_compiler_swallows_ends_the_node_without_a_traceback() -> None:
    code = """
import os, signal
from pam_antagonist.nodes.spin import run_node
callback = "import os, signal\\ntry: os.kill(os.getpid(), signal.SIGINT)\\nexcept BaseException: pass"
def create(*arguments, **options):
    exec(callback, {"__name__": "llvmlite.binding.executionengine"})
    raise RuntimeError("no compiled object yet")
raise SystemExit(run_node(create, [], name="plant", description="", table=()))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr


@pytest.mark.ros
def test_a_parameter_on_the_command_line_wins_over_a_section_for_the_node(
    tmp_path: Path, domain: None, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text("/**/plant:\n  ros__parameters:\n    mismatch: 0.02\n    rig: shin2022\n")
    for typed in (["--params-file", str(file), "-p", "rig:=typed"], ["-p", "rig:=typed", "--params-file", str(file)]):
        assert plant.main(["--ros-args", *typed]) == 2
        assert "unknown rig 'typed'" in capfd.readouterr().err


@pytest.mark.ros
def test_a_process_that_ends_is_reported_with_its_last_words(tmp_path: Path, domain: None) -> None:
    with Processes(tmp_path) as processes:
        processes.start("plant", ros_arguments({"rig": "no_such_rig"}, {})).popen.wait(30.0)
        with pytest.raises(ProcessFailed, match="plant ended with status 2: unknown rig 'no_such_rig'"):
            processes.check()


_PARENT = """
import os, signal, sys, time
from pathlib import Path
from pam_antagonist.nodes.processes import Processes
with Processes(Path(sys.argv[1])) as processes:
    pids = [processes.start(name).popen.pid for name in ("plant", "controller")]
    time.sleep(0.5)
    processes.check()
    print(*pids, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.ros
def test_nodes_end_with_a_parent_that_is_killed(tmp_path: Path, domain: None) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _PARENT, str(tmp_path)], capture_output=True, text=True, check=False, timeout=60
    )
    pids = [int(word) for word in done.stdout.split()]
    assert len(pids) == 2, done.stderr
    end = time.monotonic() + 20.0  # they notice when they have started
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        states = [Path(f"/proc/{pid}/stat").read_text().split()[2] for pid in pids if Path(f"/proc/{pid}").exists()]
        if all(state == "Z" for state in states):  # where nobody collects orphans
            break
        assert time.monotonic() < end, "nodes outlive their parent"
        time.sleep(0.05)
