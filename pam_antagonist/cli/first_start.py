"""The first start on a machine: kernels are compiled side by side, each by a process of its own.

numba compiles in one thread and keeps the result on disk. What it takes from there does not compile again.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.estimation import Estimator, simulate_model
from pam_antagonist.estimation import filter as kernels
from pam_antagonist.model import dynamics
from pam_antagonist.rig import load_rig

_RIG = "shin2022"
"""Any rig: its numbers change no machine code."""


def _filter() -> None:
    Estimator(load_rig(_RIG))


def _model() -> None:
    simulate_model(load_rig(_RIG), np.full((2, 2), 5.0), np.full(2, 4e5))


_PARTS: dict[str, tuple[Any, Callable[[], None]]] = {
    "filter": (kernels.process_all, _filter),
    "model": (dynamics.simulate, _model),
}
"""What takes seconds to compile: the kernel, and what compiles it."""


def compile_first() -> None:
    """Compile the filter and the model of a plain rig, where neither was compiled on this machine before."""
    if not all(_missing(kernel) for kernel, _ in _PARTS.values()):
        return
    print("compiling, once: about half a minute", file=sys.stderr, flush=True)
    with ExitStack() as running:
        processes = [running.enter_context(_compiling(part)) for part in _PARTS]
        for process in processes:
            # Without effect on one that has ended; where Ctrl-C ends the wait, none goes on.
            running.callback(process.terminate)
        for process in processes:
            process.wait()


def _compiling(part: str) -> subprocess.Popen[bytes]:
    # One that fails leaves its part to whoever calls the kernel, and to the message of that.
    return subprocess.Popen(
        [sys.executable, "-m", __name__, part], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def _missing(kernel: Any) -> bool:
    folder, name = Path(kernel.stats.cache_path), kernel.py_func.__qualname__
    return not any(folder.glob(f"*.{name}-*.nbi"))


if __name__ == "__main__":
    _PARTS[sys.argv[1]][1]()
