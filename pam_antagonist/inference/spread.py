"""Differences of one rig from recording to recording: their directions, and the estimate of their size.

A rig is not exactly the same on two days: valves warm up, muscles settle, the air is damper. If two recordings had to
share every parameter, the one with more samples would decide. So each recording may deviate a little from the rig's
common values, along the directions that are listed here. The relative spread of the deviations is estimated as the one
under which all recordings are most likely: a random-effects model.

Near the fit each trial's likelihood is a Gaussian in its local values. With standard normal common
parameters, deviations and starts the evidence of a spread is a Gaussian integral,

    log Z(s) = −½ log det H(s) + ½ bᵀ H(s)⁻¹ b,   H = I + Σ Mᵀ A M,   b = Σ Mᵀ a,

with A and a the information of a trial, and M the matrix from the fitted vector to its local values, which contains the
spread s (MacKay, *Information Theory, Inference, and Learning Algorithms*, 2003, chapter 28).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from pam_antagonist.inference.free_parameters import LINEAR_FORCE, Direction, FreeParameter
from pam_antagonist.inference.normal_equations import Arrow, Local
from pam_antagonist.model import dynamics
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

USUAL_SPREAD = 0.01
"""Relative spread with which a fit starts."""
_LEAST, _LARGEST = 1e-4, 0.5
"""Range of the relative spread."""
_GROUP_STD = 1.0
"""Standard deviation of the logarithm of a group's spread about the common one."""
_USUAL = 0.02
"""Scale of the half-Cauchy prior of the spread."""


@dataclass(frozen=True)
class Variation(Direction):
    """One way in which recordings of a rig may differ; its amount is a relative deviation.

    Attributes:
        group: ``force``, ``flow`` or ``joint``: variations of a group tend to have the same size.
    """

    group: str


@dataclass(frozen=True, eq=False)
class Deviations:
    """Variations in the coordinates of a fit.

    Attributes:
        shape: change of the free parameters (F, G) by a relative deviation of 1, in units of their priors.
        group: number of each variation's group (G,).
    """

    shape: Floats
    group: NDArray[np.int64]


def variations(rig: Rig, free: Sequence[FreeParameter]) -> tuple[Variation, ...]:
    """The ways in which recordings may differ in the parameters that are free.

    The terms of a force map nearly cancel each other: independent changes of the coefficients by a per cent would
    change the force by ten. So a muscle deviates by the gain of its map and by an offset instead.

    Args:
        rig: reference of the relative deviations.
        free: parameters of the fit.
    """
    names = {item.name for item in free}
    out = []
    maps = set()
    if rig.model.force == "linear":
        middle = 0.5 * (rig.supply.pressure + rig.atmosphere.pressure)
        force = dynamics.forces(np.array([0.0, 0.0, middle, middle]), rig.parameters())
        for i in (1, 2):
            own = {f"muscle_{i}.force.{c}" for c in LINEAR_FORCE}
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
    of_flow = ("valve_", "gas.", "supply.", "atmosphere.", "effects.valve_")
    return "flow" if name.startswith(of_flow) or ".volume." in name else "joint"


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


def log_evidence(trials: Sequence[Local], between: Floats) -> float:
    """Log Z of a spread, up to a constant.

    Args:
        trials: information of each.
        between: change of the free parameters (F, G) by deviations of one standard deviation.
    """
    return Arrow.of(trials, between, len(between)).log_evidence()


def most_likely_spread(trials: Sequence[Local], deviations: Deviations) -> tuple[Floats, float]:
    """The spread of each group at which evidence and prior are highest.

    The logarithm of each group's spread has a normal prior about a common one. So groups that the recordings hardly
    determine follow the others.

    Args:
        trials: information of each, at least two.
        deviations: directions and groups.

    Returns:
        The relative spread of each direction (G,), and the gain in log evidence over no spread.
    """
    groups = int(deviations.group.max()) + 1
    low, high = np.log(_LEAST), np.log(_LARGEST)

    def spread(logarithms: Floats) -> Floats:
        return np.asarray(np.exp(np.clip(logarithms[0] + _GROUP_STD * logarithms[1:], low, high))[deviations.group])

    def against(logarithms: Floats) -> float:
        common = float(np.exp(np.clip(logarithms[0], low, high)))
        prior = float(np.log1p((common / _USUAL) ** 2) + 0.5 * np.sum(logarithms[1:] ** 2))
        return -log_evidence(trials, spread(logarithms) * deviations.shape) + prior

    # A grid over the common spread gives the start for all spreads together.
    grid = np.linspace(low, high, 18)
    first = grid[int(np.argmin([against(np.concatenate(([x], np.zeros(groups)))) for x in grid]))]
    start = np.concatenate(([first], np.zeros(groups)))
    simplex = np.vstack([start, start + 0.5 * np.eye(groups + 1)])
    options = {"xatol": 0.02, "fatol": 0.01, "maxfev": 400, "initial_simplex": simplex}
    found = minimize(against, start, method="Nelder-Mead", options=options)
    best = spread(found.x)
    none = log_evidence(trials, _LEAST * deviations.shape)
    return best, log_evidence(trials, best * deviations.shape) - none
