"""``device_emulator``: what it refuses, and that a host finds a device behind its link."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pam_antagonist.__main__ import main
from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.device import DeviceLost
from pam_antagonist.hardware.serial_device import SerialDevice, SerialTransport
from pam_antagonist.safety import SafeAction
from validation.__main__ import COMMANDS
from validation.device.line_faults import FaultPlan, parse_fault


def test_nothing_is_overwritten(tmp_path, capsys):
    precious = tmp_path / "precious"
    precious.write_text("data")
    for option in ("--log", "--link"):
        assert main(["device_emulator", "--rig", "shin2022", option, str(precious)], COMMANDS) == 2
        assert str(precious) in capsys.readouterr().err
    assert precious.read_text() == "data"


@pytest.mark.parametrize(
    "text", ["", "flip", "silent=1", "flip=x", "flip=nan", "unplug@3-2", "unplug@-1", "unplug@a", "nan=0", "drop=-1"]
)
def test_faults_that_are_none_are_refused(text):
    with pytest.raises(BadInput, match="fault"):
        parse_fault(text)


def test_faults_begin_and_end_and_hit_what_they_name():
    plan = FaultPlan([parse_fault("nan=1@1-2"), parse_fault("flip=1@1.5-3"), parse_fault("drop=1@4")], seed=0)
    assert plan.at(0.5) == ([], [])
    assert plan.damaged(b"abc") == b"abc" and not plan.dropped()
    assert plan.at(1.0) == (["nan"], [])
    assert plan.hits("nan", 1) and not plan.hits("nan", 2)
    assert plan.at(1.6) == (["flip"], [])
    assert all(bin(a ^ b).count("1") == 1 for a, b in zip(b"abc", plan.damaged(b"abc"), strict=True))
    assert plan.at(2.5) == ([], ["nan"])
    assert plan.at(4.5) == (["drop"], ["flip"])
    assert plan.dropped()


@pytest.fixture
def started() -> Iterator[Callable[[list[str]], subprocess.Popen[str]]]:
    """Starts commands, and leaves none of them behind."""
    with contextlib.ExitStack() as stack:

        def start(command: list[str]) -> subprocess.Popen[str]:
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        yield start


@pytest.fixture
def emulated(
    tmp_path: Path, started: Callable[[list[str]], subprocess.Popen[str]]
) -> Callable[..., tuple[subprocess.Popen[str], Path, Path]]:
    """Starts an emulator with further options; returns its process, the link to its port, and its log."""

    def start(*options: str) -> tuple[subprocess.Popen[str], Path, Path]:
        link, log = tmp_path / "device", tmp_path / "log.csv"
        command = [sys.executable, "-m", "validation", "device_emulator", "--rig", "shin2022", "--no-noise"]
        emulator = started([*command, "--link", str(link), "--log", str(log), *options])
        assert emulator.stdout is not None
        assert emulator.stdout.readline().strip() == str(link)
        return emulator, link, log

    return start


@pytest.mark.realtime
def test_faults_that_begin_or_end_during_a_stall_are_not_lost(emulated):
    faults = ("unplug@0.1-0.5", "stall@0.3-1.2", "stop@0.7-0.9", "restart@1")
    options = [word for fault in faults for word in ("--fault", fault)]
    emulator, link, log = emulated("--first-us", str(2**31), *options)
    device = SerialDevice(lambda: SerialTransport(str(link)))
    device.start(SafeAction((5.0, 5.25)))
    with pytest.raises(DeviceLost):
        while True:
            device.samples(0.05)
            device.command((6.0, 5.0))
    device.close()
    end = time.monotonic() + 5.0
    while not link.exists() and time.monotonic() < end:
        time.sleep(0.01)
    time.sleep(1.0)
    emulator.send_signal(signal.SIGTERM)
    emulator.communicate(timeout=10.0)
    assert emulator.returncode == 0 and not os.path.lexists(link)
    rows = [line.split(",") for line in log.read_text().splitlines()[1:]]
    events = ["+unplug", "+stall", "-unplug", "+stop", "-stop", "+restart", "-stall"]
    assert [row[2] for row in rows if row[2] != "voltage"] == events
    # A restarted device counts from 0, with the safe voltages of power-on.
    assert int(rows[-1][1]) < 2**31 and rows[-1][2:] == ["voltage", "5.5", "5.5", "1"]
