"""How much recordings of one rig deviate from each other: the spread under which all of them are most likely.

Near the fit each trial's likelihood is a Gaussian in the parameters that it sees. With standard normal common
parameters, deviations and starts the evidence of a spread is a Gaussian integral,

    log Z(s) = −½ log det H(s) + ½ bᵀ H(s)⁻¹ b,   H = I + Σ Mᵀ A M,   b = Σ Mᵀ a,

with A and a the information of a trial and M what it sees of all unknowns, in which the spread s stands (MacKay,
*Information Theory, Inference, and Learning Algorithms*, 2003, chapter 28).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from pam_antagonist.identification.between import Deviations

Floats = NDArray[np.float64]

LEAST, LARGEST = 1e-4, 0.5
"""Spreads that are considered, relative."""
_ALIKE = 1.0
"""Standard deviation of the logarithm of a group's spread about the common one."""
_USUAL = 0.02
"""A spread that would not surprise; larger ones have to be shown by the data (half Cauchy)."""


@dataclass(frozen=True, eq=False)
class Local:
    """What one trial says about the K values that it sees: free parameters, then its start.

    Attributes:
        information: JᵀJ of its weighted residuals (K, K).
        pull: Jᵀ(J θ − r) (K,): where it wants them.
        memory: by channel, how many blocks tell as much as one.
    """

    information: Floats
    pull: Floats
    memory: Floats


def log_evidence(trials: Sequence[Local], between: Floats) -> float:
    """log Z of a spread, up to a constant.

    Args:
        trials: what each says.
        between: what deviations of one standard deviation do to the free parameters (F, G).
    """
    count, ways = between.shape
    starts = len(trials[0].information) - count
    size = count + len(trials) * (ways + starts)
    information, pull = np.eye(size), np.zeros(size)
    for index, trial in enumerate(trials):
        seen = np.zeros((count + starts, size))
        first = count + index * (ways + starts)
        seen[:count, :count] = np.eye(count)
        seen[:count, first : first + ways] = between
        seen[count:, first + ways : first + ways + starts] = np.eye(starts)
        information += seen.T @ trial.information @ seen
        pull += seen.T @ trial.pull
    _, volume = np.linalg.slogdet(information)
    return float(0.5 * pull @ np.linalg.solve(information, pull) - 0.5 * volume)


def most_likely_spread(trials: Sequence[Local], deviations: Deviations) -> tuple[Floats, float]:
    """The spread of each group at which evidence and prior are highest.

    Groups that the recordings tell little about follow the others: the logarithm of each group's spread is normal
    about a common one.

    Args:
        trials: what each says, at least two.
        deviations: directions and groups.

    Returns:
        The relative spread of each direction (G,), and by how much the logarithm of the evidence is higher with them
        than without any.
    """
    groups = int(deviations.group.max()) + 1
    low, high = np.log(LEAST), np.log(LARGEST)

    def spread(unknown: Floats) -> Floats:
        return np.asarray(np.exp(np.clip(unknown[0] + _ALIKE * unknown[1:], low, high))[deviations.group])

    def against(unknown: Floats) -> float:
        common = float(np.exp(np.clip(unknown[0], low, high)))
        prior = float(np.log1p((common / _USUAL) ** 2) + 0.5 * np.sum(unknown[1:] ** 2))
        return -log_evidence(trials, spread(unknown) * deviations.shape) + prior

    # Coarse over the common spread, then all together.
    grid = np.linspace(low, high, 18)
    first = grid[int(np.argmin([against(np.concatenate(([x], np.zeros(groups)))) for x in grid]))]
    start = np.concatenate(([first], np.zeros(groups)))
    simplex = np.vstack([start, start + 0.5 * np.eye(groups + 1)])
    options = {"xatol": 0.02, "fatol": 0.01, "maxfev": 400, "initial_simplex": simplex}
    found = minimize(against, start, method="Nelder-Mead", options=options)
    best = spread(found.x)
    none = log_evidence(trials, LEAST * deviations.shape)
    return best, log_evidence(trials, best * deviations.shape) - none
