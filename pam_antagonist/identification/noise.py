"""The sensors' noise as recordings show it, and the values' uncertainty as directions that a filter considers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification import joint_stage
from pam_antagonist.identification.runs import Run
from pam_antagonist.inference.fit import Fit
from pam_antagonist.inference.trial import converter_step, white_std
from pam_antagonist.model import parameters as par
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_LEAST_PRESSURE = 10.0
"""[Pa] Least noise of a pressure: below it the filter's rounding errors would matter."""
_EXPLAINED, _MOST = 0.99, 6
"""Directions that are considered: so much of the torque's uncertainty, and at most so many."""
_NEAR = 0.1
"""Step of the derivatives, in standard deviations."""


def with_noise(rig: Rig, recordings: Sequence[Recording]) -> Rig:
    """The rig with the sensors' noise and R of the tuning ``default`` as the recordings show them."""

    def noise_of(columns: Iterable[tuple[Floats, float]]) -> float:
        stds = [white_std(values, dt) for values, dt in columns if np.isfinite(values).any()]
        known = [std for std in stds if math.isfinite(std)]
        return float(np.sqrt(np.mean(np.square(known)))) if known else math.nan

    def less_step(std: float, step: float) -> float:
        return float(np.sqrt(max(std**2 - step**2 / 12.0, 0.0)))

    sensors = rig.sensors
    floor = max(sensors.pressure_step / math.sqrt(12.0), _LEAST_PRESSURE)
    pressure = [max(noise_of((one.pressure[:, i], one.sample_period_s) for one in recordings), floor) for i in (0, 1)]
    both = less_step(math.hypot(*pressure) / math.sqrt(2.0), sensors.pressure_step)
    changes = {"pressure_std": max(both, _LEAST_PRESSURE)}
    for name in ("angle", "torque"):
        columns = [(values, one.sample_period_s) for one in recordings if (values := getattr(one, name)) is not None]
        if math.isfinite(std := noise_of(columns)):
            seen = [converter_step(values) for values, _ in columns if np.isfinite(values).any()]
            step = max(*seen, getattr(sensors, f"{name}_step"))
            changes |= {f"{name}_std": less_step(std, step), f"{name}_step": step}
    tuning = rig.tuning("default").replaced(measurement=tuple(float(std**2) for std in pressure), consider=True)
    # Noise that no sensor may have makes an identified rig impossible; it is no fault of the rig that was given.
    return rig.unchecked(
        sensors=sensors.unchecked(**changes), tunings={**rig.tunings, "default": tuning}, directions={}
    )


def with_directions(rig: Rig, joint: Fit, runs: Sequence[Run]) -> Rig:
    """The rig with the few combinations of values whose uncertainty changes the muscles' torque most.

    In a new recording values deviate from the common ones as they did in those that were fitted.
    """
    runs = [run for run in runs if np.isfinite(run.angle).any()]
    if not joint.unknowns or not runs:
        return rig
    values = joint.values
    base = joint_stage.model_values(joint.unknowns, values)
    own = {item.recording: joint_stage.model_values(joint.unknowns, values, item.recording)
           for item in joint.unknowns if item.recording}  # fmt: skip
    common = [k for k, item in enumerate(joint.unknowns) if not item.recording]
    roots = np.linalg.cholesky(joint.covariance[np.ix_(common, common)])
    steps = [_changes(joint, common, column) for column in roots.T]
    steps += [{path: (value - base[path]) / math.sqrt(len(own)) for path, value in one.items()} for one in own.values()]
    p = rig.parameters()

    def torque(changes: dict[str, float]) -> Floats:
        q = par.changed(p, {path: rig.value(path) + _NEAR * change for path, change in changes.items()})
        return np.concatenate([joint_stage.torques(run, q) for run in runs])

    effect = np.stack([(torque(step) - torque({})) / _NEAR for step in steps], axis=1)
    _, strength, turned = np.linalg.svd(effect[np.isfinite(effect).all(axis=1)], full_matrices=False)
    share = np.cumsum(strength**2) / max(float(np.sum(strength**2)), 1e-300)
    directions = {}
    for k in range(min(int(np.searchsorted(share, _EXPLAINED)) + 1, _MOST, len(steps))):
        total: dict[str, float] = {}
        for weight, step in zip(turned[k], steps, strict=True):
            for path, change in step.items():
                total[path] = total.get(path, 0.0) + float(weight) * change
        directions[f"mode_{k + 1}"] = total
    return rig.replaced(directions=directions)


def _changes(joint: Fit, common: Sequence[int], column: Floats) -> dict[str, float]:
    """Change of each parameter, by dotted path, by one standard deviation of a combination of the unknowns."""
    amounts = joint.amounts.copy()
    before = joint_stage.model_values(joint.unknowns, joint.values)
    amounts[common] += _NEAR * column
    moved = {item.name: item.value(float(a)) for item, a in zip(joint.unknowns, amounts, strict=True)}
    after = joint_stage.model_values(joint.unknowns, moved)
    return {path: (value - before[path]) / _NEAR for path, value in after.items()}
