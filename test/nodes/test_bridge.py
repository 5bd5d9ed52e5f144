"""Device emulator, bridge, estimator, controller and recorder as processes, through everything that a line may do."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist import replay
from pam_antagonist.estimation import Estimator
from pam_antagonist.hardware.calibration import Converter, load_calibration
from pam_antagonist.nodes.processes import Processes, ros_arguments
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.replays.accounting import account
from pam_antagonist.rig import load_rig

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

PERIOD_NS = 1_000_000
SAFE = (5.0, 5.25)  # not the default, so that nothing else can be taken for it; exact as float32
LIMIT_MS = 50.0
# [s] after the first command that is not the bridge's own safe voltages
FAULTS = ("flip=0.01@4-5", "unplug@5.2-6", "nan=1@8.5-8.7")
RIG = load_rig("shin2022_regulators", regulators=True)
SAFE_PRESSURE = (311.3e3, 356.3e3)  # of regulators: 3.5 and 4.25 V, exact as float32
GOAL = math.radians(8.0)


@dataclass(frozen=True)
class Run:
    """A recording, the emulator's log (a list of ``probe.Row``), and (time [ns], status) of the bridge."""

    bag: Path
    recording: Recording
    log: list[Any]
    statuses: list[tuple[int, Any]]
    safe: tuple[float, float]
    killed_ns: int
    cleared: list[Any] = field(default_factory=list)
    changed: list[Any] = field(default_factory=list)
    inactive: tuple[int, int] = (0, 0)

    def at(self, event: str) -> int:
        """When an event began [ns]."""
        return next(row.time_ns for row in self.log if row.event == event)

    def between(self, first: str, last: str, margin_s: float = 0.0) -> np.ndarray:
        """Mask of the recorded samples between two events."""
        stamps = self.recording.stamp_ns
        return (stamps > self.at(first) + margin_s * 1e9) & (stamps < self.at(last))

    def voltages(self, first_ns: int, last_ns: float = math.inf) -> list[Any]:
        """Rows of the log with voltages on the valves meanwhile."""
        return [row for row in self.log if row.event == "voltage" and first_ns < row.time_ns < last_ns]

    def said(self, part: str, first_ns: int, last_ns: int) -> list[Any]:
        """What the bridge said of a part meanwhile."""
        return [
            status for at, status in self.statuses if status.name == f"pam/bridge: {part}" and first_ns < at < last_ns
        ]


class Line:
    """The processes, and the log of the device at their end."""

    def __init__(self, folder: Path, processes: Processes, probe: Any, device: list[str]) -> None:
        self.processes, self.probe, self.port, self.log = processes, probe, folder / "device", folder / "voltages.csv"
        self._folder, self._device = folder, [*device, "--link", str(self.port), "--log", str(self.log), "--seed", "3"]

    def start(self, told: dict[str, Any], controller: dict[str, Any], owner: dict[str, Any]) -> None:
        """Start the nodes, and then the device; until the first command that is not the bridge's own."""
        for name, arguments in (
            ("record", ["--out", str(self._folder / "bag")]),
            ("estimator", ros_arguments(told, {})),
            ("controller", ros_arguments({**told, **controller}, {})),
            ("bridge", ros_arguments({"port": str(self.port), "diagnostics_period": 0.1, **owner}, {})),
        ):
            self.processes.start(name, arguments)
        self.probe.until(lambda: self.probe.statuses("pam/bridge: device") != [], 60.0, "a start")
        self.probe.until(lambda: self.probe.matched("reference", 2), 60.0, "a controller and a recorder")
        self.processes.start("device_emulator", self._device, module="validation")
        self.probe.until(lambda: self.logged("voltage", safe_too=False), 60.0, "a first command")

    def logged(self, event: str, safe_too: bool = True) -> bool:
        from probe import read_log

        self.processes.check()
        return self.log.exists() and any(row.event == event and safe_too >= row.safe for row in read_log(self.log))

    def end(self, safe: tuple[float, float], **more: Any) -> Run:
        """Kill the bridge, then stop the others."""
        from probe import kill, read_log

        killed = kill(self.processes, "bridge")
        self.probe.wait(0.2)
        self.processes.stop("device_emulator", "controller", "estimator", "record")
        statuses = [(at, status) for at, message in self.probe.seen["diagnostics"] for status in message.status]
        bag = self._folder / "bag"
        return Run(bag, read_bag(bag), read_log(self.log), statuses, safe, killed, **more)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, module_domain: None) -> Run:
    """Nine seconds at 1 kHz with a reference of 10°, the faults, a stop that is cleared, then the bridge is killed."""
    from probe import Probe, read_log

    folder, safe = tmp_path_factory.mktemp("bridge"), {"safe_voltage": list(SAFE)}
    faults = [word for fault in FAULTS for word in ("--fault", fault)]
    with Processes(folder) as processes, Probe("diagnostics") as probe:
        line = Line(folder, processes, probe, ["--rig", "shin2022", "--drift", "50", *faults])
        line.start({}, safe, safe)
        probe.insist(0, math.radians(10.0))
        probe.until(lambda: line.logged("-nan"), 30.0, "the last fault's end")
        probe.wait(0.2)
        cleared = [probe.trigger("bridge/clear_stop") for _ in range(2)]
        probe.trigger("controller/clear_stop")  # its estimate had no pressure 1
        probe.wait(0.8)
        begun = time.time_ns()
        changed = [probe.transition("bridge", "deactivate"), probe.state("bridge")]
        probe.wait(0.2)
        ended = time.time_ns()
        changed += [probe.transition("bridge", "activate"), probe.state("bridge")]
        again = lambda: any(row.time_ns > ended and row.voltage != SAFE for row in read_log(line.log))  # noqa: E731
        probe.until(again, 20.0, "commands")
        return line.end(SAFE, cleared=cleared, changed=changed, inactive=(begun, ended))


