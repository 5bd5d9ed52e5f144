"""Feed the estimator one sample at a time, as a driver or a simulation of your own would."""

from pathlib import Path

import numpy as np

from pam_antagonist import Estimator, load_rig, read_bag

recording = read_bag(Path(__file__).parent / "recordings" / "leak_free")
estimator = Estimator(load_rig("shin2022"))

print("time [s]  angle [°]  ± 95 % [°]  torque [N m]")
samples = zip(recording.stamp_ns.tolist(), recording.pressure, recording.voltage, strict=True)
for k, (stamp_ns, (p1, p2), (u1, u2)) in enumerate(samples):
    row = estimator.step(stamp_ns, p1, p2, u1, u2)  # ns, absolute Pa, V; NaN where a reading is missing
    if row is not None and k % 5000 == 0:
        half = 1.96 * np.degrees(np.sqrt(row["covariance"][0, 0]))
        print(f"{k / 1000:8.1f} {np.degrees(row['angle']):10.3f} {half:11.3f} {row['torque']:13.3f}")
print(estimator.counts)
