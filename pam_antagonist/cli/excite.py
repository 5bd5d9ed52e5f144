"""``excite``: drive a joint so that its recording tells most, within limits."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.design import SHORTEST, Limits, Plan, designed, standard_errors
from pam_antagonist.design.apart import LIKELY, instead_of, told_apart
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.trial import CHANNELS
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.nodes.processes import Processes, ProcessFailed, free_domain, ros_arguments
from pam_antagonist.optional import needs_ros
from pam_antagonist.recording.notes import write_notes
from pam_antagonist.report import terminal
from pam_antagonist.report.table import Table, number, percent
from pam_antagonist.rig import Rig, load_rig

_DESCRIPTION = """\
Drive a joint so that its recording tells most of what the rig file leaves open.

The voltages are designed beforehand, by the rig's model: of many courses, the one is taken that makes the determinant
of the parameters' information largest (D-optimal), for all parameters that identify moves. The joint stays within the
limits, with a margin of three standard deviations by what the rig file declares uncertain.

With --tell-apart the voltages are those under which the found effect and those that explain as much differ most, as
short as that may be (--duration at most). It says beforehand how likely that decides, and what else would where it does
not.

--source says who owns the valves: plant starts a simulated joint, bridge a bridge to hardware, none nothing, where
such a node runs already. No controller may run beside it: one node at a time commands the valves. Ctrl-C ends it at any
time: the valves then get their safe voltages. It ends by itself, at rest, where a measured pressure or angle is beyond
a limit.

DIR holds voltages.csv (what is planned, for simulate --profile as well), plan.json and the bag.
Status: 0 done, 2 bad input (one line says what and where), 130 interrupted (the bag up to then is kept), 1 else.
"""
_EXAMPLES = """\
examples:
  {run} excite --rig shin2022 --out excited --plan-only
  {run} excite --rig my_rig.yaml --out free --source bridge --port /dev/ttyACM0 --max-angle 15
  {run} excite --rig my_rig.yaml --out locked --source bridge --port /dev/ttyACM0 --joint locked
  {run} excite --rig my_rig.yaml --out apart --tell-apart found --plan-only
"""
_DRAIN_S = 0.3
_COMMAND_TIMEOUT = 0.1
"""[s] The commands of a plan come from a process without real-time priority."""
_STOP_BEYOND = 0.1
"""The owner of the valves stops them where a pressure is so far above the limit, as a share of the limits' width."""
_PRESSURE_UNIT = 1e3
PLAN_NOTE = "pam_antagonist.plan"
"""Name of the note in a bag that holds ``plan.json``."""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("excite", _DESCRIPTION, _EXAMPLES)
    common.add_rig(out)
    out.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of plan and bag; a new one")
    out.add_argument("--duration", type=float, default=60.0, metavar="S", help="length [s] (default: 60)")
    common.add_joint(out, ("free", "locked"), "free", "may the joint move? (default: free)")
    add_limits(out)
    out.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the search (default: 0)")
    out.add_argument(
        "--tell-apart", type=Path, metavar="FOUND",
        help="folder of close_loop: design what tells the found effect from those that explain as much",
    )  # fmt: skip
    out.add_argument(
        "--without", action="append", default=[], choices=("angle", "torque"), help="this is not measured",
    )  # fmt: skip
    out.add_argument("--plan-only", action="store_true", help="design and write the plan, drive nothing")
    add_source(out)
    return out


def add_limits(out: argparse.ArgumentParser) -> None:
    """Limits of an experiment.

    Args:
        out: takes the arguments.
    """
    for name, unit, text in (
        ("--min-pressure", "KPA", "least pressure, absolute [kPa] (default: 15 %% of the supply's gauge pressure)"),
        ("--max-pressure", "KPA", "largest pressure, absolute [kPa] (default: 97 %% of it)"),
        ("--max-angle", "DEG", "largest angle either way [deg] (default: nine tenths of the stop; 20 without one)"),
        ("--max-rate", "RAD_S", "largest rate of the angle [rad/s] (default: 10)"),
    ):
        out.add_argument(name, type=float, metavar=unit, help=text)


def add_source(out: argparse.ArgumentParser) -> None:
    """Who owns the valves.

    Args:
        out: takes the arguments.
    """
    out.add_argument(
        "--source", choices=("plant", "bridge", "none"), default="plant", help="owner of the valves (default: plant)"
    )
    out.add_argument("--port", metavar="PATH", help="serial port of the bridge's device")
    out.add_argument("--hardware", metavar="FILE", help="calibration of the bridge's device")
    out.add_argument("--parameters", type=Path, metavar="FILE", help="parameter file of plant or bridge")
    out.add_argument(
        "--mismatch", type=float, default=0.01, metavar="X", help="of the plant from the rig file (default: 0.01)"
    )


