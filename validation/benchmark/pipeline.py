"""The live pipeline as processes: plant, estimator and controller at the rig's rate, with the recorder beside them."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import Process, Processes, ProcessFailed, free_domain, ros_arguments
from pam_antagonist.recording import read_bag
from pam_antagonist.replays.accounting import account
from pam_antagonist.rig import load_rig

_SETTLE = 2.0  # after the nodes have started, before memory is looked at [s]
_NODES = ("plant", "estimator", "controller")
_OF: dict[str, dict[str, object]] = {"monitor": {"folder": "", "log_book": False}}
"""Parameters of single nodes."""


def measure(rig: str, duration: float) -> dict[str, float]:
    """Run the pipeline for a time [s], and again with the monitor: what became of samples, and what nodes took."""
    alone, watched = (_run(rig, duration, nodes) for nodes in (_NODES, (*_NODES, "monitor")))
    ratios = {
        f"pressure to command, {name}, with the monitor, of that without [-]":
            watched[f"pressure to command, {name} [ms]"] / alone[f"pressure to command, {name} [ms]"]
        for name in ("median", "99 %")
    }  # fmt: skip
    return {**alone, **{name: value for name, value in watched.items() if name.startswith("monitor")}, **ratios}


def _run(rig: str, duration: float, names: Sequence[str]) -> dict[str, float]:
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    from pam_antagonist.nodes.client import ReferenceClient

    shared: dict[str, object] = {"rig": str(Path(rig).resolve()) if rig.endswith((".yaml", ".yml")) else rig}
    with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as name:
        bag = Path(name) / "bag"
        try:
            with Processes(Path(name)) as processes:
                processes.start("record", ["--out", str(bag)])
                for node in names[1:]:
                    processes.start(node, ros_arguments({**shared, **_OF.get(node, {})}, {}))
                processes.start("plant", ros_arguments({**shared, "mismatch": 0.01, "wait_for_subscribers": 2}, {}))
                with ReferenceClient() as watch:
                    processes.wait(watch.missing)
                time.sleep(_SETTLE)
                nodes = {node: processes.running[node] for node in names}
                before = {node: _taken(process) for node, process in nodes.items()}
                begin = time.monotonic()
                while (elapsed := time.monotonic() - begin) < duration:
                    processes.check()
                    time.sleep(min(0.5, duration - elapsed))
                after = {node: _taken(process) for node, process in nodes.items()}
                processes.stop("plant")
                time.sleep(0.3)
                processes.stop(*names[:0:-1], "record")
        except ProcessFailed as error:
            raise BadInput(f"pipeline: {error}") from None
        recording = read_bag(bag)
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
        "messages out of order": float(sum(found.out_of_order.values())),
        "drift against the machine's clock [ms]": (last - first) * 1e-6,
    }
    for node in names:
        (memory, cpu), (now, spent) = before[node], after[node]
        out[f"{node}, resident memory [MB]"] = now
        out[f"{node}, growth of it [MB]"] = now - memory
        out[f"{node}, share of a core [%]"] = 100.0 * (spent - cpu) / elapsed
    return out


def _taken(process: Process) -> tuple[float, float]:
    """Resident memory of a process [MB], and processor time that it has taken [s]."""
    files = Path(f"/proc/{process.popen.pid}")
    pages = int((files / "statm").read_text().split()[1])
    fields = (files / "stat").read_text().rsplit(")", 1)[1].split()
    ticks = int(fields[11]) + int(fields[12])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6, ticks / os.sysconf("SC_CLK_TCK")
