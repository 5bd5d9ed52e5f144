"""``faults``: everything that may go wrong, made on purpose, and what the valves did."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs_ros
from validation import json_option

if TYPE_CHECKING:
    from validation.faults.fault import Fault, Outcome

_DESCRIPTION = """\
Make every fault in a running pipeline, and report what the valves did.

Device emulator, bridge, estimator and controller run as processes at the rig's sample rate, in a ROS domain of their
own. Each fault is made and ended, and the pipeline is watched until control is back. The command reports whether the
valves had safe voltages within 50 ms (by the device's own log), what /diagnostics said, and what came back by itself.
All faults take about three minutes. The machine should have nothing else to do in that time.
Status: 0 if everything came out as expected, 1 if something did not, 2 bad input.
"""
_EXAMPLES = """\
examples:
  {run} faults
  {run} faults --only "bridge killed" --only "pressure stuck"
  {run} faults --json faults.json --docs faults.md
"""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("faults", _DESCRIPTION, _EXAMPLES)
    out.add_argument("--only", action="append", metavar="NAME",
                     help="make this fault alone; may be given several times (see --list)")  # fmt: skip
    out.flag("--list", "list the faults and make none")
    out.option("--rig", "a YAML file, or a rig's name (default: shin2022)", default="shin2022", metavar="RIG")
    json_option.add_new_json(out, "the table")
    out.option("--docs", "write the table as Markdown; replaces FILE", Path, metavar="FILE")
    return out


def _main(arguments: argparse.Namespace) -> int:
    needs_ros("faults")
    from pam_antagonist.rig import load_rig
    from validation.faults import table
    from validation.faults.catalogue import FAULTS
    from validation.faults.run import run_faults

    if arguments.list:
        width = max(len(fault.name) for fault in FAULTS)
        print("\n".join(f"{fault.name.ljust(width)}  {fault.what}" for fault in FAULTS))
        return common.DONE
    faults = chosen(FAULTS, arguments.only)
    load_rig(arguments.rig)
    rig = str(Path(arguments.rig).resolve()) if arguments.rig.endswith((".yaml", ".yml")) else arguments.rig
    with common.json_alone(arguments.json), counted(len(faults), "faults") as advance:
        print(table.HEADER, flush=True)

        def done(outcome: Outcome) -> None:
            print(table.line(outcome), flush=True)
            advance(1)

        outcomes = run_faults(faults, rig, done)
    json_option.show(f"\n{table.summary(outcomes)}", table.content(outcomes), arguments.json)
    if arguments.docs is not None:
        common.write_text(arguments.docs, "\n".join([f"{table.summary(outcomes)}.", "", *table.matrix(outcomes), ""]))
    return common.DONE if all(outcome.held for outcome in outcomes) else common.FAILED


def chosen(faults: Sequence[Fault], names: Sequence[str] | None) -> list[Fault]:
    """Those faults that were asked for, in the table's order."""
    known = [fault.name for fault in faults]
    wanted = list(names or known)
    for name in wanted:
        if name not in known:
            raise BadInput(f"--only {name!r}: expected one of {', '.join(known)}")
    return [fault for fault in faults if fault.name in wanted]


main = common.command(parser, _main)
