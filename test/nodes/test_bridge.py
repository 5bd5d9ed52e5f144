"""Device emulator, bridge, estimator, controller and recorder as processes, through everything that a line may do."""

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

from pam_antagonist.nodes.processes import Processes, ros_arguments
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.replays.accounting import account

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

PERIOD_NS = 1_000_000
SAFE = (5.0, 5.25)  # not the default, so that nothing else can be taken for it; exact as float32
LIMIT_MS = 50.0
# [s] after the first command that is not the bridge's own safe voltages
FAULTS = ("flip=0.01@4-5", "unplug@5.2-6", "nan=1@8.5-8.7")


@dataclass(frozen=True)
class Row:
    """Of the emulator's log."""

    time_ns: int
    event: str
    voltage: tuple[float, float]
    safe: bool


@dataclass(frozen=True)
class Run:
    recording: Recording
    log: list[Row]
    diagnostics: list[Any]
    killed_ns: int
    cleared: list[Any]
    changed: list[Any]
    inactive: tuple[int, int]

    def at(self, event: str) -> int:
        """When an event began [ns]."""
        return next(row.time_ns for row in self.log if row.event == event)

    def between(self, first: str, last: str, margin_s: float = 0.0) -> np.ndarray:
        """Mask of the recorded samples between two events."""
        stamps = self.recording.stamp_ns
        return (stamps > self.at(first) + margin_s * 1e9) & (stamps < self.at(last))


def read_log(path: Path) -> list[Row]:
    with path.open(newline="") as file:
        return [
            Row(
                int(row["time_ns"]),
                row["event"],
                (float(row["voltage_1"]), float(row["voltage_2"])),
                row["safe"] == "1",
            )
            for row in csv.DictReader(file)
            if row["safe"] is not None
        ]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, module_domain: None) -> Run:
    """Nine seconds at 1 kHz with a reference of 10°, the faults, a stop that is cleared, then the bridge is killed."""
    from probe import Probe
    from std_srvs.srv import Trigger

    folder = tmp_path_factory.mktemp("bridge")
    port, log = folder / "device", folder / "voltages.csv"
    safe = {"safe_voltage": list(SAFE)}
    with Processes(folder) as processes, Probe("diagnostics") as probe:

        def logged(event: str, safe_too: bool = True) -> bool:
            processes.check()
            return log.exists() and any(row.event == event and safe_too >= row.safe for row in read_log(log))

        processes.start("record", ["--out", str(folder / "bag")])
        processes.start("estimator")
        processes.start("controller", ros_arguments(safe, {}))
        processes.start("bridge", ros_arguments({"port": str(port), "diagnostics_period": 0.1, **safe}, {}))
        probe.until(lambda: len(nodes_of(probe.seen["diagnostics"])) == 3, 60.0, "a start")
        probe.until(lambda: probe.matched("reference", 2), 10.0, "a controller and a recorder")
        faults = [word for fault in FAULTS for word in ("--fault", fault)]
        device = ["--rig", "shin2022", "--link", str(port), "--log", str(log), "--seed", "3", "--drift", "50", *faults]
        processes.start("device_emulator", device)
        probe.until(lambda: logged("voltage", safe_too=False), 60.0, "a first command")
        probe.refer(0, math.radians(10.0))
        probe.until(lambda: logged("-nan"), 30.0, "the last fault's end")
        probe.wait(0.2)
        cleared = [probe.call(Trigger, "bridge/clear_stop") for _ in range(2)]
        probe.call(Trigger, "controller/clear_stop")  # its estimate had no pressure 1
        probe.wait(0.8)
        begun = time.time_ns()
        changed = [probe.transition("bridge", "deactivate"), probe.state("bridge")]
        probe.wait(0.2)
        ended = time.time_ns()
        changed += [probe.transition("bridge", "activate"), probe.state("bridge")]
        probe.until(lambda: any(row.time_ns > ended and row.voltage != SAFE for row in read_log(log)), 20.0, "commands")
        popen = processes.running.pop("bridge").popen
        killed = time.time_ns()
        popen.send_signal(signal.SIGKILL)
        popen.wait()
        probe.wait(0.2)
        processes.stop("device_emulator", "controller", "estimator", "record")
        diagnostics = [(at, status) for at, message in probe.seen["diagnostics"] for status in message.status]
    return Run(read_bag(folder / "bag"), read_log(log), diagnostics, killed, cleared, changed, (begun, ended))


