"""Lead from a rig file to a controlled joint, with a person at the rig.

The steps are:

  wiring      a little air at low pressure, to test the valves, signs, zeros, supply and leaks
  free        a designed experiment with the joint free
  locked      the same with the joint locked at 0 degrees; asks for the lock
  identify    parameters, noise and tuning from both recordings
  close_loop  the physical effect that the model lacks
  apart       if two effects explain the data equally well: an experiment that distinguishes them, and close_loop again;
              if no motion would decide, the joint is not driven
  gains       a PI controller for the rig that was found, with bandwidth and margins

A rig file of new_rig that was never identified is driven by what is measured, in place of a plan: first air, slow turns
(low pressures and small angles first), quick moves that become faster as long as the joint does not swing, then
identify and gains. Only such a file may have pressure regulators.

A step that is done is not repeated: after a fault, an interruption or a break, type the same command again. A step
that found a fault says what to check. DIR holds a folder for each step, rig.yaml, parameters.yaml and report.html.

Status: 0 done, 1 a step found a fault or failed, 2 bad input (one line says what and where), 130 interrupted.

examples:
  {run} commission --rig my_rig.yaml --out commissioned --source bridge --port /dev/ttyACM0
  {run} commission --rig shin2022 --out commissioned --unattended
"""

from __future__ import annotations

import argparse
import sys

from pam_antagonist.cli import common
from pam_antagonist.cli.driving import SIMULATED, add_limits, add_source
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs_ros
from pam_antagonist.program import INTERRUPTED
from pam_antagonist.rig import load_rig

_FREE_S = 30.0
"""[s] Shortest experiment with the joint free: close_loop wants 20 s and more in which the valves move."""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("commission", __doc__)
    out.shared("--rig")
    out.shared("--out", help="folder of the results; if commission has begun in it, the command continues there")
    out.option("--duration", "length of the free experiment [s] (default: 40)", float, 40.0, "S")
    out.flag("--no-lock", "the joint cannot be locked: leave that step out")
    out.flag("--unattended", "do not wait for a person; for a simulated joint only")
    out.option(
        "--plant", "rig file of the simulated joint (default: that of --rig; for a rig that was never identified, a "
        "joint drawn from the priors of its file)", metavar="RIG",
    )  # fmt: skip
    out.shared("--seed", help="seed of the searches and of the simulated joint (default: 0)", metavar="N")
    out.shared("--no-log")
    add_limits(out)
    add_source(out)
    return out


def _main(arguments: argparse.Namespace) -> int:
    if not _FREE_S <= arguments.duration <= 3600.0:
        raise BadInput(f"--duration {arguments.duration:g}: expected {_FREE_S:g} to 3600 s")
    if arguments.source not in SIMULATED and (arguments.unattended or arguments.plant):
        raise BadInput("--unattended and --plant: only for a simulated joint; expected --source plant or rehearsal")
    if arguments.source != "rehearsal":
        needs_ros("commission")
    from pam_antagonist.cli.commission_guessed import GuessedCommission
    from pam_antagonist.cli.commission_steps import Commission, StepFailed
    from pam_antagonist.nodes.processes import ProcessFailed

    # A file that was never identified is not driven by a plan, which would be its prediction.
    rig = load_rig(arguments.rig, regulators=True)
    guess = rig.is_from_data_sheets and not rig.identified
    if not guess:
        load_rig(arguments.rig)  # only a guess is commissioned with regulators
    work = (GuessedCommission if guess else Commission)(arguments, rig)
    try:
        with work.announced():
            for name in work.STEPS:
                if not work.left_out(name):
                    work.step(name)
    except StepFailed as fault:
        print(f"{fault}\nwhen that is done, type the same command again", file=sys.stderr)
        return common.FAILED
    except ProcessFailed as error:
        print(f"error: {error}; type the same command again to go on", file=sys.stderr)
        return common.FAILED
    except KeyboardInterrupt:
        print("\ninterrupted: type the same command again to go on", file=sys.stderr)
        return INTERRUPTED
    finally:
        work.report()
    print(f"report: {arguments.out / 'report.html'} and report.json")
    print(f"next:\n{work.next_line()}")
    return common.DONE


main = common.command(parser, _main)
