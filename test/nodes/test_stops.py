"""Every stop of plant and controller as processes: safe voltages in time, latched until cleared; and one commander.

The tests stand in for the estimator, so that they decide what the controller is told; plant and controller have safe
voltages of their own, which tells whose doing it is.
"""

from __future__ import annotations

import itertools
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from pam_antagonist.nodes.processes import Processes, ros_arguments

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

PLANT_SAFE = (5.0, 5.2)
CONTROLLER_SAFE = (5.3, 5.1)
SAFE = (PLANT_SAFE, CONTROLLER_SAFE)
PRESSURE_LIMIT = 500e3
CONTROLLER = ros_arguments({"safe_voltage": list(CONTROLLER_SAFE), "diagnostics_period": 0.2, "max_angle": 0.5}, {})
LIMIT_MS = 100.0  # twice what is asked for at a device: the thread that feeds the controller is none of its own


class Feeder:
    """An estimator whose estimates are what the tests say, at 1 kHz."""

    def __init__(self, probe: Any) -> None:
        self._publisher = probe.publisher("joint_estimate")
        self._now = probe.now_ns
        self._running = True
        self.sent: list[int] = []
        self._thread = threading.Thread(target=self._run)
        self.usual()
        self._thread.start()

    def usual(self) -> None:
        self.angle, self.nis, self.flags, self.shift_ns, self.silent = 0.1, 2.0, 0, 0, False

    def _run(self) -> None:
        from pam_antagonist_msgs.msg import JointEstimate

        while self._running:
            message = JointEstimate(angle=self.angle, nis=self.nis, flags=self.flags)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(self._now() + self.shift_ns, 10**9)
            if not self.silent:
                self._publisher.publish(message)
                self.sent.append(time.time_ns())
            time.sleep(0.001)

    def stop(self) -> None:
        self._running = False
        self._thread.join()


class Bench:
    """Plant and controller, and everything to torment them with."""

    def __init__(self, processes: Processes, probe: Any, feeder: Feeder) -> None:
        self.processes, self.probe, self.feeder = processes, probe, feeder

    def enable(self, wanted: bool) -> Any:
        from std_srvs.srv import SetBool

        return self.probe.call(SetBool, "controller/enable", data=wanted)

    def work(self) -> None:
        """Clear what the test before has left, and wait until the controller moves the valves."""
        self.feeder.usual()
        self.processes.check()
        stops = ("plant/clear_stop", "controller/clear_stop")
        self.probe.until(lambda: all(self.probe.trigger(stop).success for stop in stops), 10.0, "a clear")
        self.probe.follow(degrees=11.5, apart=0.45)

    def said(self, part: str) -> list[tuple[int, str]]:
        """Level and message of each status of a part so far."""
        return [(status.level[0], status.message) for status in self.probe.statuses(part)]

    def all_safe(self, safe: tuple[float, float], seconds: float = 0.25) -> bool:
        self.probe.clear()
        self.probe.wait(seconds)
        states = set(self.probe.voltages())
        assert len(self.probe.seen["valve_state"]) > 100 * seconds
        # The plant has its own ones while the controller has had no estimate for a moment, on a busy machine.
        return safe in states and states <= {safe, PLANT_SAFE}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory, module_domain: None) -> Iterator[Bench]:
    from probe import Probe

    plant = {"safe_voltage": list(PLANT_SAFE), "max_pressure": [PRESSURE_LIMIT, 2e6], "diagnostics_period": 0.2}
    with (
        Processes(tmp_path_factory.mktemp("stops")) as processes,
        Probe("valve_command", "valve_state", "diagnostics", "pressure_1") as probe,
    ):
        processes.start("plant", ros_arguments(plant, {}))
        processes.start("controller", CONTROLLER)
        feeder = Feeder(probe)
        try:
            ready = lambda: probe.matched("reference") and probe.seen["valve_state"] and probe.seen["valve_command"]  # noqa: E731
            probe.until(ready, 60.0, "plant and controller")
            yield Bench(processes, probe, feeder)
        finally:
            feeder.stop()


