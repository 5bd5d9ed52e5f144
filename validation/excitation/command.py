"""``excitation``: what a designed experiment tells beside steps of the same length, on simulated joints."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from pam_antagonist.cli import common
from pam_antagonist.cli.numbers import whole
from pam_antagonist.cli.progress import counted
from pam_antagonist.design import Limits, designed, standard_errors
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.report import terminal
from pam_antagonist.report.table import Table, number, percent
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.physical import steady_voltage
from pam_antagonist.simulation import excitation
from pam_antagonist.simulation.plant import SCATTER_GROUPS, Plant

_DESCRIPTION = """\
Design an experiment for each of several simulated joints, and compare it with random steps of the same length over the
same pressures. The design uses the rig file only; each joint's parameters differ from it. The command compares the
parameters' standard errors, from the information at the joint's true parameters, and whether the joint stayed within
the limits.
"""
_EXAMPLES = """\
examples:
  {run} excitation --joints 20 --duration 30
"""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("excitation", _DESCRIPTION, _EXAMPLES)
    out.add_argument("--rig", default="shin2022", metavar="RIG", help="the rig file (default: shin2022)")
    out.add_argument(
        "--joints", type=whole(1, 1000), default=20, metavar="N", help="number of simulated joints (default: 20)"
    )
    out.add_argument(
        "--duration", type=float, default=30.0, metavar="S", help="length of each experiment [s] (default: 30)"
    )
    out.add_argument(
        "--mismatch",
        type=float,
        default=0.02,
        metavar="X",
        help="relative deviation of the joints' parameters from the rig file (default: 0.02)",
    )
    out.add_argument(
        "--seed", type=whole(0, 10**6), default=1, metavar="N", help="seed of the first joint (default: 1)"
    )
    common.add_new_json(out, "the figures")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _main, argv)


def _main(arguments: argparse.Namespace) -> int:
    rig = load_rig(arguments.rig)
    found = []
    with common.json_alone(arguments.json), counted(arguments.joints, "excitation") as advance:
        for seed in range(arguments.seed, arguments.seed + arguments.joints):
            found.append(compared(rig, seed, arguments.duration, arguments.mismatch))
            advance(1.0)
    common.show(_summary(found), found, arguments.json)
    return common.DONE


def compared(rig: Rig, seed: int, seconds: float, mismatch: float) -> dict[str, Any]:
    """A designed experiment beside steps, on one joint.

    Args:
        rig: the rig file.
        seed: of the joint, the search and the steps.
        seconds: length [s].
        mismatch: relative standard deviation of the joint's parameters from the rig file's [-].
    """
    limits = Limits.of(rig)
    plan = designed(rig, limits, seconds, seed=seed)
    low, high = (steady_voltage(rig, pressure)[0] for pressure in limits.pressure)
    span = excitation.Span(low, plan.rest[0], high)
    steps = excitation.profile("steps", seconds, plan.period, seed, span)
    joint = _scattered(rig, seed, mismatch)
    mine, theirs = (standard_errors(joint, voltage, plan.period) for voltage in (plan.voltage, steps))
    plant = Plant(joint, substeps=1, seed=seed, initial_pressure=(plan.pressure, plan.pressure))
    course = np.array([plant.step(voltage).truth[:4] for voltage in plan.voltage])
    return {
        "seed": seed,
        "designed": mine,
        "steps": theirs,
        "ratio": {name: mine[name] / theirs[name] for name in mine},
        "beyond_limits": limits.excess(course),
    }


def _scattered(rig: Rig, seed: int, mismatch: float) -> Rig:
    """A joint that is not quite the rig file's; what scatters together is off together."""
    factors = np.random.default_rng((seed, 7)).normal(1.0, mismatch, len(SCATTER_GROUPS))
    groups = zip(SCATTER_GROUPS, factors, strict=True)
    return moved(rig, {name: rig.value(name) * float(factor) for group, factor in groups for name in group})


def _summary(found: Sequence[dict[str, Any]]) -> str:
    rows = []
    for name in found[0]["ratio"]:
        mine, theirs, ratio = (float(np.median([one[key][name] for one in found])) for key in _COLUMNS)
        rows.append((name, percent(mine), percent(theirs), number(ratio, 2)))
    header = ("parameter", "designed, of the prior's", "steps, of the prior's", "ratio")
    table = terminal.table(Table(header, tuple(rows), "Standard errors, medians over the joints"), indent="")
    ratios = [np.median(list(one["ratio"].values())) for one in found]
    kept = sum(one["beyond_limits"] == 0.0 for one in found)
    return (
        f"{table}\nmedian ratio of a joint: {number(float(np.median(ratios)), 2)} (median of {len(found)} joints), "
        f"{number(float(np.max(ratios)), 2)} at most; limits kept by {kept} of {len(found)} joints"
    )


_COLUMNS = ("designed", "steps", "ratio")
