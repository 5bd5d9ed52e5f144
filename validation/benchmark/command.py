"""``benchmark``: what the package costs, as ratios measured in one run."""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import platform
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path

from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs_ros
from pam_antagonist.report import terminal
from pam_antagonist.report.table import Table, number
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.software import versions
from validation.benchmark.figure import Figure

_DESCRIPTION = """\
Measure what the package costs on this machine.

  kernels   a UKF step against bare RK4 steps of the same model, and against filterpy's UKF around it; a call from
            Python against the kernel; several models side by side against one by one
  replay    the whole replay command against the length of the recording
  pipeline  plant, estimator and controller as three processes at 1 kHz with a recorder (needs ROS 2): losses,
            and the round trip pressure -> command against that of a pipeline that passes messages through

  interaction  the pipeline with the torque from outside, the law through the model and the governor (needs ROS 2): the
            round trip against that of a pipeline that passes messages through; only by --only
  --soak S  none of these parts, but the pipeline for S seconds (600 is enough for most purposes): growth of memory,
            lost messages and drift of the clocks. Every process is looked at once a second. --json FILE has the series

Every figure is a ratio of two things that were timed in turn, so that a busy machine slows both.
Status: 0 whether or not a bound holds, 2 bad input.
"""
PARTS = ("kernels", "replay", "pipeline")
"""What is measured unless something else is asked for."""
_ALL = (*PARTS, "interaction")


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("benchmark", _DESCRIPTION)
    out.add_argument("--only", choices=_ALL, action="append", help="run this part alone; may be given several times")
    out.add_argument(
        "--rig", default="shin2022", metavar="RIG", help="a YAML file, or a rig's name (default: shin2022)"
    )
    out.add_argument("--bag", type=Path, metavar="BAG", help="recording for the replay (default: 60 s are simulated)")
    out.add_argument(
        "--duration", type=float, default=60.0, metavar="S", help="length of the pipeline's run [s] (default: 60)"
    )
    out.add_argument(
        "--soak", type=float, metavar="S", help="run the pipeline for this time [s], at least 15, and no other part"
    )
    common.add_new_json(out, "the figures")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _main, argv)


def _main(arguments: argparse.Namespace) -> int:
    rig = load_rig(arguments.rig)
    if arguments.soak is not None:
        return _soak(arguments)
    parts = [part for part in _ALL if part in (arguments.only or PARTS)]
    for part in ("pipeline", "interaction"):
        if part in parts:
            needs_ros(f"benchmark --only {part}")
    figures: list[Figure] = []
    with counted(len(parts), "benchmark") as done:
        for part in parts:
            figures += _measured(part, arguments, rig)
            done(1)
    _report(figures, arguments.json)
    return common.DONE


def _measured(part: str, arguments: argparse.Namespace, rig: Rig) -> list[Figure]:
    """The figures of a part, whose module is imported only now."""
    given: dict[str, tuple[object, ...]] = {
        "kernels": (rig,),
        "replay": (arguments.rig, arguments.bag),
        "pipeline": (arguments.rig, arguments.duration),
        "interaction": (rig, arguments.duration),
    }
    name = {"replay": "offline"}.get(part, part)
    module = import_module(f"validation.benchmark.{name}")
    figures: list[Figure] = module.measure(*given[part])
    return figures


def _soak(arguments: argparse.Namespace) -> int:
    if not (math.isfinite(arguments.soak) and 15.0 <= arguments.soak <= 86_400.0):
        raise BadInput(f"--soak {arguments.soak:g}: expected seconds from 15 to 86400")
    if arguments.only:
        raise BadInput("--soak and --only: expected one of them")
    needs_ros("benchmark --soak")
    from validation.benchmark import soak

    with counted(arguments.soak, "soak") as done:
        result = soak.measure(arguments.rig, arguments.soak, done)
    series: dict[str, object] = {
        "time_s": result.usage.time.round(3).tolist(),
        "resident_mb": {name: values.round(3).tolist() for name, values in result.usage.resident.items()},
        "cpu_s": {name: values.round(2).tolist() for name, values in result.usage.cpu.items()},
        "drift_ms": result.drift.round(4).tolist(),
        "block_s": soak.BLOCK,
        "lost": {stage: values.tolist() for stage, values in result.samples.lost.items()},
        "round_trip_ms": {
            name: getattr(result.samples, name).round(3).tolist() for name in ("median", "p99", "largest")
        },
    }
    _report(result.figures, arguments.json, {"duration_s": arguments.soak, "series": series})
    return common.DONE


def _report(figures: Sequence[Figure], json: str | None, more: Mapping[str, object] = {}) -> None:
    """Print the figures, and write them where that was asked for."""
    parts = "\n".join(f"\n{figure.name}: {figure.meaning}\n    {_parts(figure)}" for figure in figures)
    content = {
        "figures": {figure.name: dataclasses.asdict(figure) for figure in figures},
        "machine": {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()},
        "software": versions(),
        **more,
    }
    common.show(f"{terminal.table(_table(figures), indent='')}\n{parts}", content, json)


def _table(figures: Sequence[Figure]) -> Table:
    mark = {True: "yes", False: "NO", None: ""}
    return Table(
        ("figure", "measured", "wanted", "holds"),
        tuple(
            (figure.name, f"{number(figure.value)} {figure.unit}".strip(), figure.wanted, mark[figure.holds])
            for figure in figures
        ),
    )


def _parts(figure: Figure) -> str:
    return ", ".join(f"{name} {number(value)}" for name, value in figure.parts.items())
