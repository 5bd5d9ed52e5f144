"""Clocks that can be set: one offset for all processes of a pipeline, and nothing else of a node changes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.ros


@pytest.fixture(autouse=True)
def _ros() -> None:
    pytest.importorskip("rclpy")


def test_the_offset_is_every_process_s(tmp_path: Path) -> None:
    from validation.faults.stepped import Step

    here = Step(tmp_path / "step", new=True)
    assert here.ns == 0
    code = "import sys\nfrom validation.faults.stepped import Step, Path\nstep = Step(Path(sys.argv[1]))\n"
    code += "print(step.ns, flush=True)\nsys.stdin.readline()\nprint(step.ns)\nstep.ns = 7"
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "step")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdin is not None and other.stdout is not None
        assert other.stdout.readline() == "0\n"
        here.ns -= 5 * 10**9
        assert other.communicate("\n", timeout=30.0)[0] == "-5000000000\n"
    assert here.ns == 7
