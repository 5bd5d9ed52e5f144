"""The moving picture of the README, from a recording of the demo: ``./run python docs/demo_picture.py DEMO/bag``."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

from pam_antagonist.estimation import Estimator
from pam_antagonist.recording import read_bag
from pam_antagonist.rig import load_rig

matplotlib.use("Agg")
from matplotlib import pyplot as plt

FRAMES, MILLISECONDS, STEP = 90, 90, 20  # frames, time of each, samples from point to point


def main() -> None:
    """Write ``docs/demo.gif``: the joint, and the angle with its 95 % interval, growing with time."""
    recording = read_bag(sys.argv[1])
    reference = recording.reference
    assert reference is not None and recording.angle is not None
    run = Estimator(load_rig("shin2022")).run(recording.stamp_ns, recording.pressure, recording.voltage)
    kept = slice(0, None, STEP)
    index = run.index[kept]
    time = recording.time_s[index]
    angle, measured = np.degrees(run.rows["angle"][kept]), np.degrees(recording.angle[index])
    half = 1.96 * np.degrees(np.sqrt(run.rows["covariance"][kept][:, 0, 0]))
    newest = np.searchsorted(reference.stamp_ns, recording.stamp_ns[index], side="right") - 1
    wanted = np.where(newest >= 0, np.degrees(reference.value[np.maximum(newest, 0)]), np.nan)

    figure, axes = plt.subplot_mosaic(
        [["joint", "angle"], ["joint", "error"]], figsize=(8, 4), dpi=100, width_ratios=[1, 2.8], height_ratios=[2, 1],
        layout="constrained",
    )  # fmt: skip
    left, right, below = axes["joint"], axes["angle"], axes["error"]
    left.set(xlim=(-1.2, 1.2), ylim=(-0.4, 1.3), aspect="equal")
    left.axis("off")
    left.plot([0], [0], "o", color="black", markersize=10)
    right.set(xlim=(0, time[-1]), ylim=(-29, 29), ylabel="joint angle [°]")
    below.set(xlim=(0, time[-1]), ylim=(-0.7, 0.7), xlabel="time [s]", ylabel="error [°]")
    for axis in (right, below):
        axis.grid(alpha=0.3)
    (arm,) = left.plot([], [], color="tab:blue", linewidth=7, solid_capstyle="round")
    (aim,) = left.plot([], [], color="0.4", linestyle="--")
    (line_wanted,) = right.plot([], [], color="0.4", linestyle="--", label="reference")
    (line_measured,) = right.plot([], [], color="tab:orange", linewidth=3, label="measured, for comparison only")
    (line_angle,) = right.plot([], [], color="tab:blue", label="estimated from two pressures")
    (line_error,) = below.plot([], [], color="tab:blue", label="estimated − measured")
    below.fill_between([], [], [], color="tab:blue", alpha=0.25, label="95 % interval of the estimate")
    below.legend(loc="upper right", fontsize=7.5, framealpha=0.9, ncols=2)
    right.legend(loc="upper right", fontsize=7.5, framealpha=0.9)
    frames = []
    for end in np.linspace(2, len(time), FRAMES).astype(int):
        band = below.fill_between(time[:end], -half[:end], half[:end], color="tab:blue", alpha=0.25)
        curves = ((line_wanted, wanted), (line_measured, measured), (line_angle, angle), (line_error, angle - measured))
        for line, values in curves:
            line.set_data(time[:end], values[:end])
        for line, value in ((arm, angle[end - 1]), (aim, wanted[end - 1])):
            line.set_data([0, np.sin(np.radians(value))], [0, np.cos(np.radians(value))])
        figure.canvas.draw()
        frames.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()))  # type: ignore[attr-defined]
        band.remove()
    palette = frames[-1].quantize(48)
    pictures = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    out = Path(__file__).parent / "demo.gif"
    durations = [MILLISECONDS] * (FRAMES - 1) + [3000]
    pictures[0].save(out, save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=True)
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
