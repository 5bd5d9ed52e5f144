"""A small computer, as far as this machine can be one: the nodes in one process on a busy core.

They and the recorder share the core with three busy processes of the same priority.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

from pam_antagonist.nodes.processes import PRIORITY_VARIABLE
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.file import write_rig

_RATES = 1000.0, 500.0, 250.0
"""[Hz] Sample rates that are tried."""
_BUSY = 3
"""Busy processes beside the nodes and the recorder."""
_IN_TIME = "samples in time [%]"


def measure(rig: str, folder: Path, run: Callable[[str], dict[str, float]]) -> dict[str, float]:
    """Figures of the pipeline at each rate. `run`: runs it with a rig file, and returns its figures."""
    out: dict[str, float] = {}
    for rate in _RATES:
        file = folder / f"board_{rate:.0f}.yaml"
        write_rig(load_rig(rig).replaced(sample_period=1.0 / rate), file, [])
        with one_busy_core():
            found = run(str(file))
        shares = [value for name, value in found.items() if "share of a core" in name]
        out[f"beside three busy processes, {rate:.0f} Hz: {_IN_TIME}"] = found[_IN_TIME]
        out[f"beside three busy processes, {rate:.0f} Hz: nodes and recorder, share of a core [%]"] = sum(shares)
    return out


@contextmanager
def one_busy_core() -> Iterator[None]:
    """Whatever is started here shares one core with busy processes, and asks for no real-time priority."""
    cores, busy = os.sched_getaffinity(0), list[subprocess.Popen[bytes]]()
    with patch.dict(os.environ, {PRIORITY_VARIABLE: "0"}):
        try:
            os.sched_setaffinity(0, {max(cores)})
            for _ in range(_BUSY):
                # A session of its own each, as nodes have: Linux shares a core between sessions first.
                busy.append(subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True))
            yield
        finally:
            for process in busy:
                process.kill()
                process.wait()
            os.sched_setaffinity(0, cores)
