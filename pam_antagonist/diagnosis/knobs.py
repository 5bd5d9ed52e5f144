"""The base parameters that a diagnosis may move, as directions that the data can tell apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pam_antagonist.rig import Rig

_PRIOR = 0.05
_SUPPLY = 0.01
"""The supply is read off a gauge, and a regulator holds it: known better than what is not measured."""


@dataclass(frozen=True)
class Knob:
    """One direction in which the base model may differ from its file.

    Attributes:
        name: what it is.
        changes: change of each parameter for a relative change of 1 of the quantity.
        prior: standard deviation of the relative change.
        free_only: a locked joint does not depend on it.
    """

    name: str
    changes: Mapping[str, float]
    prior: float = _PRIOR
    free_only: bool = False


def base_knobs(rig: Rig) -> tuple[Knob, ...]:
    """The directions of a rig.

    What cannot be measured directly (Proposition 1 of Shin et al. 2022) is free. The linear force map
    F = v(l) P + w(l) is moved by its values at the middle length and its slopes, since its coefficients nearly
    cancel: one per cent of ``v2`` alone is seven of the force. Volume and polytropic index k_1 only scale the flows
    and are represented by the orifice areas.

    Args:
        rig: start values; its ``priors`` replace the 5 % of a knob that is a single parameter.
    """
    found = [_single(rig, f"valve_{i}.{name}") for i in (1, 2) for name in ("inflow_area", "outflow_area")]
    for i in (1, 2):
        found += _force_map(rig, f"muscle_{i}.force.")
    found.append(_single(rig, "gas.polytropic_volume", free_only=True))
    found.append(Knob("supply.pressure", {"supply.pressure": rig.supply.pressure}, _SUPPLY))
    for path in ("joint.inertia", "joint.viscous_friction", *_friction(rig)):
        found.append(_single(rig, path, free_only=True))
    return tuple(knob for knob in found if any(knob.changes.values()))


def _single(rig: Rig, path: str, free_only: bool = False) -> Knob:
    value = rig.value(path)
    prior = rig.priors.get(path)
    return Knob(path, {path: value}, prior / abs(value) if prior and value else _PRIOR, free_only)


def _friction(rig: Rig) -> tuple[str, ...]:
    return {
        "kikuuwe": ("friction.shaft", "friction.muscle"),
        "simple": ("friction.lever_force",),
        "tondu": ("friction.static", "friction.kinetic"),
        "none": (),
    }[rig.model.friction]


def _force_map(rig: Rig, path: str) -> list[Knob]:
    if rig.model.force != "linear":
        return [_single(rig, f"{path}c{k}") for k in range(1, 8)]
    middle = rig.geometry.length
    knobs = []
    for slope, intercept in (("v1", "v2"), ("w1", "w2")):
        steep = rig.value(path + slope)
        value = steep * middle + rig.value(path + intercept)
        knobs.append(Knob(f"{path}{slope[0]}, value at the middle length", {path + intercept: value}))
        # About the middle length, so that the slope turns the line and does not lift it.
        turned = {path + slope: steep, path + intercept: -steep * middle}
        knobs.append(Knob(f"{path}{slope[0]}, slope", turned, free_only=True))
    return knobs
