"""Several simulated joints in one process: what is lost, and what it takes."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import Processes, ProcessFailed, free_domain
from pam_antagonist.recording import read_bag
from pam_antagonist.replays.accounting import account
from pam_antagonist.rig import Rig
from pam_antagonist.rig.write import write_rig
from pam_antagonist.validation.benchmark.figure import Figure, at_most
from pam_antagonist.validation.benchmark.pipeline import cpu_seconds, resident_mb

JOINTS = 6
PERIODS = (0.002, 0.001)
"""Times between two samples of a joint that are tried [s]."""

MEMORY = 350.0
"""What the process of six joints may take [MB]."""

_START = 120.0  # time that all nodes may take to start, which may have to compile first [s]


@dataclass(frozen=True)
class _Run:
    """One run.

    Attributes:
        expected: samples of all joints.
        lost: messages that are missing, also of a time that a plant left out because it was more than 1 s behind.
        late: estimates older than 20 ms.
        median_ms: pressure to command.
        p99_ms: the same.
        resident_mb: memory of the process.
        cpu_percent: processor time of the process.
        recorder_percent: of the recorder.
    """

    expected: float
    lost: float
    late: float
    median_ms: float
    p99_ms: float
    resident_mb: float
    cpu_percent: float
    recorder_percent: float


def measure(rig: Rig, duration: float) -> list[Figure]:
    """Run six joints with a recorder, at each of the periods.

    Args:
        rig: of each joint; its sample period is replaced.
        duration: of each run [s].

    Raises:
        BadInput: the nodes do not start, or one ends.
    """
    figures = []
    for period in PERIODS:
        try:
            run = _run(rig, period, duration)
        except ProcessFailed as error:
            raise BadInput(f"joints: {error}") from None
        rate = round(1.0 / period)
        figures.append(
            at_most(
                f"joints_lost_{rate}_hz",
                f"messages missing of {JOINTS} joints at {rate} Hz in one process",
                run.lost,
                0.0,
                "",
                {**vars(run)},
            )
        )
        if period == PERIODS[0]:
            figures.append(
                at_most(
                    "joints_memory",
                    f"resident memory of the process with {JOINTS} joints",
                    run.resident_mb,
                    MEMORY,
                    "MB",
                    {"cpu_percent": run.cpu_percent},
                )
            )
    return figures


def _run(rig: Rig, period: float, duration: float) -> _Run:
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    names = [f"joint_{k + 1}" for k in range(JOINTS)]
    with tempfile.TemporaryDirectory(prefix="pam_joints_") as name:
        folder = Path(name)
        write_rig(rig.model_copy(update={"sample_period": period}), folder / "rig.yaml")
        (folder / "robot.yaml").write_text(yaml.safe_dump(_parameters(names, folder / "rig.yaml")))
        with Processes(folder) as processes:
            chosen = [word for joint in names for word in ("--namespace", f"/{joint}")]
            recorder = processes.start("record", ["--out", str(folder / "bag"), *chosen])
            process = processes.start("joints", ["--ros-args", "--params-file", str(folder / "robot.yaml")])
            _wait(processes)
            before = cpu_seconds(process), cpu_seconds(recorder)
            begin = time.monotonic()
            while (elapsed := time.monotonic() - begin) < duration:
                processes.check()
                time.sleep(min(0.5, duration - elapsed))
            elapsed = time.monotonic() - begin
            used = cpu_seconds(process) - before[0], cpu_seconds(recorder) - before[1]
            resident = resident_mb(process)
            processes.stop("joints")
            time.sleep(0.3)
            processes.stop("record")
        accounts = [account(read_bag(folder / "bag", namespace=f"/{joint}"), period) for joint in names]
    good = [item for item in accounts if item is not None and item.expected > 0]
    if len(good) < JOINTS:
        raise BadInput("joints: the recording lacks a stage of one of the joints")
    samples = round(duration / period)  # at least; the recording is two seconds longer
    return _Run(
        expected=float(sum(max(item.expected, samples) for item in good)),
        lost=float(sum(sum(item.lost.values()) + max(0, samples - item.expected) for item in good)),
        late=float(sum(item.late for item in good)),
        median_ms=float(np.median([item.latency.median for item in good])),
        p99_ms=float(max(item.latency.p99 for item in good)),
        resident_mb=resident,
        cpu_percent=100.0 * used[0] / elapsed,
        recorder_percent=100.0 * used[1] / elapsed,
    )


def _parameters(names: list[str], rig: Path) -> dict[str, object]:
    """A parameter file for so many joints."""
    sections: dict[str, dict[str, object]] = {"/**/joints": {"joints": names}, "/**": {"rig": str(rig)}}
    for k, joint in enumerate(names):
        sections[f"/{joint}/**"] = {"joint_name": joint}
        sections[f"/{joint}/plant"] = {"seed": k, "mismatch": 0.01, "wait_for_subscribers": 1}
    return {name: {"ros__parameters": values} for name, values in sections.items()}


def _wait(processes: Processes) -> None:
    """Wait until every joint is active and a moment is over."""
    log = processes.running["joints"].log
    end = time.monotonic() + _START
    while "[joints]: active" not in log.read_text(errors="replace"):
        processes.check()
        if time.monotonic() > end:
            raise ProcessFailed(f"joints did not start within {_START:g} s")
        time.sleep(0.1)
    time.sleep(2.0)
