"""How one and the same rig may differ from one recording to the next.

A rig is not quite the same on two days: valves warm up, muscles settle, the air is damper. Two recordings that are
forced to share every parameter then fight for it, and the one with more samples wins. So each recording may deviate
from the rig's common values by a little, along the directions that are listed here, and how much the recordings do
deviate (one number, relative) is estimated with the parameters: a random-effects model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.free_parameters import FreeParameter
from pam_antagonist.model import dynamics
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

USUAL_SPREAD = 0.01
"""A relative deviation that does not surprise."""
_LINEAR = ("v1", "v2", "w1", "w2")


@dataclass(frozen=True)
class Variation:
    """One way in which recordings of a rig may differ.

    Attributes:
        name: in words.
        changes: by parameter, the change for a relative deviation of 1.
        group: ``force``, ``flow`` or ``joint``: what tends to deviate by the same amount.
    """

    name: str
    changes: dict[str, float]
    group: str


@dataclass(frozen=True, eq=False)
class Deviations:
    """Variations as the fit sees them.

    Attributes:
        shape: what a relative deviation of 1 does to the free parameters (F, G), in units of their priors.
        group: number of the group that each belongs to (G,).
    """

    shape: Floats
    group: NDArray[np.int64]


def variations(rig: Rig, free: Sequence[FreeParameter]) -> tuple[Variation, ...]:
    """The ways in which recordings may differ in the parameters that are free.

    The coefficients of a force map nearly cancel each other: scattered one by one by a per cent they would change the
    force by ten. A muscle deviates by the gain of its map and by an offset instead.

    Args:
        rig: whose values the relative deviations refer to.
        free: parameters of the fit.
    """
    names = {item.name for item in free}
    out = []
    maps = set()
    if rig.model.force == "linear":
        middle = 0.5 * (rig.supply.pressure + rig.atmosphere.pressure)
        force = dynamics.forces(np.array([0.0, 0.0, middle, middle]), rig.parameters())
        for i in (1, 2):
            own = {f"muscle_{i}.force.{c}" for c in _LINEAR}
            maps |= own
            if own <= names:
                out.append(
                    Variation(f"force of muscle {i}, gain", {name: rig.value(name) for name in sorted(own)}, "force")
                )
            if f"muscle_{i}.force.w2" in names:
                out.append(
                    Variation(f"force of muscle {i}, offset", {f"muscle_{i}.force.w2": float(force[i - 1])}, "force")
                )
    for item in free:
        if item.name not in maps:
            out.append(Variation(item.name, {item.name: item.start or item.prior_std}, _group(item.name)))
    return tuple(out)


def _group(name: str) -> str:
    if ".force." in name:
        return "force"
    return "flow" if name.startswith(("valve_", "gas.", "supply.", "atmosphere.")) or ".volume." in name else "joint"


def deviations(ways: Sequence[Variation], free: Sequence[FreeParameter]) -> Deviations:
    """Variations in the units of the priors.

    Args:
        ways: the variations.
        free: parameters of the fit.
    """
    place = {item.name: k for k, item in enumerate(free)}
    shape = np.zeros((len(free), len(ways)))
    for g, way in enumerate(ways):
        for name, change in way.changes.items():
            shape[place[name], g] = change / free[place[name]].prior_std
    groups = sorted({way.group for way in ways})
    return Deviations(shape, np.array([groups.index(way.group) for way in ways], dtype=np.int64))