@pytest.fixture(scope="module")
def regulated(tmp_path_factory: pytest.TempPathFactory, module_domain: None) -> Run:
    """A joint with pressure regulators is held at an angle, then the bridge is killed."""
    from probe import Probe

    folder = tmp_path_factory.mktemp("regulators")
    Estimator(RIG)  # compiles, or loads; the processes then find it
    rig = {"rig": "shin2022_regulators"}
    hardware = "example_regulators"
    owner = {**rig, "hardware": hardware, "safe_pressure": list(SAFE_PRESSURE)}
    patient = {"command_timeout": 0.3, "max_command_age": 2.0, "missing_time": 0.5}
    device = ["--rig", rig["rig"], "--hardware", hardware, "--mismatch", "0.01"]
    with Processes(folder) as processes, Probe("diagnostics") as probe:
        line = Line(folder, processes, probe, device)
        line.start({**rig, "max_age": 0.5}, {"law": "model"}, {**owner, **patient})
        probe.insist(0, GOAL)
        probe.wait(2.0)
        return line.end(Converter(load_calibration(hardware)).output(SAFE_PRESSURE))


def test_log_has_the_faults_in_order(run: Run) -> None:
    events = [row.event for row in run.log if row.event != "voltage"]
    assert events == ["+flip", "-flip", "+unplug", "-unplug", "+nan", "-nan"]


def test_nothing_is_lost_on_a_line_in_order_and_stamps_are_even(run: Run) -> None:
    stamps = run.recording.stamp_ns
    steps = np.diff(stamps[stamps < run.at("+flip")])
    assert len(steps) > 1000
    values = {item.key: item.value for item in run.said("device", int(stamps[0]), run.at("+flip"))[-1].values}
    assert (values["samples lost"], values["damaged frames from the device"]) == ("0", "0")
    # what the recorder lacks on a busy machine is not the bridge's doing
    missing = np.rint(steps / PERIOD_NS) - 1
    assert missing.sum() <= 0.01 * len(steps)
    assert np.all(np.abs(steps - (missing + 1) * PERIOD_NS) < 1100 * (missing + 1))  # 1.1 per mille: none jumps
    assert np.all(np.diff(stamps) > 0)
    received = run.recording.received_ns["pressure_1"]
    delay = np.asarray(received.log_ns) - np.asarray(received.stamp_ns)
    assert -1e6 < np.median(delay) < 20e6, "stamps are ROS time"
    accounting = account(run.recording, 1e-3)
    assert accounting is not None and accounting.latency.median < 20.0


def test_estimate_tracks_the_angle_and_the_joint_the_reference(run: Run) -> None:
    angle, estimate = run.recording.angle, run.recording.estimate
    assert angle is not None and estimate is not None
    before = run.recording.stamp_ns < run.at("+flip")
    assert math.degrees(angle[before][-200:].mean()) > 1.0
    _, ours, theirs = np.intersect1d(run.recording.stamp_ns, estimate.stamp_ns, return_indices=True)
    error = np.degrees(angle[ours] - estimate.angle[theirs])[before[ours]]
    assert len(error) > 1000
    assert np.sqrt(np.mean(error[-1000:] ** 2)) < 1.0


def test_damaged_frames_cost_samples_and_nothing_else(run: Run) -> None:
    """A percent of the bytes: 0.61 of the samples come through, and 0.81 of the commands."""
    damaged = run.between("+flip", "-flip", margin_s=0.1)
    assert 0.4 < damaged.sum() / 900 < 0.75
    sums = run.recording.voltage[damaged].sum(axis=1)
    # the PI moves both valves by the same: whatever else was on them would have come from damaged bytes
    assert np.all((sums > sum(SAFE) - 1e-3) & (sums < 11.0 + 1e-3))
    assert np.all((run.recording.pressure[damaged] > 101e3) & (run.recording.pressure[damaged] < 715e3))
    warned = run.said("device", run.at("+flip") + 3 * 10**8, run.at("-flip"))
    assert warned and all(status.level == b"\x01" for status in warned)
    for words in ("damaged frames from the device", "damaged frames at the device"):
        assert any(words in status.message for status in warned)


