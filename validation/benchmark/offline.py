"""The whole ``replay`` command, from file to report.json."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pam_antagonist.errors import BadInput
from validation.benchmark.figure import Figure, at_least

_DURATION = 60.0
_RUNS = 3


def _command(name: str, *arguments: str) -> float:
    """Run a command of this package as a user would; returns the time it took [s]."""
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "pam_antagonist", name, *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise BadInput(f"{name} ended with status {done.returncode}: {done.stderr.strip()[-300:]}")
    return time.perf_counter() - begin


def measure(rig: str, bag: Path | None = None) -> list[Figure]:
    """Time ``replay --no-figures`` with the default tuning, compiled kernels at hand.

    Args:
        rig: name or path.
        bag: recording; default: 60 s of the simulated plant.

    Raises:
        BadInput: a command failed.
    """
    with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as name:
        folder = Path(name)
        if bag is None:
            bag = folder / "bag"
            _command("simulate", "--rig", rig, "--out", str(bag), "--duration", str(_DURATION), "--profile", "steps")
        elapsed = []
        for run in range(_RUNS + 1):
            out = folder / f"replay_{run}"
            elapsed.append(_command("replay", str(bag), "--rig", rig, "--out", str(out), "--no-figures"))
        report = json.loads((out / "report.json").read_text())
    seconds = statistics.median(elapsed[1:])
    duration = float(report["duration_s"])
    return [
        at_least(
            "replay_command",
            f"{duration:.0f} s of recording against the whole replay command (start to report.json, no figures)",
            duration / seconds,
            12.0,
            "× real time",
            {"command_s": seconds, "recording_s": duration, **{k: float(v) for k, v in report["timing"].items()}},
        )
    ]
