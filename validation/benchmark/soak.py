"""The live pipeline for a long time: what grows, what is lost, what drifts."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import Processes, ProcessFailed, free_domain
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.replays.accounting import STAGES, Accounting, OverTime, account, over_time
from pam_antagonist.rig import load_rig
from validation.benchmark.figure import Figure, at_most
from validation.benchmark.pipeline import NODES, cpu_seconds, resident_mb, start_real

WARM_UP = 60.0
"""Time from which on memory may not grow [s]; a third of the run, where that is shorter."""

BLOCK = 10.0
"""Length of the blocks over which samples are counted and the quickest delivery is taken [s]."""

_WATCHED = (*NODES, "record")
_FILE = 60.0  # length of one file of the recording, as on a rig [s]


@dataclass(frozen=True)
class Usage:
    """What the processes took, once a second.

    Attributes:
        time: since the pipeline runs (T,) [s].
        resident: process -> resident memory (T,) [MB].
        cpu: process -> processor time since its start (T,) [s].
    """

    time: NDArray[np.float64]
    resident: dict[str, NDArray[np.float64]]
    cpu: dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Soak:
    """A finished run: figures with bounds, and the series behind them.

    Attributes:
        figures: what came out.
        usage: memory and processor time.
        drift: see :func:`clock_drift`, a value each :data:`BLOCK` (B,) [ms].
        samples: losses and round trips, a value each :data:`BLOCK`.
    """

    figures: list[Figure]
    usage: Usage
    drift: NDArray[np.float64]
    samples: OverTime


def measure(rig: str, duration: float, progress: Callable[[float], object] = lambda seconds: None) -> Soak:
    """Run plant, estimator, controller and recorder.

    Args:
        rig: name or path.
        duration: [s].
        progress: called with the time that has passed since the last call [s].

    Raises:
        BadInput: ROS 2 is missing, a node does not start, or one ends before its time.
    """
    period = load_rig(rig).sample_period
    path = str(Path(rig).resolve()) if rig.endswith((".yaml", ".yml")) else rig
    try:
        usage, recording = _run(path, duration, progress)
    except ProcessFailed as error:
        raise BadInput(f"soak: {error}") from None
    accounting = account(recording, period)
    samples = over_time(recording, period, BLOCK)
    if accounting is None or samples is None or accounting.expected == 0:
        raise BadInput("soak: the recording lacks a stage of the pipeline")
    drift = clock_drift(recording)
    return Soak([*_memory(usage), _lost(accounting), _drift(drift, period), _processor(usage)], usage, drift, samples)


def _run(rig: str, duration: float, progress: Callable[[float], object]) -> tuple[Usage, Recording]:
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    from pam_antagonist.nodes.client import ReferenceClient

    with tempfile.TemporaryDirectory(prefix="pam_soak_") as name:
        folder = Path(name)
        with Processes(folder) as processes:
            processes.start("record", ["--out", str(folder / "bag"), "--max-duration", str(_FILE)])
            start_real(rig)(processes)
            with ReferenceClient() as watch:
                processes.wait(watch.missing)
            usage = _watch(processes, duration, progress)
            processes.stop("plant")
            time.sleep(0.3)
            processes.stop("controller", "estimator", "record")
        return usage, read_bag(folder / "bag")


def _watch(processes: Processes, duration: float, progress: Callable[[float], object]) -> Usage:
    """Look at every process once a second."""
    rows: list[list[float]] = []
    begin = time.monotonic()
    while True:
        now = time.monotonic() - begin
        watched = [processes.running[name] for name in _WATCHED]
        rows.append([now, *map(resident_mb, watched), *map(cpu_seconds, watched)])
        if now >= duration:
            break
        processes.check()
        time.sleep(max(0.0, min(len(rows) * 1.0, duration) - (time.monotonic() - begin)))
        progress(time.monotonic() - begin - now)
    table = np.array(rows)
    count = len(_WATCHED)
    return Usage(
        table[:, 0],
        {name: table[:, 1 + k] for k, name in enumerate(_WATCHED)},
        {name: table[:, 1 + count + k] for k, name in enumerate(_WATCHED)},
    )


def growth(usage: Usage, name: str) -> float:
    """How much more memory a process has in the end than after the warm-up [MB].

    Medians over ten seconds at both ends: what comes and goes within them is no growth.
    """
    warm = min(WARM_UP, usage.time[-1] / 3.0)
    resident = usage.resident[name]
    first = resident[(usage.time >= warm) & (usage.time < warm + 10.0)]
    return float(np.median(resident[usage.time >= usage.time[-1] - 10.0]) - np.median(first))


def clock_drift(recording: Recording) -> NDArray[np.float64]:
    """Quickest delivery of each block of ten seconds, relative to the first block (B,) [ms].

    The stamps are the device's clock, which counts its samples; the times of reception are the machine's. A busy
    machine delays samples, but not the quickest of ten thousand; what is left is the drift between the clocks.
    """
    arrivals = recording.received_ns["pressure_1"]
    lag = (arrivals.log_ns - arrivals.stamp_ns) * 1e-6
    block = ((arrivals.stamp_ns - arrivals.stamp_ns[0]) * 1e-9 / BLOCK).astype(int)
    count = np.bincount(block)
    full = np.flatnonzero(count > 0.5 * count.max())  # the last one may be short
    quickest = np.array([lag[block == k].min() for k in full])
    return quickest - quickest[0]


def _memory(usage: Usage) -> list[Figure]:
    grown = {name: growth(usage, name) for name in _WATCHED}
    warm = min(WARM_UP, usage.time[-1] / 3.0)
    return [
        at_most(
            "soak_memory_growth",
            f"largest growth of a node's resident memory between {warm:.0f} s and {usage.time[-1]:.0f} s",
            max(grown[name] for name in NODES),
            2.0,
            "MB",
            {f"{name}_mb": grown[name] for name in NODES},
        ),
        at_most(
            "soak_recorder_growth",
            "the same of the recorder, which keeps an index of its file",
            grown["record"],
            2.0 + 0.01 * usage.time[-1],
            "MB",
            {f"{name}_now_mb": float(usage.resident[name][-1]) for name in _WATCHED},
        ),
    ]


def _lost(accounting: Accounting) -> Figure:
    worst = max(accounting.lost.values())
    return at_most(
        "soak_lost",
        f"share of {accounting.expected} samples that is missing on the worst topic, between discovery and the end",
        100.0 * worst / accounting.expected,
        0.1,
        "%",
        {
            **{stage: float(accounting.lost[stage]) for stage in STAGES},
            "late": float(accounting.late),
            "round_trip_median_ms": accounting.latency.median,
            "round_trip_p99_ms": accounting.latency.p99,
            "round_trip_max_ms": accounting.latency.largest,
        },
    )


def _drift(drift: NDArray[np.float64], period: float) -> Figure:
    return at_most(
        "soak_drift",
        "largest drift between the stamps of the device and the machine's clock: quickest delivery of each ten seconds",
        float(np.abs(drift).max()),
        period * 1e3,
        "ms",
        {"end_ms": float(drift[-1]), "blocks": float(len(drift))},
    )


def _processor(usage: Usage) -> Figure:
    share = {name: 100.0 * (cpu[-1] - cpu[0]) / (usage.time[-1] - usage.time[0]) for name, cpu in usage.cpu.items()}
    parts = {f"{name}_percent": float(value) for name, value in share.items()}
    return Figure("soak_processor", "share of one core of all processes", sum(parts.values()), "", None, "%", parts)
