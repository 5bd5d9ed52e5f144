"""Recordings of the project's own plant with parameters that are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pam_antagonist.inference.free_parameters import free_parameters, moved
from pam_antagonist.inference.spread import variations
from pam_antagonist.inference.trial import Trial, make_trial
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.simulation.excitation import profile
from pam_antagonist.simulation.plant import Plant


def scattered(rig: Rig, spread: float, seed: int) -> Rig:
    """The rig with all that is identified off by a relative spread; what is measured directly stays."""
    rng = np.random.default_rng(seed)
    free = free_parameters(rig)
    values = {item.name: item.start for item in free}
    for way in variations(rig, free):
        size = spread * rng.standard_normal()
        for name, change in way.changes.items():
            values[name] += size * change
    return moved(rig, values)


def record(rig: Rig, joint: str, seed: int, seconds: float, substeps: int = 4) -> Recording:
    """What the sensors of a plant show: finer steps than the model's, noise, quantisation."""
    plant = Plant(rig, joint=joint, seed=seed, substeps=substeps)
    voltage = profile("steps", seconds, rig.sample_period, seed=seed)
    samples = [plant.step(row) for row in voltage]
    return Recording(
        path=Path(f"{joint}_{seed}"),
        stamp_ns=np.arange(1, len(samples) + 1, dtype=np.int64) * 1_000_000,
        pressure=np.array([sample.pressure for sample in samples]),
        voltage=voltage,
        angle=np.array([sample.angle for sample in samples]),
        torque=np.array([sample.torque for sample in samples]),
    )


def trial(rig: Rig, start: Rig, joint: str, seed: int, seconds: float) -> Trial:
    """A recording of ``rig``, to be fitted from ``start``."""
    return make_trial(record(rig, joint, seed, seconds), start, joint, 0.0, f"{joint}_{seed}")
