"""What the sensors of a simulated joint show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.rig.schema import Reading

Floats = NDArray[np.float64]
FIRST_STAMP_NS = 10**18


def shown(values: Floats, error: Reading, noise: Floats) -> Floats:
    """Values as a sensor shows them; the noise is in standard deviations."""
    noisy = values + error.std * noise
    return np.asarray(np.rint(noisy / error.step) * error.step if error.step > 0.0 else noisy)


def recorded(
    name: str, rig: Rig, voltage: Floats, angle: Floats, pressure: Floats, torque: Floats, rng: np.random.Generator
) -> Recording:
    """A recording of a joint from its voltages (N, 2), angles (N,), pressures (N, 2) and torques (N,)."""

    def seen(values: Floats, quantity: str) -> Floats:
        return shown(values, rig.sensors.reading(quantity), rng.standard_normal(values.shape))

    spans = np.rint(np.arange(1, len(voltage) + 1) * rig.sample_period * 1e9)
    return Recording(
        Path(name), FIRST_STAMP_NS + spans.astype(np.int64), pressure=seen(pressure, "pressure"), voltage=voltage,
        angle=seen(angle, "angle"), torque=seen(torque, "torque"),
    )  # fmt: skip