STOPS: dict[str, tuple[Callable[[Feeder], None], float, int, str]] = {
    "angle": (lambda feeder: setattr(feeder, "angle", -0.5), 10.0, 11, "estimated angle is -0.500 rad"),
    "innovations": (lambda feeder: setattr(feeder, "nis", 50.0), 15.0, 16, "pressures disagree"),
    "outliers": (lambda feeder: setattr(feeder, "flags", 8), 15.0, 16, "pressures disagree"),
    "blind": (lambda feeder: setattr(feeder, "flags", 2), 100.0, 51, "without pressure 2"),
}
"""What goes wrong, after how long [ms] and how many estimates it is to stop the valves, and what is said then."""


@pytest.mark.parametrize("name", STOPS)
def test_controller_stops_latches_and_is_cleared_without_a_bump(bench: Bench, name: str) -> None:
    begin, takes_ms, samples, reason = STOPS[name]
    bench.work()
    bench.feeder.sent.clear()
    begin(bench.feeder)
    bench.probe.wait(0.3)
    received = bench.probe.seen["valve_state"]
    unsafe = [index for index, (_, message) in enumerate(received) if tuple(message.voltage) not in SAFE]
    sent = bench.feeder.sent
    due = max(sent[0] + takes_ms * 1e6, sent[samples])
    assert (received[unsafe[-1] + 1][0] - due) * 1e-6 < LIMIT_MS
    assert bench.all_safe(CONTROLLER_SAFE)
    answer = bench.probe.trigger("controller/clear_stop")
    assert not answer.success and reason in answer.message  # the cause is still there
    bench.feeder.usual()
    assert bench.all_safe(CONTROLLER_SAFE, 0.4)  # gone, and it stays stopped
    stopped = [text for level, text in bench.said("pam/controller: commands") if level == 2]
    assert stopped and reason in stopped[-1]
    bench.probe.clear()
    answer = bench.probe.trigger("controller/clear_stop")
    assert answer.success and reason in answer.message
    bench.probe.wait(0.1)
    commands = bench.probe.voltages("valve_command")
    first = next(voltage for voltage in commands if voltage != CONTROLLER_SAFE)
    assert first == pytest.approx(CONTROLLER_SAFE, abs=0.02)


def test_estimates_that_stay_away_do_not_latch(bench: Bench) -> None:
    bench.work()
    bench.feeder.silent = True
    bench.probe.wait(0.1)
    assert CONTROLLER_SAFE in bench.probe.voltages()
    # the controller's commands go on, with the stamp of the last estimate, which is too old by now
    assert bench.all_safe(PLANT_SAFE, 0.1)
    assert bench.probe.voltage("valve_command") == CONTROLLER_SAFE
    bench.work()


@pytest.mark.slow(4)
@pytest.mark.parametrize("way", ["signal", "service of its life cycle"])
def test_a_controller_that_is_told_to_end_leaves_safe_voltages_behind(bench: Bench, way: str) -> None:
    bench.work()
    process = bench.processes.running.pop("controller")
    if way == "signal":
        process.popen.send_signal(signal.SIGINT)
    else:
        assert bench.probe.transition("controller", "shutdown")
    assert process.popen.wait(10.0) == 0
    bench.probe.wait(0.1)
    assert bench.probe.voltage("valve_command") == CONTROLLER_SAFE
    assert bench.all_safe(PLANT_SAFE, 0.1)  # the plant's own, since nobody commands
    assert "Traceback" not in process.log.read_text()
    bench.processes.start("controller", CONTROLLER)
    bench.probe.until(lambda: bool(bench.probe.seen["valve_command"]), 60.0, "the controller")


def test_disabled_is_safe_once_then_silent_and_enabled_goes_on_from_the_valves(bench: Bench) -> None:
    bench.work()
    assert bench.enable(False).success
    bench.probe.wait(0.1)
    assert bench.probe.voltage("valve_command") == CONTROLLER_SAFE
    assert bench.all_safe(PLANT_SAFE)  # the plant's own, since nobody commands
    assert bench.probe.seen["valve_command"] == []
    answer = bench.enable(True)
    assert answer.success and "5.000 and 5.200 V" in answer.message
    bench.probe.until(lambda: len(bench.probe.seen["valve_command"]) > 50, 5.0, "commands")
    commands = bench.probe.voltages("valve_command")
    assert commands[0] == pytest.approx(PLANT_SAFE, abs=1e-9)
    late = CONTROLLER_SAFE  # for a moment without estimates, on a busy machine
    pairs = [pair for pair in itertools.pairwise(commands) if late not in pair]
    assert pairs and max(abs(b - a) for one, two in pairs for a, b in zip(one, two, strict=True)) < 0.05


