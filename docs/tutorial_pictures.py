"""The pictures of the tutorial, from its rehearsal: ``./run python docs/tutorial_pictures.py rehearsed``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pam_antagonist.recording import read_bag
from pam_antagonist.report.figure import MEASURED, MODEL, QUIET, SECOND

OUT = Path(__file__).parent / "tutorials"


def main() -> None:
    """Write ``docs/tutorials/slow.png`` and ``quick.png``: pressures and angle, dashed the limits of the experiment."""
    done = Path(sys.argv[1])
    for name in ("slow", "quick"):
        limits = json.loads((done / f"{name}_1" / "plan.json").read_text())["limits"]
        recording = read_bag(done / f"{name}_1" / "bag", judge=False)
        x = (recording.stamp_ns - recording.stamp_ns[0]) * 1e-9
        figure = Figure(figsize=(9.0, 4.6), layout="constrained")
        pressures, angle = figure.subplots(2, 1, sharex=True)
        for i, color in enumerate((MODEL, SECOND)):
            pressures.plot(x, recording.pressure[:, i] * 1e-3, color=color, label=f"P{i + 1}", linewidth=0.9)
            pressures.axhline(limits["pressure_pa"][i] * 1e-3, color=QUIET, linestyle="--")
            angle.axhline((-1) ** i * np.degrees(limits["angle_rad"]), color=QUIET, linestyle="--")
        angle.plot(x, np.degrees(recording.angle), color=MEASURED, linewidth=0.9)
        pressures.set_ylabel("Pressure [kPa abs]")
        angle.set(xlabel="Time [s]", ylabel="Angle [°]")
        pressures.legend()
        figure.savefig(OUT / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main()
