"""The live page beside the pipeline: turns with a page open and turns without, in one run."""

from __future__ import annotations

import asyncio
import json
import os
import re
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import Process, Processes, ProcessFailed, free_domain
from pam_antagonist.optional import needs
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.replays.accounting import STAGES, account, round_trips
from pam_antagonist.rig import load_rig
from pam_antagonist.validation.benchmark.figure import Figure, at_most
from pam_antagonist.validation.benchmark.pipeline import cpu_seconds, start_real

_TURN = 10.0
"""A turn is about so long [s]; there are as many with a page as without, and one of each at least."""
_SETTLE = 1.0
"""At the start of each turn subscriptions come or go: that much of it does not count [s]."""
_START = 60.0
"""Time that the page's process may take to start [s]."""
ROUND_TRIP = 1.05
"""What the round trip may become with a page open."""
PROCESSOR = 10.0
"""What the page's process may take of a core [%]."""


@dataclass(frozen=True)
class _Turn:
    """A stretch of the run that counts.

    Attributes:
        looking: whether a page was open.
        begin: by the machine's clock [ns].
        end: likewise [ns].
        cpu_percent: what the page's process took of a core.
        frames: with an angle that the page got a second.
    """

    looking: bool
    begin: int
    end: int
    cpu_percent: float
    frames: float


def measure(rig: str, duration: float) -> list[Figure]:
    """Run the pipeline with a recorder and the page's process; open and close a page in turn.

    Args:
        rig: name or path.
        duration: of all turns together [s].

    Raises:
        BadInput: ROS 2 or the page's library is missing, or a process does not start.
    """
    with needs("watch", "benchmark --only watch"):
        import tornado  # noqa: F401
    path = str(Path(rig).resolve()) if rig.endswith((".yaml", ".yml")) else rig
    load = os.getloadavg()[0]
    try:
        turns, recording = _run(path, duration)
    except ProcessFailed as error:
        raise BadInput(f"watch: {error}") from None
    accounting = account(recording, load_rig(rig).sample_period)
    took = [round_trips(recording, turn.begin, turn.end)[1] for turn in turns]
    if accounting is None or any(len(times) == 0 for times in took):
        raise BadInput("watch: the recording lacks a stage of the pipeline")
    medians = np.array([np.median(times) for times in took])
    looking = np.array([turn.looking for turn in turns])
    beside, without = (_percentiles(took, which) for which in (looking, ~looking))
    cpu, idle = ([turn.cpu_percent for turn in turns if turn.looking is which] for which in (True, False))
    return [
        at_most(
            "watch_round_trip",
            f"median time pressure → command of the turns with a page open, against those without; {len(turns)} turns",
            beside[0] / without[0],
            ROUND_TRIP,
            "×",
            {
                "with_ms": beside[0],
                "without_ms": without[0],
                "with_p99_ms": beside[1],
                "without_p99_ms": without[1],
                "spread_of_turns_without": float(np.ptp(medians[~looking]) / without[0]),
                "load_before": load,
                "load_after": os.getloadavg()[0],
            },
        ),
        at_most(
            "watch_processor",
            "share of one core that the page's process takes while a page is open",
            float(np.mean(cpu)),
            PROCESSOR,
            "%",
            {
                "largest_percent": max(cpu),
                "nobody_looks_percent": float(np.mean(idle)),
                "frames_a_second": float(np.mean([turn.frames for turn in turns if turn.looking])),
            },
        ),
        at_most(
            "watch_lost",
            f"messages missing over the whole run, of {accounting.expected} samples",
            float(sum(accounting.lost.values())),
            0.0,
            "",
            {**{stage: float(accounting.lost[stage]) for stage in STAGES}, "late": float(accounting.late)},
        ),
    ]


def _percentiles(took: Sequence[NDArray[np.float64]], which: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Median and 99th percentile of the turns that are wanted, together [ms]."""
    chosen = [times for times, wanted in zip(took, which, strict=True) if wanted]
    return np.asarray(np.percentile(np.concatenate(chosen), [50.0, 99.0]), dtype=np.float64)


def _run(rig: str, duration: float) -> tuple[list[_Turn], Recording]:
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    from pam_antagonist.nodes.client import ReferenceClient

    count = 2 * max(1, round(duration / (2.0 * _TURN)))
    with tempfile.TemporaryDirectory(prefix="pam_watch_") as name:
        folder = Path(name)
        with Processes(folder) as processes:
            processes.start("record", ["--out", str(folder / "bag")])
            start_real(rig)(processes)
            page = processes.start("watch", ["--port", "0"])
            with ReferenceClient() as client:
                processes.wait(client.missing)
            address = _address(processes, page)
            turns = asyncio.run(_turns(processes, page, address, count, duration / count))
            processes.stop("watch", "plant")
            time.sleep(0.3)
            processes.stop("controller", "estimator", "record")
        return turns, read_bag(folder / "bag")


def _address(processes: Processes, page: Process) -> str:
    """Where the page's process serves, as it prints it."""
    end = time.monotonic() + _START
    while (found := re.search(r"http(://\S+/)", page.log.read_text(errors="replace"))) is None:
        processes.check()
        if time.monotonic() > end:
            raise ProcessFailed(f"watch printed no address within {_START:g} s")
        time.sleep(0.1)
    return f"ws{found[1]}live"


async def _turns(processes: Processes, page: Process, address: str, count: int, length: float) -> list[_Turn]:
    """Turns without and with a page: without, with, with, without, and so on, so that a slow drift counts for both."""
    from tornado.websocket import websocket_connect

    from pam_antagonist.nodes.watch import FIELDS

    place = FIELDS.index("angle")
    turns = []
    for k in range(count):
        looking = k % 4 in (1, 2)
        received: list[bool] = []

        def got(message: str | bytes | None, received: list[bool] = received) -> None:
            if message is not None:
                received.append(json.loads(message)["frame"][place] is not None)

        visit = await websocket_connect(address, on_message_callback=got) if looking else None
        await asyncio.sleep(_SETTLE)
        received.clear()
        used, since, begin = cpu_seconds(page), time.monotonic(), time.time_ns()
        while (left := since + length - _SETTLE - time.monotonic()) > 0.0:
            processes.check()
            await asyncio.sleep(min(0.5, left))
        elapsed, end = time.monotonic() - since, time.time_ns()
        turns.append(_Turn(looking, begin, end, 100.0 * (cpu_seconds(page) - used) / elapsed, sum(received) / elapsed))
        if visit is not None:
            visit.close()
    return turns
