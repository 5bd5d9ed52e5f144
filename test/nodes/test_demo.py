"""The demo from its command line to its report, and when it is interrupted or a process of it fails."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import replay
from pam_antagonist.cli.demo import task
from pam_antagonist.control.command import PI_MODES, Mode
from pam_antagonist.control.laws import Reachable
from pam_antagonist.control.stiffness import Box
from pam_antagonist.nodes.processes import Processes
from pam_antagonist.recording import read_bag
from pam_antagonist.rig import load_rig


def start(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "pam_antagonist", "demo", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def descendants(text: str) -> list[int]:
    """Processes whose command line holds the text, beside zombies."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and int(folder.name) != os.getpid():
            try:
                if text in (folder / "cmdline").read_text() and (folder / "stat").read_text().split()[2] != "Z":
                    found.append(int(folder.name))
            except OSError:
                continue
    return found


@pytest.mark.slow(16)
@pytest.mark.ros
@pytest.mark.realtime
def test_torque_demo_ends_with_tables_and_reports(tmp_path: Path, domain: None) -> None:
    out = tmp_path / "out"
    process = start("--mode", "torque", "--duration", "5", "--no-figures", "--out", str(out), "--seed", "2")
    said, errors = process.communicate(timeout=90)
    assert process.returncode == 0, errors
    assert errors == ""
    first = said.splitlines()[0]
    assert f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']} " in first and "watch" in first
    took = re.search(r"running after ([0-9.]+) s", said)
    assert took is not None
    for words in ("UKF", "model alone", "Steady-state performance", "95 % interval", "Latency", "Lost: published"):
        assert words in said
    report = json.loads((out / "report.json").read_text())
    assert report["joint"]["condition"] == "locked"
    live = report["live_equal"]
    assert live["equal"] == live["compared"] > 4000, live
    assert report["ukf"]["torque"]["rmse_nm"] < 0.2
    tracking = report["demo"]["tracking"]
    assert report["demo"]["simulated_joint"] == {"mismatch": 0.01, "seed": 2}
    assert tracking["reference_range_nm"] == 4.0
    assert 0.5 < tracking["steady_state_performance"] <= 1.0
    pipeline = report["demo"]["pipeline"]
    assert pipeline["expected"] > 4500
    assert set(pipeline["lost"].values()) == {0}
    assert (out / "report.html").read_text().startswith("<!DOCTYPE html>")
    recording = read_bag(out / "bag")
    assert recording.reference is not None and set(recording.reference.mode) == {1}
    assert set(recording.reference.value) == {0.0, 2.0, -2.0}
    assert not descendants(str(tmp_path))


@pytest.mark.thorough(39)
@pytest.mark.ros
@pytest.mark.realtime
def test_a_joint_that_is_pushed_yields_as_a_spring_and_damper(tmp_path: Path, domain: None) -> None:
    out = tmp_path / "out"
    process = start("--mode", "impedance", "--duration", "6", "--no-figures", "--out", str(out))
    said, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert "spring and damper" in said
    report = json.loads((out / "report.json").read_text())
    lost = report["demo"]["pipeline"]["lost"]
    assert not any(lost.values()), lost
    yielding, live = report["demo"]["yielding"], report["live_equal"]
    assert yielding["moved_deg"] > 4.0
    assert yielding["rmse_deg"] < 0.4 * yielding["moved_deg"]
    assert live["equal"] == live["compared"] > 5000, live
    recording = read_bag(out / "bag")
    pushes = recording.external_torque
    assert pushes is not None and set(pushes[np.isfinite(pushes)]) == {0.0, 1.0}


@pytest.mark.slow(14)
@pytest.mark.ros
@pytest.mark.realtime
def test_ctrl_c_stops_every_process_and_keeps_a_whole_bag(tmp_path: Path, domain: None) -> None:
    out = tmp_path / "out"
    given = ("--rig", "shin2022_regulators", "--no-pressures", "--duration", "60", "--out", str(out))
    process = start(*given)
    end = time.monotonic() + 60.0
    while not (out / "bag").is_dir() or "running" not in (process.stdout.readline() if process.stdout else ""):
        assert time.monotonic() < end
    time.sleep(1.5)
    begin = time.monotonic()
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate(timeout=30)
    assert time.monotonic() - begin < 6.0
    assert process.returncode == 130, errors
    assert str(out / "bag") in errors and "Traceback" not in errors + said
    assert not descendants(str(tmp_path))
    recording = read_bag(out / "bag")
    assert len(recording.stamp_ns) > 1000
    assert recording.drive == "regulator" and recording.angle is not None
    assert not np.isfinite(recording.pressure).any() and "pressure_1" not in recording.topics
    live = replay(out / "bag", load_rig("shin2022_regulators", regulators=True)).report.live_equal
    assert live is not None and live.equal == live.compared > 1000


