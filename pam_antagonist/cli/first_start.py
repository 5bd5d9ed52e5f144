"""The first start on a machine: kernels are compiled side by side, each by a process of its own.

numba compiles in one thread and keeps the result on disk. What it takes from there does not compile again.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.estimation import Estimator, simulate_model
from pam_antagonist.estimation import filter as kernels
from pam_antagonist.model import drive
from pam_antagonist.model import parameters as par
from pam_antagonist.model.lane_values import FEWEST, LANES
from pam_antagonist.program import started
from pam_antagonist.rig import Rig, load_rig

_RIG, _WITH_EFFECTS = "shin2022", "shin2022_external_torque"
"""Any plain rig, and any other: their numbers change no machine code."""


def _lanes() -> None:
    if FEWEST > LANES:
        return  # models run one by one on this machine
    p, pressure = load_rig(_RIG).parameters("free", 0.0), 4e5
    start = np.array([0.0, 0.0, pressure, pressure])
    # As many as there are lanes: fewer may run one by one.
    along = drive.Inputs.even(2, 1e-3, command=np.full((2, 2), 5.0))
    along.driven_each([start[None]] * LANES, [p] * LANES, drive.TORQUE)


REPLAY = "filter", "model"
"""Parts that a replay needs."""
FITS = "filter", "model", "lanes"
"""Parts that fits need."""
_PARTS: dict[str, Callable[[], object]] = {
    "filter": lambda: Estimator(load_rig(_RIG)),
    "filter with effects": lambda: Estimator(load_rig(_WITH_EFFECTS)),
    "model": lambda: simulate_model(load_rig(_RIG), np.full((2, 2), 5.0), np.full(2, 4e5)),
    "lanes": _lanes,
}
"""What takes seconds to compile, and what compiles it."""


def compile_first(parts: Sequence[str], rig: Rig) -> None:
    """Compile kernels where neither the filter nor the model was compiled on this machine before.

    Those of a plain rig are fewer. What others need is compiled when a rig has effects.

    `parts` are ``REPLAY`` or ``FITS``.
    """
    if not (_missing(kernels.process_all) and _missing(drive.drive)):
        return
    plain = bool(rig.parameters()[par.PLAIN])
    what = "for a rig without effects" if plain else "for a rig with effects"
    print(f"compiling {what}, once: about {20 if plain else 30} s", file=sys.stderr, flush=True)
    parts = parts if plain else [{"filter": "filter with effects"}.get(part, part) for part in parts]
    with ExitStack() as running:
        processes = [running.enter_context(_compiling(part)) for part in parts]
        for process in processes:
            # Without effect on one that has ended; where Ctrl-C ends the wait, none goes on.
            running.callback(process.terminate)
        for process in processes:
            process.wait()


def _compiling(part: str) -> subprocess.Popen[bytes]:
    # One that fails leaves its part to whoever calls the kernel, and to the message of that.
    return subprocess.Popen(started(__name__, part), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _missing(kernel: Any) -> bool:
    folder, name = Path(kernel.stats.cache_path), kernel.py_func.__qualname__
    return not any(folder.glob(f"*.{name}-*.nbi"))


if __name__ == "__main__":
    _PARTS[sys.argv[1]]()
