"""``commission`` at a device with a fault in its wiring: the first step names it, and nothing else is begun."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pam_antagonist.cli import commission, commission_steps
from pam_antagonist.nodes.processes import Processes

pytestmark = [pytest.mark.ros, pytest.mark.realtime]


def test_a_fault_of_the_wiring_is_named_at_once(tmp_path: Path, domain: None) -> None:
    fault, words = "swap_valves", "the valves (or their cables) are exchanged"
    link, out = tmp_path / "port", tmp_path / "commissioned"
    with Processes(tmp_path) as processes:
        device = ["--rig", "shin2022", "--link", str(link), "--seed", "3", "--mismatch", "0.01", "--fault", fault]
        processes.start("device_emulator", device)
        deadline = time.monotonic() + 60.0
        while not link.is_symlink() and time.monotonic() < deadline:
            processes.check()
            time.sleep(0.05)
        words_of = ["commission", "--rig", "shin2022", "--out", str(out), "--source", "bridge", "--port", str(link)]
        done = subprocess.run(
            [sys.executable, "-m", "pam_antagonist", *words_of],
            input="\n",
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
    assert done.returncode == 1, done.stderr
    assert words in done.stderr and "type the same command again" in done.stderr
    state = json.loads((out / "state.json").read_text())
    assert list(state["steps"]) == ["wiring"] and not state["steps"]["wiring"]["done"]
    assert words in (out / "report.html").read_text()


def test_steps_that_are_done_are_not_done_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "commissioned"
    out.mkdir()
    steps = {name: {"done": True, "said": f"{name} was fine"} for name in commission_steps.STEPS}
    (out / "state.json").write_text(json.dumps({"rig": "shin2022", "steps": steps}))
    assert commission.main(["--rig", "shin2022", "--out", str(out), "--unattended"]) == 0
    said = capsys.readouterr().out
    assert "locked: done before. locked was fine" in said
    assert json.loads((out / "report.json").read_text())["steps"][0]["name"] == "wiring"
