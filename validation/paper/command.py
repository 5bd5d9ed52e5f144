"""``paper``: every experiment of the paper on a virtual rig, beside its numbers."""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

from pam_antagonist.cli import common
from pam_antagonist.cli.common import JOBS, whole
from pam_antagonist.errors import BadInput, NoResult
from pam_antagonist.nodes.processes import ProcessFailed
from pam_antagonist.optional import available
from pam_antagonist.report import terminal

_NAMES = {
    "static": "force against pressure and length, (6) and (7)",
    "kappa": "the valve curve by three steps",
    "influence": "Proposition 1 and the guideline",
    "profile": "the input profile, and which of the 18 subsystems it visits",
    "offline": "model alone against filter",
    "online": "the live nodes on the same profile (ROS 2)",
    "compare_angle": "Table III",
    "compare_torque": "Table IV",
    "control": "sensor-less control",
    "control_live": "the same with live nodes (ROS 2)",
}
_DESCRIPTION = """\
Run the paper's experiments on a virtual rig and put the numbers beside the paper's.

The virtual rig is this package's simulator with declared mismatches: how models and estimators compare, nothing about a
real joint. What compares is repeated over --seeds rigs. Writes OUT/paper.md with its pictures, and OUT/report.json.

experiments:
""" + "".join(f"  {name.ljust(14)}  {text}\n" for name, text in _NAMES.items())
_EXAMPLES = """\
examples:
  {run} paper --out result
  {run} paper --out offline --only offline compare_angle --seeds 5
  {run} paper --out live --only online control_live --short
"""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("paper", _DESCRIPTION, _EXAMPLES)
    out.shared("--out")
    out.add_argument("--only", nargs="+", action="extend", choices=tuple(_NAMES), metavar="NAME",
                     help="run these experiments alone")  # fmt: skip
    out.shared("--seed", help="seed of the first virtual rig (default: 0)", metavar="N")
    out.option("--seeds", "how many virtual rigs (default: 20)", whole(1, 1000), 20, "N")
    out.option("--jobs", "processes (default: one a core)", JOBS, os.cpu_count() or 1, "N")
    out.flag("--short", "live runs of 30 s and less, in place of 130, 62, 38 and 20 s")
    out.flag("--no-figures", "leave the figures out")
    return out


def _run(arguments: argparse.Namespace) -> int:
    from validation.paper import page
    from validation.paper.experiments import EXPERIMENTS, run

    names = arguments.only or list(EXPERIMENTS)
    live = [name for name in names if EXPERIMENTS[name].live]
    if live and not available("rclpy"):
        others = " ".join(name for name, item in EXPERIMENTS.items() if not item.live)
        raise BadInput(
            f"{', '.join(live)}: start ROS 2 nodes, and rclpy is not installed; for the rest: --only {others}"
        )
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    common.check_output(arguments.out)
    with common.output_folder(arguments.out) as folder:
        with tempfile.TemporaryDirectory(prefix="live.", dir=folder) as scratch:
            try:
                done = run(names, seeds, arguments.jobs, arguments.short, Path(scratch))
            except ProcessFailed as error:
                raise NoResult(str(error)) from None
        page.write(done, folder, not arguments.no_figures)
    print(f"\n{terminal.table(page.overview(done))}\n\n{page.CAUTION}\n")
    print(f"after {sum(done.seconds.values()):.0f} s: {arguments.out / 'paper.md'} and report.json")
    return common.DONE


main = common.command(parser, _run)
