"""The pictures of the tutorial, from a rehearsal: ``./run python docs/commission_pictures.py rehearsed/leak_1``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib
import numpy as np

from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.rig import load_rig
from validation.excitation.rehearse import steps_of

matplotlib.use("Agg")
from matplotlib import pyplot as plt

OUT = Path(__file__).parent / "tutorials"
STEP = 20  # samples from point to point
COLOURS = ("tab:blue", "tab:orange")


def main() -> None:
    """Write ``docs/tutorials/wiring.png``, ``experiment.png`` and ``control.png``."""
    case = Path(sys.argv[1])
    done = case / "commissioned"
    _recorded("wiring", done, "The first air: valve 1 fills muscle 1, then valve 2 muscle 2, then both are vented")
    _recorded("experiment", done, "A designed experiment, joint free; dashed: the limits", "free_1")
    course = steps_of(load_rig(str(case / "truth.yaml")), done, json.loads((case / "outcome.json").read_text())["seed"])
    time = np.arange(len(course.angle)) * load_rig(str(done / "rig.yaml")).sample_period
    figure, axis = plt.subplots(figsize=(8, 2.4), dpi=80, layout="constrained")
    axis.plot(time[::STEP], np.degrees(course.value[::STEP]), "--", color="0.4", label="reference")
    axis.plot(time[::STEP], np.degrees(course.angle[::STEP]), color=COLOURS[1], linewidth=3, label="joint")
    axis.plot(time[::STEP], np.degrees(course.estimated_angle[::STEP]), color=COLOURS[0], label="estimate")
    axis.set(title="Control on the estimate, with the rig file and the gains that were found", xlabel="time [s]")
    _finish(figure, axis, "control", "angle [°]")


def _recorded(name: str, done: Path, title: str, folder: str = "wiring_1") -> None:
    """Voltages, pressures and angle of a step's recording."""
    recording: Recording = read_bag(done / folder / "bag", judge=False)
    limits = json.loads((done / folder / "plan.json").read_text())["limits"]
    assert recording.angle is not None
    time, degrees = recording.time_s[::STEP], np.degrees(recording.angle[::STEP])
    figure, (top, middle, bottom) = plt.subplots(3, 1, figsize=(8, 5), dpi=80, sharex=True, layout="constrained")
    for i, colour in enumerate(COLOURS):
        top.plot(time, recording.voltage[::STEP, i], color=colour, label=f"valve {i + 1}")
        middle.plot(time, recording.pressure[::STEP, i] / 1e3, color=colour, label=f"muscle {i + 1}")
    bottom.plot(time, degrees, color="tab:green", label="encoder")
    for value in limits["pressure_pa"]:
        middle.axhline(value / 1e3, color="0.5", linestyle="--", linewidth=1)
    if folder != "wiring_1":
        for sign in (-1.0, 1.0):
            bottom.axhline(sign * np.degrees(limits["angle_rad"]), color="0.5", linestyle="--", linewidth=1)
    top.set(title=title)
    bottom.set(xlabel="time [s]")
    for axis, unit in ((top, "voltage [V]"), (middle, "pressure [kPa]")):
        axis.grid(alpha=0.3)
        axis.set(ylabel=unit)
        axis.legend(loc="upper right", fontsize=8)
    _finish(figure, bottom, name, "angle [°]")


def _finish(figure: plt.Figure, axis: plt.Axes, name: str, label: str) -> None:
    axis.grid(alpha=0.3)
    axis.set(ylabel=label)
    axis.legend(loc="upper right", fontsize=8)
    figure.savefig(OUT / f"{name}.png", pil_kwargs={"optimize": True})
    plt.close(figure)


if __name__ == "__main__":
    main()
