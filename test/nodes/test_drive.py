"""Commands that drive a live joint: ``excite`` and ``commission``, by a plan or by what is measured."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typing_extensions import override

from pam_antagonist.cli import commission, commission_steps, excite
from pam_antagonist.cli.driving import PLAN_NOTE, Owner, drive
from pam_antagonist.design import Limits, Plan, designed
from pam_antagonist.design.exploration import Program
from pam_antagonist.nodes.processes import Processes
from pam_antagonist.recording import read_bag
from pam_antagonist.recording.notes import read_notes
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.physical import vented

pytestmark = [pytest.mark.ros, pytest.mark.realtime]
REGULATORS = load_rig("shin2022_regulators", regulators=True)
ASKED = 300e3


@pytest.mark.thorough(10)
def test_a_plan_is_driven_and_recorded_with_what_was_planned(tmp_path: Path, domain: None) -> None:
    out = tmp_path / "excited"
    assert excite.main(["--rig", "shin2022", "--out", str(out), "--duration", "6"]) == 0
    recording = read_bag(out / "bag")
    plan = json.loads(read_notes(out / "bag")[PLAN_NOTE])
    assert plan["duration_s"] == pytest.approx(6.0)
    assert recording.angle is not None and recording.torque is not None
    assert np.ptp(recording.voltage, axis=0).min() > 1.0
    assert np.ptp(recording.angle) > math.radians(2.0)
    low, high = plan["limits"]["pressure_pa"]
    assert low - 3e3 < recording.pressure.min() and recording.pressure.max() < high + 3e3


@pytest.mark.thorough(7)
def test_it_ends_at_rest_where_a_limit_is_reached(tmp_path: Path, domain: None) -> None:
    rig = load_rig("shin2022")
    plan = designed(rig, Limits.of(rig), 8.0)
    # Somebody set the limit anew after the plan was made: what is measured decides.
    narrow = replace(plan, limits=replace(plan.limits, angle=math.radians(1.0)))
    driven = drive(Owner("plant", "shin2022"), narrow, tmp_path, rig)
    assert "beyond the limit of 1.0 deg" in driven.ended
    last = read_bag(tmp_path / "bag").voltage[-100:]
    assert np.allclose(last, plan.rest, atol=1e-6)


class Fill(Program):
    """Ask for a pressure in muscle 1, for a second and a half."""

    seconds = 1.5

    @override
    def command(self, time: float, pressure: np.ndarray, angle: float) -> tuple[float, float] | None:
        return (ASKED, vented(REGULATORS)[0]) if time < self.seconds else None


@pytest.mark.slow(5)
@pytest.mark.parametrize("beyond", [pytest.param(False, marks=pytest.mark.thorough(5)), True])
def test_regulators_follow_a_program_and_let_the_air_out_beyond_a_limit(
    tmp_path: Path, domain: None, beyond: bool
) -> None:
    limits, (least, rest) = Limits.of(REGULATORS), vented(REGULATORS)
    highest = 0.5 * (least + ASKED) if beyond else limits.pressure[1]
    within = replace(limits, pressure=(limits.pressure[0], highest))
    plan = Plan(np.empty((0, 2)), REGULATORS.sample_period, "free", 0.0, within, least, rest)
    ended = drive(Owner("plant", "shin2022_regulators"), plan, tmp_path, REGULATORS, Fill()).ended
    recording = read_bag(tmp_path / "bag", judge=False)
    assert recording.drive == "regulator" and ("pressure" in ended) == beyond, ended
    pressure = recording.pressure
    if beyond:
        assert recording.voltage[-1] == pytest.approx(rest)
        assert pressure[-1, 0] < pressure[:, 0].max() - 30e3
    else:
        assert recording.voltage[:, 0].max() == pytest.approx(ASKED)
        assert pressure[:, 0].max() == pytest.approx(ASKED, rel=0.1) and pressure[:, 1].max() < least + 20e3


@pytest.mark.thorough(31)
def test_a_fault_of_the_wiring_is_named_at_once_and_nothing_else_is_begun(tmp_path: Path, domain: None) -> None:
    words = "the valves (or their cables) are exchanged"
    link, out = tmp_path / "port", tmp_path / "commissioned"
    with Processes(tmp_path) as processes:
        device = ["--rig", "shin2022", "--link", str(link), "--seed", "3", "--mismatch", "0.01"]
        processes.start("device_emulator", [*device, "--fault", "swap_valves"], module="validation")
        deadline = time.monotonic() + 60.0
        while not link.is_symlink() and time.monotonic() < deadline:
            processes.check()
            time.sleep(0.05)
        words_of = ["commission", "--rig", "shin2022", "--out", str(out), "--source", "bridge", "--port", str(link)]
        command = [sys.executable, "-m", "pam_antagonist", *words_of]
        done = subprocess.run(command, input="\n", capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 1, done.stderr
    assert words in done.stderr and "type the same command again" in done.stderr
    state = json.loads((out / "state.json").read_text())
    assert list(state["steps"]) == ["wiring"] and not state["steps"]["wiring"]["done"]
    assert words in (out / "report.html").read_text()


def test_steps_that_are_done_are_not_done_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    steps = {name: {"done": True, "said": f"{name} was fine"} for name in commission_steps.Commission.STEPS}
    (tmp_path / "state.json").write_text(json.dumps({"rig": "shin2022", "steps": steps}))
    assert commission.main(["--rig", "shin2022", "--out", str(tmp_path), "--unattended"]) == 0
    assert "locked: done before. locked was fine" in capsys.readouterr().out
    assert json.loads((tmp_path / "report.json").read_text())["steps"][0]["name"] == "wiring"
