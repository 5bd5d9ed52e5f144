"""The live pipeline as processes, beside one that passes the same messages through."""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import Process, Processes, ProcessFailed, free_domain, ros_arguments
from pam_antagonist.recording import read_bag
from pam_antagonist.replays.accounting import STAGES, Accounting, account
from pam_antagonist.rig import load_rig
from validation.benchmark.figure import Figure, at_most

_PASSTHROUGH = "validation.benchmark.passthrough"
_SETTLE = 2.0  # after the nodes have started, before memory is looked at [s]
NODES = ("plant", "estimator", "controller")
"""Those that a pipeline consists of, without the recorder."""


@dataclass(frozen=True)
class Run:
    """One run.

    Attributes:
        account: what became of its samples.
        drift_ms: of the samples against the machine's clock.
        resident_mb: memory of each node.
        growth_mb: of it over the run.
        cpu_percent: what each node took of a core.
    """

    account: Accounting
    drift_ms: float
    resident_mb: dict[str, float]
    growth_mb: dict[str, float]
    cpu_percent: dict[str, float]


def measure(rig: str, duration: float) -> list[Figure]:
    """Run both pipelines for the same time, one after the other, each with the recorder.

    Args:
        rig: name or path.
        duration: of each [s].

    Raises:
        BadInput: ROS 2 is missing, or a node does not start.
    """
    period = load_rig(rig).sample_period
    path = str(Path(rig).resolve()) if rig.endswith((".yaml", ".yml")) else rig
    try:
        empty = run(start_passthrough(period), duration, period)
        real = run(start_real(path), duration, period)
    except ProcessFailed as error:
        raise BadInput(f"pipeline: {error}") from None
    lost = sum(real.account.lost.values())
    disorder = sum(real.account.out_of_order.values())
    latency, through = real.account.latency, empty.account.latency
    return [
        at_most(
            "pipeline_round_trip",
            "median time pressure → command, against that of a pipeline that passes ordinary message objects through "
            "(this package packs its messages in one step); both under the real-time scheduler where that is allowed",
            latency.median / through.median,
            1.3,
            "×",
            {
                "pipeline_ms": latency.median,
                "passthrough_ms": through.median,
                "pipeline_p99_ms": latency.p99,
                "passthrough_p99_ms": through.p99,
                "pipeline_max_ms": latency.largest,
            },
        ),
        at_most(
            "pipeline_lost",
            f"messages missing between discovery and the end, over all stages, of {real.account.expected} samples",
            float(lost),
            0.0,
            "",
            {
                **{stage: float(real.account.lost[stage]) for stage in STAGES},
                "late": float(real.account.late),
                "passthrough": float(sum(empty.account.lost.values())),
            },
        ),
        at_most(
            "pipeline_disorder", "messages received out of the order of their stamps", float(disorder), 0.0, "", {}
        ),
        at_most(
            "pipeline_drift",
            "drift of the samples against the machine's clock over the run",
            abs(real.drift_ms),
            period * 1e3,
            "ms",
            {"expected_samples": float(real.account.expected)},
        ),
        at_most(
            "node_memory",
            "largest resident memory of a node",
            max(real.resident_mb.values()),
            300.0,
            "MB",
            {**{f"{node}_mb": value for node, value in real.resident_mb.items()}},
        ),
        at_most(
            "node_memory_growth",
            "largest growth of a node's resident memory over the run",
            max(real.growth_mb.values()),
            2.0,
            "MB",
            {**{f"{node}_mb": value for node, value in real.growth_mb.items()}},
        ),
        Figure(
            "node_processor",
            "share of one core that the nodes take, against those that pass messages through",
            sum(real.cpu_percent.values()) / sum(empty.cpu_percent.values()),
            "",
            None,
            "×",
            {
                **{f"{node}_percent": value for node, value in real.cpu_percent.items()},
                **{f"passthrough_{node}_percent": value for node, value in empty.cpu_percent.items()},
            },
        ),
    ]


@contextlib.contextmanager
def nobody() -> Iterator[Callable[[float], None]]:
    """Nobody sends references."""
    yield lambda elapsed: None


def start_real(rig: str) -> Callable[[Processes], None]:
    """What starts the three nodes.

    Args:
        rig: name or absolute path.
    """

    def start(processes: Processes) -> None:
        shared: dict[str, object] = {"rig": rig}
        processes.start("estimator", ros_arguments(shared, {}))
        processes.start("controller", ros_arguments(shared, {}))
        processes.start("plant", ros_arguments({**shared, "mismatch": 0.01, "wait_for_subscribers": 2}, {}))

    return start


def start_passthrough(period: float) -> Callable[[Processes], None]:
    """What starts three nodes that pass messages through.

    Args:
        period: of the samples [s].
    """

    def start(processes: Processes) -> None:
        for role in ("estimator", "controller", "plant"):
            processes.start(role, ros_arguments({"sample_period": period}, {}), module=_PASSTHROUGH)

    return start


def run(
    start: Callable[[Processes], None],
    duration: float,
    period: float,
    drive: Callable[[], contextlib.AbstractContextManager[Callable[[float], None]]] = nobody,
) -> Run:
    """Run a pipeline with the recorder.

    Args:
        start: starts its nodes.
        duration: of the run [s].
        period: of the samples [s].
        drive: gives what is called twice a second with the time since the start [s].

    Raises:
        BadInput: the recording lacks a stage of the pipeline.
        ProcessFailed: a node does not start, or ends.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    from pam_antagonist.nodes.client import ReferenceClient

    with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as name:
        folder = Path(name)
        with Processes(folder) as processes, contextlib.ExitStack() as clients:
            processes.start("record", ["--out", str(folder / "bag")])
            start(processes)
            with ReferenceClient() as watch:
                processes.wait(watch.missing)
            time.sleep(_SETTLE)
            act = clients.enter_context(drive())
            nodes = {node: processes.running[node] for node in NODES}
            before = {node: resident_mb(process) for node, process in nodes.items()}
            cpu_before = {node: cpu_seconds(process) for node, process in nodes.items()}
            begin = time.monotonic()
            while (elapsed := time.monotonic() - begin) < duration:
                processes.check()
                act(elapsed)
                time.sleep(min(0.5, duration - elapsed))
            elapsed = time.monotonic() - begin
            resident = {node: resident_mb(process) for node, process in nodes.items()}
            cpu = {node: cpu_seconds(process) for node, process in nodes.items()}
            processes.stop("plant")
            time.sleep(0.3)
            processes.stop("controller", "estimator", "record")
        recording = read_bag(folder / "bag")
    accounting = account(recording, period)
    if accounting is None or accounting.expected == 0:
        raise BadInput("pipeline: the recording lacks a stage of the pipeline")
    arrivals = recording.received_ns["pressure_1"]
    lag = arrivals.log_ns - arrivals.stamp_ns
    tenth = max(1, len(lag) // 10)
    # The quickest deliveries of the first and of the last tenth: a busy machine delays samples, it does not drift.
    quickest = [float(np.percentile(part, 1.0)) for part in (lag[:tenth], lag[-tenth:])]
    return Run(
        account=accounting,
        drift_ms=(quickest[1] - quickest[0]) * 1e-6,
        resident_mb=resident,
        growth_mb={node: resident[node] - before[node] for node in NODES},
        cpu_percent={node: 100.0 * (cpu[node] - cpu_before[node]) / elapsed for node in NODES},
    )


def resident_mb(process: Process) -> float:
    """Resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{process.popen.pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def cpu_seconds(process: Process) -> float:
    """Processor time that a process has taken [s]."""
    fields = Path(f"/proc/{process.popen.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
