"""What a command of this package spends: processor time, time on the clock, memory."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from pam_antagonist.errors import BadInput

# Linux counts what a process was forked from as memory of its own, so it is started from one that has next to none.
_LAUNCHER = """
import json, os, sys, time
begin = time.perf_counter()
process = os.spawnv(os.P_NOWAIT, sys.argv[2], sys.argv[2:])
_, status, usage = os.wait4(process, 0)
figures = {
    "cpu_s": usage.ru_utime + usage.ru_stime,
    "wall_s": time.perf_counter() - begin,
    "peak_mb": usage.ru_maxrss / 1e3,
}
with open(sys.argv[1], "w", encoding="utf-8") as file:
    json.dump(figures, file)
sys.exit(os.waitstatus_to_exitcode(status))
"""


class Spent(NamedTuple):
    """What one run of a command spent.

    Attributes:
        cpu_s: processor time of all its threads and of the processes that it waited for [s].
        wall_s: time on the clock [s].
        peak_mb: most memory that it held at a time [MB].
    """

    cpu_s: float
    wall_s: float
    peak_mb: float


def spent_on(command: str, bags: Sequence[str | Path], rig: str, out: Path, checkout: Path | None = None) -> Spent:
    """:func:`spent` of a command on recordings, without figures in its report.

    Args:
        command: its name.
        bags: the recordings.
        rig: name or path.
        out: folder of the result; a new one.
        checkout: as for :func:`spent`.

    Raises:
        BadInput: the command failed.
    """
    words = [*map(str, bags), "--rig", rig, "--out", str(out), "--no-figures"]
    return spent(command, *words, checkout=checkout)


def spent(*arguments: str, checkout: Path | None = None) -> Spent:
    """Run a command to its end.

    Processor time hardly changes where other work takes the cores away; time on the clock does.

    Args:
        arguments: name of the command and its arguments.
        checkout: folder of the checkout whose code runs; default: this code.

    Raises:
        BadInput: the command failed.
    """
    environment = dict(os.environ)
    if checkout is not None:
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, (str(checkout), environment.get("PYTHONPATH"))))
    with tempfile.TemporaryFile() as output, tempfile.NamedTemporaryFile("r", encoding="utf-8") as figures:
        process = subprocess.Popen(
            [sys.executable, "-c", _LAUNCHER, figures.name, sys.executable, "-m", "pam_antagonist", *arguments],
            cwd=checkout, env=environment, stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip
        try:
            status = process.wait()
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise
        if status != 0:
            output.seek(0)
            said = output.read().decode(errors="replace").strip()[-300:]
            raise BadInput(f"{arguments[0]} ended with status {status}: {said}")
        return Spent(**json.load(figures))
