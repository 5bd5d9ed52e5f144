"""The launch files in the real launch, where it is installed (it is not among the wheels of ./run)."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[2]
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
path, *words = sys.argv[1:]
given = [tuple(word.split(":=", 1)) for word in words]
service = LaunchService(argv=words)
source = PythonLaunchDescriptionSource(path)
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(source, launch_arguments=given)]))
raise SystemExit(service.run())
"""


@pytest.fixture
def environment(tmp_path: Path, domain: None) -> dict[str, str]:
    """An environment in which ROS finds the checkout as an installed package."""
    pytest.importorskip("launch_ros")
    prefix = tmp_path / "install"
    programs = prefix / "lib" / "pam_antagonist"
    programs.mkdir(parents=True)
    for name in ("plant", "estimator", "controller", "joints"):
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m pam_antagonist {name} "$@"\n')
        program.chmod(0o755)
    known = prefix / "share" / "ament_index" / "resource_index" / "packages"
    known.mkdir(parents=True)
    (known / "pam_antagonist").touch()
    found = f"{prefix}:{os.environ.get('AMENT_PREFIX_PATH', '')}"
    return {**os.environ, "AMENT_PREFIX_PATH": found, "ROS_LOG_DIR": str(tmp_path / "log"), "PYTHONUNBUFFERED": "1"}


def _launched(environment: dict[str, str], *words: str) -> subprocess.Popen[str]:
    name, *arguments = words
    return subprocess.Popen(
        [sys.executable, "-c", LAUNCH, str(ROOT / "launch" / name), *arguments],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("words", "active", "nodes"),
    [
        (("pipeline.launch.py", "namespace:=left/elbow", "joint_name:=elbow", "respawn:=true"), 3, 3),
        (("robot.launch.py",), 7, 1),
    ],
)
def test_ctrl_c_ends_every_node_cleanly(
    environment: dict[str, str], words: tuple[str, ...], active: int, nodes: int
) -> None:
    process = _launched(environment, *words)
    limit = threading.Timer(300.0, os.killpg, (process.pid, signal.SIGKILL))  # the nodes may have to compile first
    limit.start()
    try:
        assert process.stdout is not None
        lines: list[str] = []
        while sum(": active" in line for line in lines) < active:
            line = process.stdout.readline()
            assert line, f"launch has ended: {lines}"
            lines.append(line)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to launch and to its nodes
        said = "".join(lines) + process.communicate(timeout=60.0)[0]
    finally:
        limit.cancel()
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    assert process.returncode == 0, said
    assert said.count("process has finished cleanly") == nodes, said
    assert "escalating" not in said and "Traceback" not in said


def test_an_unknown_argument_is_refused_in_one_line(environment: dict[str, str]) -> None:
    process = _launched(environment, "pipeline.launch.py", "rgi:=my_rig")
    said = process.communicate(timeout=60.0)[0]
    assert process.returncode == 1
    assert "rgi:=my_rig: unknown argument; did you mean rig?" in said and "process started" not in said