def test_all_voltages_at_the_device_are_commands_or_safe(run: Run) -> None:
    sums = [sum(row.voltage) for row in run.voltages(0, run.killed_ns)][1:]
    # from the safe ones, the controller goes over to its own in half a second
    assert min(sums) > sum(SAFE) - 1e-3 and max(sums) < 11.0 + 1e-3
    assert len(sums) > 1000


def test_unplugged_device_is_safe_within_its_watchdog_and_used_again_when_it_is_back(run: Run) -> None:
    gone, back = run.at("+unplug"), run.at("-unplug")
    first = next(row for row in run.log if row.time_ns > gone and row.safe)
    assert first.voltage == SAFE and (first.time_ns - gone) * 1e-6 < LIMIT_MS
    print(f"unplugged: safe after {(first.time_ns - gone) * 1e-6:.1f} ms")
    assert all(row.voltage == SAFE for row in run.voltages(first.time_ns - 1, back))
    assert run.between("+unplug", "-unplug", margin_s=0.05).sum() == 0, "nothing is published"
    said = run.said("device", gone + 2 * 10**8, back - 10**8)
    assert said and all(status.level == b"\x02" and "no device" in status.message for status in said)
    stamps = run.recording.stamp_ns
    assert (stamps[stamps > back][0] - back) * 1e-9 < 2.0
    before = run.between("-unplug", "+nan")
    assert np.ptp(run.recording.voltage[before][-500:, 0]) > 0.0
    angle = run.recording.angle
    assert angle is not None and math.degrees(angle[before][-200:].mean()) > 1.0


def test_missing_pressure_stops_the_valves_until_it_is_cleared(run: Run) -> None:
    begin, end = run.at("+nan"), run.at("-nan")
    safe = next(row for row in run.voltages(begin) if row.voltage == SAFE)
    assert (safe.time_ns - begin) * 1e-6 < LIMIT_MS
    print(f"pressure missing: safe after {(safe.time_ns - begin) * 1e-6:.1f} ms")
    # NaN is over, and they stay
    assert all(row.voltage == SAFE for row in run.voltages(safe.time_ns - 1, end + 2 * 10**8))
    said = run.said("safety", begin + 2 * 10**8, end + 2 * 10**8)
    assert said and said[-1].level == b"\x02" and "pressure 1 is missing" in said[-1].message
    first, second = run.cleared
    assert first.success and "pressure 1 is missing" in first.message
    assert second.message == "there is no stop to clear"
    assert any(row.voltage != SAFE for row in run.voltages(end + 2 * 10**8, run.killed_ns))


def test_inactive_bridge_lets_go_of_the_device(run: Run) -> None:
    assert run.changed == [True, "inactive", True, "active"]
    begun, ended = run.inactive
    last = run.voltages(0, ended)[-1]
    assert last.safe and last.voltage == SAFE
    assert (last.time_ns - begun) * 1e-6 < 1000.0  # the transition's own time; the goodbye is quicker than 20 ms


@pytest.mark.slow(12)
@pytest.mark.parametrize("which", ["run", "regulated"])
def test_with_the_bridge_killed_the_device_is_safe_by_itself(which: str, request: pytest.FixtureRequest) -> None:
    run: Run = request.getfixturevalue(which)
    after = run.voltages(run.killed_ns)
    first = next(row for row in after if row.safe)
    assert first.voltage == run.safe == (SAFE if which == "run" else (3.5, 4.25))
    assert 10.0 < (first.time_ns - run.killed_ns) * 1e-6 < LIMIT_MS
    assert all(row.voltage == run.safe for row in after if row.time_ns >= first.time_ns)
    print(f"bridge killed: safe after {(first.time_ns - run.killed_ns) * 1e-6:.1f} ms")


def test_a_joint_with_regulators_is_held_over_the_serial_line_and_nothing_is_wrong(regulated: Run) -> None:
    recording = regulated.recording
    assert recording.drive == "regulator" and recording.angle is not None
    # The last rows have no angle and no command where the recording ends between its messages.
    held = recording.angle[-200:]
    assert np.isfinite(held).mean() > 0.95
    assert np.nanmean(held) == pytest.approx(GOAL, abs=math.radians(1.5))
    low, high = RIG.command_limits
    known = np.isfinite(recording.voltage).all(axis=1)
    commands = recording.voltage[known]
    assert known[: len(known) - len(held)].all() and known.mean() > 0.95
    assert np.all((commands > low - 1.0) & (commands < high + 1.0)), "pressures, not volts"
    assert not [status.message for status in regulated.said("safety", 0, 2**63) if status.level > b"\0"]
    live = replay(regulated.bag, RIG).report.live_equal
    assert live is not None and live.equal == live.compared > 1500
