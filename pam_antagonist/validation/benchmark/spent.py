"""What a command of this package spends: processor time, time on the clock, memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from pam_antagonist.errors import BadInput


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
    with tempfile.TemporaryFile() as output:
        begin = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "pam_antagonist", *arguments],
            cwd=checkout, env=environment, stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            _, status, usage = os.wait4(process.pid, 0)
        except BaseException:
            process.kill()
            process.wait()
            raise
        wall = time.perf_counter() - begin
        # Popen would wait for a process that is gone.
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            output.seek(0)
            said = output.read().decode(errors="replace").strip()[-300:]
            raise BadInput(f"{arguments[0]} ended with status {process.returncode}: {said}")
    return Spent(usage.ru_utime + usage.ru_stime, wall, usage.ru_maxrss / 1e3)
