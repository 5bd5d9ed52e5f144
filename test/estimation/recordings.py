"""Recordings of the project's own plant for the tests of the estimator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation.plant import Plant

PERIOD_NS = 1_000_000
START_NS = 1_800_000_000_000_000_000


@dataclass(frozen=True)
class Trial:
    """One run of the plant: stamps, measured pressures, voltages, and the truth (N, 4)."""

    stamp_ns: np.ndarray
    pressure: np.ndarray
    voltage: np.ndarray
    angle: np.ndarray
    torque: np.ndarray
    truth: np.ndarray


@lru_cache(maxsize=64)
def trial(seconds: float, seed: int = 1, joint: str = "free", mismatch: float = 0.01, hold_s: float = 0.7) -> Trial:
    """Voltage steps between 4.2 and 7.4 V, held for ``hold_s``, on a plant off its declared values."""
    samples = round(seconds * 1000)
    rng = np.random.default_rng(1000 + seed)
    levels = rng.uniform(4.2, 7.4, (samples // round(hold_s * 1000) + 1, 2))
    voltage = np.repeat(levels, round(hold_s * 1000), axis=0)[:samples]
    plant = Plant(load_rig("shin2022"), joint=joint, seed=seed, mismatch=mismatch)
    run = [plant.step(row) for row in voltage]
    return Trial(
        stamp_ns=START_NS + PERIOD_NS * np.arange(samples, dtype=np.int64),
        pressure=np.array([sample.pressure for sample in run]),
        voltage=voltage,
        angle=np.array([sample.angle for sample in run]),
        torque=np.array([sample.torque for sample in run]),
        truth=np.array([sample.truth for sample in run]),
    )


def with_effects(*names: str) -> Rig:
    """The rig of the paper with these effects at sizes that are seen."""
    effects = {
        name: {item.name: item.scale if item.is_size else item.neutral for item in CATALOGUE[name].parameters}
        for name in names
    }
    return load_rig("shin2022").replaced(effects=effects)
