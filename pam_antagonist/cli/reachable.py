"""Compute which angles at rest and which torques a joint can reach, and which stiffness it can have there.

The rig's model is evaluated at the declared supply pressure, within the bounds below. The controller has parameters of
the same names. With --out, a page with figures is written as well.

examples:
  {run} reachable --rig shin2022
  {run} reachable --rig my_rig.yaml --lowest-pressure 150e3 --out reach
"""

from __future__ import annotations

import argparse
from pathlib import Path

from pam_antagonist.cli import common
from pam_antagonist.cli.common import real
from pam_antagonist.cli.recordings import announce, check_page
from pam_antagonist.control.stiffness import LEAST_FORCE, SUPPLY_MARGIN, Box
from pam_antagonist.report.reachable import ReachableResult
from pam_antagonist.rig import load_rig

_NUMBER = real(0.0, 1e8, "a number", ", 0 or more")


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("reachable", __doc__)
    out.shared("--rig")
    out.option("--out", "folder of report.html and report.json; a new one", Path, metavar="DIR")
    lowest = "least pressure of a muscle, absolute [Pa] (default: a sixth of the supply's gauge pressure)"
    out.option("--lowest-pressure", lowest, _NUMBER, metavar="PA")
    for name, default, unit, text in (
        ("--supply-margin", SUPPLY_MARGIN, "PA", "how far the pressures stay below the supply's pressure [Pa]"),
        ("--least-force", LEAST_FORCE, "N", "least contraction force of a muscle [N]"),
    ):
        out.option(name, f"{text} (default: {default:g})", _NUMBER, default, unit)
    out.shared("--no-figures", "--open")
    return out


def _main(arguments: argparse.Namespace) -> int:
    check_page(arguments)
    rig = load_rig(arguments.rig, regulators=True)
    box = Box.of(rig.parameters(), arguments.lowest_pressure, arguments.supply_margin, arguments.least_force)
    found = ReachableResult.of(rig, box)
    announce(arguments, found, None)
    return common.DONE


main = common.command(parser, _main)