def limits_of(arguments: argparse.Namespace, rig: Rig) -> Limits:
    """The limits that were given, with defaults.

    Args:
        arguments: with those of :func:`add_limits`.
        rig: the joint.

    Raises:
        BadInput: limits that the rig cannot have.
    """
    usual = Limits.of(rig)
    low, high = (
        default if given is None else given * _PRESSURE_UNIT
        for given, default in zip((arguments.min_pressure, arguments.max_pressure), usual.pressure, strict=True)
    )
    angle = None if arguments.max_angle is None else math.radians(arguments.max_angle)
    return Limits.of(rig, (low, high), angle, arguments.max_rate)


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(_main, argv)


def _main(argv: Sequence[str] | None) -> int:
    arguments = parser().parse_args(argv)
    if not SHORTEST <= arguments.duration <= 3600.0:
        raise BadInput(f"--duration {arguments.duration:g}: expected {SHORTEST:g} to 3600 s")
    if arguments.seed < 0:
        raise BadInput(f"--seed {arguments.seed}: expected 0 or more")
    for option in ("port", "hardware"):
        if getattr(arguments, option) is not None and arguments.source != "bridge":
            raise BadInput(f"--{option}: only a bridge has one; give --source bridge as well")
    if not arguments.plan_only:
        needs_ros("excite")
    common.check_output(arguments.out)
    rig = load_rig(arguments.rig)
    limits = limits_of(arguments, rig)
    angle = common.lock_angle(arguments) or 0.0
    promise = ""
    with counted(arguments.duration, "design") as advance:
        if arguments.tell_apart is None:
            plan = designed(rig, limits, arguments.duration, arguments.joint, angle, arguments.seed, advance)
        else:
            plan, promise = _between(arguments, rig, limits, angle, advance)
    if promise:
        print(promise)
    out: Path = arguments.out
    try:
        (out / "logs").mkdir(parents=True)
    except OSError as error:
        raise BadInput(f"{out}: cannot be made: {error.strerror}") from None
    document = write_plan(out, plan, rig)
    print(_summary(document))
    if arguments.plan_only:
        print(common.next_command("simulate", [], f"--rig {arguments.rig} --profile {out}/voltages.csv --out BAG"))
        return common.DONE
    return _driven(arguments, rig, plan, out)


def _between(
    arguments: argparse.Namespace, rig: Rig, limits: Limits, angle: float, advance: Callable[[float], None]
) -> tuple[Plan, str]:
    """The experiment that tells a found effect from its rivals, and in words what it promises."""
    found, effect, rivals = undecided(arguments.tell_apart)
    extended = found.replaced(sensors=rig.sensors, valves=rig.valves)
    channels = [k for k, name in enumerate(CHANNELS) if name not in arguments.without]
    verdict = told_apart(
        extended, effect, rivals, limits, arguments.duration, arguments.joint, angle, arguments.seed, channels, advance
    )
    each = ", ".join(f"{rival} {chance:.0%}" for rival, chance in verdict.by_rival.items())
    text = f"{effect} or {' or '.join(rivals)}: decided with a chance of {verdict.chance:.0%} ({each}), "
    text += f"in {verdict.plan.duration:.0f} s with the joint {arguments.joint}"
    if verdict.chance < LIKELY:
        others = instead_of(extended, effect, rivals, limits, verdict, channels)
        text += ". No motion within the limits tells them apart"
        text += f"; what would: {'; '.join(others)}" if others else ", nor does a further sensor or a lock"
    return verdict.plan, text


def undecided(folder: Path) -> tuple[Rig, str, list[str]]:
    """What a diagnosis left undecided.

    Args:
        folder: of ``close_loop``.

    Returns:
        The rig with the found effect, its name, and the names of the effects that explain as much.

    Raises:
        BadInput: no such folder, or nothing in it is undecided.
    """
    try:
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        effects = [str(effect["name"]) for effect in report["effects"]]
        rivals = [str(name) for name in report["ambiguous_with"] if name in CATALOGUE]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"{folder}: expected a folder of close_loop with its report.json: {error}") from None
    if not effects:
        raise BadInput(f"{folder}: close_loop found no effect there; expected one with ambiguous_with in report.json")
    if not rivals:
        raise BadInput(f"{folder}: {effects[0]} is decided; expected a report with ambiguous_with")
    return load_rig(str(folder / "rig_extended.yaml")), effects[0], rivals


def _driven(arguments: argparse.Namespace, rig: Rig, plan: Plan, out: Path) -> int:
    try:
        ended = drive(arguments, rig, plan, out)
    except ProcessFailed as error:
        print(f"error: {error} (logs: {out / 'logs'})", file=sys.stderr)
        return common.FAILED
    except KeyboardInterrupt:
        print(f"\ninterrupted: what was recorded until now is in {out / 'bag'}", file=sys.stderr)
        return common.INTERRUPTED
    write_notes(out / "bag", {PLAN_NOTE: (out / "plan.json").read_text(encoding="utf-8")})
    if ended:
        print(f"stopped: {ended}. What was recorded until then is in {out / 'bag'}", file=sys.stderr)
        return common.FAILED
    print(f"recording: {out / 'bag'}")
    print(common.next_command("identify", [out / "bag"], f"--rig {arguments.rig} --out DIR"))
    return common.DONE


