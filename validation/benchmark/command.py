"""``benchmark``: what the package costs on this machine."""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs_ros
from pam_antagonist.program import versions
from pam_antagonist.report import terminal
from pam_antagonist.report.document import Table, number
from pam_antagonist.rig import load_rig
from validation import json_option

_DESCRIPTION = """\
Measure what the package costs on this machine.

  kernels   a UKF step against bare RK4 steps of the same model, and against filterpy's UKF around it; a call from
            Python against the kernel
  replay    the whole replay command against the length of the recording
  pipeline  plant, estimator and controller as three processes at 1 kHz with a recorder (needs ROS 2): lost samples,
            the time from pressure to command, memory; then again with the monitor beside them

Compare ratios rather than times: a busy machine slows both sides of a ratio.
Status: 0, or 2 for bad input.
"""
PARTS = ("kernels", "replay", "pipeline")
_RUNS = 3


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("benchmark", _DESCRIPTION)
    out.option("--only", "run this part alone; may be given several times", choices=PARTS, action="append")
    out.option("--rig", "a YAML file, or a rig's name (default: shin2022)", default="shin2022", metavar="RIG")
    out.option("--bag", "recording for the replay (default: 60 s are simulated)", Path, metavar="BAG")
    out.option("--duration", "length of the pipeline's run [s] (default: 60)", float, 60.0, "S")
    json_option.add_new_json(out, "the figures")
    return out


def _main(arguments: argparse.Namespace) -> int:
    rig = load_rig(arguments.rig)
    parts = [part for part in PARTS if part in (arguments.only or PARTS)]
    if "pipeline" in parts:
        needs_ros("benchmark --only pipeline")
    figures: dict[str, float] = {}
    with counted(len(parts), "benchmark") as done:
        for part in parts:
            if part == "kernels":
                from validation.benchmark import kernels

                figures |= kernels.measure(rig)
            elif part == "replay":
                figures |= _replay(arguments.rig, arguments.bag)
            else:
                from validation.benchmark import pipeline

                figures |= pipeline.measure(arguments.rig, arguments.duration)
            done(1)
    table = Table(("figure", "measured"), tuple((name, number(value)) for name, value in figures.items()))
    machine = {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()}
    content = {"figures": figures, "machine": machine, "software": versions()}
    json_option.show(terminal.table(table, indent=""), content, arguments.json)
    return common.DONE


def _replay(rig: str, bag: Path | None) -> dict[str, float]:
    """Time ``replay --no-figures`` with the default tuning, compiled kernels at hand."""
    with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as name:
        if bag is None:
            bag = Path(name) / "bag"
            _command("simulate", "--rig", rig, "--out", str(bag), "--duration", "60", "--profile", "steps")
        elapsed = []
        for run in range(_RUNS + 1):
            out = Path(name) / f"replay_{run}"
            elapsed.append(_command("replay", str(bag), "--rig", rig, "--out", str(out), "--no-figures"))
        report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    seconds = statistics.median(elapsed[1:])
    duration = float(report["duration_s"])
    return {f"replay of {duration:.0f} s [s]": seconds, "the recording against it [x]": duration / seconds}


def _command(name: str, *arguments: str) -> float:
    """Run a command of this package as a user would; the time that it took [s]."""
    begin = time.perf_counter()
    words = [sys.executable, "-m", "pam_antagonist", name, *arguments]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BadInput(f"{name} ended with status {done.returncode}: {done.stderr.strip()[-300:]}")
    return time.perf_counter() - begin


main = common.command(parser, _main)