def test_a_second_commander_is_refused_and_reported(bench: Bench) -> None:
    from pam_antagonist_msgs.msg import ValveCommand

    bench.work()
    intruder = bench.probe.publisher("valve_command")
    bench.probe.until(lambda: intruder.get_subscription_count() > 0, 10.0, "the plant")
    bench.probe.wait(0.3)  # the controller holds the valves, and its count is far from the intruder's
    bench.probe.clear()
    end = time.monotonic() + 0.7
    while time.monotonic() < end:
        intruder.publish(ValveCommand(voltage=[10.0, 0.0]))
        bench.probe.wait(0.002)
    states = bench.probe.voltages()
    assert len(states) > 300
    assert max(first for first, _ in states) < 8.0 and min(second for _, second in states) > 2.0
    safe = sum(state in (PLANT_SAFE, CONTROLLER_SAFE) for state in states)
    assert safe < 0.5 * len(states)  # the controller was obeyed; on a busy machine it lacks estimates at times
    errors = [text for level, text in bench.said("pam/plant: commands") if level == 2]
    assert errors and "/pam/controller is obeyed, refused: /pam/probe" in errors[-1]
    bench.probe.wait(0.5)
    assert bench.said("pam/plant: commands")[-1][0] < 2
    assert not any("stopped" in text for _, text in bench.said("pam/plant: safety"))


def test_over_pressure_stops_the_plant_and_nothing_whips_when_it_is_cleared(bench: Bench) -> None:
    bench.work()
    bench.feeder.angle = -0.4  # what the controller is told, so that it opens valve 1
    bench.probe.refer(0, 0.45)
    stopped = lambda: any("stopped" in text for _, text in bench.said("pam/plant: safety"))  # noqa: E731
    bench.probe.clear()
    bench.probe.until(stopped, 15.0, "a stop")
    received = bench.probe.seen["valve_state"]
    over = [at for at, message in bench.probe.seen["pressure_1"] if message.fluid_pressure > PRESSURE_LIMIT]
    first_safe = next(at for at, message in received if tuple(message.voltage) == PLANT_SAFE)
    assert -LIMIT_MS < (over[0] - first_safe) * 1e-6 < LIMIT_MS
    bench.probe.wait(0.2)  # in which the controller notices
    assert bench.all_safe(PLANT_SAFE, 0.3)
    assert "pressure 1 is" in bench.said("pam/plant: safety")[-1][1]
    # What the controller asks for meanwhile stays near what is on the valves, rather than at ten volts.
    commands = bench.probe.voltages("valve_command")
    assert max(abs(first - PLANT_SAFE[0]) for first, _ in commands) < 1.5
    errors = [text for level, text in bench.said("pam/controller: commands") if level == 2]
    assert errors and "do not get what is commanded" in errors[-1]
    bench.feeder.usual()
    bench.probe.refer(0, 0.12)
    bench.probe.wait(0.3)  # in which the controller takes note of both: a new reference is a step in any state
    bench.probe.clear()
    answer = bench.probe.trigger("plant/clear_stop")
    assert answer.success and "above 500.0 kPa" in answer.message
    bench.probe.wait(0.3)
    voltages = [PLANT_SAFE, *bench.probe.voltages()]
    assert len(set(voltages)) > 20
    jumps = [max(abs(b - a) for a, b in zip(one, two, strict=True)) for one, two in itertools.pairwise(voltages)]
    assert max(jumps) < 1.5


def test_a_clock_that_is_set_back_starts_the_controller_anew_and_is_said_once(bench: Bench) -> None:
    bench.work()
    bench.probe.clear()
    bench.feeder.shift_ns = -5 * 10**9
    bench.probe.wait(0.1)
    bench.feeder.silent = True
    bench.probe.wait(0.05)
    bench.feeder.shift_ns, bench.feeder.silent = 0, False
    bench.probe.wait(0.6)
    jumped = [text for _, text in bench.said("pam/controller: commands") if "jumped backwards" in text]
    assert len(jumped) == 1
    assert not any(math.isnan(value) for _, message in bench.probe.seen["valve_command"] for value in message.voltage)
    bench.work()


def test_logs_hold_no_traceback(bench: Bench) -> None:
    bench.processes.check()
    for process in bench.processes.running.values():
        assert "Traceback" not in process.log.read_text()
