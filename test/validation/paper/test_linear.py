"""The compared linear model: right on a system that is linear, and honest about its errors there."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.estimation import metrics
from validation.paper import linear


def _linear_joint(seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle [°], pressures [Pa] and voltages [V] at 1 kHz of a linear joint: first-order muscles, a lagging angle."""
    rng = np.random.default_rng(seed)
    count = round(seconds * 1000)
    voltage = np.repeat(rng.uniform(4.5, 6.5, (count // 500, 2)), 500, axis=0)
    pressure, angle = np.full((count, 2), 450e3), np.zeros(count)
    lag = np.array([1.0 / 800.0, 1.0 / 500.0])
    for k in range(1, count):
        wanted = 450e3 + 1e5 * (voltage[k] - 5.5)
        pressure[k] = pressure[k - 1] + lag * (wanted - pressure[k - 1])
        toward = 1e-4 * (pressure[k, 0] - pressure[k, 1]) + 0.05 * rng.standard_normal() * 10.0
        angle[k] = angle[k - 1] + (toward - angle[k - 1]) / 100.0
    shown = pressure + 600.0 * rng.standard_normal(pressure.shape)
    return angle, shown, voltage


def test_a_linear_joint_is_found_and_estimated_from_pressures_alone():
    model = linear.identify(*_linear_joint(60.0, 1))
    angle, pressure, voltage = _linear_joint(30.0, 2)
    found = linear.estimate(model, pressure, voltage)
    settled = slice(3000, None)
    error = (found.angle - angle)[settled]
    assert metrics.rmse(error) < 0.02 * np.ptp(angle)
    assert metrics.coverage(error, np.full(len(error), found.angle_variance)) == pytest.approx(0.95, abs=0.06)
    assert found.nis[150:].mean() == pytest.approx(2.0, rel=0.25)
