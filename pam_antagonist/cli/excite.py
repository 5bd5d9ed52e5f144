"""Design an experiment that determines the parameters of a rig well, drive the joint with it and record it.

The voltages are designed beforehand with the rig's model. Of many candidates, the command takes the one with the
largest determinant of the parameters' information (D-optimal), for all parameters that identify fits. The joint stays
within the limits with a margin of three standard deviations, by the uncertainties that the rig file declares.

With --tell-apart the experiment distinguishes the effect that close_loop found from the effects that explain the data
as well. It is as short as possible, --duration at most. The command prints the probability that the experiment
decides. If that is below a half, the command prints what else would decide.

--source says what owns the valves: plant starts a simulated joint, bridge starts a bridge to hardware, and none starts
nothing, since such a node runs already. No controller may run at the same time: only one node may command the valves.
Ctrl-C ends the experiment at any time: the valves then get their safe voltages. If a measured pressure or angle is
beyond a limit, the experiment ends by itself, with the joint at rest.

DIR holds voltages.csv (what is planned, for simulate --profile as well), plan.json and the bag.
Status: 0 done, 2 bad input (one line says what and where), 130 interrupted (the bag up to then is kept), 1 failed.

examples:
  {run} excite --rig shin2022 --out excited --plan-only
  {run} excite --rig my_rig.yaml --out free --source bridge --port /dev/ttyACM0 --max-angle 15
  {run} excite --rig my_rig.yaml --out locked --source bridge --port /dev/ttyACM0 --joint locked
  {run} excite --rig my_rig.yaml --out apart --tell-apart found --plan-only
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from pam_antagonist.cli import common, driving
from pam_antagonist.cli.driving import Owner
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs_ros
from pam_antagonist.program import INTERRUPTED
from pam_antagonist.shown import widened

if TYPE_CHECKING:
    from pam_antagonist.design import Limits, Plan
    from pam_antagonist.rig import Rig


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("excite", __doc__)
    out.shared("--rig")
    out.shared("--out", help="folder of plan and bag; a new one")
    length = "length of the experiment [s]; with --tell-apart, the longest one (default: 60)"
    out.option("--duration", length, float, 60.0, "S")
    out.shared("--joint", "--lock-angle")
    driving.add_limits(out)
    out.shared("--seed", help="seed of the search (default: 0)", metavar="N")
    out.option(
        "--tell-apart", "folder that close_loop wrote: design an experiment that distinguishes the found effect from "
        "those that explain the data as well", Path, metavar="FOUND",
    )  # fmt: skip
    out.repeated("--without", "design without this sensor", None, choices=("angle", "torque"))
    out.flag("--plan-only", "design and write the plan, drive nothing")
    driving.add_source(out)
    return out


def _main(arguments: argparse.Namespace) -> int:
    from pam_antagonist.design import SHORTEST, designed
    from pam_antagonist.report.experiments import ExciteResult
    from pam_antagonist.rig import load_rig

    if not SHORTEST <= arguments.duration <= 3600.0:
        raise BadInput(f"--duration {arguments.duration:g}: expected {SHORTEST:g} to 3600 s")
    owner = Owner.of(arguments, arguments.rig)
    if not arguments.plan_only and arguments.source != "rehearsal":
        needs_ros("excite")
    common.check_output(arguments.out)
    rig = load_rig(arguments.rig)
    limits = driving.limits_of(arguments, rig)
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
        out.mkdir(parents=True)
    except OSError as error:
        raise BadInput(f"{out}: cannot be made: {error.strerror}") from None
    planned = widened(ExciteResult, plan, rig=rig)
    planned.write(out)
    print(planned.summary())
    if arguments.plan_only:
        print(common.next_command("simulate", [], f"--rig {arguments.rig} --profile {out}/voltages.csv --out BAG"))
        return common.DONE
    return _driven(arguments, owner, plan, out, rig)


def _between(
    arguments: argparse.Namespace, rig: Rig, limits: Limits, angle: float, advance: Callable[[float], None]
) -> tuple[Plan, str]:
    """The experiment that tells a found effect from its rivals, and in words what it promises."""
    from pam_antagonist.design.apart import LIKELY, no_motion_decides, told_apart
    from pam_antagonist.inference.trial import CHANNELS

    found, effect, rivals = undecided(arguments.tell_apart)
    extended = found.replaced(sensors=rig.sensors, valves=rig.valves)
    channels = [k for k, name in enumerate(CHANNELS) if name not in arguments.without]
    verdict = told_apart(
        extended, effect, rivals, limits, arguments.duration, arguments.joint, angle, arguments.seed, channels, advance
    )
    each = ", ".join(f"{rival} {chance:.0%}" for rival, chance in verdict.by_rival.items())
    text = f"{effect} or {' or '.join(rivals)}: decided with a probability of {verdict.chance:.0%} ({each}), "
    text += f"in {verdict.plan.duration:.0f} s with the joint {arguments.joint}"
    if verdict.chance < LIKELY:
        text += f". {no_motion_decides(extended, effect, rivals, verdict, channels)}"
    return verdict.plan, text


def undecided(folder: Path) -> tuple[Rig, str, list[str]]:
    """What is undecided in a folder of ``close_loop``."""
    from pam_antagonist.model.effects import CATALOGUE
    from pam_antagonist.rig import load_rig

    try:
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        effects = [str(effect["name"]) for effect in report["effects"]]
        rivals = [str(name) for name in report["ambiguous_with"] if name in CATALOGUE]
    except (OSError, ValueError, KeyError, TypeError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise BadInput(f"{folder}: expected a folder of close_loop with its report.json: {why}") from None
    expected = "expected a folder whose report.json lists effects in ambiguous_with"
    if not effects:
        raise BadInput(f"{folder}: close_loop found no effect there; {expected}")
    if not rivals:
        raise BadInput(f"{folder}: {effects[0]} is decided, so no experiment is needed; {expected}")
    extended = folder / "rig_extended.yaml"
    if not extended.is_file():
        raise BadInput(
            f"{extended}: not there, since no rig with the effect was better than the one given; expected a folder of "
            "close_loop with it"
        )
    return load_rig(str(extended)), effects[0], rivals


def _driven(arguments: argparse.Namespace, owner: Owner, plan: Plan, out: Path, rig: Rig) -> int:
    from pam_antagonist.nodes.processes import ProcessFailed

    if owner.source in ("plant", "bridge"):
        driving.stay_apart()
        print(driving.how_to_watch(), flush=True)
    try:
        ended = driving.drive(owner, plan, out, rig).ended
    except ProcessFailed as error:
        print(f"error: {error} (logs: {out / 'logs'})", file=sys.stderr)
        return common.FAILED
    except KeyboardInterrupt:
        print(f"\ninterrupted: what was recorded until now is in {out / 'bag'}", file=sys.stderr)
        return INTERRUPTED
    if ended:
        print(f"stopped: {ended}. What was recorded until then is in {out / 'bag'}", file=sys.stderr)
        return common.FAILED
    print(f"recording: {out / 'bag'}")
    print(common.next_command("identify", [out / "bag"], f"--rig {arguments.rig} --out DIR"))
    return common.DONE


main = common.command(parser, _main)
