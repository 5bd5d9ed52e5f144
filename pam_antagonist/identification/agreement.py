"""Do the recordings come from one rig, and how much do they disagree?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.between import Variation
from pam_antagonist.identification.fit import Fit

_IMPLAUSIBLE = 3.0
"""Standard deviations of the prior by which one and the same rig does not differ between two recordings."""
_CERTAIN = 2.0
"""Standard errors from which on a difference is called one."""


@dataclass(frozen=True)
class Difference:
    """How far the recordings lie apart in one direction, relative.

    Attributes:
        name: of the direction.
        deviations: of each recording from the common value.
        largest: difference of the two that lie furthest apart.
        std: its standard error.
        limit: difference beyond which they are taken for different rigs.
        pair: which recordings these are.
    """

    name: str
    deviations: tuple[float, ...]
    largest: float
    std: float
    limit: float
    pair: tuple[int, int]

    @property
    def certain(self) -> bool:
        """Whether it is more than noise."""
        return abs(self.largest) > _CERTAIN * self.std


def differences(found: Fit, ways: tuple[Variation, ...]) -> list[Difference]:
    """All differences between the recordings, the largest in standard errors first.

    Args:
        found: a fit in which trials may deviate.
        ways: the directions, in the order of the fit's.
    """
    problem = found.problem
    if problem.between is None or found.spread is None:
        return []
    trials, free = len(problem.trials), {item.name: item for item in problem.free}
    count, own = len(problem.free), problem.between.shape[1] + 3
    out = []
    for g, way in enumerate(ways):
        at = [count + index * own + g for index in range(trials)]
        values = found.spread[g] * found.theta[at]
        first, last = int(np.argmin(values)), int(np.argmax(values))
        pick = np.zeros(problem.size)
        pick[at[first]], pick[at[last]] = -found.spread[g], found.spread[g]
        std = float(np.sqrt(pick @ found.full @ pick))
        relative = [free[name].prior_std / abs(change) for name, change in way.changes.items() if change]
        limit = _IMPLAUSIBLE * min(max(relative), 0.2)
        out.append(
            Difference(
                way.name,
                tuple(float(v) for v in values),
                float(values[last] - values[first]),
                std,
                limit,
                (first, last),
            )
        )
    return sorted(out, key=lambda item: -abs(item.largest) / max(item.std, 1e-12))


def check_same_rig(found: Fit, ways: tuple[Variation, ...]) -> None:
    """Refuse recordings that cannot be of one rig.

    Args:
        found: a fit in which trials may deviate.
        ways: the directions, in the order of the fit's.

    Raises:
        BadInput: two recordings differ by more than three standard deviations of the prior.
    """
    beyond = [item for item in differences(found, ways) if item.largest - _CERTAIN * item.std > item.limit]
    if beyond:
        worst = max(beyond, key=lambda item: item.largest / item.limit)
        low, high = (found.problem.trials[index].name for index in worst.pair)
        raise BadInput(
            f"{high} and {low} are not recordings of one rig: {worst.name} differs by {100 * worst.largest:.0f} % "
            f"(at most {100 * worst.limit:.0f} % is plausible); identify them one by one"
        )
