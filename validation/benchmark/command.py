"""Measure what the package costs on this machine.

  kernels   a UKF step against bare RK4 steps of the same model, and against filterpy's UKF around it; a call from
            Python against the kernel
  replay    the whole replay command against the length of the recording
  pipeline  plant, estimator and controller as three processes at 1 kHz with a recorder (needs ROS 2): lost samples,
            the time from pressure to command, memory; then again with the monitor beside them, with one message a
            sample, all in one process, and six joints in one process at 500 Hz
  board     all in one process, with a recorder, on one core beside three busy processes, at 1000, 500 and 250 Hz: which
            samples have an estimate in time

Compare ratios rather than times: a busy machine slows both sides of a ratio.
Status: 0, or 2 for bad input.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import Process, ProcessFailed
from pam_antagonist.optional import needs_ros
from pam_antagonist.program import started, versions
from pam_antagonist.recording import read_bag
from pam_antagonist.replays.accounting import account
from pam_antagonist.report.document import Table, number
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.file import write_rig
from validation import frame
from validation.benchmark import board
from validation.pipeline import running

PARTS = ("kernels", "replay", "pipeline", "board")
_RUNS = 3
_SETTLE = 2.0  # after the nodes have started, before memory is looked at [s]
_NODES = ("plant", "estimator", "controller")
_OF: dict[str, dict[str, object]] = {
    "plant": {"mismatch": 0.01, "wait_for_subscribers": 2}, "monitor": {"folder": "", "log_book": False},
    "joints": {"mismatch": 0.01},  # one joint, of the usual namespace
}  # fmt: skip
"""Parameters of single nodes."""
_RECORDER = "record"
_ONE = {"samples": "one", "topic_rate": 100.0}
"""Parameters of all nodes where a sample is one message, and people see every tenth."""
_JOINTS, _PERIOD = ("pam", *(f"pam_{number}" for number in range(2, 7))), 0.002
"""Namespaces of several joints in one process, and their sample period [s]."""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("benchmark", __doc__)
    out.option("--only", "run this part alone; may be given several times", choices=PARTS, action="append")
    out.option("--rig", "a YAML file, or a rig's name (default: shin2022)", default="shin2022", metavar="RIG")
    out.option("--bag", "recording for the replay (default: 60 s are simulated)", Path, metavar="BAG")
    out.option("--duration", "length of the pipeline's run [s] (default: 60)", float, 60.0, "S")
    frame.add_new_json(out, "the figures")
    return out


def _main(arguments: argparse.Namespace) -> int:
    rig = load_rig(arguments.rig)
    parts = [part for part in PARTS if part in (arguments.only or PARTS)]
    for part in ("pipeline", "board"):
        if part in parts:
            needs_ros(f"benchmark --only {part}")
    figures: dict[str, float] = {}
    with counted(len(parts), "benchmark") as done:
        for part in parts:
            if part == "kernels":
                from validation.benchmark import kernels

                figures |= kernels.measure(rig)
            elif part == "replay":
                figures |= _replay(arguments.rig, arguments.bag)
            elif part == "pipeline":
                figures |= _pipeline(arguments.rig, arguments.duration)
            else:
                with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as folder:
                    figures |= board.measure(
                        arguments.rig, Path(folder), lambda rig: _run(rig, arguments.duration, ("joints",), _ONE)
                    )
            done(1)
    table = Table(("figure", "measured"), tuple((name, number(value)) for name, value in figures.items()))
    machine = {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()}
    content = {"figures": figures, "machine": machine, "software": versions()}
    frame.show([table], arguments, content)
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
    words = started("pam_antagonist", name, *arguments)
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BadInput(f"{name} ended with status {done.returncode}: {done.stderr.strip()[-300:]}")
    return time.perf_counter() - begin


def _pipeline(rig: str, duration: float) -> dict[str, float]:
    """Run the pipeline for a time [s]; with the monitor, one message a sample, and in one process: what nodes took."""
    alone, watched = (_run(rig, duration, nodes) for nodes in (_NODES, (*_NODES, "monitor")))
    one = _run(rig, duration, _NODES, _ONE)
    together = _run(rig, duration, ("joints",), _ONE)
    ratios = {
        f"pressure to command, {name}, with the monitor, of that without [-]":
            watched[f"pressure to command, {name} [ms]"] / alone[f"pressure to command, {name} [ms]"]
        for name in ("median", "99 %")
    }  # fmt: skip
    shares = [f"{name}, share of a core" for name in (*_NODES, _RECORDER)]
    ratios |= {
        f"{name} with one message a sample, of that with topics [-]": one[f"{name} [%]"] / alone[f"{name} [%]"]
        for name in shares
    }
    for words, run in (("one message a sample", one), ("one process", together)):
        ratios |= {f"{name}, {words}": run[name] for name in run if name.startswith(("samples", "pressure to"))}
    several = _several(rig, duration)
    for words, run in (("in one process", together), (f"{len(_JOINTS)} joints at {1.0 / _PERIOD:.0f} Hz", several)):
        ratios |= {f"{name}, {words}, share of a core [%]": run[f"{name}, share of a core [%]"]
                   for name in ("joints", _RECORDER)}  # fmt: skip
    ratios |= {f"{name}, {len(_JOINTS)} joints": several[name] for name in several if name.startswith("samples")}
    return {**alone, **{name: value for name, value in watched.items() if name.startswith("monitor")}, **ratios}


def _several(rig: str, duration: float) -> dict[str, float]:
    """Several joints in one process, all recorded; what is said of samples is said of the first joint."""
    with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as folder:
        slow, sections = Path(folder) / "rig.yaml", Path(folder) / "robot.yaml"
        write_rig(load_rig(rig).replaced(sample_period=_PERIOD), slow, [])
        own = {f"/{name}/**": {"ros__parameters": {"joint_name": name}} for name in _JOINTS}
        sections.write_text(json.dumps({"/joints": {"ros__parameters": {"joints": _JOINTS}}, **own}), encoding="utf-8")
        return _run(str(slow), duration, ("joints",), _ONE, sections)


def _run(
    rig: str, duration: float, names: Sequence[str], given: Mapping[str, object] = MappingProxyType({}),
    sections: Path | None = None,
) -> dict[str, float]:  # fmt: skip
    """Figures of the nodes with a recorder. `sections`: a parameter file of several joints, `_JOINTS`."""
    from pam_antagonist.nodes.client import ReferenceClient

    path = str(Path(rig).resolve()) if rig.endswith((".yaml", ".yml")) else rig
    nodes = {name: {"rig": path, **_OF.get(name, {}), **given} for name in (*names[1:], names[0])}
    with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as folder:
        try:
            with running(Path(folder), nodes, _JOINTS if sections else (), sections) as processes:
                with ReferenceClient() as watch:
                    processes.wait(watch.missing)
                time.sleep(_SETTLE)
                taken = {node: processes.running[node] for node in (*names, _RECORDER)}
                before = {node: _taken(process) for node, process in taken.items()}
                begin = time.monotonic()
                while (elapsed := time.monotonic() - begin) < duration:
                    processes.check()
                    time.sleep(min(0.5, duration - elapsed))
                after = {node: _taken(process) for node, process in taken.items()}
        except ProcessFailed as error:
            raise BadInput(f"pipeline: {error}") from None
        recording = read_bag(Path(folder) / "bag", namespace=_JOINTS[0])
    found = account(recording, load_rig(rig).sample_period)
    if found is None or found.expected == 0:
        raise BadInput("pipeline: the recording lacks a stage of the pipeline")
    arrivals = recording.received_ns["pressure_1"]
    lag = arrivals.log_ns - arrivals.stamp_ns
    tenth = max(1, len(lag) // 10)
    # The quickest deliveries of the first and of the last tenth: a busy machine delays samples, it does not drift.
    first, last = (float(np.percentile(part, 1.0)) for part in (lag[:tenth], lag[-tenth:]))
    out = {
        "pressure to command, median [ms]": found.latency.median,
        "pressure to command, 99 % [ms]": found.latency.p99,
        "pressure to command, largest [ms]": found.latency.largest,
        "samples expected": float(found.expected),
        "samples lost": float(sum(found.lost.values())),
        "samples late": float(found.late),
        "samples in time [%]": 100.0 - 100.0 * (found.lost["joint_estimate"] + found.late) / found.expected,
        "messages out of order": float(sum(found.out_of_order.values())),
        "drift against the machine's clock [ms]": (last - first) * 1e-6,
    }
    for node in taken:
        (memory, _, cpu), (now, own, spent) = before[node], after[node]
        out[f"{node}, resident memory [MB]"] = now
        out[f"{node}, of it not shared [MB]"] = own
        out[f"{node}, growth of it [MB]"] = now - memory
        out[f"{node}, share of a core [%]"] = 100.0 * (spent - cpu) / elapsed
    return out


def _taken(process: Process) -> tuple[float, float, float]:
    """Resident memory of a process, what of it is no file's [MB], and processor time that it has taken [s]."""
    files = Path(f"/proc/{process.popen.pid}")
    pages, shared = map(int, (files / "statm").read_text().split()[1:3])
    fields = (files / "stat").read_text().rsplit(")", 1)[1].split()
    ticks = int(fields[11]) + int(fields[12])
    page = os.sysconf("SC_PAGE_SIZE") / 1e6
    return pages * page, (pages - shared) * page, ticks / os.sysconf("SC_CLK_TCK")


main = common.command(parser, _main)
