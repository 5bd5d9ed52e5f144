"""Simulate a joint with pressure regulators; estimate its angle with its pressures measured, and without."""

from dataclasses import replace

import numpy as np

from pam_antagonist import replay, simulate

recording = simulate("shin2022_regulators", duration=10.0, mismatch=0.01, seed=1)
blind = replace(recording, pressure=np.full_like(recording.pressure, np.nan))

for name, one in (("measured", recording), ("not measured", blind)):
    errors = replay(one, "shin2022_regulators").report.ukf
    print(f"pressures {name}: angle RMSE {errors.angle.rmse:.3f}°, torque RMSE {errors.torque.rmse:.3f} N m")