def nodes_of(messages: list[tuple[int, Any]]) -> set[str]:
    return {status.name.split(":")[0] for _, message in messages for status in message.status}


def status_between(run: Run, part: str, first_ns: int, last_ns: int) -> list[Any]:
    """What the bridge said of a part meanwhile."""
    return [
        status for at, status in run.diagnostics if status.name == f"pam/bridge: {part}" and first_ns < at < last_ns
    ]


def test_log_has_the_faults_in_order(run: Run) -> None:
    events = [row.event for row in run.log if row.event != "voltage"]
    assert events == ["+flip", "-flip", "+unplug", "-unplug", "+nan", "-nan"]


def test_nothing_is_lost_on_a_line_in_order_and_stamps_are_even(run: Run) -> None:
    stamps = run.recording.stamp_ns
    steps = np.diff(stamps[stamps < run.at("+flip")])
    assert len(steps) > 1000
    said = status_between(run, "device", int(stamps[0]), run.at("+flip"))[-1]
    values = {item.key: item.value for item in said.values}
    assert (values["samples lost"], values["damaged frames from the device"]) == ("0", "0")
    # what the recorder lacks on a busy machine is not the bridge's doing
    missing = np.rint(steps / PERIOD_NS) - 1
    assert missing.sum() <= 0.01 * len(steps)
    assert np.all(np.abs(steps - (missing + 1) * PERIOD_NS) < 1100 * (missing + 1))  # 1.1 per mille: none jumps
    assert np.all(np.diff(stamps) > 0)


def test_stamps_are_ros_time(run: Run) -> None:
    received = run.recording.received_ns["pressure_1"]
    delay = np.asarray(received.log_ns) - np.asarray(received.stamp_ns)
    assert -1e6 < np.median(delay) < 20e6


def test_estimate_tracks_the_angle_and_the_joint_the_reference(run: Run) -> None:
    angle, estimate = run.recording.angle, run.recording.estimate
    assert angle is not None and estimate is not None
    before = run.recording.stamp_ns < run.at("+flip")
    assert math.degrees(angle[before][-200:].mean()) > 1.0
    _, ours, theirs = np.intersect1d(run.recording.stamp_ns, estimate.stamp_ns, return_indices=True)
    tracked = before[ours]
    error = np.degrees(angle[ours] - estimate.angle[theirs])[tracked]
    assert len(error) > 1000
    assert np.sqrt(np.mean(error[-1000:] ** 2)) < 1.0


def test_every_command_is_answered_within_the_time_out(run: Run) -> None:
    accounting = account(run.recording, 1e-3)
    assert accounting is not None
    assert accounting.latency.median < 20.0


def test_damaged_frames_cost_samples_and_nothing_else(run: Run) -> None:
    """A percent of the bytes: 0.61 of the samples come through, and 0.81 of the commands."""
    damaged = run.between("+flip", "-flip", margin_s=0.1)
    share = damaged.sum() / 900
    assert 0.4 < share < 0.75
    sums = run.recording.voltage[damaged].sum(axis=1)
    # the PI moves both valves by the same: whatever else was on them would have come from damaged bytes
    assert np.all((sums > sum(SAFE) - 1e-3) & (sums < 11.0 + 1e-3))
    assert np.all((run.recording.pressure[damaged] > 101e3) & (run.recording.pressure[damaged] < 715e3))
    warned = status_between(run, "device", run.at("+flip") + 3 * 10**8, run.at("-flip"))
    assert warned and all(status.level == b"\x01" for status in warned)
    assert any("damaged frames from the device" in status.message for status in warned)
    assert any("damaged frames at the device" in status.message for status in warned)


