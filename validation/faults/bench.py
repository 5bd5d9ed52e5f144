"""Running pipelines to make faults in: nodes as processes, the valves' voltages, and the runner's ears and mouth."""

from __future__ import annotations

import math
import os
import signal
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from pam_antagonist.control.command import Mode
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.processes import Processes, ProcessFailed, free_domain, ros_arguments
from pam_antagonist.nodes.spin import stay_on_this_machine, tune_middleware
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist_msgs.msg import JointReference, ValveCommand
from validation.faults.stepped import Step
from validation.faults.verdict import (
    BRIDGE_SAFE,
    CONTROLLER_SAFE,
    Fault,
    Outcome,
    Recovery,
    Row,
    Status,
    ValveLog,
    first_obeyed,
    judge,
)

_ANSWER = 10.0  # longest time for a service [s]


_START = 90.0  # for the nodes, which may have to compile first [s]
_READY = 20.0  # for control to come back [s]
_STEADY = 0.3  # of control before a fault [s]
_APART = 0.3  # between the voltages of both valves, as the reference asks for [V]
_PERIOD = 0.1  # of diagnostics [s]
_STAYS = 0.3  # time for which a stop is watched after its cause is gone [s]
_CLEAR = 3.0  # for a stop to be cleared [s]
_BACK = 25.0  # for control to come back [s]
_AFTER = 0.25  # for diagnostics that belong to the fault [s]
_REFERENCE = math.radians(10.0)
_HEARD_BY = {"pressure_1": "estimator", "joint_estimate": "controller", "valve_command": "bridge"}
RELAYED = tuple(_HEARD_BY)
"""Topics that go through the relay of the pipeline ``relayed``, to these nodes."""