@pytest.mark.thorough(7)
@pytest.mark.ros
@pytest.mark.realtime
def test_a_failing_process_stops_the_demo_with_its_own_words(tmp_path: Path, domain: None) -> None:
    """Here the plant: it dies in the middle of the experiment."""
    out = tmp_path / "out"
    process = start("--duration", "60", "--out", str(out))
    end = time.monotonic() + 60.0
    while "running" not in (process.stdout.readline() if process.stdout else ""):
        assert time.monotonic() < end
    (plant,) = [pid for pid in descendants("wait_for_subscribers") if f"/{process.pid}/" in f"/{_parent(pid)}/"]
    os.kill(plant, signal.SIGKILL)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "error: plant ended with status -9" in errors and "Traceback" not in errors
    assert not descendants(str(tmp_path))


def _parent(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])


@pytest.mark.parametrize("mode", PI_MODES)
@pytest.mark.parametrize("duration", [1.0, 600.0])
def test_references_are_steps_within_the_paper_s_ranges(mode: Mode, duration: float) -> None:
    steps = task(load_rig("shin2022"), mode, "fast", duration).references
    times = [at for at, _, _ in steps]
    assert steps[0][:2] == (0.0, 0.0) and all(math.isnan(stiffness) for _, _, stiffness in steps)
    assert times == sorted(times) and times[-1] < duration
    largest = max(abs(value) for _, value, _ in steps)
    assert largest == pytest.approx(math.radians(20.0) if mode is Mode.ANGLE else 2.0)
    assert min(value for _, value, _ in steps) == -largest


def test_somebody_pushes_a_joint_that_is_to_yield_and_lets_go_in_between() -> None:
    rig = load_rig("shin2022_external_torque")
    asked = task(rig, Mode.IMPEDANCE, "model", 30.0)
    times, torques = zip(*asked.pushes, strict=True)
    assert list(times) == sorted(times) and times[-1] < 30.0
    assert torques[0] == 0.0 and max(torques) == -min(torques) == 1.0
    assert all(0.0 in pair for pair in zip(torques[1:], torques[2:], strict=False))
    assert [spring for _, _, spring in asked.references] == [6.0, 4.0, 8.0] and asked.damping == 0.5
    assert task(rig, Mode.ANGLE, "fast", 30.0).pushes == []


def test_references_of_angle_and_stiffness_are_within_reach_of_the_paper_s_joint() -> None:
    rig = load_rig("shin2022")
    reach = Reachable(rig.parameters(), Box.of(rig.parameters()))
    steps = task(rig, Mode.ANGLE_STIFFNESS, "model", 30.0).references
    assert max(value for _, value, _ in steps) == pytest.approx(math.radians(10.0))
    assert len({stiffness for _, _, stiffness in steps}) > 3
    for _, value, stiffness in steps:
        assert reach.nearest(Mode.ANGLE_STIFFNESS, value, stiffness) == (value, stiffness, "")


def test_a_stop_for_safety_is_found_in_the_logs_with_its_first_reason(tmp_path: Path) -> None:
    processes = Processes(tmp_path)
    assert processes.stopped() == ""
    (tmp_path / "plant.log").write_text(
        "[INFO] [1795579761.4] [pam.plant]: active\n[ERROR] [1795579817.25] [pam.plant]: stopped: on request\n"
    )
    angle = "the estimated angle is +0.574 rad, beyond 0.4538 rad (+32.9 deg; the limit is 26.0 deg)"
    (tmp_path / "controller.log").write_text(f"[ERROR] [1795579816.66] [pam.controller]: stopped: {angle}\n")
    assert processes.stopped() == f"controller: {angle}"