def test_all_voltages_at_the_device_are_commands_or_safe(run: Run) -> None:
    sums = [sum(row.voltage) for row in run.log if row.event == "voltage" and row.time_ns < run.killed_ns][1:]
    # from the safe ones, the controller goes over to its own in half a second
    assert min(sums) > sum(SAFE) - 1e-3 and max(sums) < 11.0 + 1e-3
    assert len(sums) > 1000


def test_without_a_device_nothing_is_published_and_diagnostics_say_so(run: Run) -> None:
    gone, back = run.at("+unplug"), run.at("-unplug")
    assert run.between("+unplug", "-unplug", margin_s=0.05).sum() == 0
    said = status_between(run, "device", gone + 2 * 10**8, back - 10**8)
    assert said and all(status.level == b"\x02" and "no device" in status.message for status in said)


def test_unplugged_device_is_safe_within_its_watchdog(run: Run) -> None:
    gone = run.at("+unplug")
    first = next(row for row in run.log if row.time_ns > gone and row.safe)
    assert first.voltage == SAFE
    assert (first.time_ns - gone) * 1e-6 < LIMIT_MS
    print(f"unplugged: safe after {(first.time_ns - gone) * 1e-6:.1f} ms")
    meanwhile = [row for row in run.log if first.time_ns <= row.time_ns < run.at("-unplug")]
    assert all(row.voltage == SAFE for row in meanwhile)


def test_device_that_is_back_is_used_again(run: Run) -> None:
    stamps = run.recording.stamp_ns
    again = stamps[stamps > run.at("-unplug")]
    assert (again[0] - run.at("-unplug")) * 1e-9 < 2.0
    before = run.between("-unplug", "+nan")
    assert np.ptp(run.recording.voltage[before][-500:, 0]) > 0.0
    angle = run.recording.angle
    assert angle is not None and math.degrees(angle[before][-200:].mean()) > 1.0


def test_missing_pressure_stops_the_valves_until_it_is_cleared(run: Run) -> None:
    begin, end = run.at("+nan"), run.at("-nan")
    after = [row for row in run.log if row.time_ns > begin and row.event == "voltage"]
    safe = next(row for row in after if row.voltage == SAFE)
    assert (safe.time_ns - begin) * 1e-6 < LIMIT_MS
    print(f"pressure missing: safe after {(safe.time_ns - begin) * 1e-6:.1f} ms")
    # NaN is over, and they stay
    assert all(row.voltage == SAFE for row in after if safe.time_ns <= row.time_ns < end + 2 * 10**8)
    said = status_between(run, "safety", begin + 2 * 10**8, end + 2 * 10**8)
    assert said and said[-1].level == b"\x02" and "pressure 1 is missing" in said[-1].message
    first, second = run.cleared
    assert first.success and "pressure 1 is missing" in first.message
    assert second.message == "there is no stop to clear"
    assert any(row.voltage != SAFE for row in after if end + 2 * 10**8 < row.time_ns < run.killed_ns)


def test_inactive_bridge_lets_go_of_the_device(run: Run) -> None:
    assert run.changed == [True, "inactive", True, "active"]
    begun, ended = run.inactive
    rows = [row for row in run.log if row.event == "voltage" and row.time_ns < ended]
    assert rows[-1].safe and rows[-1].voltage == SAFE
    assert (rows[-1].time_ns - begun) * 1e-6 < 1000.0  # the transition's own time; the goodbye is quicker than 20 ms


def test_bridge_killed(run: Run) -> None:
    after = [row for row in run.log if row.time_ns > run.killed_ns and row.event == "voltage"]
    unsafe = [row for row in after if row.voltage != SAFE]
    first = next(row for row in after if row.safe)
    assert first.voltage == SAFE
    assert 10.0 < (first.time_ns - run.killed_ns) * 1e-6 < LIMIT_MS
    assert all(row.time_ns < first.time_ns for row in unsafe)
    print(f"bridge killed: safe after {(first.time_ns - run.killed_ns) * 1e-6:.1f} ms")
