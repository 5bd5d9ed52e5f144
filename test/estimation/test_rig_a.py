"""On recordings of a simulator that nobody here has written, as configured: nothing is fitted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.estimation import Estimator, simulate_model
from pam_antagonist.recording import read_bag
from pam_antagonist.rig import load_rig

DATA = Path(__file__).parents[3] / "shared" / "data" / "rig_a"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"recordings of rig A are not at hand ({DATA})")


def _coverage(estimate: np.ndarray, variance: np.ndarray, measured: np.ndarray, sensor_std: float) -> float:
    return float(np.mean(np.abs(estimate - measured) <= 1.96 * np.sqrt(variance + sensor_std**2)))


@pytest.mark.parametrize("joint", ["free", "locked"])
def test_default_tuning_is_honest_on_nominal(joint: str) -> None:
    rig = load_rig("shin2022")
    recording = read_bag(DATA / "nominal" / joint)
    rows = Estimator(rig, "default", joint).run(recording.stamp_ns, recording.pressure, recording.voltage).rows
    assert len(rows) == 60_000
    angle = _coverage(rows["angle"], rows["covariance"][:, 0, 0], recording.angle, rig.sensors.angle_std)
    torque = _coverage(rows["torque"], rows["covariance"][:, 2, 2], recording.torque, rig.sensors.torque_std)
    assert 0.88 <= angle <= 1.0 and 0.88 <= torque <= 1.0
    if joint == "free":
        published = Estimator(rig, "published").run(recording.stamp_ns, recording.pressure, recording.voltage).rows
        model = simulate_model(rig, recording.voltage, recording.pressure[0])
        rmse = {
            name: np.sqrt(np.mean((values - recording.angle) ** 2))
            for name, values in (("default", rows["angle"]), ("published", published["angle"]), ("model", model.angle))
        }
        assert rmse["default"] <= 1.4 * rmse["model"]
        assert rmse["default"] <= 0.5 * rmse["published"]