def write_plan(out: Path, plan: Plan, rig: Rig) -> dict[str, Any]:
    """Write ``voltages.csv`` and ``plan.json``.

    Args:
        out: folder, which is there.
        plan: the experiment.
        rig: by whose model it was designed.

    Returns:
        The content of ``plan.json``.
    """
    changes = np.flatnonzero(np.any(np.diff(plan.voltage, axis=0) != 0.0, axis=1)) + 1
    rows = [0, *changes, len(plan.voltage) - 1]
    lines = [f"{k * plan.period:.6g},{plan.voltage[k, 0]:.4f},{plan.voltage[k, 1]:.4f}" for k in rows]
    (out / "voltages.csv").write_text("\n".join(["t_s,u1,u2", *lines]) + "\n", encoding="utf-8")
    start = (plan.pressure, plan.pressure)
    errors = standard_errors(rig, plan.voltage, plan.period, plan.joint, plan.lock_angle, start)
    document = {
        "rig": rig.name,
        "joint": plan.joint,
        "lock_angle_rad": plan.lock_angle if plan.joint == "locked" else None,
        "duration_s": plan.duration,
        "limits": {
            "pressure_pa": list(plan.limits.pressure),
            "angle_rad": plan.limits.angle,
            "rate_rad_s": plan.limits.rate,
        },
        "rest_v": list(plan.rest),
        "standard_errors": errors,
    }
    (out / "plan.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return document


def _summary(document: dict[str, Any]) -> str:
    limits = document["limits"]
    low, high = (value / _PRESSURE_UNIT for value in limits["pressure_pa"])
    rows = [(name, percent(share)) for name, share in document["standard_errors"].items()]
    table = terminal.table(Table(("parameter", "standard error, of its prior's"), tuple(rows)))
    angle = number(math.degrees(limits["angle_rad"]), 3)
    return (
        f"planned: {document['duration_s']:g} s, joint {document['joint']}, {low:.0f} to {high:.0f} kPa, "
        f"up to {angle} deg and {limits['rate_rad_s']:g} rad/s\n{table}"
    )


def drive(arguments: argparse.Namespace, rig: Rig, plan: Plan, out: Path) -> str:
    """Run a plan on the joint and record it into ``out/bag``.

    Args:
        arguments: with those of :func:`add_source`, ``rig`` and ``seed``.
        rig: the joint.
        plan: the experiment.
        out: folder, which is there, with a folder ``logs``.

    Returns:
        Why it ended early, in words; empty where it did not.

    Raises:
        ProcessFailed: a node ended or does not start.
    """
    from pam_antagonist.nodes.drive import DriveClient

    source: str = arguments.source
    if source != "none":
        # A domain of its own keeps two experiments, or an experiment and a rig, from hearing each other.
        if "ROS_DOMAIN_ID" not in os.environ:
            os.environ["ROS_DOMAIN_ID"] = str(free_domain())
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rest = np.array(plan.rest)
    with Processes(out / "logs") as processes, DriveClient() as client:
        processes.start("record", ["--out", str(out / "bag")])
        if source != "none":
            processes.start(source, _owner(arguments, rig, plan))
        try:

            def missing() -> str:
                client.send(rest)
                return client.missing()

            processes.wait(missing)
            with counted(plan.duration, f"excite, joint {plan.joint}") as advance:
                return client.drive(plan.voltage, plan.period, rest, plan.limits.broken, processes.check, advance)
        finally:
            if source in processes.running:
                processes.stop(source)
            time.sleep(_DRAIN_S)
            processes.stop(*processes.running)


def _owner(arguments: argparse.Namespace, rig: Rig, plan: Plan) -> list[str]:
    """Command line of the node that owns the valves."""
    low, high = plan.limits.pressure
    name = str(Path(arguments.rig).resolve()) if arguments.rig.endswith((".yaml", ".yml")) else arguments.rig
    given: dict[str, object] = {
        "rig": name,
        "command_timeout": _COMMAND_TIMEOUT,
        "safe_voltage": list(plan.rest),
        "max_pressure": [high + _STOP_BEYOND * (high - low)] * 2,
    }
    if arguments.source == "plant":
        given |= {"joint": plan.joint, "lock_angle": plan.lock_angle, "wait_for_subscribers": 1}
        given |= {"seed": arguments.seed, "mismatch": arguments.mismatch}
    for option in ("port", "hardware"):
        if (value := getattr(arguments, option)) is not None:
            given[option] = value
    files = [] if arguments.parameters is None else ["--params-file", str(arguments.parameters)]
    return [*ros_arguments(given, {}), *files]


if __name__ == "__main__":
    sys.exit(main())
