"""What commands share that drive a joint by a plan: owner of the valves, limits, the plan's files, the recording."""

from __future__ import annotations

import argparse
import math
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pam_antagonist.cli.common import Parser
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.program import typed

if TYPE_CHECKING:
    from pam_antagonist.design import Limits, Plan
    from pam_antagonist.design.exploration import Program
    from pam_antagonist.rig import Rig


SOURCES = ("plant", "bridge", "none", "rehearsal")
SIMULATED = ("plant", "rehearsal")
PLAN_NOTE = "pam_antagonist.plan"
"""Name of the note in a bag that holds ``plan.json``."""
_DRAIN_S = 0.3
_COMMAND_TIMEOUT = 0.1
"""[s] The commands of a plan come from a process without real-time priority."""
_STOP_BEYOND = 0.1
"""The owner of the valves stops them where a pressure is so far above the limit, as a share of the limits' width."""
_LONGEST_VENT_S = 20.0
"""[s] So long a plan waits for the pressures to fall below half way to the limit."""
_KPA = 1e3


@dataclass(frozen=True)
class Owner:
    """Who owns the valves."""

    source: str  # ``plant``, ``bridge``, ``none`` (a node that runs already), or ``rehearsal`` (no node at all)
    rig: str
    seed: int = 0
    mismatch: float = 0.0  # of a simulated joint's parameters from the rig file [-]
    port: str | None = None
    hardware: str | None = None
    parameters: Path | None = None

    @classmethod
    def of(cls, arguments: argparse.Namespace, rig: str) -> Owner:
        """From the arguments of :func:`add_source`."""
        for option in ("port", "hardware"):
            if getattr(arguments, option) is not None and arguments.source != "bridge":
                raise BadInput(f"--{option}: only a bridge has one; give --source bridge as well")
        path = str(Path(rig).resolve()) if rig.endswith((".yaml", ".yml")) else rig
        return cls(
            arguments.source, path, arguments.seed, arguments.mismatch, arguments.port, arguments.hardware,
            arguments.parameters,
        )  # fmt: skip

    def command_line(self, plan: Plan, drive: str) -> list[str]:
        """Arguments of the node. `drive`: of the rig."""
        from pam_antagonist.nodes.processes import ros_arguments

        low, high = plan.limits.pressure
        given: dict[str, object] = {
            "rig": self.rig,
            "command_timeout": _COMMAND_TIMEOUT,
            {"valve": "safe_voltage", "regulator": "safe_pressure"}[drive]: list(plan.rest),
            "max_pressure": [high + _STOP_BEYOND * (high - low)] * 2,
        }
        if self.source == "plant":
            given |= {"joint": plan.joint, "lock_angle": plan.lock_angle, "wait_for_subscribers": 1}
            given |= {"seed": self.seed, "mismatch": self.mismatch, "initial_pressure": [plan.pressure] * 2}
        bridge = {"port": self.port, "hardware": self.hardware}
        given |= {name: value for name, value in bridge.items() if value is not None}
        files = [] if self.parameters is None else ["--params-file", str(self.parameters)]
        return [*ros_arguments(given, {}), *files]


class DrivenExperiment(NamedTuple):
    """What came of an experiment."""

    bag: Path
    begun_ns: int  # stamp at which it began [ns]
    ended: str  # why it ended early, in words; empty where it did not


def add_limits(out: Parser) -> None:
    """Limits of an experiment."""
    for name, unit, text in (
        ("--min-pressure", "KPA", "least pressure, absolute [kPa] (default: 15 %% of the supply's gauge pressure)"),
        ("--max-pressure", "KPA", "largest pressure, absolute [kPa] (default: 97 %% of the supply's gauge pressure)"),
        ("--max-angle", "DEG", "largest angle either way [deg] (default: nine tenths of the stop; 20 without one)"),
        ("--max-rate", "RAD_S", "largest rate of the angle [rad/s] (default: 10)"),
    ):
        out.option(name, text, float, metavar=unit)


def limits_of(arguments: argparse.Namespace, rig: Rig) -> Limits:
    """The limits that were given, with defaults."""
    from pam_antagonist.design import Limits

    low, high = Limits.of(rig).pressure
    low = low if arguments.min_pressure is None else arguments.min_pressure * _KPA
    high = high if arguments.max_pressure is None else arguments.max_pressure * _KPA
    angle = None if arguments.max_angle is None else math.radians(arguments.max_angle)
    return Limits.of(rig, (low, high), angle, arguments.max_rate)


def add_source(out: Parser) -> None:
    """Who owns the valves."""
    source = "what owns the valves (default: plant); rehearsal: a simulated joint without ROS, faster than real time"
    out.option("--source", source, default="plant", choices=SOURCES)
    out.option("--port", "serial port of the bridge's device", metavar="PATH")
    out.option("--hardware", "calibration of the bridge's device", metavar="FILE")
    out.option("--parameters", "parameter file of plant or bridge", Path, metavar="FILE")
    out.shared("--mismatch")


def stay_apart() -> None:
    """Have the nodes of this process hear only those that it starts, unless the environment says otherwise."""
    # A domain of its own keeps two experiments, or an experiment and a rig, from hearing each other.
    if "ROS_DOMAIN_ID" not in os.environ:
        from pam_antagonist.nodes.processes import free_domain

        os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def how_to_watch() -> str:
    """The line that shows the joint of this process in the browser: it is in a ROS domain of its own."""
    return f"to watch it in the browser: ROS_DOMAIN_ID={os.environ.get('ROS_DOMAIN_ID', '0')} {typed('watch')}"


