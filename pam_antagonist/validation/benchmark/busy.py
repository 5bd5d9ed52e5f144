"""Processor time of the offline commands beside other work, against alone."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from pam_antagonist.validation.benchmark.figure import Figure, at_most
from pam_antagonist.validation.benchmark.growth import recorded
from pam_antagonist.validation.benchmark.spent import spent_on

_COMMANDS = ("close_loop", "identify")
_BOUND = 1.5
_WORK = """
import numpy as np
values = np.random.default_rng(1).standard_normal((700, 700))
while True:
    np.sort(values @ values, axis=None)
"""


def measure(rig: str) -> list[Figure]:
    """Each command over a pair of a minute: alone, then beside a process for each core that sorts and multiplies.

    Args:
        rig: name or path.

    Raises:
        BadInput: a command failed.
    """
    figures = []
    with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as name:
        folder = Path(name)
        bags = [recorded(rig, folder, 1, seed) for seed in (1, 2)]
        spent_on(_COMMANDS[0], bags, rig, folder / "first")
        for command in _COMMANDS:
            alone = spent_on(command, bags, rig, folder / f"{command}_alone")
            with _other_work():
                beside = spent_on(command, bags, rig, folder / f"{command}_beside")
            parts = {"alone_cpu_s": alone.cpu_s, "beside_cpu_s": beside.cpu_s}
            parts |= {"alone_wall_s": alone.wall_s, "beside_wall_s": beside.wall_s}
            meaning = f"processor time of {command} beside {os.cpu_count()} busy processes against alone"
            figures.append(at_most(f"{command}_beside", meaning, beside.cpu_s / alone.cpu_s, _BOUND, "×", parts))
    return figures


@contextmanager
def _other_work() -> Iterator[None]:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with ExitStack() as running:
        for _ in range(os.cpu_count() or 1):
            process = subprocess.Popen([sys.executable, "-c", _WORK], env=environment, stdin=subprocess.DEVNULL)
            running.callback(process.wait)
            running.callback(process.kill)
        yield
