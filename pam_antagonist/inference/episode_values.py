"""What a report shows of a model of many episodes: its numbers, with intervals by episode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.bootstrap import Interval, steps
from pam_antagonist.inference.pressure_driven import PressureDriven, PressureModel


def shown(joint: PressureDriven, model: PressureModel) -> dict[str, float]:
    """What a report shows of a model, by dotted path: no coefficients that only move together.

    Args:
        joint: the episodes.
        model: of them.
    """
    values = joint.values(model)
    out = {name: values[name] for name in ("joint.stiffness", "joint.viscous_friction")}
    middle = joint.rig.geometry.length
    for i in (1, 2):
        path = f"muscle_{i}.force."
        out[f"{path}v, at the middle length"] = values[f"{path}v1"] * middle + values[f"{path}v2"]
    return out | dict(model.effects)


def draws(joint: PressureDriven, model: PressureModel, seed: int = 0) -> dict[str, NDArray[np.float64]]:
    """What :func:`shown` shows, for draws of a bootstrap by episode: a Gauss-Newton step for each (D,).

    Args:
        joint: the episodes that were fitted.
        model: fitted to them.
        seed: of the draws.
    """
    left = joint.residual(model)
    spans = list(zip(joint.first[:-1].tolist(), joint.first[1:].tolist(), strict=True))
    at = joint.coordinates(model)
    found = [
        shown(joint, joint.moved(model, at + step)) for step in steps(spans, joint.jacobian(model, left), left, seed)
    ]
    return {name: np.array([one[name] for one in found]) for name in found[0]}


def intervals(joint: PressureDriven, model: PressureModel) -> dict[str, Interval]:
    """What :func:`shown` shows, with 95 % intervals by episode.

    Args:
        joint: the episodes that were fitted.
        model: fitted to them.
    """
    best = shown(joint, model)
    return {name: Interval.of(best[name], values) for name, values in draws(joint, model).items()}