def drive(owner: Owner, plan: Plan, out: Path, rig: Rig, program: Program | None = None) -> DrivenExperiment:
    """Drive the joint and record it into ``out/bag``, with ``out/plan.json`` as a note where there is one.

    `program` drives it in place of the plan's voltages; the plan then says where the joint rests, and its limits.
    """
    from pam_antagonist.design.exploration import Planned
    from pam_antagonist.recording.notes import write_notes

    program = Planned(plan.voltage, plan.period) if program is None else program
    if owner.source == "rehearsal":
        from pam_antagonist.rig import load_rig

        joint = load_rig(owner.rig, regulators=True)
        begun_ns, ended = rehearse(joint, plan, program, owner.seed, owner.mismatch, out / "bag")
    else:
        begun_ns, ended = _through_nodes(owner, plan, program, rig.drive, out)
    if (out / "plan.json").exists():
        write_notes(out / "bag", {PLAN_NOTE: (out / "plan.json").read_text(encoding="utf-8")})
    return DrivenExperiment(out / "bag", begun_ns, ended)


def _through_nodes(owner: Owner, plan: Plan, program: Program, drive: str, out: Path) -> tuple[int, str]:
    """Stamp at which the experiment began [ns], and in words why it ended early."""
    from pam_antagonist.nodes.client import DriveClient
    from pam_antagonist.nodes.processes import Processes, ProcessFailed

    if owner.source != "none":  # a node that runs already is heard
        stay_apart()
    rest, ready = np.array(plan.rest), 0.5 * (plan.pressure + plan.limits.pressure[1])
    (out / "logs").mkdir(exist_ok=True)
    with Processes(out / "logs") as processes, DriveClient(drive=drive) as client:
        processes.start("record", ["--out", str(out / "bag")])
        if owner.source != "none":
            processes.start(owner.source, owner.command_line(plan, drive))

        def missing() -> str:
            client.send(rest)
            return client.missing()

        def check() -> None:
            processes.check()
            if reason := processes.stopped():
                raise ProcessFailed(f"stopped for safety, {reason}")

        def broken(pressures: Any, angle: float) -> str:
            return plan.limits.broken(pressures, angle if program.confined else math.nan)

        try:
            processes.wait(missing)
            client.settle(rest, lambda seen: bool(np.all(seen <= ready)), check, _LONGEST_VENT_S)
            with counted(program.seconds, f"excite, joint {plan.joint}") as advance:
                begun_ns = client.now_ns()
                ended = client.follow(program.command, program.seconds, rest, broken, check, advance)
                client.hold(rest)
        finally:
            if owner.source in processes.running:
                processes.stop(owner.source)
            time.sleep(_DRAIN_S)
            processes.stop(*processes.running)
    return begun_ns, ended


def rehearse(rig: Rig, plan: Plan, program: Program, seed: int, mismatch: float, bag: Path) -> tuple[int, str]:
    """Drive a simulated joint by a program, without ROS and faster than real time, and write the recording.

    The joint is that of the plant node, and so are the limits at which the plan ends. What is not in it is time: delays
    of messages, and a computer that is busy. Returns when it began [ns], and in words why it ended early.

    `plan`: says where the joint begins and what its limits are. `mismatch`: standard deviation of the joint's
    parameters from the rig's [-].
    """
    from pam_antagonist.api.simulate import FIRST_STAMP_NS
    from pam_antagonist.recording import Recording, write_bag
    from pam_antagonist.safety.supervision import RETREAT, TICK, Lookout
    from pam_antagonist.simulation.plant import Plant

    start, period = (plan.pressure, plan.pressure), plan.period
    plant = Plant(rig, plan.joint, plan.lock_angle, seed, mismatch=mismatch, initial_pressure=start)
    lookout, every, ended = Lookout(), max(1, round(TICK / period)), ""
    samples = [plant.step(plan.rest)]
    while (k := len(samples) - 1) * period < program.seconds:
        seen = samples[-1]
        command = program.command(k * period, seen.pressure, seen.angle)
        if command is None:
            break
        samples.append(plant.step(command))
        angle = seen.angle if program.confined else math.nan
        if k % every == 0 and (reason := lookout.ends(plan.limits.broken(seen.pressure, angle))):
            ended = f"after {k * period:.1f} s {reason}"
            samples += [plant.step(plan.rest) for _ in range(round(RETREAT / period))]
            break
    stamps = FIRST_STAMP_NS + np.rint(np.arange(len(samples)) * period * 1e9).astype(np.int64)
    pressure, voltage, angles, torque, encoder, _ = (np.array(column) for column in zip(*samples, strict=True))
    recording = Recording(
        path=bag, stamp_ns=stamps, pressure=pressure, voltage=voltage, angle=angles, torque=torque,
        angle_sensor=None if rig.encoder is None else encoder, drive=rig.drive,
    )  # fmt: skip
    write_bag(bag, recording, pressure_variance=rig.sensors.pressure_std**2)
    return FIRST_STAMP_NS, ended
