"""A joint with pressure regulators behind a device, as processes, without pressure sensors."""

from __future__ import annotations

import csv
import math
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from pam_antagonist import read_bag, replay
from pam_antagonist.estimation import Estimator
from pam_antagonist.hardware.calibration import Converter, load_calibration
from pam_antagonist.nodes.processes import Processes, ros_arguments
from pam_antagonist.paths import config_dir
from pam_antagonist.rig import load_rig

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

RIG = load_rig("shin2022_regulators", regulators=True)
SAFE = (311.3e3, 356.3e3)  # not the default, so that nothing else can be taken for it; 3.5 and 4.25 V, exact as float32
GOAL = math.radians(8.0)


@dataclass(frozen=True)
class Run:
    bag: Path
    volts: tuple[float, float]
    log: list[tuple[int, tuple[float, float], bool]]
    killed_ns: int
    diagnostics: list[Any]


def hardware(folder: Path) -> Path:
    """A calibration without pressure sensors."""
    content = yaml.safe_load((config_dir() / "hardware" / "example_regulators.yaml").read_text(encoding="utf-8"))
    content["pressure_sensors"] = "none"
    del content["pressure_1"], content["pressure_2"]
    path = folder / "hardware.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def read_log(path: Path) -> list[tuple[int, tuple[float, float], bool]]:
    with path.open(newline="") as file:
        return [
            (int(row["time_ns"]), (float(row["voltage_1"]), float(row["voltage_2"])), row["safe"] == "1")
            for row in csv.DictReader(file)
            if row["safe"] is not None
        ]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, module_domain: None) -> Run:
    """The joint is brought to an angle and held there, then the bridge is killed."""
    from probe import Probe

    folder = tmp_path_factory.mktemp("regulators")
    Estimator(RIG)  # compiles, or loads; the processes then find it
    calibration, port, log = hardware(folder), folder / "device", folder / "voltages.csv"
    volts = Converter(load_calibration(calibration)).output(SAFE)
    rig = {"rig": "shin2022_regulators"}
    told = {**rig, "pressure_sensors": "none", "max_age": 0.5}
    owner = {**rig, "hardware": str(calibration), "port": str(port), "safe_pressure": list(SAFE)}
    patient = {"command_timeout": 0.3, "max_command_age": 2.0, "missing_time": 0.5, "diagnostics_period": 0.1}
    with Processes(folder) as processes, Probe("diagnostics") as probe:

        def commanded() -> bool:
            processes.check()
            return log.exists() and any(row[1] != volts and not row[2] for row in read_log(log))

        processes.start("record", ["--out", str(folder / "bag")])
        processes.start("estimator", ros_arguments(told, {}))
        processes.start("controller", ros_arguments({**told, "law": "model"}, {}))
        processes.start("bridge", ros_arguments({**owner, **patient}, {}))
        probe.until(lambda: probe.matched("reference", 2), 60.0, "a controller and a recorder")
        device = ["--rig", rig["rig"], "--hardware", str(calibration), "--link", str(port), "--log", str(log)]
        processes.start("device_emulator", [*device, "--mismatch", "0.01", "--seed", "3"])
        probe.until(commanded, 60.0, "a first command")
        probe.refer(0, GOAL)
        probe.wait(2.5)
        popen = processes.running.pop("bridge").popen
        killed = time.time_ns()
        popen.send_signal(signal.SIGKILL)
        popen.wait()
        probe.wait(0.2)
        processes.stop("device_emulator", "controller", "estimator", "record")
        said = [status for _, message in probe.seen["diagnostics"] for status in message.status]
    return Run(folder / "bag", volts, read_log(log), killed, said)


def test_the_joint_is_held_over_the_serial_line_and_nothing_is_wrong(run: Run) -> None:
    recording = read_bag(run.bag)
    assert recording.drive == "regulator" and recording.angle is not None
    # The last row has no angle where the recording ends between its messages.
    held = recording.angle[-200:]
    assert np.isfinite(held).mean() > 0.95
    assert np.nanmean(held) == pytest.approx(GOAL, abs=math.radians(1.5))
    low, high = RIG.command_limits
    assert np.all((recording.voltage > low - 1.0) & (recording.voltage < high + 1.0)), "pressures, not volts"
    assert not np.isfinite(recording.pressure).any() and "pressure_1" not in recording.topics
    assert not [
        status.message for status in run.diagnostics if status.name == "pam/bridge: safety" and status.level > b"\0"
    ]


def test_a_replay_gives_the_bits_of_the_live_estimate(run: Run) -> None:
    report = replay(run.bag, RIG).report
    assert report.live_equal is not None and report.live_equal.compared > 1500
    assert report.live_equal.equal == report.live_equal.compared


def test_with_the_bridge_killed_the_device_asks_for_the_safe_pressures(run: Run) -> None:
    after = [row for row in run.log if row[0] > run.killed_ns]
    first = next(row for row in after if row[2])
    assert first[1] == run.volts == (3.5, 4.25)
    assert 10.0 < (first[0] - run.killed_ns) * 1e-6 < 50.0
    assert all(row[1] == run.volts for row in after if row[0] >= first[0])
    print(f"bridge killed: safe after {(first[0] - run.killed_ns) * 1e-6:.1f} ms")