class Bench:
    """A pipeline in a domain of its own, with the runner's ears and mouth beside it. A context manager."""

    def __init__(
        self, folder: Path, domain: int, namespace: str = "/pam", rig: str = "shin2022", kind: str = ""
    ) -> None:
        folder.mkdir(parents=True)
        self.folder, self.domain = folder, domain
        self.processes = Processes(folder)
        self.rig = rig  # name or path, of every node and of the device
        self.note = ""  # what a cause has to say beside its times
        self._namespace, self._environment = namespace, {"ROS_DOMAIN_ID": str(domain)}
        self._relayed = RELAYED if kind == "relayed" else ()
        self._step = folder / "step" if kind == "stepped" else None
        self._log = ValveLog(folder / "voltages.csv")
        self._port, self._pipe = folder / "device", folder / "orders"
        self._clock = None if self._step is None else Step(self._step, new=True)
        # The runner's own ears and mouth: they take what has come when they are asked, and cost nothing in between.
        tune_middleware()
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO, domain_id=domain)
        options: dict[str, Any] = {"context": self._context, "start_parameter_services": False}
        self._node = Node("fault_watcher", namespace=namespace, **options)
        self._caller = Node("fault_caller", namespace=namespace, **options)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._caller)
        # every status on /diagnostics of a node in the namespace so far, without the namespace
        self.statuses: list[Status] = []
        self._diagnostics = self._node.create_subscription(DiagnosticArray, "/diagnostics", lambda _: None, qos.RECORD)
        self._reference = self._node.create_publisher(JointReference, TOPICS["reference"].relative, qos.REFERENCE)
        self._clients: dict[str, Any] = {}

    def __enter__(self) -> Bench:
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *reason: object) -> None:
        self.processes.stop()
        self._executor.shutdown()
        self._caller.destroy_node()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _start(self) -> None:
        if self._relayed:
            arguments = [str(self.folder / "relay_orders"), str(self.domain), *self._relayed]
            self.processes.start("relay", arguments, self._environment, module="validation.faults.relay")
        names = ("estimator", "controller", "bridge")
        for name in names:
            self.start(name)
        arguments = ["--rig", self.rig, "--link", str(self._port), "--log", str(self.folder / "voltages.csv")]
        arguments += ["--seed", "3", "--orders", str(self._pipe)]
        self.processes.start("device_emulator", arguments, module="validation")

        def all_there() -> bool:
            heard = {status.part.partition(":")[0] for status in self.statuses}
            return self._reference.get_subscription_count() > 0 and len(heard) >= len(names)

        self.until(all_there, _START, "a start")
        self.ready(_START)

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
            self.processes.start(name, arguments, self._environment)
        else:
            arguments = [str(self._step), *arguments]
            self.processes.start(name, arguments, self._environment, module="validation.faults.stepped")

    def record(self, out: Path) -> None:
        """Start a recorder."""
        arguments = ["--out", str(out), *ros_arguments({"diagnostics_period": _PERIOD}, {"__ns": self._namespace})]
        self.processes.start("record", arguments, self._environment)

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

    def collect(self) -> None:
        """Take what has come."""
        handle, kind, prefix = self._diagnostics.handle, self._diagnostics.msg_type, f"{self._namespace.strip('/')}/"
        with handle:
            while (taken := handle.take_message(kind, False)) is not None:
                for status in taken[0].status:
                    if status.name.startswith(prefix):
                        part = status.name.removeprefix(prefix)
                        values = {item.key: item.value for item in status.values}
                        received_ns = taken[1]["received_timestamp"]
                        self.statuses.append(Status(received_ns, part, status.level[0], status.message, values))

    def latest(self, part: str) -> Status | None:
        """The newest status of a part; None if there is none."""
        return next((status for status in reversed(self.statuses) if status.part == part), None)

    def clear(self, node: str) -> tuple[bool, str]:
        """Ask a node to clear its stop; whether it did, and what it says."""
        name = f"{node}/clear_stop"
        if name not in self._clients:
            self._clients[name] = self._caller.create_client(Trigger, name)
        client = self._clients[name]
        if client.wait_for_service(_ANSWER):
            future = client.call_async(Trigger.Request())
            self._executor.spin_until_future_complete(future, _ANSWER)
            if future.done():
                return bool(future.result().success), str(future.result().message)
        raise ProcessFailed(f"{name} does not answer")

    def intrude(self, seconds: float, voltage: Sequence[float]) -> None:
        """Command the valves beside the controller, 500 times a second [V], for a time [s]."""
        publisher = self._node.create_publisher(ValveCommand, TOPICS["valve_command"].relative, qos.COMMAND)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            publisher.publish(ValveCommand(voltage=list(voltage)))
            time.sleep(0.002)
        self._node.destroy_publisher(publisher)

    def rows(self) -> list[Row]:
        """What was on the valves so far."""
        self.collect()
        return self._log.update()

    def wait(self, seconds: float) -> None:
        """Let time pass, and collect what is said."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.collect()
            time.sleep(min(0.02, max(0.0, end - time.monotonic())))

    def until(self, condition: Callable[[], bool], seconds: float, what: str, pause: float = 0.02) -> None:
        """Wait for something; what the nodes complain about is said where it does not come about in time."""
        end = time.monotonic() + seconds
        while not condition():
            self.processes.check()
            self.collect()
            if time.monotonic() > end:
                newest = {status.part: status for status in self.statuses}
                trouble = "".join(f"; {one.part}: {one.message}" for one in newest.values() if one.level > 0)
                raise ProcessFailed(f"{what} did not come about in time{trouble}")
            time.sleep(pause)

    def controlled(self) -> bool:
        """Whether the controller has had the valves for a while, by the reference, which is sent again."""
        self._reference.publish(JointReference(mode=int(Mode.ANGLE), value=_REFERENCE))
        rows = self.rows()
        now = time.time_ns()
        if not rows or now - rows[-1].time_ns > 0.2e9:  # the last rows wait for their flush
            return False
        first, second = rows[-1].voltage
        since = now - round(_STEADY * 1e9)
        return (
            rows[0].time_ns < since
            and first_obeyed(rows, since) == since
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
                    self.clear(node)
                cleared = time.monotonic()
            return self.controlled()

        self.until(controlled, seconds, "control")
        self.wait(0.15)  # diagnostics of it

    def run_beside(self) -> Bench:
        """Another pipeline beside this one, at 250 Hz, in another namespace of the same domain; entering starts it."""
        rig = self.folder / "slow.yaml"  # at 250 Hz, so that two pipelines have room on two cores
        rig.write_text(f"based_on: {self.rig}\nname: at_250_hz\nsample_period: 0.004\n", encoding="utf-8")
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


def run_faults(
    faults: Sequence[Fault], rig: str, done: Callable[[Outcome], object] = lambda outcome: None
) -> list[Outcome]:
    """Make faults in pipelines of device emulator, bridge, estimator and controller, in the given order."""
    stay_on_this_machine()
    outcomes: list[Outcome] = []
    bench: Bench | None = None
    with tempfile.TemporaryDirectory(prefix="pam_faults_") as name, ExitStack() as stack:
        for number, fault in enumerate(faults):
            if bench is None or fault.bench != faults[number - 1].bench:
                stack.close()
                bench = Bench(Path(name) / str(number), free_domain(), rig=rig, kind=fault.bench)
                try:
                    stack.enter_context(bench)
                except ProcessFailed as error:
                    raise BadInput(f"faults: the pipeline {fault.bench!r} does not start: {error}") from None
            try:
                outcomes.append(make(fault, bench))
            except ProcessFailed as error:
                outcomes.append(Outcome(fault, failures=(str(error),)))
                bench = None  # the next one begins with a pipeline of which everything is known
            done(outcomes[-1])
    return outcomes


def make(fault: Fault, bench: Bench) -> Outcome:
    """Make one fault in a running pipeline, end it, look on until control is back, and judge what happened."""
    bench.ready()
    bench.note = ""
    first = len(bench.statuses)
    first_row = max(0, len(bench.rows()) - 1)
    before = list({status.part: status for status in bench.statuses[:first]}.values())
    cause = fault.cause(bench)
    begin = next(cause)
    bench.wait(fault.lasts)
    over = next(cause)
    cleared = None
    if fault.recovery is Recovery.CLEAR:
        bench.wait(_STAYS)
        cleared = _clear(fault, bench)
    bench.until(bench.controlled, _BACK, "control")
    bench.wait(_AFTER)
    rows = bench.rows()[first_row:]
    said = [*before, *bench.statuses[first:]]
    return judge(fault, begin, over, cleared, rows, said, bench.note)


def _clear(fault: Fault, bench: Bench) -> int:
    """Clear the stops; the time right before the last one, which gives the valves back [ns since 1970]."""
    refused = ""
    for node in fault.clear:
        end = time.monotonic() + _CLEAR
        while True:
            now = time.time_ns()
            good, refused = bench.clear(node)
            if good:
                break
            if time.monotonic() > end:
                raise ProcessFailed(f"{node} does not clear its stop: {refused}")
            bench.wait(0.1)
    return now
