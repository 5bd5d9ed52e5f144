"""``monitor --explain RIG``: which sizes a monitor finds within a minute, on a short simulated run."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence

import numpy as np

from pam_antagonist.api.simulate import simulate
from pam_antagonist.cli import common
from pam_antagonist.diagnosis.monitor import THRESHOLD, Monitor
from pam_antagonist.diagnosis.monitor_responses import SHARE
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs_ros
from pam_antagonist.report.table import Table
from pam_antagonist.report.terminal import render
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.limits import rest_pressure, rest_voltage

_SETTLING, _SECONDS = 95, 60
"""[s] Before the minute that counts, and that minute."""
_ENCODER = {"std": 5e-4}
"""Where the rig file has none."""
_LARGE = 20.0
"""Sizes above this many typical ones count as not seen."""


def smallest(rig: Rig, moving: bool, encoder: bool) -> dict[tuple[str, str], float]:
    """Size of each hypothesis that has the evidence of an alarm after a minute, by name and unit; else infinite."""
    if encoder and rig.encoder is None:
        rig = rig.with_value("encoder", _ENCODER)
    seconds = _SETTLING + _SECONDS + 1
    voltage = None
    if not moving:
        rest = (rest_pressure(rig),) * 2 if rig.drive == "regulator" else rest_voltage(rig)
        voltage = np.tile(rest, (round(seconds / rig.sample_period), 1))
    run = simulate(rig, voltage, duration=float(seconds), seed=1)
    monitor = Monitor(rig, encoder=encoder)
    monitor.add(run.stamp_ns, run.pressure, run.voltage, run.angle_sensor if encoder else None)
    stds = monitor.blocks.stds(_SECONDS)
    out = {}
    for item, std in zip(monitor.watched, stds, strict=True):
        size = math.sqrt(2.0 * THRESHOLD) * float(std)
        seen = size <= min(max(item.high, -item.low), _LARGE * item.step / SHARE)
        out[item.label, item.unit] = size if seen else math.inf
    return out


def explain(name: str) -> str:
    """The table of a rig."""
    rig = load_rig(name, regulators=True)
    if rig.valves.sealed:
        raise BadInput(f"rig {rig.name} is sealed: expected a joint that valves or regulators drive")
    ways = [(moving, encoder) for encoder in (False, True) for moving in (True, False)]
    found = [smallest(rig, *way) for way in ways]
    rows = []
    for label, unit in dict.fromkeys(key for each in found for key in each):
        sizes = [each.get((label, unit), math.inf) for each in found]
        rows.append((label, *(f"{size:.2g} {unit}" if math.isfinite(size) else "not seen" for size in sizes)))
    heads = ("effect", "moving", "at rest", "moving, encoder", "at rest, encoder")
    caption = f"smallest sizes that monitor finds within a minute: {rig.name}, one simulated run, nothing else wrong"
    return render([Table(heads, tuple(rows), caption)])


def _explain(arguments: argparse.Namespace) -> int:
    print(explain(arguments.explain))
    return common.DONE


def parser() -> common.Parser:
    """The arguments of ``--explain``."""
    out = common.Parser("monitor", "Which sizes monitor finds within a minute, on a short simulated run.")
    out.option("--explain", "name or file of a rig", metavar="RIG")
    return out


def main(argv: Sequence[str] | None = None) -> int:
    """The node, or ``--explain RIG``."""
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] == ["--search"]:
        from pam_antagonist.cli import monitor_search

        return monitor_search.main(words[1:])
    if any(word.partition("=")[0] == "--explain" for word in words):
        return int(common.command(parser, _explain)(words))
    try:
        needs_ros("monitor")
    except BadInput as error:
        print(f"error: {error}", file=sys.stderr)
        return common.BAD_INPUT
    from pam_antagonist.nodes.monitor import main as node

    return node(words)
