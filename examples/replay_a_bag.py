"""Replay a recording through the estimator and plot the angle with its 95 % interval: replay_a_bag.py [BAG] [PNG]."""

import sys
from pathlib import Path

import matplotlib
import numpy as np

from pam_antagonist import replay

matplotlib.use("Agg")  # write a file, open no window
from matplotlib import pyplot as plt

bag = sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent / "recordings" / "leak_free"
result = replay(bag, "shin2022")

time = (result.run.stamp_ns - result.run.stamp_ns[0]) * 1e-9
error = np.degrees(result.run.rows["angle"] - result.measured_angle)
half = 1.96 * np.degrees(np.sqrt(result.run.rows["covariance"][:, 0, 0]))  # 95 % interval, to either side
print(f"angle RMSE {np.sqrt(np.mean(error**2)):.3f}°, {np.mean(np.abs(error) < half):.1%} within the interval")

plt.fill_between(time, error - half, error + half, alpha=0.3, label="95 % interval")
plt.plot(time, error, label="error of the estimated angle")
plt.gca().set(xlabel="time [s]", ylabel="angle error [°]")
plt.legend()
plt.savefig(sys.argv[2] if len(sys.argv) > 2 else "angle.png", dpi=150)
