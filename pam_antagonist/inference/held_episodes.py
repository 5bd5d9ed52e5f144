"""Split of many episodes into those that a fit may see, and those that are held out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.intp]

FIFTH = 5


@dataclass(frozen=True, eq=False)
class EpisodeSplit:
    """Split of the episodes, as indices."""

    pool: Indices  # episodes that may be fitted (E,)
    interleaved: Indices
    later: Indices


def held_out(episodes: int, share: float) -> EpisodeSplit:
    """Hold out the last share of the episodes, and every fifth of the others."""
    before = np.arange(round(episodes * (1.0 - share)))
    fifth = before % FIFTH == FIFTH - 1
    return EpisodeSplit(before[~fifth], before[fifth], np.arange(len(before), episodes))


def thinned(episodes: Indices, most: int) -> Indices:
    """At most ``most`` of the episodes, evenly spread."""
    if len(episodes) <= most:
        return episodes
    return episodes[np.linspace(0, len(episodes) - 1, most).round().astype(int)]
