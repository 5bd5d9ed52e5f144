"""Running pipelines to make faults in: every node a process, the valves' voltages from where they are applied."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

from pam_antagonist.nodes.processes import Processes, ProcessFailed, ros_arguments
from validation.faults import valve_log
from validation.faults.stepped import Step
from validation.faults.valve_log import BRIDGE_SAFE, CONTROLLER_SAFE, Row, ValveLog
from validation.faults.watcher import Watcher

_START = 90.0  # for the nodes, which may have to compile first [s]
_READY = 20.0  # for control to come back [s]
_STEADY = 0.3  # of control before a fault [s]
_APART = 0.3  # between the voltages of both valves, as the reference asks for [V]
_PERIOD = 0.1  # of diagnostics [s]
REFERENCE = math.radians(10.0)
_HEARD_BY = {"pressure_1": "estimator", "joint_estimate": "controller", "valve_command": "bridge"}
RELAYED = tuple(_HEARD_BY)
"""Topics that go through the relay of the pipeline ``relayed``, to these nodes."""

SLOW_RIG = "based_on: {base}\nname: at_250_hz\nsample_period: 0.004\n"
"""A rig at 250 Hz, so that two pipelines have room on two cores."""


class Bench:
    """A pipeline in a domain of its own, with the runner's watcher beside it. A context manager.

    Attributes:
        processes: the nodes.
        watcher: ears and mouth.
        folder: the folder.
        rig: name or path, of every node and of the device.
    """

    def __init__(
        self, folder: Path, domain: int, namespace: str = "/pam", rig: str = "shin2022", kind: str = ""
    ) -> None:
        folder.mkdir(parents=True)
        self.folder, self.domain = folder, domain
        self.processes = Processes(folder)
        self.watcher = Watcher(namespace, domain)
        self.rig = rig
        self._namespace = namespace
        self._relayed = RELAYED if kind == "relayed" else ()
        self._step = folder / "step" if kind == "stepped" else None
        self._log = ValveLog(folder / "voltages.csv")
        self._port, self._pipe = folder / "device", folder / "orders"
        self._clock = None if self._step is None else Step(self._step, new=True)
        self._stack = ExitStack()

    def __enter__(self) -> Bench:
        with ExitStack() as stack:
            stack.enter_context(self.watcher)
            stack.enter_context(self.processes)
            self._start()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *reason: object) -> None:
        self._stack.close()

    # ---------------------------------------------------------------- processes

    def _start(self) -> None:
        if self._relayed:
            arguments = [str(self.folder / "relay_orders"), str(self.domain), *self._relayed]
            self.processes.start("relay", arguments, self._environment(), module="validation.faults.relay")
        names = ("estimator", "controller", "bridge")
        for name in names:
            self.start(name)
        arguments = ["--rig", self.rig, "--link", str(self._port), "--log", str(self.folder / "voltages.csv")]
        self.processes.start("device_emulator", [*arguments, "--seed", "3", "--orders", str(self._pipe)])

        def all_there() -> bool:
            heard = {status.part.partition(":")[0] for status in self.watcher.statuses}
            return self.watcher.listeners() > 0 and len(heard) >= len(names)

        self.until(all_there, _START, "a start")
        self.ready(_START)

    def _environment(self) -> dict[str, str]:
        return {"ROS_DOMAIN_ID": str(self.domain)}

    def start(self, name: str, more: Mapping[str, object] | None = None) -> None:
        """Start a node, with other parameters than usual where some are given."""
        safe = CONTROLLER_SAFE if name == "controller" else BRIDGE_SAFE
        parameters: dict[str, object] = {"rig": self.rig, "diagnostics_period": _PERIOD}
        if name in ("bridge", "controller"):
            parameters["safe_voltage"] = list(safe)
        if name == "bridge":
            parameters["port"] = str(self._port)
        remappings = {"__ns": self._namespace}
        remappings |= {t: f"relayed/{t}" for t in self._relayed if _HEARD_BY.get(t) == name}
        arguments = ros_arguments({**parameters, **(more or {})}, remappings)
        if self._step is None:
            self.processes.start(name, arguments, self._environment())
        else:
            arguments = [str(self._step), *arguments]
            self.processes.start(name, arguments, self._environment(), module="validation.faults.stepped")

    def record(self, out: Path) -> None:
        """Start a recorder."""
        arguments = ["--out", str(out), *ros_arguments({"diagnostics_period": _PERIOD}, {"__ns": self._namespace})]
        self.processes.start("record", arguments, self._environment())

    def kill(self, name: str) -> int:
        """SIGKILL for a node; the time right before [ns since 1970]."""
        popen = self.processes.running.pop(name).popen
        now = time.time_ns()
        popen.kill()
        popen.wait()
        return now

    def stall(self, name: str, seconds: float) -> tuple[int, int]:
        """Let a process stand still; begin and end [ns since 1970]."""
        popen = self.processes.running[name].popen
        begin = time.time_ns()
        popen.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        end = time.time_ns()
        popen.send_signal(signal.SIGCONT)
        return begin, end

    # ---------------------------------------------------------------- orders

    def order(self, text: str) -> int:
        """Give the device an order; when it carried it out [ns since 1970]."""
        before, event = len(self.rows()), text.partition("=")[0]
        _write(self._pipe, text)
        done: list[int] = []

        def carried_out() -> bool:
            done.extend(row.time_ns for row in self.rows()[before:] if row.event == event)
            return bool(done)

        self.until(carried_out, 5.0, f"the device's {text}", 0.005)
        return done[0]

    def relay(self, text: str) -> int:
        """Give the relay an order; when [ns since 1970]."""
        now = time.time_ns()
        _write(self.folder / "relay_orders", text)
        return now

    def set_clock_back(self, seconds: float) -> int:
        """Set the nodes' time back, or ahead where that is negative; when [ns since 1970]."""
        assert self._clock is not None
        now = time.time_ns()
        self._clock.ns -= round(seconds * 1e9)
        return now

    # ---------------------------------------------------------------- looking

    def rows(self) -> list[Row]:
        """What was on the valves so far."""
        self.watcher.collect()
        return self._log.update()

    def wait(self, seconds: float) -> None:
        """Let time pass, and collect what is said."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.watcher.collect()
            time.sleep(min(0.02, max(0.0, end - time.monotonic())))

    def until(self, condition: Callable[[], bool], seconds: float, what: str, pause: float = 0.02) -> None:
        """Wait for something; what the nodes complain about is said where it does not come about in time."""
        end = time.monotonic() + seconds
        while not condition():
            self.processes.check()
            self.watcher.collect()
            if time.monotonic() > end:
                newest = {status.part: status for status in self.watcher.statuses}
                trouble = "".join(f"; {one.part}: {one.message}" for one in newest.values() if one.level > 0)
                raise ProcessFailed(f"{what} did not come about in time{trouble}")
            time.sleep(pause)

    def controlled(self) -> bool:
        """Whether the controller has had the valves for a while, by the reference, which is sent again."""
        self.watcher.refer(REFERENCE)
        rows = self.rows()
        now = time.time_ns()
        if not rows or now - rows[-1].time_ns > 0.2e9:  # the last rows wait for their flush
            return False
        first, second = rows[-1].voltage
        since = now - round(_STEADY * 1e9)
        return (
            rows[0].time_ns < since
            and valve_log.first_obeyed(rows, since) == since
            and all(not row.safe for row in rows if row.time_ns >= since)
            and first - second > _APART
        )

    def ready(self, seconds: float = _READY) -> None:
        """Wait for control, clearing whatever an earlier fault has left."""
        cleared = time.monotonic()

        def controlled() -> bool:
            nonlocal cleared
            if time.monotonic() - cleared > 2.0:
                for node in ("bridge", "controller"):
                    self.watcher.clear(node)
                cleared = time.monotonic()
            return self.controlled()

        self.until(controlled, seconds, "control")
        self.wait(0.15)  # diagnostics of it

    def back(self, seconds: float) -> None:
        """Wait for control without clearing anything."""
        self.until(self.controlled, seconds, "control")

    def run_beside(self) -> Bench:
        """Another pipeline beside this one, at 250 Hz, in another namespace of the same domain; entering starts it."""
        rig = self.folder / "slow.yaml"
        rig.write_text(SLOW_RIG.format(base=self.rig), encoding="utf-8")
        return Bench(self.folder / "second", self.domain, namespace="/left/elbow", rig=str(rig))


def _write(pipe: Path, text: str) -> None:
    """A line into a named pipe that somebody reads."""
    try:
        descriptor = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
    except OSError as error:
        raise ProcessFailed(f"{pipe.name}: nobody takes orders: {error.strerror}") from None
    try:
        os.write(descriptor, text.encode() + b"\n")
    finally:
        os.close(descriptor)
